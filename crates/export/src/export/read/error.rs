//! Errors of the readers of surfaces.

use std::path::PathBuf;

/// Reason why a surface could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file, or a file that it refers to, could not be opened or read.
    #[error("cannot read {}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// The path does not name a regular file. A pipe, for example, may never end.
    #[error("{} is {kind}, not a regular file", path.display())]
    NotAFile {
        /// The path.
        path: PathBuf,
        /// Kind of file, such as `a directory`.
        kind: &'static str,
    },
    /// The format is unknown, or the contents are not in the format that the name states.
    #[error(
        "the format is not recognised. Known formats, and how they are recognised: binary glTF by its first bytes \
         (`glTF`); PLY by its first line (`ply`); glTF by its extension (.gltf or .glb) and its first character (`{{`); \
         STL, OBJ and VTP by their extensions (.stl, .obj, .vtp)"
    )]
    UnknownFormat,
    /// The file was read, and has no triangles. The notes of the surface say what was passed over.
    #[error("the file has no triangles{}", .0.iter().map(|note| format!("; {note}")).collect::<String>())]
    NoTriangles(Vec<String>),
    /// The file is packed, or in an encoding or format that is known but not read.
    #[error("this is {kind}, which is not read; {remedy}")]
    Foreign {
        /// What the file is, such as `a ZIP archive`.
        kind: String,
        /// What to do, as a request.
        remedy: &'static str,
    },
    /// The file exceeds a limit on what is read.
    #[error("{path}: {what}, and at most {most} are read")]
    TooLarge {
        /// Part of the file, such as `nodes[7]`, or its path.
        path: String,
        /// Clause that says what exceeds the limit, with the number if it is known.
        what: String,
        /// The limit.
        most: u64,
    },
    /// A line of a text file is invalid.
    #[error("line {line}: {detail}")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// Description of the error.
        detail: String,
    },
    /// A binary file is invalid at some byte.
    #[error("byte {byte}: {detail}")]
    Byte {
        /// Offset into the file, bytes.
        byte: usize,
        /// Description of the error.
        detail: String,
    },
    /// A part of a file is invalid.
    #[error("{path}: {detail}")]
    Document {
        /// Part of the file, such as `accessors[3]`, `piece 1, Polys, offsets` or `line 7`.
        path: String,
        /// Description of the error.
        detail: String,
    },
}

impl ReadError {
    /// Error about a part of a file.
    pub(super) fn document(path: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::Document { path: path.into(), detail: detail.into() }
    }
}
