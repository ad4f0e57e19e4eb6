//! Exported surfaces: indexed triangles in metres, grouped in named patches.

use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::ops::Range;

/// The body, or bodies, that a closed surface bounds: `tissue` lies between the walls, `lumen`
/// inside the inner wall, and `regions` are both with their common wall once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "schema", schema(as = Body))]
pub enum BodyKind {
    /// Between the walls: a solid torus, Euler number 0.
    Tissue,
    /// Inside the inner wall, capped: Euler number 2.
    Lumen,
    /// Both bodies, with the wall between them once: three triangles meet at the edges of its rims.
    /// Euler number 2.
    Regions,
}

impl BodyKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Tissue, Self::Lumen, Self::Regions];

    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Tissue => "tissue",
            Self::Lumen => "lumen",
            Self::Regions => "regions",
        }
    }

    /// Finds the kind with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|body| body.name() == name)
    }

    /// Patches of the body's surface, in the order of its files.
    #[must_use]
    pub fn patches(self) -> &'static [PatchKind] {
        use PatchKind::{CapAmpulla, CapIsthmus, Inlet, InnerWall, OuterWall, Outlet, Wall};
        match self {
            Self::Tissue => &[InnerWall, OuterWall, CapIsthmus, CapAmpulla],
            Self::Lumen => &[Wall, Inlet, Outlet],
            Self::Regions => &[InnerWall, OuterWall, CapIsthmus, CapAmpulla, Inlet, Outlet],
        }
    }

    /// Euler number of a valid surface of this body.
    #[must_use]
    pub fn euler(self) -> i64 {
        match self {
            Self::Tissue => 0,
            Self::Lumen | Self::Regions => 2,
        }
    }
}

/// Unit of length of the coordinates in a file: metres, millimetres or micrometres.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum LengthUnit {
    /// Metres.
    #[serde(rename = "m")]
    Metre,
    /// Millimetres.
    #[serde(rename = "mm")]
    Millimetre,
    /// Micrometres.
    #[serde(rename = "um")]
    Micrometre,
}

impl LengthUnit {
    /// All units.
    pub const ALL: [Self; 3] = [Self::Metre, Self::Millimetre, Self::Micrometre];

    /// Name in files and requests.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Metre => "m",
            Self::Millimetre => "mm",
            Self::Micrometre => "um",
        }
    }

    /// Finds the unit with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|unit| unit.name() == name)
    }

    /// Number of units in a metre.
    #[must_use]
    pub fn per_metre(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Millimetre => 1e3,
            Self::Micrometre => 1e6,
        }
    }

    /// Length of the unit in metres.
    #[must_use]
    pub fn metres(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Millimetre => 1e-3,
            Self::Micrometre => 1e-6,
        }
    }

    /// Converts positions from metres to this unit, rounding each coordinate once.
    #[must_use]
    pub fn of_metres(self, positions: &[[f32; 3]]) -> Cow<'_, [[f32; 3]]> {
        match self {
            Self::Metre => Cow::Borrowed(positions),
            _ => positions.iter().map(|p| p.map(|x| (f64::from(x) * self.per_metre()) as f32)).collect(),
        }
    }
}

/// Name of a part of a body's surface.
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
    /// Lid of the lumen body at the isthmus end.
    Inlet,
    /// Lid of the lumen body at the ampulla end.
    Outlet,
}

impl PatchKind {
    const ALL: [Self; 7] =
        [Self::InnerWall, Self::OuterWall, Self::CapIsthmus, Self::CapAmpulla, Self::Wall, Self::Inlet, Self::Outlet];

    /// Finds the patch with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// True for the side of a body, false for a patch that closes an end.
    #[must_use]
    pub fn is_wall(self) -> bool {
        matches!(self, Self::InnerWall | Self::OuterWall | Self::Wall)
    }

    /// Name in files: nodes and materials of glTF, groups of OBJ.
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

/// Consecutive triangles that form one patch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Patch {
    /// Kind of the patch.
    pub kind: PatchKind,
    /// Range of [`Mesh::triangles`]. The patches of a mesh cover all triangles without overlap.
    pub triangles: Range<usize>,
}

/// A closed triangle surface with shared vertices. Patches share the vertices of their borders.
///
/// x and y are those of the sections (y up), z runs along the tube. The axes are right-handed, so
/// glTF needs no rotation. Seen from outside the body, triangles are counter-clockwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Body that the surface bounds.
    pub body: BodyKind,
    /// Distinct vertex positions in metres, exactly as exported.
    pub positions: Vec<[f32; 3]>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Named patches, in order.
    pub patches: Vec<Patch>,
}

impl Mesh {
    /// Triangles of a patch; empty if the mesh has no such patch.
    #[must_use]
    pub fn patch(&self, kind: PatchKind) -> &[[u32; 3]] {
        self.patches
            .iter()
            .find(|patch| patch.kind == kind)
            .map_or(&[], |patch| &self.triangles[patch.triangles.clone()])
    }
}
