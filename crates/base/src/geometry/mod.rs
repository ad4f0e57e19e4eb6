//! Exact plane and space geometry: predicates, segments, polygons, constrained triangulation,
//! bounding-volume hierarchies and triangle contact. Independent of the model.

pub mod blocks;
pub mod bvh;
pub mod coarse;
pub mod course;
pub mod cut;
mod descent;
pub mod distance;
pub mod patch;
pub mod polygon;
pub mod predicates;
pub mod segment;
pub mod star;
pub mod strips;
pub mod tri_tri;
pub mod triangulate;
