//! Plain data that simulation, loft, certificate and export exchange: sections, meshes, planes and
//! cuts.

mod cut;
mod mesh;
mod plane;
mod rows;
mod section;

pub use cut::{Border, Cut, CutRing, Line, RingKind};
pub use mesh::{BodyKind, LengthUnit, Mesh, Patch, PatchKind};
pub use plane::Plane;
pub use rows::{Row, RowRuns, Rows, WallRows};
pub use section::{Ring, Section};

#[cfg(any(test, feature = "samples"))]
#[doc(hidden)]
pub mod sample;
