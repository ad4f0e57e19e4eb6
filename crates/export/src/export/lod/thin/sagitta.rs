//! Distances of rows from the straight lines between two other rows.
//!
//! The rows are ranked like the marks of a ruler: a row at an odd multiple of a power of two is
//! compared with the rows that far before and after it, which are of higher rank. It stays no
//! longer than they do.

use crate::model::{Row, WallRows};
use glam::DVec3;
use rayon::prelude::*;

/// Number of columns of a block.
pub(super) const BLOCK: u32 = 32;
/// Number of columns to either side among which the nearest part of a line is searched.
const REACH: usize = 16;

/// The distance of each row in each block of columns, m.
pub(super) struct Sagittas {
    blocks: usize,
    distances: Vec<f32>,
}

impl Sagittas {
    /// Distances of the rows at `z`. The first and the last row have infinite ones.
    pub(super) fn new(positions: &[[f32; 3]], rows: &WallRows, z: &[f32]) -> Self {
        let last = rows.len() - 1;
        let blocks = rows.columns().div_ceil(BLOCK as usize);
        let of_row = |row: usize| {
            if row == 0 || row == last {
                return vec![f32::INFINITY; blocks];
            }
            let (before, after) = around(row, last);
            let part = f64::from(z[row] - z[before]) / f64::from(z[after] - z[before]);
            let line = Line::between(positions, rows.row(before), rows.row(after), part);
            line.distances(positions, rows.row(row), blocks)
        };
        let mut distances = (0..rows.len()).into_par_iter().map(of_row).collect::<Vec<_>>().concat();
        let mut size = 1;
        while size < rows.len() {
            for row in (size..last).step_by(2 * size) {
                let (before, after) = around(row, last);
                for block in 0..blocks {
                    let distance = distances[row * blocks + block];
                    for other in [before, after] {
                        let other = &mut distances[other * blocks + block];
                        *other = other.max(distance);
                    }
                }
            }
            size *= 2;
        }
        Self { blocks, distances }
    }

    /// Distances of a row, by block.
    pub(super) fn of_row(&self, row: usize) -> &[f32] {
        &self.distances[row * self.blocks..(row + 1) * self.blocks]
    }
}

/// The rows with which a row is compared.
fn around(row: usize, last: usize) -> (usize, usize) {
    let step = row & row.wrapping_neg();
    (row - step, last.min(row + step))
}

/// Points on the straight lines between two rows, at the same fraction of the way. There is one for
/// each vertex of the upper row; columns that begin above the lower row begin on its contour.
struct Line<'a> {
    columns: &'a [u32],
    points: Vec<DVec3>,
    /// Directions of the straight lines.
    along: Vec<DVec3>,
}

impl<'a> Line<'a> {
    fn between(positions: &[[f32; 3]], lower: Row<'_>, upper: Row<'a>, part: f64) -> Self {
        let point = |v: u32| DVec3::from_array(positions[v as usize].map(f64::from));
        let (n, m) = (lower.len(), upper.len());
        let (mut points, mut along) = (Vec::with_capacity(m), Vec::with_capacity(m));
        // Columns of the lower row, by their index in the upper one. Those before the first belong
        // to the edge from the last to the first.
        let mut indices: Vec<usize> = Vec::with_capacity(n);
        let mut index = 0;
        for column in lower.columns {
            index += upper.columns[index..].iter().take_while(|other| *other < column).count();
            indices.push(index);
        }
        let mut next = 0;
        for k in 0..m {
            if next < n && indices[next] <= k {
                next += 1;
            }
            let (before, after) = ((next + n - 1) % n, next % n);
            // Steps of the upper row since the vertex before, and up to the vertex after.
            let done = (k + m - indices[before]) % m;
            let steps = (indices[after] + m - indices[before]) % m;
            let fraction = if steps == 0 { 0.0 } else { done as f64 / steps as f64 };
            let from = point(lower.vertices[before]).lerp(point(lower.vertices[after]), fraction);
            let to = point(upper.vertices[k]);
            points.push(from.lerp(to, part));
            along.push((to - from).normalize_or_zero());
        }
        Self { columns: upper.columns, points, along }
    }

    /// Maximum distance of the vertices of a row between the two rows, by block.
    fn distances(&self, positions: &[[f32; 3]], row: Row<'_>, blocks: usize) -> Vec<f32> {
        let mut distances = vec![0.0_f32; blocks];
        let m = self.points.len();
        let mut start = 0;
        for (vertex, column) in row.vertices.iter().zip(row.columns) {
            start += self.columns[start..].iter().take_while(|other| *other < column).count();
            let point = DVec3::from_array(positions[*vertex as usize].map(f64::from));
            let mut best = self.squared_distance(point, start);
            for step in [1, m - 1] {
                let mut edge = start;
                for _ in 0..REACH {
                    edge = (edge + step) % m;
                    let square = self.squared_distance(point, edge);
                    if square >= best {
                        break;
                    }
                    best = square;
                }
            }
            let block = &mut distances[(column / BLOCK) as usize];
            *block = block.max(best.sqrt() as f32);
        }
        distances
    }

    /// Squared distance from the edge after a point, across the straight lines.
    fn squared_distance(&self, point: DVec3, edge: usize) -> f64 {
        let along = self.along[edge];
        let across = |vector: DVec3| vector - along * vector.dot(along);
        let (from, to) = (self.points[edge], self.points[(edge + 1) % self.points.len()]);
        squared_distance(across(point - from), across(to - from))
    }
}

/// Squared distance of a point from a segment; both are relative to its start.
pub(super) fn squared_distance(point: DVec3, segment: DVec3) -> f64 {
    let length = segment.length_squared();
    let part = if length > 0.0 { (point.dot(segment) / length).clamp(0.0, 1.0) } else { 0.0 };
    (point - segment * part).length_squared()
}
