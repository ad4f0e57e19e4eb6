//! Rows and columns of a lofted surface.

/// Vertices of the walls of a lofted surface, by the section that they lie on.
///
/// The walls of a loft are strips between consecutive sections. A row consists of the vertices of
/// one section on one wall, in the order of the contour. A column consists of the vertices of one
/// particle; it begins at the section where the particle was inserted, or one before, where the
/// loft divides an edge for it, and it ends at the last section.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows {
    /// Place of each section along the straight tube, m.
    pub z: Vec<f32>,
    /// Inner and outer wall.
    pub walls: [RowRuns; 2],
}

/// Rows of one wall, first to last, as runs of consecutive vertices: a small part of the memory of
/// [`WallRows`].
#[derive(Clone, Debug, PartialEq)]
pub struct RowRuns {
    /// Row `k` has the vertices `starts[k]..starts[k + 1]`, counted from the first row on.
    starts: Vec<usize>,
    /// First vertex and length of each run. Runs may extend over several rows.
    runs: Vec<(u32, u32)>,
    /// Which vertices are of columns that the row before does not have.
    new: Vec<usize>,
    len: usize,
}

/// Rows of one wall.
#[derive(Clone, Debug, PartialEq)]
pub struct WallRows {
    /// Row `k` has the entries `starts[k]..starts[k + 1]` of the other lists.
    starts: Vec<usize>,
    vertices: Vec<u32>,
    columns: Vec<u32>,
}

/// A row: vertices and their columns, which ascend. The last vertex is followed by the first.
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    /// Vertex indices.
    pub vertices: &'a [u32],
    /// Columns, numbered in the order of the last row.
    pub columns: &'a [u32],
}

impl Row<'_> {
    /// Number of vertices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.vertices.len()
    }

    /// True without vertices.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.vertices.is_empty()
    }
}

impl WallRows {
    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// True without rows.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A row.
    #[must_use]
    pub fn row(&self, k: usize) -> Row<'_> {
        let own = self.starts[k]..self.starts[k + 1];
        Row { vertices: &self.vertices[own.clone()], columns: &self.columns[own] }
    }

    /// Number of columns, all of which the last row has.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.row(self.len() - 1).len()
    }
}

impl Default for RowRuns {
    fn default() -> Self {
        Self { starts: vec![0], runs: Vec::new(), new: Vec::new(), len: 0 }
    }
}

impl RowRuns {
    /// Adds a vertex to the current row. It is new if the row before has no vertex of its column.
    #[inline]
    pub fn push(&mut self, vertex: u32, is_new: bool) {
        if is_new {
            self.new.push(self.len);
        }
        self.len += 1;
        match self.runs.last_mut() {
            Some((first, length)) if *first + *length == vertex => *length += 1,
            _ => self.runs.push((vertex, 1)),
        }
    }

    /// Ends the current row.
    pub fn end_row(&mut self) {
        self.starts.push(self.len);
    }

    /// The rows. In each row after the first, as many vertices must not be new as the row before
    /// has vertices, and in the same order.
    #[must_use]
    pub fn expanded(&self) -> WallRows {
        let starts = self.starts.clone();
        let mut new = &self.new[..];
        let mut vertices = Vec::with_capacity(self.len);
        vertices.extend(self.runs.iter().flat_map(|&(first, length)| first..first + length));
        let mut columns = vec![0; vertices.len()];
        let rows = starts.len() - 1;
        if rows > 0 {
            let last = starts[rows - 1]..starts[rows];
            columns[last].iter_mut().zip(0..).for_each(|(column, k)| *column = k);
        }
        for k in (1..rows).rev() {
            let (before, own_new) = new.split_at(new.partition_point(|index| *index < starts[k]));
            new = before;
            let (mut from, mut to) = (starts[k], starts[k - 1]);
            for end in own_new.iter().copied().chain([starts[k + 1]]) {
                columns.copy_within(from..end, to);
                to += end - from;
                from = end + 1;
            }
        }
        WallRows { starts, vertices, columns }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_continue_from_row_to_row() {
        let mut runs = RowRuns::default();
        for row in [
            &[(0, false), (1, false)][..],
            &[(2, false), (7, true), (3, false)],
            &[(4, false), (5, false), (6, false), (8, true)],
        ] {
            row.iter().for_each(|&(vertex, is_new)| runs.push(vertex, is_new));
            runs.end_row();
        }
        let rows = runs.expanded();
        assert_eq!((rows.len(), rows.columns()), (3, 4));
        assert_eq!((rows.row(0).vertices, rows.row(0).columns), (&[0, 1][..], &[0, 2][..]));
        assert_eq!((rows.row(1).vertices, rows.row(1).columns), (&[2, 7, 3][..], &[0, 1, 2][..]));
        assert_eq!((rows.row(2).vertices, rows.row(2).columns), (&[4, 5, 6, 8][..], &[0, 1, 2, 3][..]));
    }
}
