//! Resamples a contour: the row of vertices at a section plane.

use super::field::LengthField;
use super::sheet::{Level, Sheet};
use crate::geometry::distance::squared_distance;
use crate::geometry::vector::distance;

/// Minimum number of vertices of a row. With fewer, places on opposite sides could be mistaken for
/// neighbours.
const FEWEST: f64 = 12.0;

/// Values of u at which a level is resampled, increasing.
pub(super) fn resampled(sheet: &Sheet, field: &LengthField, k: usize) -> Vec<f64> {
    let level = &sheet.levels[k];
    let widths = field.row(k);
    let width = sheet.period / widths.len() as f64;
    let point = |u: f64| level.point(u);
    // Number of edges before the end of each column.
    let mut count = 0.0;
    let mut last = point(0.0);
    let ends: Vec<f64> = (0..widths.len())
        .map(|j| {
            let next = point((j + 1) as f64 * width);
            count += distance(last, next) / f64::from(widths[j]);
            last = next;
            count
        })
        .collect();
    let edges = count.ceil().max(FEWEST);
    let mut j = 0;
    let mut row: Vec<f64> = (0..edges as usize)
        .map(|i| {
            let wanted = i as f64 / edges * count;
            while ends[j] < wanted && j + 1 < ends.len() {
                j += 1;
            }
            let begin = if j == 0 { 0.0 } else { ends[j - 1] };
            (j as f64 + ((wanted - begin) / (ends[j] - begin)).clamp(0.0, 1.0)) * width
        })
        .collect();
    row.dedup_by(|b, a| *b - *a < 1e-6);
    refine(sheet, field, level, &mut row);
    row
}

/// Adds particles that are too far from the edges of a row, the farthest first.
fn refine(sheet: &Sheet, field: &LengthField, level: &Level, row: &mut Vec<f64>) {
    let mut i = 0;
    while i < row.len() {
        let from = row[i];
        let to = row.get(i + 1).copied().unwrap_or(row[0] + sheet.period);
        let [a, b] = [from, to].map(|u| level.point(u));
        let mut worst = (1.0, None);
        let first = level.find(from) + 1;
        for &u in level.u[first..].iter().take_while(|&&u| u < to) {
            let p = level.point(u);
            // The rest of the tolerance is left to the edges above and below.
            let limit = 0.75 * field.tolerance(sheet, [u, level.z]);
            let strain = squared_distance(p, [a, b, b]).sqrt() / limit;
            if strain > worst.0 && u > from + 1e-6 && u < to - 1e-6 {
                worst = (strain, Some(u));
            }
        }
        match worst.1 {
            Some(u) => row.insert(i + 1, u),
            None => i += 1,
        }
    }
}

/// Joins two rows with triangles. A row is a list of pairs of vertex number and u, sorted by u.
pub(super) fn stitched(
    sheet: &Sheet,
    lower: &[(u32, f64)],
    upper: &[(u32, f64)],
    point: impl Fn(u32) -> [f64; 3],
) -> Vec<[u32; 3]> {
    let (n, m) = (lower.len(), upper.len());
    // Starts at the vertex of the upper row that is nearest to the first one of the lower row.
    let offset = |j: usize| (sheet.near(upper[j].1, lower[0].1) - lower[0].1).abs();
    let begin = (0..m).min_by(|&i, &j| offset(i).total_cmp(&offset(j))).unwrap_or(0);
    let (mut i, mut j) = (0, 0);
    let mut triangles = Vec::with_capacity(n + m);
    while i < n || j < m {
        let at = |row: &[(u32, f64)], k: usize| row[k % row.len()].0;
        let (a, b) = (at(lower, i), at(upper, begin + j));
        let (next_a, next_b) = (at(lower, i + 1), at(upper, begin + j + 1));
        let along_lower = j == m || (i < n && distance(point(next_a), point(b)) <= distance(point(a), point(next_b)));
        if along_lower {
            triangles.push([a, next_a, b]);
            i += 1;
        } else {
            triangles.push([a, next_b, b]);
            j += 1;
        }
    }
    triangles
}
