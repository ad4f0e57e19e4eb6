//! Data, exact geometry and random numbers that all parts of the engine share.
//!
//! | module | content |
//! |---|---|
//! | [`model`] | plain data: [`Section`](model::Section), [`Mesh`](model::Mesh), [`Cut`](model::Cut) |
//! | [`geometry`] | exact predicates, triangulation, hierarchies, cuts, courses |
//! | [`tissue`] | layers of a section: [`TissueMap`](tissue::TissueMap) |
//! | [`random`] | random numbers as pure functions of a seed |
//! | [`clock`], [`lock`] | elapsed time for reports; a mutex without poisoning |
//!
//! A section consists of two contours, the inner and the outer wall, in micrometres. Meshes are in
//! metres. This example cuts a mesh across the tube, 1.7 mm from the isthmus end:
//!
//! ```
//! use oviduct_base::geometry::cut::Body;
//! use oviduct_base::model::{Mesh, Plane, RingKind};
//!
//! fn count_islands(mesh: &Mesh) -> usize {
//!     let cut = Body::from(mesh).cut(&Plane::across(1700.0));
//!     cut.of(RingKind::Island).count()
//! }
//! # let body = oviduct_base::model::BodyKind::Tissue;
//! # let mesh = Mesh { body, positions: vec![], triangles: vec![], patches: vec![] };
//! # assert_eq!(count_islands(&mesh), 0);
//! ```

pub mod clock;
pub mod geometry;
pub mod lock;
pub mod model;
pub mod random;
pub mod tissue;
#[doc(hidden)]
pub mod vectorize;

/// Version of the engine. Digests contain it, so only the version that grew a model reuses it.
pub const ENGINE_VERSION: &str = env!("CARGO_PKG_VERSION");
