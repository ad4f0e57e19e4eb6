//! Limits on the size of what is read.
//!
//! A small file can describe a very large surface, for example by placing one mesh many times. The
//! limits are above the size of real surfaces, which have up to tens of millions of triangles.

use super::error::ReadError;

/// Bytes of a file together with the files that it refers to.
pub(super) const BYTES: u64 = 4 << 30;
/// Triangles of a surface, counting every instance of a mesh.
pub(super) const TRIANGLES: u64 = 64_000_000;
/// Vertices of a surface, counting every instance of a mesh. Formats without shared vertices have
/// three per triangle.
pub(super) const VERTICES: u64 = 3 * TRIANGLES;
/// JSON objects of a glTF document, or XML elements of a VTP file. An object has at least two bytes
/// in the file and takes a few hundred bytes of memory.
pub(super) const OBJECTS: u64 = 2_000_000;
/// Items of glTF accessors that have no data, so that they are zeros.
pub(super) const ZEROS: u64 = 1 << 22;
/// Bytes of an array of strings.
pub(super) const TEXT: u64 = 1 << 24;

/// Checks the number of triangles.
///
/// # Errors
/// [`ReadError::TooLarge`] with `path`.
#[inline]
pub(super) fn triangles(path: &str, count: u64) -> Result<(), ReadError> {
    limited(path, count, "triangles", TRIANGLES)
}

/// Checks the number of vertices.
///
/// # Errors
/// [`ReadError::TooLarge`] with `path`.
#[inline]
pub(super) fn vertices(path: &str, count: u64) -> Result<(), ReadError> {
    limited(path, count, "vertices", VERTICES)
}

/// Checks that a `count` of `what` is at most `most`.
///
/// # Errors
/// [`ReadError::TooLarge`] with `path`.
#[inline]
pub(super) fn limited(path: &str, count: u64, what: &str, most: u64) -> Result<(), ReadError> {
    if count <= most {
        return Ok(());
    }
    Err(ReadError::TooLarge { path: path.to_owned(), what: format!("there are {count} {what}"), most })
}
