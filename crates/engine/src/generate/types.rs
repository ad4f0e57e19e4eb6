//! Inputs and results of a generation.

use super::outputs::Outputs;
use super::warnings::Warning;
use crate::ENGINE_VERSION;
use crate::export::Metadata;
use crate::export::sections_bin::SectionsError;
use crate::measure::checklist::Checklist;
use crate::measure::comparison::Comparison;
use crate::measure::morphometry::{Cuts, Morphometry};
use crate::measure::{Certificate, RegionsCertificate};
use crate::mesh::LoftError;
use crate::mesh::bend::Refined;
use crate::mesh::contract::Contracted;
use crate::mesh::lean::Leaned;
use crate::model::{BodyKind, LengthUnit, Section};
use crate::sim::SimError;
use crate::sim::cpu::StateError;
use crate::sim::gpu::GpuError;
use crate::spec::{Bent, ModelSpec};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tempfile::TempPath;

/// Requested backend.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema), schema(description = "Requested or used backend."))]
#[serde(rename_all = "kebab-case")]
pub enum Backend {
    /// A GPU if one is available, otherwise the CPU.
    #[default]
    Auto,
    /// A GPU only.
    Gpu,
    /// All threads of the CPU worker.
    Cpu,
    /// One thread.
    CpuSingle,
}

impl Backend {
    /// Its name in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Gpu => "gpu",
            Self::Cpu => "cpu",
            Self::CpuSingle => "cpu-single",
        }
    }
}

/// Backend that grew, or grows, a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UsedBackend {
    /// A GPU.
    Gpu,
    /// All threads of the CPU worker.
    Cpu,
    /// One thread.
    CpuSingle,
}

impl From<UsedBackend> for Backend {
    fn from(used: UsedBackend) -> Self {
        match used {
            UsedBackend::Gpu => Self::Gpu,
            UsedBackend::Cpu => Self::Cpu,
            UsedBackend::CpuSingle => Self::CpuSingle,
        }
    }
}

/// Stage of a generation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Growing sections.
    Simulate,
    /// Finishing the surface: caps, patches.
    Mesh,
    /// Computing the certificate.
    Certify,
    /// Measuring the sections and comparing them with anatomy.
    Measure,
    /// Writing files.
    Export,
    /// Moving files to the artifact store.
    Store,
}

/// Progress of a generation: always the complete current state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Progress {
    /// Stage.
    pub stage: Stage,
    /// Fraction of the whole, 0 to 1, never decreasing.
    pub fraction: f64,
    /// Current time step.
    pub step: u32,
    /// Total number of time steps.
    pub steps: u32,
    /// Number of particles of both loops.
    pub particles: u32,
    /// Number of recorded sections.
    pub sections: u32,
    /// Estimated seconds to the end; null until there is enough data.
    pub eta_seconds: Option<f64>,
}

/// Receiver of progress. Called between steps on the simulating thread, so it must not block.
pub trait Sink: Sync {
    /// Receives the progress, up to once per step.
    fn progress(&self, progress: &Progress);
    /// Receives each recorded section.
    fn section(&self, section: &Section);
    /// Returns true to request a checkpoint, from which the generation can continue elsewhere.
    /// Called between steps.
    fn wants_checkpoint(&self) -> bool {
        false
    }
    /// Receives the requested checkpoint: a file in [`Request::dir`] for
    /// [`crate::generate::Checkpoint::open`].
    fn checkpoint(&self, _: TempPath) {}
}

/// A sink that ignores everything.
impl Sink for () {
    fn progress(&self, _: &Progress) {}
    fn section(&self, _: &Section) {}
}

/// Requests a running generation to stop; checked between steps.
#[derive(Clone, Debug, Default)]
pub struct CancelToken(Arc<AtomicBool>);

impl CancelToken {
    /// Requests the stop.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// True if the stop was requested.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Model to generate, and directory of its files.
#[derive(Clone, Debug)]
pub struct Request {
    /// Name of the preset on which the spec was resolved, for the record.
    pub preset: String,
    /// Specification.
    pub spec: ModelSpec,
    /// Seed, 0 to 2^53 − 1.
    pub seed: u64,
    /// The backend.
    pub backend: Backend,
    /// Files to write besides `sections.bin` and `report.json`, which are always written.
    pub outputs: Outputs,
    /// Existing directory for the files.
    pub dir: PathBuf,
    /// Limit of the predicted memory. Above it, generation fails with [`GenerateError::Memory`].
    pub memory_limit_bytes: Option<u64>,
}

impl Request {
    /// Origin of the model, which has this number of sections.
    pub(super) fn metadata(&self, sections: usize) -> Metadata {
        Metadata {
            preset: self.preset.clone(),
            seed: self.seed,
            digest: self.spec.digest(self.seed),
            engine: ENGINE_VERSION.into(),
            length_mm: self.spec.length_mm,
            sections,
        }
    }
}

/// A written file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct FileOutput {
    /// Name, such as `model.glb`.
    pub name: String,
    /// Media type.
    pub media_type: String,
    /// Size.
    pub bytes: u64,
    /// SHA-256, lower-case hex.
    pub sha256: String,
}

/// Wall-clock seconds by stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Seconds {
    /// Simulation, with slab tests.
    pub simulate: f64,
    /// Loft, caps.
    pub mesh: f64,
    /// Certificate.
    pub certify: f64,
    /// Morphometry.
    #[serde(default)]
    pub measure: f64,
    /// Writing files.
    pub export: f64,
    /// Total.
    pub total: f64,
}

/// A finished model.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Backend that computed the model.
    pub used: UsedBackend,
    /// Description of the device, such as a GPU's name or `cpu, 2 threads`.
    pub device: String,
    /// Files in [`Request::dir`].
    pub files: Vec<FileOutput>,
    /// Findings about the model.
    pub findings: Findings,
    /// Timing.
    pub seconds: Seconds,
}

/// Bending of a tube along its course.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Bending {
    /// Distance between the ends of the centre line, mm.
    pub end_distance_mm: f64,
    /// Length of the centre line divided by the distance between its ends.
    pub tortuosity: f64,
    /// True if the course was changed because it was too tight or approached itself too closely.
    pub relaxed: bool,
    /// Place at which the tube is bent most in relation to its radius, mm from the isthmus end.
    pub tightest_at_mm: f64,
    /// Radius of curvature at this place, mm; null if the course is straight.
    pub curve_radius_mm: Option<f64>,
    /// Maximum radius of the wall at this place, mm.
    pub wall_radius_mm: f64,
    /// Lower bound of the distance between the outer walls of two distant parts of the tube, µm;
    /// null if the course turns too little for two parts to approach each other.
    pub far_parts_um: Option<f64>,
    /// Statistics of the bending: intersecting triangles, and the changes that separated them.
    #[serde(flatten)]
    pub refined: Refined,
}

impl Bending {
    pub(super) fn of(bent: &Bent, refined: Refined) -> Self {
        let Bent { course, room, relaxed } = bent;
        Self {
            end_distance_mm: course.end_distance() / 1000.0,
            tortuosity: course.tortuosity(),
            relaxed: *relaxed,
            tightest_at_mm: room.bend.at / 1000.0,
            curve_radius_mm: Some(room.bend.curve / 1000.0).filter(|radius| radius.is_finite()),
            wall_radius_mm: room.bend.tube / 1000.0,
            far_parts_um: room.near.map(|near| near.distance),
            refined,
        }
    }
}

/// Measures of a contraction and of its frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ContractionReport {
    /// Period, seconds.
    pub period_s: f64,
    /// Volume of the lumen at rest, mm³. The certificate of the model has the volume of the tissue.
    pub lumen_volume_mm3: f64,
    /// Maximum relative difference between the volumes of the tissue in a frame and at rest.
    pub tissue_deviation: f64,
    /// Statistics of intersecting triangles, and of the damping that separated them.
    #[serde(flatten)]
    pub contracted: Contracted,
    /// The frames of one period, in order.
    pub frames: Vec<FrameReport>,
}

/// A frame of a contraction.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct FrameReport {
    /// Time, seconds.
    pub time_s: f64,
    /// Length of the tube along its centre line, mm.
    pub length_mm: f64,
    /// Volume of the tissue, mm³.
    pub tissue_volume_mm3: f64,
    /// Volume of the lumen, mm³.
    pub lumen_volume_mm3: f64,
    /// Maximum fraction of the lumen of a section that is closed.
    pub closed: f64,
    /// Maximum fraction by which the outer wall of a section is narrower than at rest.
    pub narrowed: f64,
    /// Certificate of the surface of the frame.
    pub certificate: Certificate,
}

/// Certificate of a surface that is written in addition to the tissue in metres. It refers to the
/// written coordinates.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema), schema(as = OtherSurface))]
pub struct SurfaceFinding {
    /// Certified body.
    pub body: BodyKind,
    /// Unit of the written coordinates.
    pub unit: LengthUnit,
    /// Result of the tests.
    pub certificate: SurfaceCertificate,
}

/// Certificate of one body, or of both bodies together.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema), schema(as = OtherCertificate))]
#[serde(untagged)]
#[expect(clippy::large_enum_variant, reason = "a model has at most five")]
pub enum SurfaceCertificate {
    /// Tissue or lumen alone.
    Body(Certificate),
    /// Tissue and lumen in one surface.
    Regions(RegionsCertificate),
}

/// Counts and main measures of a finished model. Models of older versions lack some members.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Summary {
    /// Number of recorded sections, without sections that mending added.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub sections: u64,
    /// Number of sections that mending added.
    #[cfg_attr(feature = "schema", schema(value_type = Option<u64>, minimum = 0))]
    pub sections_added: u64,
    /// Number of diagonals of the surface that mending flipped.
    #[cfg_attr(feature = "schema", schema(value_type = Option<u64>, minimum = 0))]
    pub diagonals_flipped: u64,
    /// Number of particles of both loops.
    pub particles: ParticleCounts,
    /// Number of particle splits that were deferred for lack of room.
    #[cfg_attr(feature = "schema", schema(value_type = Option<u64>, minimum = 0))]
    pub splits_deferred: u64,
    /// Number of particle splits that were omitted for lack of room.
    #[cfg_attr(feature = "schema", schema(value_type = Option<u64>, minimum = 0))]
    pub splits_missing: u64,
    /// Number of vertices of the surface.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub vertices: u64,
    /// Number of triangles of the surface.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub triangles: u64,
    /// Minimum distance between walls within a section, over all sections, micrometres.
    pub min_gap_um: Option<f64>,
    /// Volume of the tissue, mm³.
    pub volume_mm3: f64,
    /// Area of the surface, mm².
    pub area_mm2: f64,
    /// Warnings about poor growth.
    #[cfg_attr(feature = "schema", schema(required = false))]
    pub warnings: Vec<Warning>,
    /// Figures of the certificate. Absent in a report, which contains the whole certificate.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(value_type = CertificateFigures, required = false))]
    pub certificate: Option<CertificateFigures>,
}

/// Number of particles of both loops at the ends of the model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ParticleCounts {
    /// Particles of the first section.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub start: u64,
    /// Particles of the last section.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub end: u64,
}

/// A certificate without its lists of components and failures, as the record of a job keeps it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(transparent)]
pub struct CertificateFigures(serde_json::Value);

impl CertificateFigures {
    /// Members of a certificate that its figures lack.
    const LISTS: [&str; 2] = ["bodies", "failures"];
}

impl From<&Certificate> for CertificateFigures {
    fn from(certificate: &Certificate) -> Self {
        let mut members = serde_json::json!(certificate);
        if let Some(members) = members.as_object_mut() {
            members.retain(|name, _| !Self::LISTS.contains(&&**name));
        }
        Self(members)
    }
}

#[cfg(feature = "schema")]
impl utoipa::PartialSchema for CertificateFigures {
    fn schema() -> utoipa::openapi::RefOr<utoipa::openapi::Schema> {
        use utoipa::openapi::{RefOr, Schema};
        let mut schema = Certificate::schema();
        if let RefOr::T(Schema::Object(object)) = &mut schema {
            object.description = Some("Certificate without its lists of components and failures.".into());
            object.properties.retain(|name, _| !Self::LISTS.contains(&name.as_str()));
            object.required.retain(|name| !Self::LISTS.contains(&name.as_str()));
        }
        schema
    }
}

#[cfg(feature = "schema")]
impl utoipa::ToSchema for CertificateFigures {}

/// Findings about a finished model. `report.json` contains all of them.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Counts, main measures and warnings.
    pub summary: Summary,
    /// Certificate of the tissue in metres.
    pub certificate: Certificate,
    /// Certificates of the other surfaces that are written: all bodies and units except the tissue
    /// in metres.
    pub surfaces: Vec<SurfaceFinding>,
    /// Measures of planar cuts across the surface before bending.
    pub morphometry: Morphometry,
    /// Measures of the simulated sections; `None` if the cuts are the sections, because the surface
    /// neither leans nor is even.
    pub simulated: Option<Morphometry>,
    /// Islands, thickness and gaps in the cuts across the ampulla; `None` like `simulated`.
    pub cuts: Option<Cuts>,
    /// Displacement of the surface, if it leans.
    pub lean: Option<Leaned>,
    /// Bending of the surface, if its tube is not straight.
    pub course: Option<Bending>,
    /// Measures of the frames, if the tube contracts.
    pub contraction: Option<ContractionReport>,
    /// Comparison of the measures with published ones; `None` without a known preset.
    pub comparison: Option<Comparison>,
    /// Judgement by the anatomical checklist; `None` if it has no statement about the organ.
    pub checklist: Option<Checklist>,
}

impl Findings {
    /// Figures for the record of a job: the summary with the figures of the certificate, and the
    /// means by region in the member `morphometry`.
    #[must_use]
    pub fn figures(&self) -> serde_json::Value {
        let summary = Summary { certificate: Some((&self.certificate).into()), ..self.summary.clone() };
        let mut figures = serde_json::json!(summary);
        figures["morphometry"] = self.morphometry.means();
        figures
    }
}

/// Reason why a generation ended without a model.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// The generation was cancelled.
    #[error("the generation was cancelled")]
    Cancelled,
    /// The surface failed its certificate.
    #[error("the model failed its certificate: {detail}")]
    Certificate {
        /// Failed test and its place.
        detail: String,
    },
    /// The predicted memory is above the limit.
    #[error("the model needs about {needed} bytes of memory; the limit is {limit}")]
    Memory {
        /// Predicted memory, bytes.
        needed: u64,
        /// Limit, bytes.
        limit: u64,
    },
    /// The requested backend is not available.
    #[error("the backend is not available: {detail}")]
    Backend {
        /// Why.
        detail: String,
    },
    /// The GPU failed for a reason unrelated to the model. The same request can run on the CPU.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A defect of this program. Only a batch reports it, because its other members continue.
    #[error("the generation panicked: {detail}")]
    Panic {
        /// Message of the panic.
        detail: String,
    },
    /// A file cannot contain the model, because its format has a limit.
    #[error("{name} cannot hold the model: {detail}")]
    Format {
        /// File name.
        name: String,
        /// Why.
        detail: String,
    },
    /// A file could not be written.
    #[error("writing {name} failed")]
    Io {
        /// File name.
        name: String,
        /// Cause.
        #[source]
        source: std::io::Error,
    },
    /// The state of the simulation became invalid, for example a position that is not finite.
    #[error("the simulation failed: {detail}")]
    Simulation {
        /// Error and its place.
        detail: String,
    },
}

impl From<SectionsError> for GenerateError {
    fn from(error: SectionsError) -> Self {
        Self::Io { name: "checkpoint".into(), source: std::io::Error::other(error) }
    }
}

impl From<LoftError> for GenerateError {
    fn from(error: LoftError) -> Self {
        Self::Certificate { detail: error.to_string() }
    }
}

impl From<SimError> for GenerateError {
    fn from(error: SimError) -> Self {
        Self::Simulation { detail: error.to_string() }
    }
}

impl From<StateError> for GenerateError {
    fn from(error: StateError) -> Self {
        Self::Simulation { detail: error.to_string() }
    }
}
