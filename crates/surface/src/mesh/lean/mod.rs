//! The lean: displaces a finished surface along the tube, by different amounts at different places
//! of a section.
//!
//! The displacement is a continuous map of space. The map is injective while its derivative along z
//! stays below 1, so strengths that could be steeper are reduced first. A smooth surface then
//! cannot intersect itself, but flat triangles can. An exact search (`intersection`) finds
//! intersecting triangles, and the displacement is damped around them until none intersect. This
//! terminates, because the lofted surface does not intersect itself.

mod cosine;
mod field;
#[cfg(test)]
pub(super) mod tests;

pub(super) use field::LeanField;
pub use field::{Lean, Station};

use super::intersection::{IntersectionSearch, middle_of};
use crate::model::Mesh;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Fraction of the displacement that a place loses per round: in the first rounds, and later, when
/// few places are left.
const DAMPING: [f64; 2] = [0.15, 0.5];
/// Number of first rounds.
const GENTLE: u32 = 8;
/// Reach of damping across the tube, as a fraction of the wavelength, and along it, as a multiple
/// of the distance of sections.
const ACROSS: f64 = 0.225;
const ALONG: f64 = 1.5;
/// Distance at which damping ends, in reaches.
const FAR: f64 = 3.0;
/// Rounds of damping before the whole displacement is scaled down, and the factor.
const ROUNDS: u32 = 24;
const SCALE: f64 = 0.7;
/// With more intersecting pairs than this, the displacement is scaled down immediately.
const MOST_PAIRS: usize = 10_000;
/// Maximum derivative of the displacement along z, by the estimate of [`Lean::steepness`].
const STEEPEST: f64 = 0.9;
/// Maximum number of times that the displacement is scaled down; after that it is zero.
const SCALINGS: u32 = 6;

/// Number of vertices that are compared with a centre together. Vertices of the same z follow their
/// contour, so they are close.
const RUN: usize = 64;

/// Statistics of the lean: intersecting triangles, and the damping that separated them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Leaned {
    /// Number of pairs of triangles that intersected before damping.
    pub met: usize,
    /// Number of places at which the displacement was damped.
    pub damped: usize,
    /// Number of rounds of damping.
    pub rounds: u32,
    /// Factor on the whole displacement: 1 unless the displacement was too steep or damping around
    /// places did not suffice.
    pub scale: f64,
}

/// Surface during its displacement.
struct LeaningSurface<'a> {
    mesh: &'a mut Mesh,
    field: LeanField<'a>,
    /// z before the displacement, m.
    z: Vec<f32>,
    /// Fraction of the displacement that remains.
    left: Vec<f64>,
    /// Vertices that can be displaced, by ascending z.
    order: Vec<u32>,
    /// Minima and maxima of x and y of each [`RUN`] of `order`, µm.
    boxes: Vec<[[f64; 2]; 2]>,
}

/// Displaces a surface along the tube. `stop` is called between rounds; if it returns true, the
/// surface stays as it is.
#[inline(never)] // counted by scripts/counts
pub fn lean(mesh: &mut Mesh, lean: &Lean, stop: &dyn Fn() -> bool) -> Leaned {
    let z = mesh.positions.iter().map(|p| p[2]).collect();
    let field = LeanField::new(lean);
    let mut surface = LeaningSurface { mesh, field, z, left: Vec::new(), order: Vec::new(), boxes: Vec::new() };
    let mut done = Leaned::default();
    let at_first = (STEEPEST / lean.steepness()).min(1.0);
    for scaling in 0..=SCALINGS {
        done.scale = if scaling == SCALINGS { 0.0 } else { at_first * SCALE.powi(scaling as i32) };
        surface.displace_all(done.scale);
        let mut search = IntersectionSearch::new(surface.mesh);
        // Triangles that have not moved do not intersect each other.
        let has_moved = |v: usize| surface.mesh.positions[v][2] != surface.z[v];
        let mut pairs = search.pairs_touching(surface.mesh, |t| surface.has_corner(t, has_moved));
        done.met = done.met.max(pairs.len());
        for round in 0..ROUNDS {
            if pairs.is_empty() || stop() {
                return done;
            }
            if pairs.len() > MOST_PAIRS {
                break;
            }
            let centres = surface.centres(&pairs, lean);
            done.damped += centres.len();
            done.rounds += 1;
            pairs = surface.damp(&centres, DAMPING[usize::from(round >= GENTLE)], &mut search);
        }
        if pairs.is_empty() {
            return done;
        }
    }
    done
}

pub(super) fn in_um(metres: f32) -> f64 {
    f64::from(metres) * 1e6
}

/// Place around which a displacement is damped, and the reach of damping across and along the tube,
/// µm.
pub(super) struct Centre {
    pub(super) place: [f64; 3],
    reach: [f64; 2],
}

impl Centre {
    /// Adds a place unless another one is near.
    pub(super) fn add(centres: &mut Vec<Self>, place: [f64; 3], reach: [f64; 2]) {
        if !centres.iter().rev().any(|centre| centre.square(place) < 0.25) {
            centres.push(Self { place, reach });
        }
    }

    /// Adds a place around which the lean is damped, unless another one is near.
    pub(super) fn add_to_lean(centres: &mut Vec<Self>, place: [f64; 3], lean: &Lean) {
        Self::add(centres, place, [ACROSS * lean.wavelength_um, ALONG * lean.spacing_um(place[2])]);
    }

    /// Fraction of the displacement that remains at a place; `None` beyond the reach.
    pub(super) fn remainder(&self, p: [f64; 3], damping: f64) -> Option<f64> {
        remainder(self.square(p), damping)
    }

    /// True if damping reaches the section at `z_um`.
    pub(super) fn is_near(&self, z_um: f64) -> bool {
        (z_um - self.place[2]).abs() < FAR * self.reach[1]
    }

    /// Squared distance of a point, in reaches.
    pub(super) fn square(&self, p: [f64; 3]) -> f64 {
        let d = [0, 1, 2].map(|axis| p[axis] - self.place[axis]);
        (d[0] * d[0] + d[1] * d[1]) / (self.reach[0] * self.reach[0]) + d[2] * d[2] / (self.reach[1] * self.reach[1])
    }
}

/// Fraction of a displacement that remains at a squared distance in reaches; `None` beyond the
/// reach.
pub(super) fn remainder(square: f64, damping: f64) -> Option<f64> {
    (square < FAR * FAR).then(|| 1.0 - damping * libm::exp(-square / 2.0))
}

impl LeaningSurface<'_> {
    /// Position of a vertex before the displacement, µm.
    fn place(&self, v: usize) -> [f64; 3] {
        let [x, y, _] = self.mesh.positions[v];
        [x, y, self.z[v]].map(in_um)
    }

    /// Displaces all vertices by a fraction of the field.
    fn displace_all(&mut self, scale: f64) {
        self.left = Vec::new();
        let mut full: Vec<f64> = (0..self.z.len()).into_par_iter().map(|v| self.field.at(self.place(v))).collect();
        self.order = (0..full.len() as u32).collect();
        self.order.retain(|&v| full[v as usize] != 0.0);
        self.order.shrink_to_fit();
        self.order.sort_by(|&a, &b| self.z[a as usize].total_cmp(&self.z[b as usize]));
        let box_of = |run: &[u32]| {
            [0, 1].map(|axis| {
                let along = || run.iter().map(|&v| in_um(self.mesh.positions[v as usize][axis]));
                [along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max)]
            })
        };
        self.boxes = self.order.chunks(RUN).map(box_of).collect();
        for (v, &full) in full.iter().enumerate().filter(|(_, full)| **full != 0.0) {
            self.displace(v, scale * full);
        }
        // The displacement of the few vertices that damping moves is computed again.
        full.fill(scale);
        self.left = full;
    }

    /// Displaces a vertex from its first position.
    fn displace(&mut self, v: usize, by_um: f64) {
        self.mesh.positions[v][2] = ((in_um(self.z[v]) + by_um) * 1e-6) as f32;
    }

    /// True if a triangle has at least one of some vertices.
    fn has_corner(&self, t: usize, is_one: impl Fn(usize) -> bool) -> bool {
        self.mesh.triangles[t].iter().fold(false, |is, &v| is | is_one(v as usize))
    }

    /// Midpoints of intersecting pairs before the displacement, thinned out.
    fn centres(&self, pairs: &[[u32; 2]], lean: &Lean) -> Vec<Centre> {
        let mut centres: Vec<Centre> = Vec::new();
        for &pair in pairs {
            Centre::add_to_lean(&mut centres, middle_of(self.mesh, pair, |v| self.place(v as usize)), lean);
        }
        centres
    }

    /// Damps the displacement around the centres and returns the pairs that intersect afterwards.
    /// All earlier pairs lie near a centre.
    fn damp(&mut self, centres: &[Centre], damping: f64, search: &mut IntersectionSearch) -> Vec<[u32; 2]> {
        let mut is_moved = vec![false; self.z.len()];
        for centre in centres {
            let (z, far) = (centre.place[2], FAR * centre.reach[1]);
            let z_of = |v: &u32| in_um(self.z[*v as usize]);
            let first = self.order.partition_point(|v| z_of(v) < z - far);
            let end = self.order.partition_point(|v| z_of(v) <= z + far);
            for run in first / RUN..end.div_ceil(RUN) {
                let [x, y] = [0, 1].map(|axis| {
                    let [low, high] = self.boxes[run][axis];
                    centre.place[axis].clamp(low, high)
                });
                // Rounding is monotone, so no vertex in the box is nearer than this place.
                if centre.remainder([x, y, z], damping).is_none() {
                    continue;
                }
                for &v in &self.order[first.max(run * RUN)..end.min((run + 1) * RUN)] {
                    let v = v as usize;
                    if let Some(remainder) = centre.remainder(self.place(v), damping) {
                        self.left[v] *= remainder;
                        is_moved[v] = true;
                    }
                }
            }
        }
        for v in (0..is_moved.len()).filter(|&v| is_moved[v]) {
            self.displace(v, self.left[v] * self.field.at(self.place(v)));
        }
        let is_changed = |t: usize| self.has_corner(t, |v| is_moved[v]);
        search.update(self.mesh, is_changed);
        search.pairs_touching(self.mesh, is_changed)
    }
}
