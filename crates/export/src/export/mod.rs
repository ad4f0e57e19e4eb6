//! Files: writers of surfaces and sections over [`std::io::Write`], and readers of surfaces in
//! common formats.
//!
//! No writer reads a clock or draws a random number, so the same input gives the same bytes.

pub mod animation;
pub mod centreline;
mod chunks;
mod colours;
pub mod convert;
pub mod course;
pub mod cut;
pub mod frames;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
pub mod glb;
pub mod hashing;
pub mod labels;
pub mod lod;
mod normals;
pub mod obj;
pub mod ply;
pub mod read;
pub mod sections_bin;
pub mod shape;
pub mod stl;
pub mod svg;
pub mod threemf;
pub mod vtp;

pub use shape::{AXES, NamedPatch, Shape};

use serde::{Deserialize, Serialize};

/// Citation of the method, written into files.
pub const CITATION: &str =
    "Burkitt, Romano, Walker, Fazeli: 3D Modelling of Complex Biological Structures: The Oviduct (2010)";

/// Origin of a model, written into every file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Metadata {
    /// Name of the preset.
    pub preset: String,
    /// Seed of the model.
    pub seed: u64,
    /// Digest of the model: SHA-256 of the resolved spec, the seed and the engine version, hex.
    pub digest: String,
    /// Version of the engine that grew the model.
    pub engine: String,
    /// Length of the tube, millimetres.
    pub length_mm: f64,
    /// Number of sections, including those added to mend slabs.
    pub sections: usize,
}

#[cfg(test)]
pub(crate) mod tests;
