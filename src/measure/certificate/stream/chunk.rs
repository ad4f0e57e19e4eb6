//! Parts of a surface, as they come.

/// The next part of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Chunk<'a> {
    /// Vertices as exported.
    pub positions: &'a [[f32; 3]],
    /// Number of the first of them: vertices are numbered in the order in which they come, without gaps.
    pub first_vertex: u32,
    /// Triangles; their vertices have come with this chunk or before, and have not retired.
    pub triangles: &'a [[u32; 3]],
    /// Promise: no later triangle names a vertex below this number.
    pub retired_vertices: u32,
    /// Promise: no later triangle has a corner below this z.
    pub retired_z: f32,
}
