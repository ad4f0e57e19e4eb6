//! Generations on the CPU of a worker, one at a time.

use super::{GenerateFailure, Generation, Task, request};
use crate::generate::{Backend, CancelToken, Checkpoint, Outcome, Sink, generate, resume};
use crate::jobs::BackendReport;
use crate::worker::generator::{Generator, Work, WorkError};
use crate::worker::verdict;
use rayon::ThreadPool;
use std::io;
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The threads of a worker.
pub(in crate::worker) struct Cpu {
    /// For `cpu`.
    all: Arc<ThreadPool>,
    /// For `cpu-single`.
    single: Arc<ThreadPool>,
    free: Arc<Semaphore>,
}

impl Cpu {
    /// Starts the threads of the worker of this name.
    ///
    /// # Errors
    /// If threads cannot be created.
    pub(in crate::worker) fn new(worker: &str, count: usize) -> io::Result<Self> {
        let (all, single) = (threads(worker, count)?, threads(worker, 1)?);
        Ok(Self { all, single, free: Arc::new(Semaphore::new(1)) })
    }

    /// What a record says of a job that runs here, by the backend that it asked for.
    pub(in crate::worker) fn report(&self, requested: Backend) -> BackendReport {
        let used = if requested == Backend::CpuSingle { Backend::CpuSingle } else { Backend::Cpu };
        let count = self.pool(used).current_num_threads();
        BackendReport { requested, used: Some(used), device: Some(device(count)), fallback: None }
    }

    /// The description of the device.
    pub(in crate::worker) fn device(&self) -> String {
        device(self.all.current_num_threads())
    }

    /// Waits until no generation uses the threads.
    pub(in crate::worker) async fn free(&self) -> OwnedSemaphorePermit {
        Arc::clone(&self.free).acquire_owned().await.expect("the semaphore is never closed")
    }

    /// Starts a generation on a thread that may block and whose panics are caught; it keeps `permit` until it has stopped.
    pub(in crate::worker) fn generate(
        &self,
        generator: Arc<dyn Generator>,
        backend: Backend,
        task: Task,
        permit: OwnedSemaphorePermit,
    ) -> Generation {
        let (pool, cancel) = (Arc::clone(self.pool(backend)), task.cancel.clone());
        let thread = tokio::task::spawn_blocking(move || {
            let Task { job, dir, sink, cancel, memory_limit_bytes, checkpoint } = &task;
            let (memory_limit_bytes, checkpoint) = (*memory_limit_bytes, checkpoint.as_deref());
            let work = Work { job, backend, dir: dir.path(), memory_limit_bytes, checkpoint };
            pool.install(|| sink.span().in_scope(|| generator.generate(work, &**sink, cancel)))
        });
        let result = async move {
            match thread.await {
                Ok(result) => Ok(result?),
                Err(error) => Err(GenerateFailure::Verdict(verdict::of_join(error))),
            }
        };
        Generation::new(result, cancel, Some(permit))
    }

    fn pool(&self, backend: Backend) -> &Arc<ThreadPool> {
        if backend == Backend::CpuSingle { &self.single } else { &self.all }
    }
}

/// The description of a CPU with so many threads.
fn device(threads: usize) -> String {
    format!("cpu, {threads} thread{}", if threads == 1 { "" } else { "s" })
}

/// A pool of threads named after a worker.
///
/// # Errors
/// If threads cannot be created.
pub(in crate::worker) fn threads(worker: &str, count: usize) -> io::Result<Arc<ThreadPool>> {
    let worker = worker.to_owned();
    rayon::ThreadPoolBuilder::new()
        .num_threads(count.max(1))
        .thread_name(move |n| format!("{worker}/{n}"))
        .build()
        .map(Arc::new)
        .map_err(io::Error::other)
}

/// The generator of the CPU: grows the stored spec, from the checkpoint if there is one that can be used.
///
/// # Errors
/// [`WorkError`].
pub fn generate_on_cpu(work: Work<'_>, sink: &dyn Sink, cancel: &CancelToken) -> Result<Outcome, WorkError> {
    let request = request(work)?;
    Ok(match work.checkpoint.map(|bytes| Checkpoint::read(&request, bytes)) {
        Some(Ok(checkpoint)) => {
            tracing::info!(job = %work.job.id, "the model is resumed from a checkpoint");
            resume(&request, checkpoint, sink, cancel)?
        }
        Some(Err(error)) => {
            tracing::warn!(job = %work.job.id, %error, "the model is grown from the beginning");
            generate(&request, sink, cancel)?
        }
        None => generate(&request, sink, cancel)?,
    })
}
