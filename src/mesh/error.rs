//! What can go wrong between sections and surface, with the place named.

use std::fmt;

use crate::geometry::polygon::ContourError;
use crate::geometry::triangulate::TriangulateError;

/// Which of the two loops of a section.
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

/// Why sections could not be lofted. A lofter that has returned an error is spent.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LoftError {
    /// No section was handed over.
    #[error("no section to loft to")]
    NoSection,
    /// Only one section: a tube needs two.
    #[error("a tube needs at least two sections")]
    NoSlab,
    /// A ring has not as many ids as points.
    #[error("section at step {step}: the {wall} ring has {points} points but {ids} ids")]
    Ids {
        /// Step of the section.
        step: f64,
        /// Which ring.
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
        /// Which ring.
        wall: Wall,
        /// What is wrong with it.
        source: ContourError,
    },
    /// The inner ring does not lie inside the outer one.
    #[error("section at step {step} (z = {z_um} µm): {source} (metres)")]
    Nesting {
        /// Step of the section.
        step: f64,
        /// Place along the tube, micrometres.
        z_um: f64,
        /// What is wrong.
        source: ContourError,
    },
    /// An id of the earlier section is missing from the later one, or out of order.
    #[error("section at step {step}: id {id} of the {wall} ring has no continuation in order")]
    Continuation {
        /// Step of the later section.
        step: f64,
        /// Which ring.
        wall: Wall,
        /// The id.
        id: u32,
    },
    /// A section does not lie above the one before it, in metres as exported.
    #[error("section at step {step} lies at z = {z_um} µm, not above the section before it")]
    Order {
        /// Step of the section.
        step: f64,
        /// Its place along the tube, micrometres.
        z_um: f64,
    },
    /// Walls meet in a slab whatever sections are added.
    #[error(
        "walls meet between steps {from_step} and {to_step} (z = {z_um} µm) near \
         ({x_um:.3}, {y_um:.3}) µm; further sections do not part them"
    )]
    Unmendable {
        /// Step below the slab.
        from_step: f64,
        /// Step above it.
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
    /// More vertices than were allowed, or than 32-bit indices can number.
    #[error(
        "the surface would have more than {most} vertices: its walls meet in so many places that sections are added \
         without end (weaker forces, finer steps or shorter recording intervals may help)"
    )]
    TooLarge {
        /// The limit.
        most: usize,
    },
}
