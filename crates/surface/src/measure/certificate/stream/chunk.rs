//! Parts of a surface, as they come.

/// The next part of a surface.
#[derive(Clone, Debug)]
pub struct Chunk<'a> {
    /// Vertices as exported.
    pub positions: &'a [[f32; 3]],
    /// Number of the first of them: vertices are numbered in the order in which they come, without gaps.
    pub first_vertex: u32,
    /// Triangles in order, in any number of slices; their vertices have come with this chunk or before, and have not retired.
    pub triangles: Vec<&'a [[u32; 3]]>,
    /// Promise: no later triangle names a vertex below this number.
    pub retired_vertices: u32,
    /// Promise: no later triangle has a corner below this z.
    pub retired_z: f32,
}

impl Chunk<'_> {
    /// How many triangles it has.
    pub(super) fn count(&self) -> usize {
        self.triangles.iter().map(|part| part.len()).sum()
    }
}
