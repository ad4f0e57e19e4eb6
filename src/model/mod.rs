//! Plain data exchanged by simulation, loft, certificate and export: sections and meshes.

mod mesh;
mod section;

pub use mesh::{BodyKind, LengthUnit, Mesh, Patch, PatchKind};
pub use section::{Ring, Section};

#[cfg(test)]
pub(crate) mod sample;
