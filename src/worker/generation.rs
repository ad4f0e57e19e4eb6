//! A generation on threads of its own, and the threads of a worker.

use super::attempt::{Context, Prepared};
use super::generator::{Work, WorkError};
use super::turn::Turn;
use super::verdict::{self, Verdict};
use crate::generate::{Backend, CancelToken, GenerateError, Outcome};
use crate::jobs::{BackendReport, ClaimedJob};
use bytes::Bytes;
use rayon::ThreadPool;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;

/// The threads of one worker.
pub(super) struct Threads {
    /// For `cpu`.
    pub(super) all: Arc<ThreadPool>,
    /// For `cpu-single`.
    pub(super) single: Arc<ThreadPool>,
}

impl Threads {
    /// What runs a job asked of `requested`, and its report as long as it runs.
    pub(super) fn choose(&self, requested: Backend) -> (Arc<ThreadPool>, BackendReport) {
        let (pool, used) = match requested {
            Backend::CpuSingle => (&self.single, Backend::CpuSingle),
            Backend::Auto | Backend::Cpu | Backend::Gpu => (&self.all, Backend::Cpu),
        };
        let device = Some(device(pool.current_num_threads()));
        (Arc::clone(pool), BackendReport { requested, used: Some(used), device, fallback: None })
    }
}

/// A CPU with so many threads, in words.
pub(super) fn device(threads: usize) -> String {
    format!("cpu, {threads} thread{}", if threads == 1 { "" } else { "s" })
}

/// Why a generation gave no model.
pub(super) enum Unmade {
    /// For the model's sake, or the service's.
    Verdict(Verdict),
    /// The GPU could not do it, for this reason.
    Gpu(String),
}

/// The end of a generation.
pub(super) type Made = Pin<Box<dyn Future<Output = Result<Outcome, Unmade>> + Send>>;

/// A generation on threads of its own. Dropping it asks it to stop; the threads cannot be dropped.
pub(super) struct Generation {
    made: Made,
    cancel: CancelToken,
    /// Its turn on the threads of the CPU; others take theirs once it is gone.
    turn: Option<Turn>,
}

impl Generation {
    /// `made` resolves when the threads have stopped working on it, also after `cancel`.
    pub(super) fn new(made: Made, cancel: CancelToken) -> Self {
        Self { made, cancel, turn: None }
    }

    /// Its end. May be dropped and called again until it has resolved.
    pub(super) fn made(&mut self) -> impl Future<Output = Result<Outcome, Unmade>> + '_ {
        &mut self.made
    }

    /// Asks it to stop.
    pub(super) fn stop(&self) {
        self.cancel.cancel();
    }

    /// It was asked to stop and has not: nobody waits for its turn on the threads.
    pub(super) fn is_stuck(&self) {
        if let Some(turn) = &self.turn {
            turn.is_stuck();
        }
    }
}

impl Drop for Generation {
    fn drop(&mut self) {
        self.cancel.cancel();
    }
}

/// Runs the CPU's generator on a thread that may block and whose panic is caught.
pub(super) fn generate(
    context: &Context,
    pool: Arc<ThreadPool>,
    turn: Turn,
    claimed: &ClaimedJob,
    from: Option<Bytes>,
    prepared: &Prepared,
    backend: Backend,
) -> Generation {
    let generator = Arc::clone(&context.generator);
    let memory_limit_bytes = context.options.memory_limit_bytes;
    let (job, dir, live) = (claimed.job().clone(), Arc::clone(&prepared.dir), Arc::clone(&prepared.live));
    let token = prepared.cancel.clone();
    let thread = tokio::task::spawn_blocking(move || {
        let work = Work { job: &job, backend, dir: dir.path(), memory_limit_bytes, checkpoint: from.as_deref() };
        pool.install(|| live.span().in_scope(|| generator.generate(work, &*live, &token)))
    });
    let made = async move {
        match thread.await {
            Ok(Ok(outcome)) => Ok(outcome),
            Ok(Err(WorkError::Generate(GenerateError::Gpu(error)))) => Err(Unmade::Gpu(error.to_string())),
            Ok(Err(error)) => Err(Unmade::Verdict(verdict::of_error(&error))),
            Err(error) => Err(Unmade::Verdict(verdict::of_join(error))),
        }
    };
    Generation { made: Box::pin(made), cancel: prepared.cancel.clone(), turn: Some(turn) }
}
