//! A contour resampled: the row of vertices at a section plane.

use super::field::Field;
use super::sheet::{Level, Sheet};
use crate::geometry::distance::squared_distance;

/// Fewest vertices of a row: with fewer, places on opposite sides could be mistaken for neighbours.
const FEWEST: f64 = 12.0;

/// The values of u, increasing, at which a level is resampled.
pub(super) fn resampled(sheet: &Sheet, field: &Field, k: usize) -> Vec<f64> {
    let level = &sheet.levels[k];
    let widths = field.row(k);
    let width = sheet.period / widths.len() as f64;
    let point = |u: f64| {
        let [x, y] = level.at(u.rem_euclid(sheet.period), sheet.period);
        [x, y, level.z]
    };
    // How many edges lie before the end of each column.
    let mut count = 0.0;
    let mut last = point(0.0);
    let ends: Vec<f64> = (0..widths.len())
        .map(|j| {
            let next = point((j + 1) as f64 * width);
            count += length(last, next) / f64::from(widths[j]);
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

/// Adds the particles that are too far from the edges of a row, the farthest first.
fn refine(sheet: &Sheet, field: &Field, level: &Level, row: &mut Vec<f64>) {
    let mut i = 0;
    while i < row.len() {
        let from = row[i];
        let to = row.get(i + 1).copied().unwrap_or(row[0] + sheet.period);
        let (a, b) = (place(sheet, level, from), place(sheet, level, to));
        let mut worst = (1.0, None);
        let first = level.find(from, sheet.period) + 1;
        for &u in level.u[first..].iter().take_while(|&&u| u < to) {
            let p = place(sheet, level, u);
            // Half of it is left to the edges above and below.
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

fn place(sheet: &Sheet, level: &Level, u: f64) -> [f64; 3] {
    let [x, y] = level.at(u.rem_euclid(sheet.period), sheet.period);
    [x, y, level.z]
}

/// The triangles between two rows, given by the numbers of their vertices and the values of u, both increasing.
pub(super) fn stitched(
    sheet: &Sheet,
    lower: &[(u32, f64)],
    upper: &[(u32, f64)],
    point: impl Fn(u32) -> [f64; 3],
) -> Vec<[u32; 3]> {
    let (n, m) = (lower.len(), upper.len());
    // Begin at the vertex of the upper row that is nearest to the first of the lower row.
    let offset = |j: usize| (sheet.near(upper[j].1, lower[0].1) - lower[0].1).abs();
    let begin = (0..m).min_by(|&i, &j| offset(i).total_cmp(&offset(j))).unwrap_or(0);
    let (mut i, mut j) = (0, 0);
    let mut triangles = Vec::with_capacity(n + m);
    while i < n || j < m {
        let at = |row: &[(u32, f64)], k: usize| row[k % row.len()].0;
        let (a, b) = (at(lower, i), at(upper, begin + j));
        let (next_a, next_b) = (at(lower, i + 1), at(upper, begin + j + 1));
        let along_lower = j == m || (i < n && length(point(next_a), point(b)) <= length(point(a), point(next_b)));
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

#[inline]
pub(super) fn length(a: [f64; 3], b: [f64; 3]) -> f64 {
    let d = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
    (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
}
