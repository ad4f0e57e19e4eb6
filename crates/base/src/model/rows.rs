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
    pub walls: [WallRows; 2],
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

/// Collects the rows of a wall, first to last.
#[derive(Clone, Debug)]
pub struct RowsBuilder {
    starts: Vec<usize>,
    vertices: Vec<u32>,
    /// Indices of the vertices of whose column the row before has no vertex.
    new: Vec<usize>,
}

impl Default for RowsBuilder {
    fn default() -> Self {
        Self { starts: vec![0], vertices: Vec::new(), new: Vec::new() }
    }
}

impl RowsBuilder {
    /// Adds a vertex to the current row. It is new if the row before has no vertex of its column.
    #[inline]
    pub fn push(&mut self, vertex: u32, is_new: bool) {
        if is_new {
            self.new.push(self.vertices.len());
        }
        self.vertices.push(vertex);
    }

    /// Ends the current row.
    pub fn end_row(&mut self) {
        self.starts.push(self.vertices.len());
    }

    /// The rows. In each row after the first, as many vertices must not be new as the row before
    /// has vertices, and in the same order.
    #[must_use]
    pub fn finish(self) -> WallRows {
        let Self { starts, vertices, mut new } = self;
        let mut columns = vec![0; vertices.len()];
        let rows = starts.len() - 1;
        if rows > 0 {
            let last = starts[rows - 1]..starts[rows];
            columns[last].iter_mut().zip(0..).for_each(|(column, k)| *column = k);
        }
        for k in (1..rows).rev() {
            let own_new = new.split_off(new.partition_point(|index| *index < starts[k]));
            let (mut from, mut to) = (starts[k], starts[k - 1]);
            for end in own_new.into_iter().chain([starts[k + 1]]) {
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
        let mut builder = RowsBuilder::default();
        for row in [
            &[(0, false), (1, false)][..],
            &[(2, false), (7, true), (3, false)],
            &[(4, false), (5, false), (6, false), (8, true)],
        ] {
            row.iter().for_each(|&(vertex, is_new)| builder.push(vertex, is_new));
            builder.end_row();
        }
        let rows = builder.finish();
        assert_eq!((rows.len(), rows.columns()), (3, 4));
        assert_eq!((rows.row(0).vertices, rows.row(0).columns), (&[0, 1][..], &[0, 2][..]));
        assert_eq!((rows.row(1).vertices, rows.row(1).columns), (&[2, 7, 3][..], &[0, 1, 2][..]));
        assert_eq!((rows.row(2).vertices, rows.row(2).columns), (&[4, 5, 6, 8][..], &[0, 1, 2, 3][..]));
    }
}
