//! A wave of contraction that narrows and shortens a finished tube: frames of one period, which
//! share the vertices and triangles of the surface at rest.
//!
//! The tissue keeps its volume; the lumen gives way. In each section the wave closes a fraction of
//! the lumen and shortens the tube. The cross section of the tissue grows by as much as the tube is
//! shortened: the wall contracts and thickens, and the mucosa thickens into the lumen (`level`).
//! Where there is no room for that, the wave is weaker. Lean (`shift`) and course are applied to
//! the contracted tube.
//!
//! An exact search (`intersection`) finds triangles of a frame that still intersect. Around them,
//! first the mucosa moves less, then the lean is damped, then the wave is weakened, until no
//! triangles intersect. This terminates, because the surface at rest does not intersect itself.

mod level;
mod shift;
#[cfg(test)]
mod tests;
mod wave;

pub use wave::{Contraction, Station};

use super::bend;
use super::intersection::{IntersectionSearch, middle_of};
use super::lean::{Centre, Lean, LeanField, in_um, remainder};
use crate::geometry::course::Course;
use crate::model::{Mesh, PatchKind};
use level::{ContractedShape, Level, area};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shift::Shift;
use std::collections::{BTreeMap, BTreeSet};
use wave::Wave;

/// Maximum number of damping rounds per frame.
const ROUNDS: u32 = 40;
const DAMP_LEAN_FROM_ROUND: u32 = 3;
const HALVE_WAVE_FROM_ROUND: u32 = 24;
const HALVE_ALL_FROM_ROUND: u32 = 32;
const GIVE_UP_ROUND: u32 = 38;
/// Reach of damping across the tube and along it, µm.
const REACH: [f64; 2] = [60.0, 300.0];
const REMAINDER: f64 = 0.5;
/// Fraction of the lean that a place loses per round. A larger fraction changes the lean so steeply
/// that triangles around the place intersect.
const DAMPING: f64 = 0.15;
const UNUSED: u32 = u32::MAX;

/// Surface at rest.
pub struct Rest<'a> {
    /// Straight surface, with its lean.
    pub straight: &'a Mesh,
    /// z of the lofted vertices before the lean, m. The lofted vertices come first.
    pub z: &'a [f32],
    /// Edges whose midpoints are the other vertices, in the order of the vertices.
    pub split: &'a [(u32, u32)],
    /// Lean of the surface.
    pub lean: Option<&'a Lean>,
    /// Course along which the surface is bent.
    pub course: Option<&'a Course>,
}

/// Statistics of the contraction: intersecting triangles, and the damping that separated them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Contracted {
    /// Number of pairs of triangles that intersected before damping, in all frames.
    pub met: usize,
    /// Number of places at which the motion of the mucosa was damped.
    pub damped: usize,
    /// Number of places at which the lean of frames was damped.
    pub lean_damped: usize,
    /// Number of rounds of damping.
    pub rounds: u32,
    /// Minimum factor on the wave, without its rise at the ends: 1 if there is room for the whole
    /// wave everywhere.
    pub least_factor: f64,
    /// Place of the minimum factor, mm from the isthmus end.
    pub least_factor_at_mm: f64,
}

/// Surface at one moment of the contraction.
pub struct Frame {
    /// Surface of the tissue.
    pub mesh: Mesh,
    /// Length of the tube along its centre line, µm.
    pub length_um: f64,
    /// Maximum fraction of the lumen of a section that is closed.
    pub closed: f64,
    /// Maximum fraction by which the outer wall of a section is narrower than at rest.
    pub narrowed: f64,
}

/// Contracting tube: computes its frames.
pub struct Contracting<'a> {
    rest: Rest<'a>,
    levels: Vec<Level>,
    /// z of each section at rest, µm.
    places: Vec<f64>,
    /// Field of the lean, and the lean of each section.
    field: Option<LeanField<'a>>,
    shifts: Vec<Shift>,
    wave: Wave,
    /// Factor on the wave in each section.
    factors: Vec<f64>,
    ends_um: f64,
    done: Contracted,
}

impl<'a> Contracting<'a> {
    /// Prepares the contraction: computes for each section which part of the wave it has room for.
    #[must_use]
    pub fn new(rest: Rest<'a>, by: &Contraction) -> Self {
        let levels = levels(&rest);
        let places: Vec<f64> = levels.iter().map(|level| in_um(rest.z[level.inner[0] as usize])).collect();
        let wave = Wave::new(by, &places);
        let factors = levels.par_iter().zip(&wave.at).map(|(level, (station, _))| level.limit(station, 1.0)).collect();
        let field = rest.lean.map(LeanField::new);
        let shift = |field| {
            let leaned = |v: u32| in_um(rest.straight.positions[v as usize][2]);
            levels.par_iter().zip(&places).map(|(level, &z)| Shift::new(level, z, field, leaned)).collect()
        };
        let shifts = field.as_ref().map(shift).unwrap_or_default();
        let done =
            Contracted { met: 0, damped: 0, lean_damped: 0, rounds: 0, least_factor: 1.0, least_factor_at_mm: 0.0 };
        let mut of = Self { rest, levels, places, field, shifts, wave, factors, ends_um: by.ends_um, done };
        of.ease();
        of
    }

    /// Statistics of the frames computed so far.
    #[must_use]
    pub fn done(&self) -> Contracted {
        let [first, last] = [self.places[0], self.places[self.places.len() - 1]];
        let rises = |z: f64| ((z - first).min(last - z) / self.ends_um).min(1.0);
        let parts = self.places.iter().zip(&self.factors).map(|(&z, &factor)| {
            let full = rises(z);
            // Factors are sums, so they differ from the rise by rounding errors.
            (if factor < full - 1e-9 { factor / full } else { 1.0 }, z)
        });
        let (least, at) = parts.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((1.0, 0.0));
        Contracted { least_factor: least, least_factor_at_mm: at / 1000.0, ..self.done }
    }

    /// Frame at a time, in periods, without intersecting triangles. Damping stays in effect for
    /// later frames. `stop` is called between rounds; if it returns true, the frame is returned as
    /// it is.
    pub fn frame(&mut self, time: f64, stop: &dyn Fn() -> bool) -> Frame {
        let mut frame = self.place(time);
        let mut search = IntersectionSearch::new(&frame.mesh);
        let mut pairs = search.all_pairs(&frame.mesh);
        self.done.met += pairs.len();
        for round in 0..ROUNDS {
            if pairs.is_empty() || stop() {
                break;
            }
            self.done.rounds += 1;
            self.damp(&pairs, round);
            let moved = self.place(time);
            let has_moved = |v: &u32| moved.mesh.positions[*v as usize] != frame.mesh.positions[*v as usize];
            let triangles = &frame.mesh.triangles;
            let mut is_changed: Vec<bool> = triangles.par_iter().map(|t| t.iter().any(has_moved)).collect();
            pairs.as_flattened().iter().for_each(|&t| is_changed[t as usize] = true);
            search.update(&moved.mesh, |t| is_changed[t]);
            pairs = search.pairs_touching(&moved.mesh, |t| is_changed[t]);
            frame = moved;
        }
        frame
    }

    /// Limits how steeply the factors change along the tube, from zero at both ends.
    fn ease(&mut self) {
        let n = self.factors.len();
        self.factors[0] = 0.0;
        self.factors[n - 1] = 0.0;
        for i in 1..n {
            let rise = (self.places[i] - self.places[i - 1]) / self.ends_um;
            self.factors[i] = self.factors[i].min(self.factors[i - 1] + rise);
        }
        for i in (1..n).rev() {
            let rise = (self.places[i] - self.places[i - 1]) / self.ends_um;
            self.factors[i - 1] = self.factors[i - 1].min(self.factors[i] + rise);
        }
    }

    /// Frame at a time with the damping so far. Its triangles may intersect.
    #[must_use]
    pub fn place(&self, time: f64) -> Frame {
        let moved: Vec<(ContractedShape, Vec<[f64; 3]>)> =
            (0..self.levels.len()).into_par_iter().map(|k| self.section(k, time)).collect();
        let mut along = vec![self.places[0]];
        for k in 1..self.places.len() {
            let stretch = 0.5 * (moved[k - 1].0.stretch + moved[k].0.stretch);
            along.push(along[k - 1] + stretch * (self.places[k] - self.places[k - 1]));
        }
        let straight = self.rest.straight;
        let mut positions = straight.positions.clone();
        // z before the tube is shortened, µm.
        let mut z: Vec<f64> = positions.iter().map(|p| in_um(p[2])).collect();
        for (level, (shape, points)) in self.levels.iter().zip(&moved) {
            for (&v, &[x, y, at]) in level.inner.iter().zip(points) {
                put(&mut positions, v, [x, y]);
                z[v as usize] = at;
            }
            if shape.outer != 1.0 {
                for &v in &level.outer {
                    let [x, y, _] = straight.positions[v as usize].map(in_um);
                    put(&mut positions, v, [x, y].map(|x| shape.outer * x));
                }
            }
        }
        for (m, &(v, w)) in (self.rest.z.len()..).zip(self.rest.split) {
            let ([ax, ay, _], [bx, by, _]) = (positions[v as usize].map(in_um), positions[w as usize].map(in_um));
            put(&mut positions, m as u32, [0.5 * (ax + bx), 0.5 * (ay + by)]);
            let by = |v: u32| z[v as usize] - in_um(straight.positions[v as usize][2]);
            z[m] += 0.5 * (by(v) + by(w));
        }
        positions.par_iter_mut().zip(&z).for_each(|(p, &z)| p[2] = (self.moved_along(&along, z) * 1e-6) as f32);
        let mesh = Mesh { positions, ..straight.clone() };
        Frame {
            mesh: self.rest.course.map_or_else(|| mesh.clone(), |course| bend::bend(&mesh, course)),
            length_um: along[along.len() - 1] - along[0],
            closed: moved.iter().map(|(shape, _)| shape.closed).fold(0.0, f64::max),
            narrowed: moved.iter().map(|(shape, _)| 1.0 - shape.outer).fold(0.0, f64::max),
        }
    }

    /// Shape of section `k` at a time, and the points of its inner contour before the tube is
    /// shortened, µm.
    fn section(&self, k: usize, time: f64) -> (ContractedShape, Vec<[f64; 3]>) {
        let (level, station) = (&self.levels[k], &self.wave.at[k].0);
        let part = self.factors[k] * self.wave.rise(k, time);
        let shape = level.shape(station, part * station.closure, 1.0 - part * station.shortening);
        let z = |i: usize, p| match (&self.field, self.shifts.get(k)) {
            (Some(field), Some(shift)) => self.places[k] + shift.at(i, p, field),
            _ => self.places[k],
        };
        let points = level.moved(shape.depth).enumerate().map(|(i, p)| {
            let [x, y] = p.map(|x| shape.inner * x);
            [x, y, z(i, p)]
        });
        (shape, points.collect())
    }

    /// Place along the shortened tube, µm.
    fn moved_along(&self, along: &[f64], z: f64) -> f64 {
        let after = self.places.partition_point(|&place| place <= z).clamp(1, self.places.len() - 1);
        let [a, b] = [self.places[after - 1], self.places[after]];
        along[after - 1] + (z - a) / (b - a) * (along[after] - along[after - 1])
    }

    /// Reduces the motion of the mucosa around intersecting pairs. Later rounds also damp the lean,
    /// and then weaken the wave.
    fn damp(&mut self, pairs: &[[u32; 2]], round: u32) {
        let straight = self.rest.straight;
        let (mut centres, mut upright) = (Vec::new(), Vec::new());
        for &pair in pairs {
            let middle = middle_of(straight, pair, |v| {
                let [x, y, _] = straight.positions[v as usize].map(in_um);
                [x, y, self.level_z(v)]
            });
            Centre::add(&mut centres, middle, REACH);
            if let Some(lean) = self.rest.lean.filter(|_| (DAMP_LEAN_FROM_ROUND..GIVE_UP_ROUND).contains(&round)) {
                Centre::add_to_lean(&mut upright, middle, lean);
            }
        }
        self.done.damped += centres.len();
        if round < HALVE_WAVE_FROM_ROUND {
            self.done.lean_damped += upright.len();
        }
        let sections = self.levels.par_iter().zip(&mut self.shifts);
        sections.for_each(|(level, shift)| match round {
            ..HALVE_WAVE_FROM_ROUND => shift.damp(&level.points, &upright, DAMPING),
            HALVE_WAVE_FROM_ROUND..GIVE_UP_ROUND => shift.restore(&level.points, &upright, REMAINDER),
            _ => shift.restore_all(),
        });
        let (places, centres) = (&self.places, &centres);
        self.levels.par_iter_mut().zip(&mut self.factors).enumerate().for_each(|(k, (level, factor))| {
            let near: Vec<&Centre> = centres.iter().filter(|centre| centre.is_near(places[k])).collect();
            for (p, most) in level.points.iter().zip(&mut level.most) {
                let squares = near.iter().map(|centre| centre.square([p[0], p[1], places[k]]));
                *most *= remainder(squares.fold(f64::INFINITY, f64::min), 1.0 - REMAINDER).unwrap_or(1.0);
            }
            let is_near = near.iter().any(|centre| (places[k] - centre.place[2]).abs() < REACH[1]);
            if round >= GIVE_UP_ROUND {
                *factor = 0.0;
            } else if round >= HALVE_ALL_FROM_ROUND || (round >= HALVE_WAVE_FROM_ROUND && is_near) {
                *factor *= REMAINDER;
            }
        });
        let limits = self.levels.par_iter().zip(&self.wave.at).zip(&self.factors);
        self.factors = limits.map(|((level, (station, _)), &factor)| level.limit(station, factor)).collect();
        self.ease();
    }

    /// z of a vertex before the lean, µm.
    fn level_z(&self, v: u32) -> f64 {
        match (v as usize).checked_sub(self.rest.z.len()) {
            None => in_um(self.rest.z[v as usize]),
            Some(m) => {
                let (v, w) = self.rest.split[m];
                0.5 * (self.level_z(v) + self.level_z(w))
            }
        }
    }
}

/// Volume of the lumen of a tissue with planar ends, mm³.
#[must_use]
pub fn lumen_mm3(tissue: &Mesh) -> f64 {
    let corner = |v: u32| tissue.positions[v as usize].map(|x| f64::from(x) * 1e3);
    let origin = tissue.triangles.first().map_or([0.0; 3], |t| corner(t[0]));
    let volume = |a: [f64; 3], b: [f64; 3], c: [f64; 3]| {
        let [a, b, c] = [a, b, c].map(|p| glam::DVec3::from(p) - glam::DVec3::from(origin));
        a.dot(b.cross(c)) / 6.0
    };
    let inner = tissue.patch(PatchKind::InnerWall);
    let mut rims = BTreeSet::new();
    for &[a, b, c] in inner {
        for (v, w) in [(a, b), (b, c), (c, a)] {
            if !rims.remove(&(w, v)) {
                rims.insert((v, w));
            }
        }
    }
    // Each rim is closed by a fan from one of its points. The fan may leave the rim, because it
    // lies in the rim's plane.
    let mut next: BTreeMap<u32, u32> = rims.into_iter().collect();
    let mut sum: f64 = inner.iter().map(|t| volume(corner(t[0]), corner(t[1]), corner(t[2]))).sum();
    while let Some((start, mut at)) = next.pop_first() {
        while let Some(to) = next.remove(&at) {
            sum += volume(corner(start), corner(to), corner(at));
            at = to;
        }
    }
    sum.abs()
}

fn put(positions: &mut [[f32; 3]], v: u32, [x, y]: [f64; 2]) {
    let p = &mut positions[v as usize];
    (p[0], p[1]) = ((x * 1e-6) as f32, (y * 1e-6) as f32);
}

/// Sections of a lofted surface, by ascending z.
fn levels(rest: &Rest<'_>) -> Vec<Level> {
    let n = rest.z.len();
    // Neighbours of a vertex in its section. In a leaning surface the edges of a section may be
    // split.
    let mut beside = vec![[UNUSED; 2]; n];
    let mut is_inner = vec![false; n];
    for kind in [PatchKind::InnerWall, PatchKind::OuterWall] {
        for triangle in rest.straight.patch(kind) {
            let [a, b, c] = *triangle;
            for v in triangle {
                if let Some(is_inner) = is_inner.get_mut(*v as usize) {
                    *is_inner = kind == PatchKind::InnerWall;
                }
            }
            [(a, b), (b, c), (c, a)].into_iter().for_each(|edge| join(&mut beside, rest.z, edge));
        }
    }
    rest.split.iter().for_each(|&edge| join(&mut beside, rest.z, edge));
    let mut by_place: BTreeMap<u32, [Vec<u32>; 2]> = BTreeMap::new();
    let mut is_seen = vec![false; n];
    let place = |v: u32| {
        let [x, y, _] = rest.straight.positions[v as usize].map(in_um);
        [x, y]
    };
    for v in 0..n as u32 {
        if is_seen[v as usize] {
            continue;
        }
        let mut ring = vec![v];
        let (mut before, mut at) = (v, beside[v as usize][0]);
        while at != v && at != UNUSED {
            ring.push(at);
            let [a, b] = beside[at as usize];
            (before, at) = (at, if a == before { b } else { a });
        }
        ring.iter().for_each(|&v| is_seen[v as usize] = true);
        if area(ring.iter().map(|&v| place(v))) < 0.0 {
            ring.reverse();
        }
        // The bits of non-negative floats are ordered like the floats.
        let rings = by_place.entry(rest.z[v as usize].max(0.0).to_bits()).or_default();
        rings[usize::from(!is_inner[v as usize])] = ring;
    }
    let rings: Vec<[Vec<u32>; 2]> = by_place.into_values().collect();
    rings.into_par_iter().map(|[inner, outer]| Level::new(inner, outer, place)).collect()
}

/// Makes the ends of an edge neighbours if both belong to one section.
fn join(beside: &mut [[u32; 2]], z: &[f32], (v, w): (u32, u32)) {
    if z.get(v as usize).is_none_or(|at| z.get(w as usize) != Some(at)) {
        return;
    }
    for (v, w) in [(v, w), (w, v)] {
        let of = &mut beside[v as usize];
        if let Some(free) = of.iter().position(|&x| x == w || x == UNUSED) {
            of[free] = w;
        }
    }
}
