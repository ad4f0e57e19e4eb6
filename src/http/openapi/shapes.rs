//! What is stored or built as JSON and sent as it is: the types here only describe it.
#![expect(dead_code, reason = "describes JSON; only its schema is used")]

use crate::generate::{Bending, ContractionReport};
use crate::http::wire::responses::{CertificateFigures, ParameterValue, SpecPatch};
use crate::measure::comparison::Comparison;
use crate::measure::morphometry::{Cuts, Morphometry};
use crate::measure::{Certificate, RegionsCertificate};
use crate::mesh::lean::Leaned;
use crate::model::{BodyKind, LengthUnit};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Counts and measures of a model that has succeeded. An older version wrote fewer.
#[derive(ToSchema)]
pub(in crate::http) struct Summary {
    /// Recorded sections, without those added by mending.
    #[schema(minimum = 0)]
    sections: u64,
    /// Sections added by mending.
    #[schema(minimum = 0)]
    sections_added: Option<u64>,
    /// Diagonals of the surface that were flipped by mending.
    #[schema(minimum = 0)]
    diagonals_flipped: Option<u64>,
    /// Particles of both loops.
    particles: ParticleCounts,
    /// Splits that were made later than asked for.
    #[schema(minimum = 0)]
    splits_deferred: Option<u64>,
    /// Splits that were never made.
    #[schema(minimum = 0)]
    splits_missing: Option<u64>,
    /// Vertices of the surface.
    #[schema(minimum = 0)]
    vertices: u64,
    /// Triangles of the surface.
    #[schema(minimum = 0)]
    triangles: u64,
    /// Least distance between walls of one section, micrometres.
    min_gap_um: Option<f64>,
    /// Enclosed volume, cubic millimetres.
    volume_mm3: f64,
    /// Area of the surface, square millimetres.
    area_mm2: f64,
    /// Signs of poor growth.
    #[schema(required = false)]
    warnings: Vec<ModelWarning>,
    /// The figures of the certificate; not in a report, which has the certificate itself.
    #[schema(required = false)]
    certificate: CertificateFigures,
}

/// Numbers of particles at the two ends of the tube.
#[derive(ToSchema)]
pub(in crate::http) struct ParticleCounts {
    /// In the first section.
    #[schema(minimum = 0)]
    start: u64,
    /// In the last section.
    #[schema(minimum = 0)]
    end: u64,
}

/// A sign of poor growth of a model that has succeeded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ModelWarning {
    /// `splits-missing`, `small-gap`, `particles-short`, `lean-reduced`, `lean-left-out` or `contraction-reduced`; there may be more in future.
    pub code: String,
    /// A sentence with the numbers.
    pub detail: String,
}

/// What `report.json` holds.
#[derive(ToSchema)]
pub(in crate::http) struct StoredReport {
    /// SHA-256 of the canonical spec (without `solver.search`), the seed and the engine version, as in the model.
    digest: String,
    /// Preset that the spec was resolved on.
    preset: String,
    /// Seed.
    #[schema(minimum = 0, maximum = 9007199254740991i64)]
    seed: u64,
    /// Version of the program that grew it.
    engine: String,
    /// The complete resolved spec.
    spec: SpecPatch,
    /// Counts and measures.
    summary: Summary,
    /// The certificate of the surface as exported.
    certificate: Certificate,
    /// What its sections measure. Models of version 0.2 and earlier have none.
    #[schema(required = false)]
    morphometry: Morphometry,
    /// What planar cuts across the ampulla show, if the surface leans; otherwise null: they are its sections.
    #[schema(required = false, nullable = true)]
    cuts: Option<Cuts>,
    /// How the surface was displaced, if it leans; otherwise null.
    #[schema(required = false, nullable = true)]
    lean: Option<Leaned>,
    /// How the surface was bent, if its tube is not straight; otherwise null.
    #[schema(required = false, nullable = true)]
    course: Option<Bending>,
    /// What the frames of the contraction measure; only if the tube contracts.
    #[schema(required = false)]
    contraction: ContractionReport,
    /// The measures beside published ones of the organ and species of the preset.
    #[schema(required = false)]
    comparison: Comparison,
    /// The levels of detail, the finest first; only if the model was grown with `lod`. A model that reuses it has the same
    /// report, and the files that it asked for.
    #[schema(required = false)]
    levels: Vec<DetailLevel>,
    /// The other surfaces that are written: lumen, both bodies together, and what is written in other units than metres.
    #[schema(required = false)]
    surfaces: Vec<OtherSurface>,
}

/// A surface besides the tissue in metres, certified in the coordinates that are written.
#[derive(ToSchema)]
pub(in crate::http) struct OtherSurface {
    /// Its body.
    body: BodyKind,
    /// Unit of its files.
    unit: LengthUnit,
    /// What is proved of it.
    certificate: OtherCertificate,
}

/// The certificate of one body, or of both together.
#[derive(Serialize, ToSchema)]
#[serde(untagged)]
enum OtherCertificate {
    Body(Box<Certificate>),
    Regions(RegionsCertificate),
}

/// A level of detail.
#[derive(ToSchema)]
pub(in crate::http) struct DetailLevel {
    /// Name of the file.
    file: String,
    /// Vertices; those that patches share are counted once.
    #[schema(minimum = 0)]
    vertices: u64,
    /// Triangles.
    #[schema(minimum = 0)]
    triangles: u64,
    /// Step of the grid to which positions are rounded, along x, y and z, micrometres.
    precision_um: [f64; 3],
    /// Largest distance measured between the level and the full surface, in both directions, micrometres.
    distance_um: f64,
}

/// A preset in a list.
#[derive(ToSchema)]
pub(in crate::http) struct PresetSummary {
    /// Name.
    name: String,
    /// Title.
    title: String,
    /// Organ.
    organ: String,
    /// Species.
    species: String,
    /// What it is a model of.
    description: String,
    /// Whether it is the preset of requests that name none.
    default: bool,
}

/// A preset.
#[derive(ToSchema)]
pub(in crate::http) struct Preset {
    /// Name.
    name: String,
    /// Title.
    title: String,
    /// Organ.
    organ: String,
    /// Species.
    species: String,
    /// What it is a model of.
    description: String,
    /// Whether it is the preset of requests that name none.
    default: bool,
    /// Its spec.
    spec: SpecPatch,
    /// Its parameters.
    parameters: Vec<PresetParameter>,
}

/// A parameter of a preset.
#[derive(ToSchema)]
pub(in crate::http) struct PresetParameter {
    /// Title.
    title: String,
    /// Unit; empty if it has none.
    unit: String,
    /// Meaning.
    description: String,
    /// Value.
    value: ParameterValue,
    /// Where the value comes from.
    source: Option<String>,
    /// JSON pointer into the spec.
    pointer: String,
}
