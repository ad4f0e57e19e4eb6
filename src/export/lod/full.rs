//! The full surface as the levels need it: patch by patch, with corners of their own, on the grid.

use super::grid::{Cell, Grid};
use crate::geometry::distance::Triangles;
use crate::geometry::patch::{PatchGeometry, patch_geometry};
use crate::model::{Mesh, PatchKind};
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::Range;

/// The triangles of each patch, as corners of the full surface.
pub(super) type Level<'a> = Vec<Cow<'a, [[u32; 3]]>>;

/// The full surface. A corner is a vertex of one patch; patches that share a vertex have a corner each.
pub(super) struct Full<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) grid: Grid,
    /// Cell of each vertex of the mesh.
    pub(super) cells: Vec<Cell>,
    /// Position of each vertex of the mesh, rounded to its cell.
    pub(super) placed: Vec<[f32; 3]>,
    /// Vertex of each corner.
    pub(super) vertices: Vec<u32>,
    /// Normal of each corner, in the space of the grid.
    pub(super) normals: Vec<[i16; 3]>,
    pub(super) parts: Vec<Part>,
}

/// A patch that has triangles.
pub(super) struct Part {
    pub(super) kind: PatchKind,
    pub(super) corners: Range<u32>,
    /// Triangles as corners, in the order of the mesh.
    pub(super) triangles: Vec<[u32; 3]>,
    /// The same triangles within [`Mesh::triangles`].
    source: Range<usize>,
}

impl<'a> Full<'a> {
    pub(super) fn new(mesh: &'a Mesh) -> Self {
        let grid = Grid::of(&mesh.positions);
        let patches: Vec<_> = mesh.patches.iter().filter(|patch| !patch.triangles.is_empty()).collect();
        let (cells, geometries) = rayon::join(
            || grid.cells(&mesh.positions),
            || patches.par_iter().map(|patch| patch_geometry(mesh, patch)).collect::<Vec<_>>(),
        );
        let placed = cells.par_iter().map(|cell| grid.position(*cell)).collect();
        let normals =
            geometries.par_iter().flat_map(|g| g.normals.par_iter().map(|normal| grid.normal(*normal))).collect();
        let (mut vertices, mut parts) = (Vec::new(), Vec::new());
        for (patch, PatchGeometry { vertices: own, mut triangles, .. }) in patches.into_iter().zip(geometries) {
            let first = vertices.len() as u32;
            vertices.extend(own);
            triangles.par_iter_mut().for_each(|t| *t = t.map(|v| v + first));
            let corners = first..vertices.len() as u32;
            parts.push(Part { kind: patch.kind, corners, triangles, source: patch.triangles.clone() });
        }
        Self { mesh, grid, cells, placed, vertices, normals, parts }
    }

    /// The level with all triangles.
    pub(super) fn level(&self) -> Level<'_> {
        self.parts.iter().map(|part| Cow::Borrowed(&part.triangles[..])).collect()
    }

    /// The triangles of a patch at full precision.
    pub(super) fn hierarchy(&self, part: &Part) -> Triangles<impl Fn(usize) -> [[f64; 3]; 3] + Sync + use<'_, 'a>> {
        let triangles = &self.mesh.triangles[part.source.clone()];
        let corner = |v: u32| self.mesh.positions[v as usize].map(f64::from);
        Triangles::new(triangles.len(), move |i| triangles[i].map(corner))
    }
}
