//! Reads surfaces from files in the usual formats, ours or not: glTF (binary or not), OBJ, STL, PLY.
//!
//! Invariant: no bytes, however broken, make a reader panic; what it cannot take it refuses with the place named. All
//! vertex indices of a [`Surface`] are in range.

mod accessor;
mod gltf;
mod obj;
mod ply;
mod stl;
mod text;

use std::ops::Range;
use std::path::{Path, PathBuf};

/// A surface as read: coordinates exactly as they stand in the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// Vertex positions in units of the file.
    pub positions: Vec<[f64; 3]>,
    /// Vertex indices of each triangle. Faces with more corners are split into fans.
    pub triangles: Vec<[u32; 3]>,
    /// Named parts in the order of the file; they need not cover all triangles.
    pub groups: Vec<Group>,
    /// Length of the unit of the file.
    pub unit: Unit,
}

/// A named part of a surface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// Name in the file.
    pub name: String,
    /// Its triangles.
    pub triangles: Range<usize>,
}

/// The unit of length of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Unit {
    /// The file does not say; taken to be metres.
    #[default]
    Assumed,
    /// The file (a comment such as `units: mm`) or its format says: so many metres.
    Stated(f64),
}

impl Unit {
    /// Metres in a unit.
    #[must_use]
    pub fn metres(self) -> f64 {
        match self {
            Self::Assumed => 1.0,
            Self::Stated(metres) => metres,
        }
    }
}

/// Formats that can be read.
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
}

/// Why a file could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file, or one it refers to, could not be opened or read.
    #[error("cannot read {}", path.display())]
    Io {
        /// File.
        path: PathBuf,
        /// Cause.
        #[source]
        source: std::io::Error,
    },
    /// Neither its name nor its first bytes tell the format.
    #[error("{} is not a file of a known format (glb, gltf, obj, stl, ply)", path.display())]
    UnknownFormat {
        /// File.
        path: PathBuf,
    },
    /// A line of a text file is wrong.
    #[error("line {line}: {detail}")]
    Line {
        /// Line, the first being 1.
        line: usize,
        /// What is wrong.
        detail: String,
    },
    /// Something is wrong at a byte of a binary file.
    #[error("byte {byte}: {detail}")]
    Byte {
        /// Offset into the file.
        byte: usize,
        /// What is wrong.
        detail: String,
    },
    /// A glTF document is wrong.
    #[error("{path}: {detail}")]
    Document {
        /// The part concerned, such as `accessors[3]`.
        path: String,
        /// What is wrong.
        detail: String,
    },
}

/// Reads a surface from a file.
///
/// # Errors
/// See [`ReadError`].
pub fn read_surface(path: &Path) -> Result<Surface, ReadError> {
    let bytes = read_bytes(path)?;
    let format = format_of(path, &bytes).ok_or_else(|| ReadError::UnknownFormat { path: path.to_owned() })?;
    parse(&bytes, format, path.parent())
}

/// Reads a surface from memory. `folder` is where a glTF document may find files it refers to.
///
/// # Errors
/// See [`ReadError`].
pub fn parse(bytes: &[u8], format: Format, folder: Option<&Path>) -> Result<Surface, ReadError> {
    match format {
        Format::Gltf => gltf::parse(bytes, folder),
        Format::Obj => obj::parse(bytes),
        Format::Stl => stl::parse(bytes),
        Format::Ply => ply::parse(bytes),
    }
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, ReadError> {
    std::fs::read(path).map_err(|source| ReadError::Io { path: path.to_owned(), source })
}

/// The format of a file, by its first bytes where these are certain, else by its name.
fn format_of(path: &Path, bytes: &[u8]) -> Option<Format> {
    if bytes.starts_with(b"glTF") {
        return Some(Format::Gltf);
    }
    if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
        return Some(Format::Ply);
    }
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "glb" | "gltf" => Some(Format::Gltf),
        "obj" => Some(Format::Obj),
        "stl" => Some(Format::Stl),
        "ply" => Some(Format::Ply),
        _ => None,
    }
}

impl Surface {
    /// Splits a face into a fan around its first corner.
    fn add_face(&mut self, corners: &[u32]) {
        for pair in corners.windows(2).skip(1) {
            self.triangles.push([corners[0], pair[0], pair[1]]);
        }
    }

    /// Ends the last group and, where a name is given, begins another.
    fn begin_group(&mut self, name: Option<&str>) {
        let now = self.triangles.len();
        if let Some(last) = self.groups.last_mut() {
            last.triangles.end = now;
            if last.triangles.is_empty() {
                self.groups.pop();
            }
        }
        if let Some(name) = name {
            self.groups.push(Group { name: name.to_owned(), triangles: now..now });
        }
    }
}

#[cfg(test)]
mod tests;
