//! What a worker runs: the interface to generators of models.

use crate::fit::FitError;
use crate::generate::{Backend, CancelToken, GenerateError, Outcome, Sink};
use crate::jobs::Job;
use crate::sim::Plan;
use rayon::ThreadPool;
use std::path::Path;

/// One generation to run.
#[derive(Clone, Copy, Debug)]
pub struct Work<'a> {
    /// The job; its `spec` is the resolved spec in canonical form.
    pub job: &'a Job,
    /// The backend to use; never `auto`.
    pub backend: Backend,
    /// Existing directory that the files are written to.
    pub dir: &'a Path,
    /// Most memory to use, bytes.
    pub memory_limit_bytes: Option<u64>,
    /// The checkpoint that an earlier attempt left with [`Sink::checkpoint`]; resumed from if it can be used.
    pub checkpoint: Option<&'a Path>,
}

/// Why a generation gave no model.
#[derive(Debug, thiserror::Error)]
pub enum WorkError {
    /// The stored spec does not resolve in this version of the engine.
    #[error("the stored spec is not valid for this engine: {detail}")]
    Spec {
        /// The faults.
        detail: String,
    },
    /// The generation failed.
    #[error(transparent)]
    Generate(#[from] GenerateError),
    /// The fit failed.
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// Makes the model of a job. Called on a thread of a rayon pool whose size is the job's: one thread for
/// `cpu-single`, all of the worker's for others. May panic: the job fails, the worker goes on.
pub trait Generator: Send + Sync + 'static {
    /// Generates; checks `cancel` at least every few tens of milliseconds.
    ///
    /// # Errors
    /// [`WorkError`].
    fn generate(&self, work: Work<'_>, sink: &dyn Sink, cancel: &CancelToken) -> Result<Outcome, WorkError>;
}

impl<F> Generator for F
where
    F: Fn(Work<'_>, &dyn Sink, &CancelToken) -> Result<Outcome, WorkError> + Send + Sync + 'static,
{
    fn generate(&self, work: Work<'_>, sink: &dyn Sink, cancel: &CancelToken) -> Result<Outcome, WorkError> {
        self(work, sink, cancel)
    }
}

/// What is known of a job that fits on a device: the plan of its simulation, unless its generator makes it later.
pub type Admitted = Option<Plan>;

/// A member of a batch.
#[derive(Clone, Copy)]
pub struct BatchWork<'a> {
    /// The generation to run.
    pub work: Work<'a>,
    /// What [`BatchGenerator::admit`] gave for it.
    pub plan: Option<&'a Plan>,
    /// Receives its progress.
    pub sink: &'a dyn Sink,
    /// Stops this member alone.
    pub cancel: &'a CancelToken,
}

/// What a batch calls as it goes on.
#[derive(Clone, Copy)]
pub struct BatchCalls<'a> {
    /// Called when the device is free for another batch; surfaces of this one may still be made.
    pub simulated: &'a dyn Fn(),
    /// Called with the index and the result of each member when it ends.
    pub ended: &'a (dyn Fn(usize, Result<Outcome, WorkError>) + Sync),
}

/// Makes the models of several jobs at a time on one GPU. All methods may block.
pub trait BatchGenerator: Send + Sync + 'static {
    /// The description of the device.
    fn device(&self) -> String;

    /// Opens the device, anew if it was lost.
    ///
    /// # Errors
    /// Why it cannot be opened; recorded with jobs.
    fn open(&self) -> Result<(), String>;

    /// Which of `jobs` fit on the device together, by index; `None` for the others. They have the same batch key; the first is
    /// the oldest and always fits.
    ///
    /// # Errors
    /// Why not even the first can run on the device; recorded with it.
    fn admit(&self, jobs: &[&Job]) -> Result<Vec<Option<Admitted>>, String>;

    /// Generates; returns when every member has ended. The calling thread drives the device; `pool` has the threads for the
    /// surfaces. The next batch may begin, on another thread, once this one has called `simulated`.
    /// [`GenerateError::Gpu`] is an error of the device: such a job may run on the CPU.
    fn generate(&self, members: &[BatchWork<'_>], pool: &ThreadPool, calls: BatchCalls<'_>);
}
