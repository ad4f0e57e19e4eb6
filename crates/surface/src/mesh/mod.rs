//! Lofts sections into a closed surface that does not intersect itself (paper, section 3.1).
//!
//! A [`Lofter`] takes sections as the simulation records them. Between two sections lies a slab. Stable
//! ids relate the vertices of the two, vertices that are new in the later section are inserted into
//! the edges of the earlier one, and each edge gives a quad that is split along a diagonal. Every slab is tested
//! with exact predicates on the exported coordinates. If its walls meet, it is mended by the
//! other diagonal or else by an additional section. The ends are closed by constrained triangulation.
//!
//! Invariant: a mesh that a [`Lofter`] finished is closed and oriented, and no two of its triangles meet except
//! in shared vertices and edges.

mod align;
pub mod bend;
mod bodies;
mod contact;
pub mod contract;
mod draft;
mod error;
pub mod lean;
mod loft;
mod meeting;
mod mend;
pub mod quality;
mod slab;
pub mod smooth;

#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;

pub use bodies::{lumen, regions};
pub use draft::draft;
pub use error::{LoftError, Wall};
pub use loft::{Accepted, Lofter};
