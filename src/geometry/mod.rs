//! Geometry without knowledge of organs: patches of a mesh, triangle strips.

pub mod patch;
pub mod strips;
