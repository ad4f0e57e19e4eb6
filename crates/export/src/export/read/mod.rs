//! Readers of surfaces in common formats: glTF (binary or JSON), OBJ, STL, PLY and VTP, from
//! oviduct or other programs.
//!
//! Invariants:
//!
//! - No input makes a reader panic. An error names the place in the file that cannot be read.
//! - Memory is allocated for data that exist, never for a count that the file merely states, and
//!   within `limits`.
//! - All vertex indices of a [`Surface`] are in range.

mod error;
mod file;
mod gltf;
mod limits;
mod obj;
mod patches;
mod ply;
mod polygons;
mod scalar;
mod stl;
mod surface;
mod text;
mod vtp;

pub use error::ReadError;
pub use surface::{Group, Surface, Unit};

use std::path::Path;

/// A file format that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// glTF 2.0, `.glb` or `.gltf`.
    Gltf,
    /// Wavefront OBJ.
    Obj,
    /// STL, text or binary.
    Stl,
    /// PLY, text or binary.
    Ply,
    /// `PolyData` of VTK in XML, `.vtp`.
    Vtp,
}

/// Reads a surface from a regular file.
///
/// # Errors
/// See [`ReadError`]. A file without triangles is refused.
pub fn read_surface(path: &Path) -> Result<Surface, ReadError> {
    let bytes = file::read(path, limits::BYTES)?;
    let unknown = || text::foreign(&bytes).unwrap_or(ReadError::UnknownFormat);
    let format = format_of(path, &bytes).ok_or_else(unknown)?;
    let mut surface = parse(&bytes, format, path.parent())?;
    if surface.triangles.is_empty() {
        surface.notes.truncate(3);
        return Err(ReadError::NoTriangles(surface.notes));
    }
    Ok(surface)
}

/// Reads a surface from memory. A glTF document may refer to files in `folder`.
///
/// # Errors
/// See [`ReadError`].
pub fn parse(bytes: &[u8], format: Format, folder: Option<&Path>) -> Result<Surface, ReadError> {
    // The header of a binary STL file may begin with any bytes.
    if format != Format::Stl
        && let Some(error) = text::foreign(bytes)
    {
        return Err(error);
    }
    let mut surface = match format {
        Format::Gltf => gltf::parse(bytes, folder),
        Format::Obj => obj::parse(bytes),
        Format::Stl => stl::parse(bytes),
        Format::Ply => ply::parse(bytes),
        Format::Vtp => vtp::parse(bytes),
    }?;
    surface.drop_unused_not_finite();
    Ok(surface)
}

/// Detects the format by the first bytes of the file if these identify it, else by the extension.
fn format_of(path: &Path, bytes: &[u8]) -> Option<Format> {
    if bytes.starts_with(b"glTF") {
        return Some(Format::Gltf);
    }
    let text = text::without_mark(bytes);
    if text.starts_with(b"ply\n") || text.starts_with(b"ply\r") {
        return Some(Format::Ply);
    }
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "glb" | "gltf" => Some(Format::Gltf),
        "obj" => Some(Format::Obj),
        "stl" => Some(Format::Stl),
        "ply" => Some(Format::Ply),
        // Other files of VTK are refused by the name of what they hold.
        "vtp" | "vtu" | "vtk" | "pvtp" => Some(Format::Vtp),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
