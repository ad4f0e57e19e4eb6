//! One wall between two sections as a smooth sheet: every place (u, z) of a plane strip has a point in space.
//!
//! u is the arc length along the last section of the sheet; a particle keeps its u in all of them. Between neighbouring
//! particles and between neighbouring sections positions are interpolated linearly, so that each cross section is the contour
//! with its particles on their straight ways, which never cross (docs/physics.md). Lengths along the sheet
//! differ little from lengths in (u, z), because particles move by about a hundredth of the distance between sections.

use super::error::RemeshError;
use crate::model::Ring;

/// The contour of a section as part of a sheet, beginning with the first particle of the sheet.
pub(super) struct Level {
    /// Place along the tube, micrometres.
    pub(super) z: f64,
    /// u of each particle, from 0, increasing.
    pub(super) u: Vec<f64>,
    /// Positions of the particles, micrometres.
    pub(super) points: Vec<[f64; 2]>,
    /// Index in the ring of the section of the first particle.
    pub(super) turn: usize,
    /// The last particle before each of equal parts of u.
    table: Vec<u32>,
}

/// A wall from one section to another.
pub(super) struct Sheet {
    pub(super) levels: Vec<Level>,
    /// Length of the last contour; u and u + period are the same place.
    pub(super) period: f64,
}

/// The contour at any height.
#[derive(Clone, Copy)]
pub(super) struct Slice<'a> {
    pub(super) lower: &'a Level,
    pub(super) upper: &'a Level,
    pub(super) z: f64,
    share: f64,
    period: f64,
}

impl Sheet {
    /// The sheet of one wall through consecutive sections.
    pub(super) fn new(rings: &[(&Ring, f64)]) -> Result<Self, RemeshError> {
        let first = rings.first().and_then(|(ring, _)| ring.ids.first()).ok_or(RemeshError::Sections)?;
        let mut levels = Vec::with_capacity(rings.len());
        let mut period = 0.0;
        // The ids and u of the level above.
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
            levels.push(Level { z, u: u.clone(), points, turn, table });
            above = Some((ids, u));
        }
        levels.reverse();
        Ok(Self { levels, period })
    }

    /// The representative of `u` that is nearest to `anchor`.
    #[inline]
    pub(super) fn near(&self, u: f64, anchor: f64) -> f64 {
        u - self.period * ((u - anchor) / self.period).round()
    }

    /// The number of the level at or below `z`, with a level above it.
    #[inline]
    pub(super) fn below(&self, z: f64) -> usize {
        self.levels.partition_point(|level| level.z <= z).clamp(1, self.levels.len() - 1) - 1
    }

    /// The contour at height `z`.
    #[inline]
    pub(super) fn slice(&self, z: f64) -> Slice<'_> {
        let k = self.below(z);
        let (lower, upper) = (&self.levels[k], &self.levels[k + 1]);
        Slice { lower, upper, z, share: (z - lower.z) / (upper.z - lower.z), period: self.period }
    }

    /// Calls `visit` with the place and the point of each particle's way that the line from one place to another crosses.
    #[inline]
    pub(super) fn crossed(&self, from: [f64; 2], to: [f64; 2], mut visit: impl FnMut([f64; 2], [f64; 3])) {
        let to = [self.near(to[0], from[0]), to[1]];
        let ([start, z], [end, _]) = if from[0] <= to[0] { (from, to) } else { (to, from) };
        let slope = if start < end { (to[1] - from[1]) / (to[0] - from[0]) } else { 0.0 };
        // Beyond the slab of the middle the ways are extended.
        let slice = self.slice(0.5 * (from[1] + to[1]));
        let height = slice.upper.z - slice.lower.z;
        let level = slice.upper;
        let mut shift = (start / self.period).floor() * self.period;
        let mut i = level.find((start - shift).clamp(0.0, self.period), self.period) + 1;
        loop {
            if i == level.u.len() {
                i = 0;
                shift += self.period;
            }
            let u = level.u[i] + shift;
            if u >= end {
                return;
            }
            if u > start {
                let z = z + slope * (u - start);
                let share = (z - slice.lower.z) / height;
                let (a, b) = (slice.lower.at(level.u[i], self.period), level.points[i]);
                visit([u, z], [a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, z]);
            }
            i += 1;
        }
    }

    /// The point in space of a place.
    #[inline]
    pub(super) fn point(&self, [u, z]: [f64; 2]) -> [f64; 3] {
        self.slice(z).point(u)
    }
}

impl Slice<'_> {
    /// The point at `u`, which may be any representative.
    #[inline]
    pub(super) fn point(&self, u: f64) -> [f64; 3] {
        let u = u.rem_euclid(self.period);
        let (a, b) = (self.lower.at(u, self.period), self.upper.at(u, self.period));
        [a[0] + (b[0] - a[0]) * self.share, a[1] + (b[1] - a[1]) * self.share, self.z]
    }
}

impl Level {
    /// The particle at or before `u`, which is from 0 to the period.
    #[inline]
    pub(super) fn find(&self, u: f64, period: f64) -> usize {
        let part = (u / period * self.table.len() as f64) as usize;
        let mut i = self.table[part.min(self.table.len() - 1)] as usize;
        while i + 1 < self.u.len() && self.u[i + 1] <= u {
            i += 1;
        }
        i
    }

    /// The point at `u`, which is from 0 to the period.
    #[inline]
    pub(super) fn at(&self, u: f64, period: f64) -> [f64; 2] {
        let i = self.find(u, period);
        let (a, u0) = (self.points[i], self.u[i]);
        let (b, u1) = if i + 1 < self.u.len() { (self.points[i + 1], self.u[i + 1]) } else { (self.points[0], period) };
        let t = (u - u0) / (u1 - u0);
        [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
    }
}

/// The length of a vector. `hypot` rounds otherwise in other C libraries.
#[inline]
pub(super) fn norm([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

/// The place of each point along a closed contour, and its length.
pub(super) fn arc_lengths(points: &[[f64; 2]]) -> (Vec<f64>, f64) {
    let mut length = 0.0;
    let u = (0..points.len())
        .map(|i| {
            let (a, b) = (points[i], points[(i + 1) % points.len()]);
            let u = length;
            length += norm([b[0] - a[0], b[1] - a[1]]);
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
        // A little early, so that rounding never begins after the particle that is looked for.
        let begin = (part as f64 - 1e-6) / parts as f64 * period;
        while i + 1 < u.len() && u[i + 1] <= begin {
            i += 1;
        }
        table.push(i as u32);
    }
    table
}
