//! Errors of the remesher.

use crate::geometry::triangulate::TriangulateError;

/// Error of the remesher.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RemeshError {
    /// Fewer than two sections, or a section does not continue the previous one.
    #[error("the sections do not form a surface")]
    Sections,
    /// An end cannot be closed.
    #[error("an end cannot be closed: {0}")]
    Cap(#[from] TriangulateError),
    /// Walls intersect even with the smallest tolerance.
    #[error("{0} pairs of triangles meet however small the tolerance is")]
    Meeting(usize),
    /// The caller stopped the remesher.
    #[error("stopped")]
    Stopped,
}
