//! Pixels inside closed edges.

use super::Grid;
use super::contour::Edge;
use std::ops::Range;

/// Calls `mark` with each row, counted from the first of `rows`, and the columns of a part of it
/// that lies inside closed edges: a ray to the left crosses an odd number of them.
pub(super) fn inside<'e>(
    grid: &Grid,
    rows: Range<u32>,
    edges: impl Iterator<Item = &'e Edge>,
    mut mark: impl FnMut(usize, Range<usize>),
) {
    let (low, high) = (grid.y(rows.end.max(1) - 1), grid.y(rows.start));
    let mut crossings: Vec<Vec<f64>> = vec![Vec::new(); rows.len()];
    for edge in edges {
        let (y0, y1) = (edge.from[1], edge.to[1]);
        let (least, most) = (y0.min(y1), y0.max(y1));
        if most < low || least > high {
            continue;
        }
        for row in grid.rows(least, most) {
            let row = row as u32;
            let y = grid.y(row);
            if rows.contains(&row) && (y0 <= y) != (y1 <= y) {
                let x = edge.from[0] + (y - y0) / (y1 - y0) * (edge.to[0] - edge.from[0]);
                crossings[(row - rows.start) as usize].push(x);
            }
        }
    }
    for (row, xs) in crossings.iter_mut().enumerate() {
        xs.sort_unstable_by(f64::total_cmp);
        for pair in xs.chunks_exact(2) {
            mark(row, grid.columns(pair[0], pair[1]));
        }
    }
}
