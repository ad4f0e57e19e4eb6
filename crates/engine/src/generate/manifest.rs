//! Manifest of a model: its files, how to check them, and their origin.

use super::contraction;
use super::files::{REPORT, SECTIONS};
use super::outputs::{Kind, Outputs, kind_of};
use super::types::FileOutput;
use crate::export::CITATION;
use crate::model::{BodyKind, LengthUnit};
use serde::Serialize;
use serde_json::Value;

/// Name of the manifest among the files of a model.
pub const MANIFEST: &str = "manifest.json";

/// True if a model may have a file of this name.
#[must_use]
pub fn is_model_file(name: &str) -> bool {
    [MANIFEST, REPORT, SECTIONS].contains(&name) || kind_of(name).is_some() || contraction::is_frames(name)
}

/// Files of a model with their origin.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Manifest {
    /// Program that created the files, with its version: the engine version of the digest.
    pub engine: String,
    /// Preset that the spec was resolved on.
    pub preset: String,
    /// Seed.
    #[cfg_attr(feature = "schema", schema(minimum = 0, maximum = 9007199254740991i64))]
    pub seed: u64,
    /// SHA-256 of spec, seed and engine version. Models with the same digest have the same surface.
    pub digest: String,
    /// The resolved spec: `oviduct generate --preset … --spec … --seed …` generates the same model.
    #[cfg_attr(feature = "schema", schema(schema_with = spec_schema))]
    pub spec: Value,
    /// Axes of all files.
    pub axes: &'static str,
    /// Terms of use of the program and of the model.
    pub licence: Licence,
    /// How to cite the method.
    pub cite: &'static str,
    /// The files.
    pub files: Vec<ManifestFile>,
}

/// Terms of use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Licence {
    /// SPDX expression of the licence of the program.
    pub software: &'static str,
    /// Terms of use of a model.
    pub model: &'static str,
}

/// A file of a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ManifestFile {
    /// Name.
    pub name: String,
    /// Media type.
    pub media_type: String,
    /// Size.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub bytes: u64,
    /// SHA-256, lower-case hex.
    pub sha256: String,
    /// Body whose surface the file contains; null for files without a surface.
    pub body: Option<BodyKind>,
    /// Unit of the coordinates in the file; null if the file has no coordinates or names the unit
    /// of each value.
    pub unit: Option<LengthUnit>,
    /// Names of the patches of the surface, in order.
    pub patches: Vec<&'static str>,
}

impl Manifest {
    /// The manifest of the files of a model.
    #[must_use]
    pub fn new(of: Origin<'_>, outputs: &Outputs, files: &[FileOutput]) -> Self {
        Self {
            engine: of.engine.to_owned(),
            preset: of.preset.to_owned(),
            seed: of.seed,
            digest: of.digest.to_owned(),
            spec: of.spec,
            axes: crate::export::AXES,
            licence: Licence {
                software: env!("CARGO_PKG_LICENSE"),
                model: "No rights are claimed in models: they belong to whoever has them grown.",
            },
            cite: CITATION,
            files: files.iter().map(|file| entry(outputs, file)).collect(),
        }
    }
}

/// Inputs from which a model was grown.
#[derive(Clone, Debug)]
pub struct Origin<'a> {
    /// Engine version of the digest.
    pub engine: &'a str,
    /// Preset.
    pub preset: &'a str,
    /// Seed.
    pub seed: u64,
    /// Digest.
    pub digest: &'a str,
    /// Resolved spec.
    pub spec: Value,
}

/// Reference to the schema of the spec, which only the description of the interface contains.
#[cfg(feature = "schema")]
fn spec_schema() -> utoipa::openapi::Ref {
    utoipa::openapi::Ref::from_schema_name("SpecPatch")
}

fn entry(outputs: &Outputs, file: &FileOutput) -> ManifestFile {
    let kind = kind_of(&file.name);
    let contracting = contraction::is_frames(&file.name);
    let body = if contracting { Some(BodyKind::Tissue) } else { kind.and_then(surface) };
    ManifestFile {
        name: file.name.clone(),
        media_type: file.media_type.clone(),
        bytes: file.bytes,
        sha256: file.sha256.clone(),
        body,
        unit: if contracting { Some(LengthUnit::Metre) } else { kind.and_then(|kind| kind.output.unit(outputs.units)) },
        patches: body.map_or_else(Vec::new, |body| body.patches().iter().map(|patch| patch.name()).collect()),
    }
}

/// Body whose surface a file contains.
fn surface(kind: Kind) -> Option<BodyKind> {
    // Levels of detail show the tissue.
    kind.body.or((kind.output == super::Output::Lod).then_some(BodyKind::Tissue))
}
