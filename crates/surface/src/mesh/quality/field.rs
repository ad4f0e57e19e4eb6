//! How long edges may be, and how far the result may be from the sheet, at every place of a sheet.
//!
//! The length is the resolution, less where a chord of that length would leave the contour by more than a
//! part of the tolerance. The tolerance is less where another part of the wall is near, so that walls cannot meet. Lengths
//! grow gradually from place to place.

use super::sheet::{Sheet, arc_lengths, norm};
use crate::geometry::blocks::{Blocks, Rect};

/// Width of the columns of the raster, micrometres.
const COLUMN: f64 = 4.0;
/// Growth of the length of edges per distance.
const GROWTH: f64 = 0.5;
/// Tolerance as a part of the gap to another part of the wall: the two sides together stay below it.
const OF_GAP: f64 = 0.4;
/// Error of a chord that determines its length, as a part of the tolerance; edges may be a third longer.
const OF_TOLERANCE: f64 = 1.0;

/// What the lengths depend on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aims {
    /// Greatest length of edges, micrometres.
    pub(super) length: f64,
    /// Greatest distance between sheet and result, micrometres.
    pub(super) tolerance: f64,
}

/// A place in space where the tolerance must be smaller than elsewhere.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// Whether it was added after the last search.
    pub(super) fresh: bool,
    pub(super) centre: [f64; 3],
    pub(super) radius: f64,
    pub(super) tolerance: f64,
}

/// Raster over a sheet: a row for each level, columns of equal width in u.
pub(super) struct Field {
    columns: usize,
    period: f64,
    length: Vec<f32>,
    tolerance: Vec<f32>,
}

impl Field {
    pub(super) fn new(sheet: &Sheet, aims: Aims, spots: &[Spot]) -> Self {
        let columns = ((sheet.period / COLUMN) as usize).max(16);
        let cells = columns * sheet.levels.len();
        let mut field = Self {
            columns,
            period: sheet.period,
            length: Vec::with_capacity(cells),
            tolerance: Vec::with_capacity(cells),
        };
        // The distance from each cell to the next along its row.
        let mut along = Vec::with_capacity(cells);
        for level in &sheet.levels {
            let (s, whole) = arc_lengths(&level.points);
            let tolerance = tolerances(&level.points, &s, whole, level.z, aims, spots);
            let length = lengths(&level.points, &tolerance, aims);
            let place = |j: usize| {
                let u = (j as f64 + 0.5) * sheet.period / columns as f64;
                let i = level.find(u, sheet.period);
                let (u1, next) = if i + 1 < s.len() { (level.u[i + 1], i + 1) } else { (sheet.period, 0) };
                (i, next, (u - level.u[i]) / (u1 - level.u[i]))
            };
            let row = field.length.len();
            let mut last = 0.0;
            for j in 0..columns {
                let (i, next, t) = place(j);
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

    /// The length of edges at a place, where `level` is at or below it.
    #[inline]
    pub(super) fn length(&self, sheet: &Sheet, place: [f64; 2]) -> f64 {
        self.mixed(&self.length, sheet, place)
    }

    #[inline]
    pub(super) fn tolerance(&self, sheet: &Sheet, place: [f64; 2]) -> f64 {
        self.mixed(&self.tolerance, sheet, place)
    }

    /// The mean length of edges.
    pub(super) fn mean(&self) -> f64 {
        self.length.iter().map(|&x| f64::from(x)).sum::<f64>() / self.length.len() as f64
    }

    /// The lengths in the columns of a level.
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

    /// Lets lengths grow by no more than [`GROWTH`] from cell to cell.
    fn grade(&mut self, along: &[f32], heights: &[f64]) {
        let (columns, rows) = (self.columns, heights.len());
        let growth = GROWTH as f32;
        for _ in 0..2 {
            for k in 0..rows {
                let (row, along) = (&mut self.length[k * columns..][..columns], &along[k * columns..][..columns]);
                // Twice around, since the row is closed.
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

/// The tolerance at each point of a contour.
fn tolerances(points: &[[f64; 2]], s: &[f64], whole: f64, z: f64, aims: Aims, spots: &[Spot]) -> Vec<f64> {
    let n = points.len();
    let reach = aims.tolerance / OF_GAP;
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
                // What is near along the contour, too, is no other wall.
                if apart(j).min(apart(j + 1)) > 2.0 * reach {
                    gap = gap.min(distance(p, points[j], points[(j + 1) % n]));
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

/// The length of chords around each point of a contour that stay near enough to it.
fn lengths(points: &[[f64; 2]], tolerance: &[f64], aims: Aims) -> Vec<f64> {
    let n = points.len();
    let of = |i: usize| {
        let error = tolerance[i] * OF_TOLERANCE;
        let least = (2.0 * aims.tolerance * (tolerance[i] / aims.tolerance).sqrt()).min(aims.length);
        let mut half = aims.length / 2.0;
        while 2.0 * half > least {
            let (to, ahead) = walk(points, i, half, |i| (i + 1) % n);
            let (from, behind) = walk(points, i, half, |i| (i + n - 1) % n);
            let first = i + n - behind;
            if (first..=first + ahead + behind).all(|j| distance(points[j % n], from, to) <= error) {
                return 2.0 * half;
            }
            half *= 0.8;
        }
        least
    };
    (0..n).map(of).collect()
}

/// The point of a contour at a distance along it from point `i`, and how many points lie between.
fn walk(points: &[[f64; 2]], i: usize, distance: f64, next: impl Fn(usize) -> usize) -> ([f64; 2], usize) {
    let (mut at, mut left, mut passed) = (i, distance, 0);
    loop {
        let (a, b) = (points[at], points[next(at)]);
        let length = norm([b[0] - a[0], b[1] - a[1]]);
        if length >= left || 2 * passed + 2 >= points.len() {
            let t = (left / length).min(1.0);
            return ([a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t], passed);
        }
        left -= length;
        at = next(at);
        passed += 1;
    }
}

/// Distance of `p` from the segment from `a` to `b`.
#[inline]
pub(super) fn distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (ab, ap) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let square = ab[0] * ab[0] + ab[1] * ab[1];
    let t = if square > 0.0 { ((ap[0] * ab[0] + ap[1] * ab[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    norm([ap[0] - ab[0] * t, ap[1] - ab[1] * t])
}
