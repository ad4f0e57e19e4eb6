//! What a worker runs.

use crate::generate::{Backend, CancelToken, GenerateError, Outcome, Sink};
use crate::jobs::Job;
use std::path::Path;

/// One generation to be done.
#[derive(Clone, Copy, Debug)]
pub struct Work<'a> {
    /// The job; its `spec` is the resolved spec in canonical form.
    pub job: &'a Job,
    /// What is to compute it: never `auto`.
    pub backend: Backend,
    /// Existing, empty folder that the files are written to.
    pub dir: &'a Path,
    /// Memory that it may use.
    pub memory_limit_bytes: Option<u64>,
    /// What an earlier attempt left with [`Sink::checkpoint`]; to begin there, where it can be used.
    pub checkpoint: Option<&'a [u8]>,
}

/// Why a worker made no model.
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
}

/// Makes a model of a job. Called on a thread of a rayon pool whose size is the job's: one thread for
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

/// A job of a batch.
#[derive(Clone, Copy)]
pub struct BatchWork<'a> {
    /// What is to be done.
    pub work: Work<'a>,
    /// Where its progress goes.
    pub sink: &'a dyn Sink,
    /// Asks this job alone to stop.
    pub cancel: &'a CancelToken,
}

/// Takes the end of a member of a batch, by its place.
pub type BatchEnds<'a> = &'a (dyn Fn(usize, Result<Outcome, WorkError>) + Sync);

/// Makes models of several jobs at a time, on one GPU. All methods may block.
pub trait BatchGenerator: Send + Sync + 'static {
    /// The device in words.
    fn device(&self) -> String;

    /// Makes the device ready; opens it anew where it was lost.
    ///
    /// # Errors
    /// Why there is none, in words for a job's record.
    fn open(&self) -> Result<(), String>;

    /// Which of `jobs` (the first is the oldest) to run together; the first always is one of them.
    ///
    /// # Errors
    /// Why not even the first one can run on the device, in words for its record.
    fn admit(&self, jobs: &[&Job]) -> Result<Vec<bool>, String>;

    /// Generates; calls `ended` once for each member as soon as it has ended. Called on a thread of a rayon pool that
    /// has one thread more than the worker's, to drive the device. [`GenerateError::Gpu`] stands for faults of the
    /// device: such a job may run on the CPU.
    fn generate(&self, members: &[BatchWork<'_>], ended: BatchEnds<'_>);
}
