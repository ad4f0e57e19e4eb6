//! Why a surface cannot be remeshed.

use crate::geometry::triangulate::TriangulateError;

/// Why a surface cannot be remeshed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RemeshError {
    /// There are fewer than two sections, or one does not continue the one before.
    #[error("the sections do not form a surface")]
    Sections,
    /// An end cannot be closed.
    #[error("an end cannot be closed: {0}")]
    Cap(#[from] TriangulateError),
    /// Walls meet however small the tolerance.
    #[error("{0} pairs of triangles meet however small the tolerance is")]
    Meeting(usize),
    /// It was asked to stop.
    #[error("stopped")]
    Stopped,
}
