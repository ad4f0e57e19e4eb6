//! What a worker runs.

use crate::generate::{CancelToken, GenerateError, Outcome, Sink};
use crate::jobs::Job;
use std::path::Path;

/// One generation to be done.
#[derive(Clone, Copy, Debug)]
pub struct Work<'a> {
    /// The job; its `spec` is the resolved spec in canonical form.
    pub job: &'a Job,
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
