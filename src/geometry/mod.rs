//! Exact plane and space geometry: predicates, segments, polygons, constrained triangulation.

pub mod predicates;
