//! The interface between workers and the generators of models.

use crate::fit::FitError;
use crate::generate::{CancelToken, GenerateError, Outcome, Sink, UsedBackend};
use crate::jobs::Job;
use crate::sim::Plan;
use crate::spec::ModelSpec;
use rayon::ThreadPool;
use std::path::Path;

/// Input of one generation.
#[derive(Clone, Copy, Debug)]
pub struct GenerationInput<'a> {
    /// The job; its `spec` is the resolved spec in canonical form.
    pub job: &'a Job,
    /// The spec of a model, if it has been read already.
    pub spec: Option<&'a ModelSpec>,
    /// The backend to use.
    pub backend: UsedBackend,
    /// Existing directory for the files.
    pub dir: &'a Path,
    /// Maximum memory, bytes.
    pub memory_limit_bytes: Option<u64>,
    /// Checkpoint that an earlier attempt passed to [`Sink::checkpoint`]. The generation resumes
    /// from it if possible.
    pub checkpoint: Option<&'a Path>,
}

/// Reason why a generation has no result.
#[derive(Debug, thiserror::Error)]
pub enum WorkError {
    /// The stored spec does not resolve in this version of the engine.
    #[error("the stored spec is not valid for this engine: {detail}")]
    Spec {
        /// The faults of the spec.
        detail: String,
    },
    /// The generation failed.
    #[error(transparent)]
    Generate(#[from] GenerateError),
    /// The fit failed.
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// Generates the model of a job. The worker calls it on a thread of a rayon pool: of one thread for
/// `cpu-single`, of all threads of the worker otherwise. If it panics, the job fails and the worker
/// continues. It checks the token at least every few tens of milliseconds.
pub type Generator = dyn Fn(GenerationInput<'_>, &dyn Sink, &CancelToken) -> Result<Outcome, WorkError> + Send + Sync;

/// Simulation plan of an admitted job. `None` if the generator builds the plan later, in
/// `generate`.
pub type AdmittedPlan = Option<Plan>;

/// A member of a GPU batch.
#[derive(Clone, Copy)]
pub struct BatchMember<'a> {
    /// Input of the generation.
    pub input: GenerationInput<'a>,
    /// Plan from [`BatchGenerator::admit`].
    pub plan: Option<&'a Plan>,
    /// Receiver of its progress.
    pub sink: &'a dyn Sink,
    /// Stops this member alone.
    pub cancel: &'a CancelToken,
}

/// Callbacks of a GPU batch.
#[derive(Clone, Copy)]
pub struct BatchCallbacks<'a> {
    /// Called when the device is free for another batch; the surfaces of this one may still be in
    /// progress.
    pub simulated: &'a dyn Fn(),
    /// Called with the index and the result of each member at its end.
    pub ended: &'a (dyn Fn(usize, Result<Outcome, WorkError>) + Sync),
}

/// Generates the models of several jobs together on one GPU. All methods may block.
pub trait BatchGenerator: Send + Sync + 'static {
    /// Description of the device.
    fn device(&self) -> String;

    /// Opens the device, or opens it again if it was lost.
    ///
    /// # Errors
    /// The reason why the device cannot be opened, which is recorded with jobs.
    fn open(&self) -> Result<(), String>;

    /// Selects the jobs that fit on the device together: a plan for each of them, by index, and
    /// `None` for the others. All `jobs` have the same batch key; the first is the oldest and
    /// always fits.
    ///
    /// # Errors
    /// The reason why not even the first job can run on the device, which is recorded with that
    /// job.
    fn admit(&self, jobs: &[&Job]) -> Result<Vec<Option<AdmittedPlan>>, String>;

    /// Generates the models and returns when every member has ended. The calling thread drives the
    /// device; `pool` has the threads for the surfaces. The next batch may begin, on another
    /// thread, once this one has called `simulated`. [`GenerateError::Gpu`] is an error of the
    /// device; such a job may run on the CPU.
    fn generate(&self, members: &[BatchMember<'_>], pool: &ThreadPool, callbacks: BatchCallbacks<'_>);
}
