//! Exact predicates, bounding-volume hierarchies, triangle contact, patches of a mesh and triangle strips: geometry
//! that knows nothing of organs.

pub mod bvh;
pub mod patch;
pub mod predicates;
pub mod strips;
pub mod tri_tri;
