//! Maximum edge length and tolerance at every place of a sheet.
//!
//! The length is the resolution. It is smaller where a chord of that length would deviate from the
//! contour by more than the tolerance. The tolerance is smaller where another part of the wall is
//! near, so that walls cannot intersect. Lengths change gradually from place to place.

use super::sheet::{Sheet, arc_lengths};
use crate::geometry::blocks::{Blocks, Rect};
use crate::geometry::vector::{distance, lerp, squared_distance_to_segment};

/// Width of the columns of the raster, µm.
const COLUMN: f64 = 4.0;
/// Maximum increase of the edge length per distance.
const GROWTH: f64 = 0.5;
/// Tolerance as a fraction of the gap to another part of the wall. Both sides together use less
/// than the gap.
const OF_GAP: f64 = 0.4;
/// Error of a chord that limits its length, as a fraction of the tolerance. Edges may be a third
/// longer than the limit.
const OF_TOLERANCE: f64 = 1.0;

/// Limits of a wall.
#[derive(Clone, Copy, Debug)]
pub(super) struct RemeshLimits {
    /// Maximum length of edges, µm.
    pub(super) length: f64,
    /// Maximum distance between sheet and result, µm.
    pub(super) tolerance: f64,
}

/// A ball in space with a smaller tolerance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// True if the last search added the spot.
    pub(super) fresh: bool,
    pub(super) centre: [f64; 3],
    pub(super) radius: f64,
    pub(super) tolerance: f64,
}

/// Raster over a sheet with one row per level and columns of equal width in u.
pub(super) struct LengthField {
    columns: usize,
    period: f64,
    length: Vec<f32>,
    tolerance: Vec<f32>,
}

impl LengthField {
    pub(super) fn new(sheet: &Sheet, limits: RemeshLimits, spots: &[Spot]) -> Self {
        let columns = ((sheet.period / COLUMN) as usize).max(16);
        let cells = columns * sheet.levels.len();
        let mut field = Self {
            columns,
            period: sheet.period,
            length: Vec::with_capacity(cells),
            tolerance: Vec::with_capacity(cells),
        };
        // Distance from each cell to the next cell of its row.
        let mut along = Vec::with_capacity(cells);
        for level in &sheet.levels {
            let (s, whole) = arc_lengths(&level.points);
            let tolerance = tolerances(&level.points, &s, whole, level.z, limits, spots);
            let length = lengths(&level.points, &tolerance, limits);
            let row = field.length.len();
            let mut last = 0.0;
            for j in 0..columns {
                let u = (j as f64 + 0.5) * sheet.period / columns as f64;
                let i = level.find(u);
                let (u1, next) = if i + 1 < s.len() { (level.u[i + 1], i + 1) } else { (sheet.period, 0) };
                let t = (u - level.u[i]) / (u1 - level.u[i]);
                let mix = |values: &[f64]| (values[i] + (values[next] - values[i]) * t) as f32;
                field.length.push(mix(&length));
                field.tolerance.push(mix(&tolerance));
                let end = if next == 0 { whole } else { s[next] };
                let at = s[i] + (end - s[i]) * t;
                if j > 0 {
                    along.push((at - last) as f32);
                }
                last = at;
            }
            along.push((whole / columns as f64) as f32);
            for (i, &u) in level.u.iter().enumerate() {
                let cell = row + ((u / sheet.period * columns as f64) as usize).min(columns - 1);
                field.length[cell] = field.length[cell].min(length[i] as f32);
                field.tolerance[cell] = field.tolerance[cell].min(tolerance[i] as f32);
            }
        }
        let heights: Vec<f64> = sheet.levels.iter().map(|level| level.z).collect();
        field.grade(&along, &heights);
        field
    }

    /// Maximum length of edges at a place.
    #[inline]
    pub(super) fn length(&self, sheet: &Sheet, place: [f64; 2]) -> f64 {
        self.mixed(&self.length, sheet, place)
    }

    #[inline]
    pub(super) fn tolerance(&self, sheet: &Sheet, place: [f64; 2]) -> f64 {
        self.mixed(&self.tolerance, sheet, place)
    }

    /// Mean of the maximum edge lengths.
    pub(super) fn mean(&self) -> f64 {
        self.length.iter().map(|&x| f64::from(x)).sum::<f64>() / self.length.len() as f64
    }

    /// Maximum edge lengths in the columns of a level.
    pub(super) fn row(&self, level: usize) -> &[f32] {
        &self.length[level * self.columns..(level + 1) * self.columns]
    }

    #[inline]
    fn mixed(&self, values: &[f32], sheet: &Sheet, [u, z]: [f64; 2]) -> f64 {
        let k = sheet.below(z);
        let t = (z - sheet.levels[k].z) / (sheet.levels[k + 1].z - sheet.levels[k].z);
        let column = (u.rem_euclid(self.period) / self.period * self.columns as f64) as usize;
        let cell = k * self.columns + column.min(self.columns - 1);
        let (a, b) = (f64::from(values[cell]), f64::from(values[cell + self.columns]));
        a + (b - a) * t
    }

    /// Limits the growth of lengths from cell to cell to [`GROWTH`].
    fn grade(&mut self, along: &[f32], heights: &[f64]) {
        let (columns, rows) = (self.columns, heights.len());
        let growth = GROWTH as f32;
        for _ in 0..2 {
            for k in 0..rows {
                let (row, along) = (&mut self.length[k * columns..][..columns], &along[k * columns..][..columns]);
                // Two rounds, because the row is closed.
                for j in 0..2 * columns {
                    let (here, next) = (j % columns, (j + 1) % columns);
                    row[next] = row[next].min(row[here] + growth * along[here]);
                }
                for j in (0..2 * columns).rev() {
                    let (here, next) = (j % columns, (j + 1) % columns);
                    row[here] = row[here].min(row[next] + growth * along[here]);
                }
            }
            let up = (1..rows).map(|k| (k - 1, k));
            let down = (1..rows).rev().map(|k| (k, k - 1));
            for (from, to) in up.chain(down) {
                let step = growth * (heights[to] - heights[from]).abs() as f32;
                for j in 0..columns {
                    let limit = self.length[from * columns + j] + step;
                    let cell = &mut self.length[to * columns + j];
                    *cell = cell.min(limit);
                }
            }
        }
    }
}

/// Tolerance at each point of a contour.
fn tolerances(points: &[[f64; 2]], s: &[f64], whole: f64, z: f64, limits: RemeshLimits, spots: &[Spot]) -> Vec<f64> {
    let n = points.len();
    let reach = limits.tolerance / OF_GAP;
    let rects: Vec<Rect> =
        (0..n).map(|i| Rect::around(&[points[i], points[(i + 1) % n]].map(|p| p.map(|x| x as f32)))).collect();
    let blocks = Blocks::new(&rects);
    let near: Vec<&Spot> = spots.iter().filter(|spot| (spot.centre[2] - z).abs() < spot.radius).collect();
    (0..n)
        .map(|i| {
            let p = points[i];
            let mut gap = reach;
            let query = Rect { min: p.map(|x| (x - reach) as f32), max: p.map(|x| (x + reach) as f32) };
            blocks.query(&query, |j| {
                let apart = |end: usize| {
                    let along = (s[end % n] - s[i]).rem_euclid(whole);
                    along.min(whole - along)
                };
                // A neighbour along the contour is not another wall.
                if apart(j).min(apart(j + 1)) > 2.0 * reach {
                    gap = gap.min(squared_distance_to_segment(p, points[j], points[(j + 1) % n]).sqrt());
                }
            });
            let in_spots = near.iter().filter(|spot| {
                let [x, y, h] = [p[0] - spot.centre[0], p[1] - spot.centre[1], z - spot.centre[2]];
                x * x + y * y + h * h < spot.radius * spot.radius
            });
            in_spots.map(|spot| spot.tolerance).fold(gap * OF_GAP, f64::min)
        })
        .collect()
}

/// Length of chords around each point of a contour that stay close enough to it.
fn lengths(points: &[[f64; 2]], tolerance: &[f64], limits: RemeshLimits) -> Vec<f64> {
    let n = points.len();
    let of = |i: usize| {
        let error = tolerance[i] * OF_TOLERANCE;
        let least = (2.0 * limits.tolerance * (tolerance[i] / limits.tolerance).sqrt()).min(limits.length);
        let mut half = limits.length / 2.0;
        while 2.0 * half > least {
            let (to, ahead) = walk(points, i, half, |i| (i + 1) % n);
            let (from, behind) = walk(points, i, half, |i| (i + n - 1) % n);
            let first = i + n - behind;
            let is_near = |j: usize| squared_distance_to_segment(points[j % n], from, to).sqrt() <= error;
            if (first..=first + ahead + behind).all(is_near) {
                return 2.0 * half;
            }
            half *= 0.8;
        }
        least
    };
    (0..n).map(of).collect()
}

/// Point at a distance along a contour from point `i`, and the number of points passed.
fn walk(points: &[[f64; 2]], i: usize, far: f64, next: impl Fn(usize) -> usize) -> ([f64; 2], usize) {
    let (mut at, mut left, mut passed) = (i, far, 0);
    loop {
        let (a, b) = (points[at], points[next(at)]);
        let length = distance(a, b);
        if length >= left || 2 * passed + 2 >= points.len() {
            return (lerp(a, b, (left / length).min(1.0)), passed);
        }
        left -= length;
        at = next(at);
        passed += 1;
    }
}
