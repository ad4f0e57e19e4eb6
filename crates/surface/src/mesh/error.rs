//! Errors of the loft, each with its place.

use std::fmt;

use crate::geometry::polygon::ContourError;
use crate::geometry::triangulate::TriangulateError;

/// One of the two loops of a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wall {
    /// Boundary of the lumen.
    Inner,
    /// Boundary of the tissue.
    Outer,
}

impl fmt::Display for Wall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Inner => "inner",
            Self::Outer => "outer",
        })
    }
}

/// Errors of the loft. After an error, the lofter must not be used again.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LoftError {
    /// The history has no section.
    #[error("no section to loft to")]
    NoSection,
    /// Only one section; a tube needs two.
    #[error("a tube needs at least two sections")]
    NoSlab,
    /// A ring has different numbers of ids and points.
    #[error("section at step {step}: the {wall} ring has {points} points but {ids} ids")]
    Ids {
        /// Step of the section.
        step: f64,
        /// Wall of the ring.
        wall: Wall,
        /// Number of points.
        points: usize,
        /// Number of ids.
        ids: usize,
    },
    /// A ring crosses itself, is malformed or clockwise.
    #[error("section at step {step} (z = {z_um} µm): {wall} contour: {source} (metres)")]
    Contour {
        /// Step of the section.
        step: f64,
        /// Place along the tube, micrometres.
        z_um: f64,
        /// Wall of the ring.
        wall: Wall,
        /// The fault of the contour.
        source: ContourError,
    },
    /// The inner ring does not lie inside the outer one.
    #[error("section at step {step} (z = {z_um} µm): {source} (metres)")]
    Nesting {
        /// Step of the section.
        step: f64,
        /// Place along the tube, micrometres.
        z_um: f64,
        /// The fault.
        source: ContourError,
    },
    /// An id of the earlier section is missing from the later one, or out of order.
    #[error("section at step {step}: id {id} of the {wall} ring has no continuation in order")]
    Continuation {
        /// Step of the later section.
        step: f64,
        /// Wall of the ring.
        wall: Wall,
        /// The id.
        id: u32,
    },
    /// A section is not above the previous one in exported metres.
    #[error("section at step {step} is at z = {z_um} µm, not above the previous section")]
    Order {
        /// Step of the section.
        step: f64,
        /// Its place along the tube, micrometres.
        z_um: f64,
    },
    /// Walls intersect in a slab even after sections were added.
    #[error(
        "walls meet between steps {from_step} and {to_step} (z = {z_um} µm) near \
         ({x_um:.3}, {y_um:.3}) µm; additional sections do not separate them"
    )]
    Unmendable {
        /// Step below the slab.
        from_step: f64,
        /// Step above the slab.
        to_step: f64,
        /// Place of the upper end of the slab along the tube, micrometres.
        z_um: f64,
        /// Where the walls meet, micrometres.
        x_um: f64,
        /// Where the walls meet, micrometres.
        y_um: f64,
    },
    /// An end could not be closed.
    #[error("the {end} end could not be closed: {source}")]
    Cap {
        /// `isthmus` or `ampulla`.
        end: &'static str,
        /// Why.
        source: TriangulateError,
    },
    /// The cap of an end has no rim at the inner wall that a lid could close.
    #[error("the {end} end has no closed rim around the lumen")]
    Rim {
        /// `isthmus` or `ampulla`.
        end: &'static str,
    },
    /// More vertices than allowed, or than 32-bit indices can address.
    #[error(
        "the surface would have more than {most} vertices: its walls meet in so many places that too many sections \
         would have to be added (weaker forces, more steps or a smaller recording interval may help)"
    )]
    TooLarge {
        /// Maximum number of vertices.
        most: usize,
    },
}
