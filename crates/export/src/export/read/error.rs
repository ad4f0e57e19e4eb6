//! Why a surface could not be read.

use std::path::PathBuf;

/// Why a file could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file, or one that it refers to, could not be opened or read.
    #[error("cannot read {}", path.display())]
    Io {
        /// File.
        path: PathBuf,
        /// Cause.
        #[source]
        source: std::io::Error,
    },
    /// The path names something else than a regular file; a pipe, for example, may never end.
    #[error("{} is {kind}, not a regular file", path.display())]
    NotAFile {
        /// Path.
        path: PathBuf,
        /// What the path names, such as `a directory`.
        kind: &'static str,
    },
    /// The format of the file is not known, or the file is not in the format that its name states.
    #[error(
        "the format is not recognised. Known formats, and how they are recognised: binary glTF by its first bytes \
         (`glTF`); PLY by its first line (`ply`); glTF by its extension (.gltf or .glb) and its first character (`{{`); \
         STL, OBJ and VTP by their extensions (.stl, .obj, .vtp)"
    )]
    UnknownFormat,
    /// The file holds more than is read.
    #[error("{path}: {what}, and at most {most} are read")]
    TooLarge {
        /// The part concerned, such as `nodes[7]` or a path.
        path: String,
        /// What there is too much of, with the number if it is known.
        what: String,
        /// The limit.
        most: u64,
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
    /// A part of a glTF document or of a VTP file is wrong.
    #[error("{path}: {detail}")]
    Document {
        /// The part concerned, such as `accessors[3]` or `piece 1, Polys, offsets`.
        path: String,
        /// What is wrong.
        detail: String,
    },
}

impl ReadError {
    /// A fault in a part of a glTF document or of a VTP file.
    pub(super) fn document(path: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::Document { path: path.into(), detail: detail.into() }
    }
}
