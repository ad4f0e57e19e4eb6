//! Lofts sections into a closed surface that does not intersect itself (paper, section 3.1).
//!
//! A [`Lofter`] receives sections as the simulation records them. The surface between two sections
//! is a slab. Stable ids match the vertices of both sections, new vertices of the later section are
//! inserted into edges of the earlier one, and each edge gives a quad that is split along a
//! diagonal. Exact predicates test every slab in the exported coordinates. If its walls intersect,
//! the slab is mended: by the other diagonal, or by an additional section. Constrained
//! triangulation closes the ends.
//!
//! Invariant: a mesh from [`Lofter::finish`] is closed and oriented, and no two of its triangles
//! intersect outside their shared vertices and edges.

mod align;
pub mod bend;
mod bodies;
pub mod contract;
mod draft;
mod error;
mod intersection;
pub mod lean;
mod loft;
mod mend;
pub mod quality;
mod slab;
pub mod smooth;
mod unwrap;

#[cfg(test)]
mod samples;
#[cfg(test)]
mod tests;

pub use bodies::{lumen, regions};
pub use draft::draft;
pub use error::{LoftError, Wall};
pub use loft::{Accepted, Lofter};
pub use unwrap::unwrap;
