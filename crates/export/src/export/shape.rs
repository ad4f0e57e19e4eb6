//! [`Shape`], the input of the writers of surfaces.

use super::Metadata;
use crate::model::{LengthUnit, Mesh};
use std::ops::Range;

/// Maximum number of triangles of a [`TriangleRun`].
const RUN: usize = if cfg!(test) { 1 << 4 } else { 1 << 16 };

/// A surface to be written: a body of a model, or a surface that was read from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape<'a> {
    /// Name of the body: `tissue`, `lumen`, `regions`, or the name of a converted file.
    pub name: &'a str,
    /// Distinct vertex positions in `unit`.
    pub positions: &'a [[f32; 3]],
    /// Vertex indices of each triangle.
    pub triangles: &'a [[u32; 3]],
    /// Named patches, which cover all triangles in order and without overlap.
    pub patches: Vec<NamedPatch<'a>>,
    /// Unit of the positions.
    pub unit: LengthUnit,
    /// Origin of a model; `None` for a converted file.
    pub meta: Option<&'a Metadata>,
}

/// A run of triangles with a name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedPatch<'a> {
    /// Name of the patch.
    pub name: &'a str,
    /// Triangles of the patch.
    pub triangles: Range<usize>,
}

impl<'a> Shape<'a> {
    /// Shape of a body of a model, in metres.
    #[must_use]
    pub fn of(mesh: &'a Mesh, meta: &'a Metadata) -> Self {
        Self {
            name: mesh.body.name(),
            positions: &mesh.positions,
            triangles: &mesh.triangles,
            patches: (mesh.patches.iter())
                .map(|patch| NamedPatch { name: patch.kind.name(), triangles: patch.triangles.clone() })
                .collect(),
            unit: LengthUnit::Metre,
            meta: Some(meta),
        }
    }

    /// Generator that a file states: oviduct with its version.
    pub(super) fn generator(&self) -> String {
        format!("oviduct {}", engine(self.meta))
    }

    /// Triangles of a patch.
    pub(super) fn triangles_of(&self, patch: &NamedPatch<'_>) -> &'a [[u32; 3]] {
        &self.triangles[patch.triangles.clone()]
    }

    /// Positions of the corners of a triangle.
    pub(super) fn corners(&self, triangle: [u32; 3]) -> [[f32; 3]; 3] {
        triangle.map(|v| self.positions[v as usize])
    }

    /// Splits the triangles of a patch into runs, in order.
    pub(super) fn runs(&self, patch: &NamedPatch<'_>) -> Vec<TriangleRun<'a>> {
        let run = |triangles: &'a [[u32; 3]]| {
            let bounds = |(least, end): (u32, u32), &v: &u32| (least.min(v), end.max(v + 1));
            let (least, end) = triangles.as_flattened().iter().fold((u32::MAX, 0), bounds);
            TriangleRun { vertices: least..end, triangles }
        };
        let mut runs: Vec<_> = self.triangles_of(patch).chunks(RUN).map(run).collect();
        let mut least = u32::MAX;
        for run in runs.iter_mut().rev() {
            least = least.min(run.vertices.start);
            run.vertices.start = least;
        }
        runs
    }
}

/// Successive triangles of a patch, for writers that keep data for each vertex in use.
pub(super) struct TriangleRun<'a> {
    /// Vertices in use: this run names no vertex outside the range, and later runs of the patch
    /// name none before it.
    pub(super) vertices: Range<u32>,
    /// Vertex indices of each triangle.
    pub(super) triangles: &'a [[u32; 3]],
}

/// Engine version that a file states. For a model, this is the version that grew it.
pub(super) fn engine(meta: Option<&Metadata>) -> &str {
    meta.map_or(crate::ENGINE_VERSION, |meta| &meta.engine)
}

/// Description of the axes of all files of models.
pub const AXES: &str = "right-handed, y up, z along the tube from isthmus to ampulla";
