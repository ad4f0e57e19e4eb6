//! The exported surface: indexed triangles in metres, grouped in named patches.

use std::ops::Range;

/// The closed body that a mesh bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BodyKind {
    /// Between the walls: a solid torus, Euler number 0.
    Tissue,
    /// Inside the inner wall, capped: Euler number 2.
    Lumen,
}

impl BodyKind {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Tissue => "tissue",
            Self::Lumen => "lumen",
        }
    }

    /// Euler number of a sound surface of this body.
    #[must_use]
    pub fn euler(self) -> i64 {
        match self {
            Self::Tissue => 0,
            Self::Lumen => 2,
        }
    }
}

/// A named part of a body's surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PatchKind {
    /// Mucosa, the boundary of the lumen.
    InnerWall,
    /// Outer boundary of the tissue.
    OuterWall,
    /// Annulus that closes the tissue at the isthmus end (z = 0).
    CapIsthmus,
    /// Annulus that closes the tissue at the ampulla end (z = length).
    CapAmpulla,
    /// Side of the lumen body.
    Wall,
    /// End of the lumen body at the isthmus.
    Inlet,
    /// End of the lumen body at the ampulla.
    Outlet,
}

impl PatchKind {
    const ALL: [Self; 7] =
        [Self::InnerWall, Self::OuterWall, Self::CapIsthmus, Self::CapAmpulla, Self::Wall, Self::Inlet, Self::Outlet];

    /// The patch of a name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// The name used in files: nodes and materials of glTF, groups of OBJ.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::InnerWall => "inner_wall",
            Self::OuterWall => "outer_wall",
            Self::CapIsthmus => "cap_isthmus",
            Self::CapAmpulla => "cap_ampulla",
            Self::Wall => "wall",
            Self::Inlet => "inlet",
            Self::Outlet => "outlet",
        }
    }
}

/// A run of triangles that form one named patch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Patch {
    /// Kind of the patch.
    pub kind: PatchKind,
    /// Its triangles, as a range of [`Mesh::triangles`]; patches cover all triangles without overlap.
    pub triangles: Range<usize>,
}

/// A closed triangle surface with shared vertices (patches share the vertices of their borders).
///
/// Axes: x and y as in the sections (y up), z along the tube; right-handed, so glTF needs no rotation.
/// Triangles are counter-clockwise seen from outside the body.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Which body it bounds.
    pub body: BodyKind,
    /// Distinct vertex positions in metres, exactly as exported.
    pub positions: Vec<[f32; 3]>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// The named patches, in order.
    pub patches: Vec<Patch>,
}
