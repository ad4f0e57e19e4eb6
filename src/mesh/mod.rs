//! Sections to a closed surface that meets itself nowhere (paper, section 3.1).
//!
//! A [`Lofter`] takes sections as the simulation records them. Between two sections lies a slab: stable
//! ids say which vertex continues which, vertices that are new in the later section are inserted into
//! the edges of the earlier one, and one quad an edge is split along a diagonal. Every slab is tested
//! with exact predicates on the coordinates that are exported, and mended where its walls meet: by the
//! other diagonal, else by a further section. The ends are closed by constrained triangulation.
//!
//! Invariant: a mesh that leaves this module is closed, oriented, and no two of its triangles meet but
//! in shared vertices and edges.

mod align;
mod contact;
mod error;
mod loft;
mod mend;
mod slab;

#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;

pub use error::{LoftError, Wall};
pub use loft::{Accepted, Lofter};
