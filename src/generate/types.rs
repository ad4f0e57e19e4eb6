//! What goes into a generation and what comes out.

use crate::model::Section;
use crate::sim::gpu::GpuError;
use crate::spec::ModelSpec;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// What is computing, as asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Backend {
    /// A GPU where there is one, else the CPU.
    #[default]
    Auto,
    /// A GPU or nothing.
    Gpu,
    /// All threads of the CPU worker.
    Cpu,
    /// One thread.
    CpuSingle,
}

impl Backend {
    /// The word for it in JSON.
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

/// A file format of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Output {
    /// Binary glTF.
    Glb,
    /// Wavefront OBJ.
    Obj,
}

impl Output {
    /// The file name's extension, which is also its name in requests.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Glb => "glb",
            Self::Obj => "obj",
        }
    }
}

/// Stage of a job's life while it runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Growing sections.
    Simulate,
    /// Finishing the surface: caps, patches.
    Mesh,
    /// Proving it sound.
    Certify,
    /// Writing files.
    Export,
    /// Moving files to the artifact store.
    Store,
}

/// How far a generation has come; always the whole current state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Progress {
    /// Stage.
    pub stage: Stage,
    /// Fraction of the whole, 0 to 1, never decreasing.
    pub fraction: f64,
    /// Time step reached.
    pub step: u32,
    /// Time steps in all.
    pub steps: u32,
    /// Particles of both loops.
    pub particles: u32,
    /// Sections recorded.
    pub sections: u32,
    /// Estimated seconds to the end, once there is a basis for it.
    pub eta_seconds: Option<f64>,
}

/// Receives progress. Called between steps on the simulating thread; must not block.
pub trait Sink: Sync {
    /// Called often (each few steps); thin out as needed.
    fn progress(&self, progress: &Progress);
    /// Called for each recorded section.
    fn section(&self, section: &Section);
    /// Whether the state is wanted, so that the generation can go on elsewhere; asked between steps.
    fn wants_checkpoint(&self) -> bool {
        false
    }
    /// The state that was wanted, as [`crate::generate::Checkpoint::read`] takes it.
    fn checkpoint(&self, _: Vec<u8>) {}
}

/// A sink that ignores everything.
impl Sink for () {
    fn progress(&self, _: &Progress) {}
    fn section(&self, _: &Section) {}
}

/// Asks a running generation to stop; checked between steps.
#[derive(Clone, Debug, Default)]
pub struct CancelToken(Arc<AtomicBool>);

impl CancelToken {
    /// Asks to stop.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether it was asked to stop.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// What to generate, and where to put the files.
#[derive(Clone, Debug)]
pub struct Request {
    /// Name of the preset that the spec was resolved on, for the record.
    pub preset: String,
    /// The model.
    pub spec: ModelSpec,
    /// Seed, 0 to 2^53 − 1.
    pub seed: u64,
    /// What shall compute it.
    pub backend: Backend,
    /// Formats to write besides `sections.bin` and `report.json`, which are always written.
    pub outputs: Vec<Output>,
    /// Existing folder that the files are written to.
    pub dir: PathBuf,
    /// Fails with [`GenerateError::Memory`] where more would be needed.
    pub memory_limit_bytes: Option<u64>,
}

/// A file that was written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Seconds {
    /// Simulation, with slab tests.
    pub simulate: f64,
    /// Loft, caps.
    pub mesh: f64,
    /// Certificate.
    pub certify: f64,
    /// Writing files.
    pub export: f64,
    /// All.
    pub total: f64,
}

/// A finished model. `report` is what `report.json` holds.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// What computed it.
    pub used: Backend,
    /// Device in words, such as the processor's name or `cpu, 2 threads`.
    pub device: String,
    /// Files in [`Request::dir`].
    pub files: Vec<FileOutput>,
    /// Counts and measures in short: `sections`, `sections_added`, `particles`, `vertices`, `triangles`, …
    pub summary: serde_json::Value,
    /// The certificate as JSON.
    pub certificate: serde_json::Value,
    /// Timing.
    pub seconds: Seconds,
}

/// Why a generation ended without a model.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// It was asked to stop.
    #[error("the generation was cancelled")]
    Cancelled,
    /// The surface could not be proven sound; `detail` names the place.
    #[error("the model failed its certificate: {detail}")]
    Certificate {
        /// What failed and where.
        detail: String,
    },
    /// It would need more memory than allowed.
    #[error("the model needs about {needed} bytes of memory; the limit is {limit}")]
    Memory {
        /// Predicted need.
        needed: u64,
        /// The limit.
        limit: u64,
    },
    /// The backend asked for is not available.
    #[error("the backend is not available: {detail}")]
    Backend {
        /// Why.
        detail: String,
    },
    /// The GPU could not do it, through no fault of the model: the same request runs on the CPU.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A fault of this program; only a batch says so, since its other members go on.
    #[error("the generation panicked: {detail}")]
    Panic {
        /// The message of the panic.
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
    /// The simulation left its domain of validity, such as a position that is not finite.
    #[error("the simulation failed: {detail}")]
    Simulation {
        /// What and where.
        detail: String,
    },
}
