//! Exact geometry in the plane and in space. All decisions on surfaces use exact predicates, so a
//! certificate does not depend on rounding.
//!
//! | module | subject |
//! |---|---|
//! | [`predicates`], [`segment`] | exact orientations and intersections of segments |
//! | [`polygon`] | closed contours: area, simplicity, containment, nesting |
//! | [`triangulate`] | constrained Delaunay triangulation between contours |
//! | [`tri_tri`] | exact intersection of two triangles |
//! | [`blocks`], [`bvh`], [`coarse`] | hierarchies that find overlapping pairs |
//! | [`curve`] | order of items along a space-filling curve |
//! | [`distance`] | distances between points and triangles |
//! | [`cut`] | planar cuts of a body, and its half beyond a plane |
//! | [`course`] | centre lines, and the map that bends a tube |
//! | [`star`] | star-shaped outlines |
//! | [`patch`], [`strips`] | patches with normals, triangle strips |
//! | [`vector`] | sums, products and distances of plain arrays |
//!
//! ```
//! use oviduct_base::geometry::polygon::{check_contour, check_nested, signed_area};
//! use oviduct_base::geometry::triangulate::annulus;
//!
//! let outer = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
//! let inner = [[1.0, 1.0], [2.0, 1.0], [1.0, 2.0]];
//! check_contour(&outer)?; // simple and counter-clockwise
//! check_contour(&inner)?;
//! check_nested(&inner, &outer)?;
//! assert_eq!(signed_area(&outer) - signed_area(&inner), 15.5);
//!
//! let triangles = annulus(&inner, &outer)?; // as many triangles as points
//! assert_eq!(triangles.len(), 7);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod blocks;
pub mod bvh;
pub mod coarse;
pub mod course;
pub mod curve;
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
pub mod vector;
