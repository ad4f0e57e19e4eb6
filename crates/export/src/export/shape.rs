//! What the writers of surfaces are given: a [`Source`], which is a [`Shape`] in memory or a [spool](super::spool) on disk.

use super::Metadata;
use crate::model::{LengthUnit, Mesh};
use std::io;
use std::ops::Range;

/// A surface that is read piece by piece, as often as a writer needs.
pub trait Source: Sync {
    /// What is known without reading it.
    fn head(&self) -> Head<'_>;

    /// Calls `each` with all positions in order, some at a time.
    ///
    /// # Errors
    /// Those of reading and of `each`.
    fn positions(&self, each: &mut dyn FnMut(&[[f32; 3]]) -> io::Result<()>) -> io::Result<()>;

    /// Calls `each` with the triangles of patches, given by their numbers. The triangles of a patch come in order; those of
    /// different patches may alternate.
    ///
    /// # Errors
    /// Those of reading and of `each`.
    fn walk(&self, patches: &[usize], each: &mut dyn FnMut(&Piece<'_>) -> io::Result<()>) -> io::Result<()>;

    /// Whether all of it is in memory anyway, so that a writer may hold as much.
    fn is_in_memory(&self) -> bool;

    /// [`walk`](Self::walk) with one patch after another: all triangles in order.
    ///
    /// # Errors
    /// Those of reading and of `each`.
    fn walk_in_order(&self, each: &mut dyn FnMut(&Piece<'_>) -> io::Result<()>) -> io::Result<()> {
        (0..self.head().patches.len()).try_for_each(|patch| self.walk(&[patch], each))
    }
}

/// What is known of a surface without reading it.
#[derive(Clone, Debug, PartialEq)]
pub struct Head<'a> {
    /// Name of the whole.
    pub name: &'a str,
    /// Number of vertices.
    pub vertices: usize,
    /// Number of triangles.
    pub triangles: usize,
    /// Named patches, as in [`Shape`].
    pub patches: Vec<NamedPatch<'a>>,
    /// Unit of the positions.
    pub unit: LengthUnit,
    /// Origin of a generated model; none for a converted file.
    pub meta: Option<&'a Metadata>,
}

impl Head<'_> {
    /// The program that writes it, with its version.
    pub(super) fn generator(&self) -> String {
        format!("oviduct {}", engine(self.meta))
    }
}

/// Some triangles of a patch with the positions of their corners.
#[derive(Clone, Copy, Debug)]
pub struct Piece<'a> {
    /// Number of the patch.
    pub patch: usize,
    /// Number of the first of `positions`. Neither this piece nor a later one of the same walk uses a vertex before it.
    pub first: u32,
    /// Positions of the vertices from `first` on that may be in use.
    pub positions: &'a [[f32; 3]],
    /// Vertex numbers of each triangle.
    pub triangles: &'a [[u32; 3]],
}

impl Piece<'_> {
    /// The position of a vertex.
    pub(super) fn position(&self, vertex: u32) -> [f32; 3] {
        self.positions[(vertex - self.first) as usize]
    }

    /// The corners of a triangle.
    pub(super) fn corners(&self, triangle: [u32; 3]) -> [[f32; 3]; 3] {
        triangle.map(|v| self.position(v))
    }
}

/// A surface to be written: a body of a model, or what was read from another file.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape<'a> {
    /// Name of the whole: `tissue`, `lumen`, `regions`, or that of a converted file.
    pub name: &'a str,
    /// Distinct vertex positions in `unit`.
    pub positions: &'a [[f32; 3]],
    /// Vertex indices of each triangle.
    pub triangles: &'a [[u32; 3]],
    /// Named patches; they cover all triangles in order without overlap.
    pub patches: Vec<NamedPatch<'a>>,
    /// Unit of the positions.
    pub unit: LengthUnit,
    /// Origin of a generated model; none for a converted file.
    pub meta: Option<&'a Metadata>,
}

/// A run of triangles with a name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedPatch<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its triangles.
    pub triangles: Range<usize>,
}

impl<'a> Shape<'a> {
    /// A body of a model, in metres.
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
}

impl Source for Shape<'_> {
    fn head(&self) -> Head<'_> {
        Head {
            name: self.name,
            vertices: self.positions.len(),
            triangles: self.triangles.len(),
            patches: self.patches.clone(),
            unit: self.unit,
            meta: self.meta,
        }
    }

    fn positions(&self, each: &mut dyn FnMut(&[[f32; 3]]) -> io::Result<()>) -> io::Result<()> {
        each(self.positions)
    }

    fn walk(&self, patches: &[usize], each: &mut dyn FnMut(&Piece<'_>) -> io::Result<()>) -> io::Result<()> {
        let triangles = |patch: usize| &self.triangles[self.patches[patch].triangles.clone()];
        // Writers keep something for each vertex from the first to the last in use: of a small patch, often few.
        let used = || patches.iter().flat_map(|&patch| triangles(patch).as_flattened());
        let first = used().min().map_or(0, |&least| least as usize);
        let end = used().max().map_or(first, |&greatest| greatest as usize + 1);
        let positions = &self.positions[first..end];
        patches
            .iter()
            .try_for_each(|&patch| each(&Piece { patch, first: first as u32, positions, triangles: triangles(patch) }))
    }

    fn is_in_memory(&self) -> bool {
        true
    }
}

/// The version of the program that a file names: of a model, the one that grew it.
pub(super) fn engine(meta: Option<&Metadata>) -> &str {
    meta.map_or(crate::ENGINE_VERSION, |meta| &meta.engine)
}

/// Axes of all files of models, in words.
pub const AXES: &str = "right-handed, y up, z along the tube from isthmus to ampulla";
