//! Exact plane and space geometry: predicates, segments, polygons, constrained triangulation.

pub mod blocks;
pub mod patch;
pub mod polygon;
pub mod predicates;
pub mod segment;
pub mod triangulate;
