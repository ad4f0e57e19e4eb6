//! Exact predicates, bounding-volume hierarchies and triangle contact: geometry that knows nothing of organs.

pub mod bvh;
pub mod predicates;
pub mod tri_tri;
