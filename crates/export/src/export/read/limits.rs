//! Limits on what is read. A small file can describe a very large surface, for example by placing one mesh many times. The
//! limits are above the size of real surfaces, which have up to tens of millions of triangles.

use super::error::ReadError;

/// Bytes of a file together with the files that it refers to.
pub(super) const BYTES: u64 = 4 << 30;
/// Triangles of a surface, after all instances are placed.
pub(super) const TRIANGLES: u64 = 64_000_000;
/// Vertices of a surface, after all instances are placed. Formats without shared vertices have three per triangle.
pub(super) const VERTICES: u64 = 3 * TRIANGLES;
/// JSON objects of a glTF document; each takes a few hundred bytes in memory, and two in the file. XML elements of a VTP file.
pub(super) const OBJECTS: u64 = 2_000_000;
/// Bytes of an array of strings.
pub(super) const TEXT: u64 = 1 << 24;

/// Refuses a surface of too many triangles.
///
/// # Errors
/// [`ReadError::TooLarge`] with `path`.
#[inline]
pub(super) fn triangles(path: &str, count: u64) -> Result<(), ReadError> {
    limited(path, count, "triangles", TRIANGLES)
}

/// Refuses a surface of too many vertices.
///
/// # Errors
/// [`ReadError::TooLarge`] with `path`.
#[inline]
pub(super) fn vertices(path: &str, count: u64) -> Result<(), ReadError> {
    limited(path, count, "vertices", VERTICES)
}

/// Refuses a `count` of `what` above `most`.
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
