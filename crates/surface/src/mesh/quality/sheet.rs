//! A wall between two section planes as a smooth sheet: a map from places (u, z) to points in
//! space.
//!
//! u is the arc length along the last section of the sheet. A particle keeps its u in all sections.
//! Positions are interpolated linearly between neighbouring particles and between neighbouring
//! sections. Each cross section is therefore a contour whose particles are on their straight paths,
//! and these never cross (docs/physics.md). Distances on the sheet differ little from distances in
//! (u, z), because particles move by about a hundredth of the distance between sections.

use super::error::RemeshError;
use crate::geometry::vector::{distance, lerp};
use crate::model::Ring;

/// Contour of a section, beginning with the first particle of the sheet.
pub(super) struct Level {
    /// Place along the tube, µm.
    pub(super) z: f64,
    /// u of each particle, increasing from 0.
    pub(super) u: Vec<f64>,
    /// Positions of the particles, µm.
    pub(super) points: Vec<[f64; 2]>,
    /// Index of the first particle in the ring of the section.
    pub(super) turn: usize,
    /// Last particle before each of equally long intervals of u; speeds up [`Level::find`].
    table: Vec<u32>,
    /// Period of the sheet.
    period: f64,
}

/// One wall between two section planes.
pub(super) struct Sheet {
    pub(super) levels: Vec<Level>,
    /// Length of the last contour. u and u + period are the same place.
    pub(super) period: f64,
}

impl Sheet {
    /// Builds the sheet of one wall through consecutive sections, given as rings with their z.
    pub(super) fn new(rings: &[(&Ring, f64)]) -> Result<Self, RemeshError> {
        let first = rings.first().and_then(|(ring, _)| ring.ids.first()).ok_or(RemeshError::Sections)?;
        let mut levels = Vec::with_capacity(rings.len());
        let mut period = 0.0;
        // Ids and u of the level above.
        let mut above: Option<(Vec<u32>, Vec<f64>)> = None;
        for &(ring, z) in rings.iter().rev() {
            let turn = ring.ids.iter().position(|id| id == first).ok_or(RemeshError::Sections)?;
            let ids: Vec<u32> = ring.ids[turn..].iter().chain(&ring.ids[..turn]).copied().collect();
            let points: Vec<[f64; 2]> =
                ring.points[turn..].iter().chain(&ring.points[..turn]).map(|p| p.map(f64::from)).collect();
            let u = match &above {
                None => {
                    let (u, length) = arc_lengths(&points);
                    period = length;
                    u
                }
                Some((ids_above, u_above)) => {
                    let mut next = ids_above.iter().zip(u_above);
                    let mut u = Vec::with_capacity(ids.len());
                    for id in &ids {
                        u.push(*next.find(|(other, _)| *other == id).ok_or(RemeshError::Sections)?.1);
                    }
                    u
                }
            };
            let table = table(&u, period);
            levels.push(Level { z, u: u.clone(), points, turn, table, period });
            above = Some((ids, u));
        }
        levels.reverse();
        Ok(Self { levels, period })
    }

    /// Representative of `u` that is nearest to `anchor`.
    #[inline]
    pub(super) fn near(&self, u: f64, anchor: f64) -> f64 {
        u - self.period * ((u - anchor) / self.period).round()
    }

    /// Index of the level at or below `z` that has a level above it.
    #[inline]
    pub(super) fn below(&self, z: f64) -> usize {
        self.levels.partition_point(|level| level.z <= z).clamp(1, self.levels.len() - 1) - 1
    }

    /// Heights of the levels between two heights.
    pub(super) fn heights_between(&self, low: f64, high: f64) -> impl Iterator<Item = f64> {
        let first = self.levels.partition_point(|level| level.z <= low);
        self.levels[first..].iter().map(|level| level.z).take_while(move |z| *z < high)
    }

    /// Calls `visit` for the places between two others at which the line between them crosses a
    /// particle's path or a level, in order of increasing u: with the place and its point in space.
    /// The wall has no edges between such places.
    #[inline]
    pub(super) fn crossed(&self, from: [f64; 2], to: [f64; 2], mut visit: impl FnMut([f64; 2], [f64; 3])) {
        let to = [self.near(to[0], from[0]), to[1]];
        let ([start, z], [end, z_end]) = if from[0] <= to[0] { (from, to) } else { (to, from) };
        let slope = if start < end { (z_end - z) / (end - start) } else { 0.0 };
        let (low, high) = (z.min(z_end), z.max(z_end));
        let k = self.below(low);
        let first = if self.levels[k].z > low { k } else { k + 1 };
        let count = self.levels[first..].iter().take_while(|level| level.z < high).count();
        // The level above the line has all particles of those below.
        let level = &self.levels[(first + count).clamp(k + 1, self.levels.len() - 1)];
        let mut passed = 0;
        // Visits levels before `until`; returns the slab in which the line continues.
        let mut pass_levels = |until: f64, visit: &mut dyn FnMut([f64; 2], [f64; 3])| {
            while passed < count {
                let at = self.levels[if z <= z_end { first + passed } else { first + count - 1 - passed }].z;
                let place = [start + (end - start) * (at - z) / (z_end - z), at];
                if place[0] > until {
                    break;
                }
                visit(place, self.point(place));
                passed += 1;
            }
            let above = if z <= z_end { first + passed } else { first + count - passed };
            above.clamp(1, self.levels.len() - 1) - 1
        };
        let mut shift = (start / self.period).floor() * self.period;
        let mut i = level.find((start - shift).clamp(0.0, self.period)) + 1;
        loop {
            if i == level.u.len() {
                i = 0;
                shift += self.period;
            }
            let u = level.u[i] + shift;
            if u >= end {
                pass_levels(f64::INFINITY, &mut visit);
                return;
            }
            if u > start {
                let place = [u, z + slope * (u - start)];
                let slab = pass_levels(u, &mut visit);
                visit(place, self.point_in(slab, place));
            }
            i += 1;
        }
    }

    /// Point in space at a place.
    #[inline]
    pub(super) fn point(&self, place: [f64; 2]) -> [f64; 3] {
        self.point_in(self.below(place[1]), place)
    }

    /// Point in space at a place in the slab above level `k`.
    #[inline]
    fn point_in(&self, k: usize, [u, z]: [f64; 2]) -> [f64; 3] {
        let [lower, upper] = [&self.levels[k], &self.levels[k + 1]];
        let u = u.rem_euclid(self.period);
        let [x, y] = lerp(lower.at(u), upper.at(u), (z - lower.z) / (upper.z - lower.z));
        [x, y, z]
    }
}

impl Level {
    /// Index of the particle at or before `u`, which must be between 0 and the period.
    #[inline]
    pub(super) fn find(&self, u: f64) -> usize {
        let part = (u / self.period * self.table.len() as f64) as usize;
        let mut i = self.table[part.min(self.table.len() - 1)] as usize;
        while i + 1 < self.u.len() && self.u[i + 1] <= u {
            i += 1;
        }
        i
    }

    /// Point at `u`, which must be between 0 and the period.
    #[inline]
    pub(super) fn at(&self, u: f64) -> [f64; 2] {
        let i = self.find(u);
        let (a, u0) = (self.points[i], self.u[i]);
        let (b, u1) =
            if i + 1 < self.u.len() { (self.points[i + 1], self.u[i + 1]) } else { (self.points[0], self.period) };
        lerp(a, b, (u - u0) / (u1 - u0))
    }

    /// Point in space at `u`, which may be any representative.
    pub(super) fn point(&self, u: f64) -> [f64; 3] {
        let [x, y] = self.at(u.rem_euclid(self.period));
        [x, y, self.z]
    }
}

/// Arc length from the first point to each point of a closed contour, and the whole length.
pub(super) fn arc_lengths(points: &[[f64; 2]]) -> (Vec<f64>, f64) {
    let mut length = 0.0;
    let u = (0..points.len())
        .map(|i| {
            let u = length;
            length += distance(points[i], points[(i + 1) % points.len()]);
            u
        })
        .collect();
    (u, length)
}

fn table(u: &[f64], period: f64) -> Vec<u32> {
    let parts = u.len();
    let mut table = Vec::with_capacity(parts);
    let mut i = 0;
    for part in 0..parts {
        // Starts slightly early, so that rounding never skips the particle.
        let begin = (part as f64 - 1e-6) / parts as f64 * period;
        while i + 1 < u.len() && u[i + 1] <= begin {
            i += 1;
        }
        table.push(i as u32);
    }
    table
}
