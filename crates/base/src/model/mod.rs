//! Plain data exchanged by simulation, loft, certificate and export: sections, meshes and cuts.

mod cut;
mod mesh;
mod section;

pub use cut::{Body, Border, Cut, CutRing, Line, Plane, RingKind};
pub use mesh::{BodyKind, LengthUnit, Mesh, Patch, PatchKind};
pub use section::{Ring, Section};

#[cfg(any(test, feature = "samples"))]
#[doc(hidden)]
pub mod sample;
