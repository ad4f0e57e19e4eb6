//! The full surface on the grid, with the normals of its vertices.

use super::grid::{Cell, Grid};
use crate::geometry::patch::{Numbering, add, doubled_area_normal, patch_geometry, unit};
use crate::model::{Mesh, Patch};
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::HashMap;
use std::ops::Range;

/// Minimum number of vertices whose normals are summed at a time.
const MIN_RUN: usize = 1 << 16;
/// Maximum number of runs.
const MAX_RUNS: usize = 16;
/// Number of triangles whose vertices are compared with a run at a time.
const CHUNK: usize = 1 << 10;

/// Triangles of a level, for each patch that has triangles.
pub(super) type PatchTriangles<'a> = Vec<Cow<'a, [[u32; 3]]>>;

/// The full surface. Its walls have no common vertices.
pub(super) struct FullSurface<'a> {
    pub(super) mesh: &'a Mesh,
    /// Patches that have triangles.
    pub(super) patches: Vec<&'a Patch>,
    pub(super) grid: Grid,
    /// Cell of each vertex.
    pub(super) cells: Vec<Cell>,
    /// Normal of each vertex of a wall, in the space of the grid.
    normals: Vec<[i16; 3]>,
}

impl<'a> FullSurface<'a> {
    pub(super) fn new(mesh: &'a Mesh) -> Self {
        let grid = Grid::spanning(&mesh.positions);
        let patches: Vec<&Patch> = mesh.patches.iter().filter(|patch| !patch.triangles.is_empty()).collect();
        let cells = grid.cells(&mesh.positions);
        // Computed in runs of vertices, because the sums take more memory than everything else.
        let count = mesh.positions.len();
        let run = MIN_RUN.max(count.div_ceil(MAX_RUNS));
        let chunks = chunks(mesh, &patches);
        let of_run = |first: usize| normals(mesh, &chunks, first..count.min(first + run), &grid);
        let normals = (0..count.div_ceil(run)).into_par_iter().flat_map_iter(|k| of_run(k * run)).collect();
        Self { mesh, patches, grid, cells, normals }
    }

    /// All triangles.
    pub(super) fn triangles(&self) -> PatchTriangles<'a> {
        all_triangles(self.mesh)
    }

    /// Position of a vertex.
    pub(super) fn position(&self, vertex: u32) -> [f64; 3] {
        self.mesh.positions[vertex as usize].map(f64::from)
    }

    /// Position of a vertex, rounded to the grid.
    pub(super) fn placed(&self, vertex: u32) -> [f32; 3] {
        self.grid.position(self.cells[vertex as usize])
    }

    /// Normals of `vertices` of a patch, in the space of the grid.
    pub(super) fn normals(&self, patch: &Patch, vertices: &[u32]) -> Vec<[i16; 3]> {
        if patch.kind.is_wall() {
            return vertices.iter().map(|&v| self.normals[v as usize]).collect();
        }
        let geometry = patch_geometry(self.mesh, patch);
        let normals: HashMap<u32, [f32; 3]> = geometry.vertices.into_iter().zip(geometry.normals).collect();
        vertices.iter().map(|v| self.grid.normal(normals[v])).collect()
    }
}

/// All triangles of a mesh, for each patch that has triangles.
pub(super) fn all_triangles(mesh: &Mesh) -> PatchTriangles<'_> {
    let patches = mesh.patches.iter().filter(|patch| !patch.triangles.is_empty());
    patches.map(|patch| Cow::Borrowed(&mesh.triangles[patch.triangles.clone()])).collect()
}

/// Consecutive triangles of a wall, and the range of their vertices.
struct Chunk<'a> {
    triangles: &'a [[u32; 3]],
    vertices: Range<usize>,
}

/// The triangles of the walls.
fn chunks<'a>(mesh: &'a Mesh, patches: &[&Patch]) -> Vec<Chunk<'a>> {
    let chunk = |triangles: &'a [[u32; 3]]| {
        let vertices = triangles.as_flattened();
        let first = vertices.iter().min().map_or(0, |v| *v as usize);
        let end = vertices.iter().max().map_or(0, |v| *v as usize + 1);
        Chunk { triangles, vertices: first..end }
    };
    let walls = patches.iter().filter(|patch| patch.kind.is_wall());
    walls.flat_map(|patch| mesh.triangles[patch.triangles.clone()].chunks(CHUNK)).map(chunk).collect()
}

/// Normals of a range of vertices, in the space of the grid. Only triangles of walls count.
fn normals(mesh: &Mesh, chunks: &[Chunk<'_>], vertices: Range<usize>, grid: &Grid) -> Vec<[i16; 3]> {
    let mut sums = vec![[0.0; 3]; vertices.len()];
    let is_near = |chunk: &&Chunk<'_>| chunk.vertices.start < vertices.end && vertices.start < chunk.vertices.end;
    for triangle in chunks.iter().filter(is_near).flat_map(|chunk| chunk.triangles) {
        if triangle.iter().any(|&v| vertices.contains(&(v as usize))) {
            let normal = doubled_area_normal(triangle.map(|v| mesh.positions[v as usize]));
            for v in triangle.map(|v| v as usize).into_iter().filter(|v| vertices.contains(v)) {
                add(&mut sums[v - vertices.start], normal);
            }
        }
    }
    sums.into_iter().map(|sum| grid.normal(unit(sum))).collect()
}

/// Renumbers vertices in the order of their first use. Returns the vertex of each number.
pub(super) fn number(vertices: &mut [u32]) -> Vec<u32> {
    let first = vertices.iter().copied().min().unwrap_or(0);
    let end = vertices.iter().copied().max().map_or(0, |last| last + 1);
    let (mut numbering, mut numbered) = (Numbering::default(), Vec::new());
    numbering.advance(first, (end - first) as usize);
    for vertex in vertices {
        let (number, is_new) = numbering.number(*vertex);
        if is_new {
            numbered.push(*vertex);
        }
        *vertex = number;
    }
    numbered
}
