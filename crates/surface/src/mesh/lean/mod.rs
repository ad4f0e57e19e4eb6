//! The lean: displaces a finished surface along the tube, more in one place of a section than in another.
//!
//! The displacement is a continuous map of space. It is one to one if it changes by less than 1 along z, so a surface without
//! triangles, which it would move exactly, could not come to meet itself; strengths that could be too steep are reduced before.
//! Triangles are flat and can meet: where they do, the displacement is damped around the place, until none meet (`meeting`, exact).
//! Without displacement the surface is the lofted one, which does not meet itself, so this ends.

mod field;
mod stations;
#[cfg(test)]
pub(super) mod tests;

pub(super) use field::Field;
pub use stations::{Lean, Station};

use super::meeting::Meeting;
use crate::model::Mesh;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Share of the displacement that a place loses in each of the first rounds, and in later ones, when only stubborn places are left.
const DAMPING: [f64; 2] = [0.15, 0.5];
/// First rounds.
const GENTLE: u32 = 8;
/// Reach of damping across the tube, as a part of the wavelength, and along it in units of the distance of sections.
const ACROSS: f64 = 0.225;
const ALONG: f64 = 1.5;
/// Reaches at which damping ends.
const FAR: f64 = 3.0;
/// Rounds of damping before all displacement is scaled down, and the factor.
const ROUNDS: u32 = 24;
const SCALE: f64 = 0.7;
/// With more pairs that meet, the displacement is scaled down at once.
const MOST_PAIRS: usize = 10_000;
/// Most that the displacement may change along z, by the estimate of [`Lean::steepness`].
const STEEPEST: f64 = 0.9;
/// Times that it is scaled down; after that nothing is displaced.
const SCALINGS: u32 = 6;

/// What was done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Leaned {
    /// Pairs of triangles that met before damping.
    pub met: usize,
    /// Places at which the displacement was damped.
    pub damped: usize,
    /// Rounds of damping.
    pub rounds: u32,
    /// Factor on all displacement: 1 unless it was too steep, or damping around places did not suffice.
    pub scale: f64,
}

/// The surface while it is displaced.
struct Surface<'a> {
    mesh: &'a mut Mesh,
    /// z before, m.
    z: Vec<f32>,
    /// Full displacement, µm.
    full: Vec<f64>,
    /// Part of it that is left.
    left: Vec<f64>,
    /// Vertices by ascending z.
    order: Vec<u32>,
}

/// Displaces a surface. `stop` is asked between rounds; if it says so, the surface is left as it is then.
pub fn lean(mesh: &mut Mesh, lean: &Lean, stop: &dyn Fn() -> bool) -> Leaned {
    let field = Field::new(lean);
    let full: Vec<f64> = mesh.positions.par_iter().map(|p| field.at(p.map(in_um))).collect();
    let z: Vec<f32> = mesh.positions.iter().map(|p| p[2]).collect();
    let mut order: Vec<u32> = (0..z.len() as u32).collect();
    order.sort_by(|&a, &b| z[a as usize].total_cmp(&z[b as usize]));
    let left = vec![1.0; z.len()];
    let mut surface = Surface { mesh, z, full, left, order };
    let mut done = Leaned::default();
    let at_first = (STEEPEST / lean.steepness()).min(1.0);
    for scaling in 0..=SCALINGS {
        done.scale = if scaling == SCALINGS { 0.0 } else { at_first * SCALE.powi(scaling as i32) };
        surface.left.fill(done.scale);
        (0..surface.z.len()).for_each(|v| surface.displace(v));
        let mut meeting = Meeting::new(surface.mesh);
        let mut pairs = meeting.pairs(surface.mesh);
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
            pairs = surface.damp(&centres, DAMPING[usize::from(round >= GENTLE)], &mut meeting);
        }
        if pairs.is_empty() {
            return done;
        }
    }
    done
}

fn in_um(metres: f32) -> f64 {
    f64::from(metres) * 1e6
}

/// Where displacement is damped, and how far around, µm.
pub(super) struct Centre {
    place: [f64; 3],
    reach: [f64; 2],
}

impl Centre {
    /// Adds a place, unless another one is near.
    pub(super) fn add(centres: &mut Vec<Self>, place: [f64; 3], lean: &Lean) {
        if !centres.iter().rev().any(|centre| centre.square(place) < 0.25) {
            let along = ALONG * lean.spacing_um(place[2]);
            centres.push(Self { place, reach: [ACROSS * lean.wavelength_um, along] });
        }
    }

    /// The part of the displacement that is left at a place; none if the place is too far away.
    pub(super) fn left(&self, p: [f64; 3], damping: f64) -> Option<f64> {
        let square = self.square(p);
        (square < FAR * FAR).then(|| 1.0 - damping * libm::exp(-square / 2.0))
    }

    /// Whether damping reaches a section.
    pub(super) fn is_near(&self, z_um: f64) -> bool {
        (z_um - self.place[2]).abs() < FAR * self.reach[1]
    }

    /// Squared distance in reaches.
    fn square(&self, p: [f64; 3]) -> f64 {
        let d = [0, 1, 2].map(|axis| p[axis] - self.place[axis]);
        (d[0] * d[0] + d[1] * d[1]) / (self.reach[0] * self.reach[0]) + d[2] * d[2] / (self.reach[1] * self.reach[1])
    }
}

impl Surface<'_> {
    /// Place of a vertex before, µm.
    fn place(&self, v: usize) -> [f64; 3] {
        let [x, y, _] = self.mesh.positions[v];
        [x, y, self.z[v]].map(in_um)
    }

    /// Puts a vertex where it belongs now.
    fn displace(&mut self, v: usize) {
        if self.full[v] != 0.0 {
            self.mesh.positions[v][2] = ((in_um(self.z[v]) + self.left[v] * self.full[v]) * 1e-6) as f32;
        }
    }

    /// The middles of triangles that meet, as they were before they were displaced, without those that are near to another.
    fn centres(&self, pairs: &[[u32; 2]], lean: &Lean) -> Vec<Centre> {
        let mut centres: Vec<Centre> = Vec::new();
        for &[a, b] in pairs {
            let corners = [a, b].map(|t| self.mesh.triangles[t as usize]);
            let places = corners.as_flattened().iter().map(|&v| self.place(v as usize));
            let mut place = [0.0; 3];
            for p in places {
                for axis in 0..3 {
                    place[axis] += p[axis] / 6.0;
                }
            }
            Centre::add(&mut centres, place, lean);
        }
        centres
    }

    /// Takes a share of the displacement away around places, and returns the pairs of triangles that meet afterwards; all that met before
    /// lie there.
    fn damp(&mut self, centres: &[Centre], damping: f64, meeting: &mut Meeting) -> Vec<[u32; 2]> {
        let mut is_moved = vec![false; self.z.len()];
        for centre in centres {
            let (z, far) = (centre.place[2], FAR * centre.reach[1]);
            let first = self.order.partition_point(|&v| in_um(self.z[v as usize]) < z - far);
            for &v in &self.order[first..] {
                let v = v as usize;
                if in_um(self.z[v]) > z + far {
                    break;
                }
                if let Some(left) = centre.left(self.place(v), damping).filter(|_| self.full[v] != 0.0) {
                    self.left[v] *= left;
                    is_moved[v] = true;
                }
            }
        }
        (0..is_moved.len()).filter(|&v| is_moved[v]).for_each(|v| self.displace(v));
        let is_changed: Vec<bool> =
            self.mesh.triangles.iter().map(|t| t.iter().any(|&v| is_moved[v as usize])).collect();
        let changed: Vec<u32> =
            (0u32..).zip(&is_changed).filter(|(_, is_changed)| **is_changed).map(|(t, _)| t).collect();
        meeting.update(self.mesh, &changed);
        meeting.pairs_of(self.mesh, &changed, &is_changed)
    }
}
