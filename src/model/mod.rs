//! The plain data that the rooms of floor 2 hand to each other: sections and meshes.

mod mesh;
mod section;

pub use mesh::{BodyKind, Mesh, Patch, PatchKind};
pub use section::{Ring, Section};

#[cfg(test)]
pub(crate) mod sample;
