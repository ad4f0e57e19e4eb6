//! Triangles between the kept vertices of rows.
//!
//! The front is the contour up to which the surface is done. It goes round the tube and consists of
//! vertices of several rows. A row replaces the part of the front below it.

use super::contour::Kept;
use crate::model::WallRows;

/// The surface whose rows are joined.
pub(super) struct Surface<'a> {
    pub(super) positions: &'a [[f32; 3]],
    pub(super) rows: &'a WallRows,
}

/// A kept vertex. Columns continue beyond the last one where a contour goes round.
#[derive(Clone, Copy)]
struct Corner {
    vertex: u32,
    row: u32,
    column: i32,
}

/// The triangles up to the front. They face away from the axis of the tube.
pub(super) struct Strips {
    pub(super) triangles: Vec<[u32; 3]>,
    front: Vec<Corner>,
    front_columns: Vec<u32>,
}

impl Strips {
    /// Begins with the whole first row.
    pub(super) fn new(surface: &Surface<'_>) -> Self {
        let mut strips = Self { triangles: Vec::new(), front: Vec::new(), front_columns: Vec::new() };
        strips.set_front((0..surface.rows.row(0).len()).map(|k| surface.corner(0, k)).collect());
        strips
    }

    /// Columns of the front, ascending.
    pub(super) fn front_columns(&self) -> &[u32] {
        &self.front_columns
    }

    fn set_front(&mut self, front: Vec<Corner>) {
        self.front_columns = front.iter().map(|corner| corner.column as u32).collect();
        self.front = front;
    }

    /// Adds the kept vertices of a row above the front.
    pub(super) fn add(&mut self, surface: &Surface<'_>, row: usize, kept: &Kept) {
        let columns = surface.columns();
        let corners = |indices: &[usize]| indices.iter().map(|&k| surface.corner(row, k)).collect::<Vec<_>>();
        let parts = match kept {
            Kept::Whole(indices) => {
                let upper = corners(indices);
                let closed = |contour: &[Corner]| {
                    let again = Corner { column: contour[0].column + columns, ..contour[0] };
                    [contour, &[again]].concat()
                };
                self.join(surface, &closed(&self.front.clone()), &closed(&upper));
                return self.set_front(upper);
            }
            Kept::Parts(parts) if parts.is_empty() => return,
            Kept::Parts(parts) => parts,
        };
        // The front from the first part on.
        let first = surface.corner(row, parts[0][0]).column;
        let turned =
            |corner: &Corner| Corner { column: first + (corner.column - first).rem_euclid(columns), ..*corner };
        let mut old: Vec<Corner> = self.front.iter().map(turned).collect();
        old.sort_unstable_by_key(|corner| corner.column);
        let mut old = old.into_iter().peekable();
        let end = old.clone().last().expect("the front has vertices");
        let mut front: Vec<Corner> = Vec::with_capacity(self.front.len());
        for part in parts {
            let upper = corners(part);
            let (from, to) = (upper[0].column, upper[upper.len() - 1].column);
            front.extend(std::iter::from_fn(|| old.next_if(|corner| corner.column < from)));
            // The neighbours of the part on the front remain.
            let left = front.last().copied().unwrap_or(Corner { column: end.column - columns, ..end });
            let mut lower = vec![left];
            lower.extend(std::iter::from_fn(|| old.next_if(|corner| corner.column <= to)));
            lower.push(old.peek().copied().unwrap_or_else(|| {
                let again = front.first().unwrap_or(&upper[0]);
                Corner { column: again.column + columns, ..*again }
            }));
            self.join(surface, &lower, &upper);
            front.extend(upper);
        }
        front.extend(old);
        front.iter_mut().for_each(|corner| corner.column = corner.column.rem_euclid(columns));
        front.sort_unstable_by_key(|corner| corner.column);
        self.set_front(front);
    }

    /// Joins two chains of vertices, between their first and their last vertices. The upper chain is
    /// in one row.
    fn join(&mut self, surface: &Surface<'_>, lower: &[Corner], upper: &[Corner]) {
        let (mut i, mut j) = (0, 0);
        while i + 1 < lower.len() || j + 1 < upper.len() {
            let is_lower = match (lower.get(i + 1), upper.get(j + 1)) {
                (Some(a), Some(b)) => surface.is_lower_next([lower[i], *a], [upper[j], *b]),
                (a, _) => a.is_some(),
            };
            if is_lower {
                self.triangles.push([lower[i], lower[i + 1], upper[j]].map(|corner| corner.vertex));
                i += 1;
            } else {
                self.triangles.push([lower[i], upper[j + 1], upper[j]].map(|corner| corner.vertex));
                j += 1;
            }
        }
    }
}

impl Surface<'_> {
    /// Number of columns.
    fn columns(&self) -> i32 {
        self.rows.columns() as i32
    }

    /// A vertex of a row, whose indices continue beyond its end.
    fn corner(&self, row: usize, k: usize) -> Corner {
        let own = self.rows.row(row);
        let (turns, k) = (k / own.len(), k % own.len());
        let column = own.columns[k] as i32 + turns as i32 * self.columns();
        Corner { vertex: own.vertices[k], row: row as u32, column }
    }

    /// True if the next triangle between two chains has an edge of the lower one. `lower` and
    /// `upper` are the current and the next vertices.
    fn is_lower_next(&self, lower: [Corner; 2], upper: [Corner; 2]) -> bool {
        let [a, next_a] = lower;
        let [b, next_b] = upper;
        // The edge from `a` to `next_b` would pass below `next_a`.
        let rise = |to: Corner| i64::from(to.row) - i64::from(a.row);
        let run = |to: Corner| i64::from(to.column - a.column);
        if run(next_a) * rise(next_b) <= rise(next_a) * run(next_b) {
            return true;
        }
        let skews = [next_a.column - b.column, next_b.column - a.column].map(i32::abs);
        if skews[0] != skews[1] {
            return skews[0] < skews[1];
        }
        self.square(next_a, b) <= self.square(a, next_b)
    }

    /// Squared distance between two vertices.
    fn square(&self, a: Corner, b: Corner) -> f64 {
        let [p, q] = [a, b].map(|corner| self.positions[corner.vertex as usize].map(f64::from));
        (0..3).map(|axis| (p[axis] - q[axis]).powi(2)).sum()
    }
}
