//! Work on the CPU of a worker: one model at a time, and beside it one fit and one short model.

use super::{GenerateFailure, Generation, GenerationOutput, Task, fit_of, request};
use crate::fit::{FitError, FitProgress, FitSink, fit};
use crate::generate::{Backend, CancelToken, Checkpoint, Outcome, Sink, UsedBackend, generate, resume};
use crate::jobs::{BackendReport, JobKind};
use crate::worker::gate::Gate;
use crate::worker::generator::{GenerationInput, Generator, WorkError};
use crate::worker::progress::AttemptSink;
use crate::worker::verdict;
use rayon::ThreadPool;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

/// A place in the queue for the threads of a worker.
pub(in crate::worker) type Queued = Pin<Box<dyn Future<Output = OwnedSemaphorePermit> + Send>>;

/// The right to use the threads of a worker for a generation.
pub(in crate::worker) enum Threads {
    Free(OwnedSemaphorePermit),
    /// The generation that uses them nearly ends.
    Soon(Queued),
    /// A longer model uses them. A thread of its own runs a short one.
    Beside(OwnedSemaphorePermit),
}

/// How a generation uses the threads of its worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::worker) enum ThreadUse {
    /// It uses all threads.
    All,
    /// It uses all threads for so short a time (`NEARLY_FREE`) that the worker claims the next
    /// model at once.
    NearlyFree,
    /// It uses the thread for short models, beside a generation that uses all others.
    Beside,
}

/// The threads of a worker.
pub(in crate::worker) struct Cpu {
    /// Threads for `cpu`.
    all: Arc<ThreadPool>,
    /// Thread for `cpu-single`.
    single: Arc<ThreadPool>,
    /// Thread for a short model beside a longer one.
    beside: Arc<ThreadPool>,
    free: Arc<Semaphore>,
    beside_free: Arc<Semaphore>,
    /// True while a model runs that is not [`ThreadUse::NearlyFree`].
    runs_long: watch::Sender<bool>,
    /// True once the running generation nearly ends.
    nearly_free: watch::Sender<bool>,
    /// Right to run a fit.
    fit: Arc<Semaphore>,
    gate: Arc<Gate>,
    worker: String,
    nice: u8,
}

impl Cpu {
    /// Starts the threads of a worker, with this niceness.
    ///
    /// # Errors
    /// The error of creating threads.
    pub(in crate::worker) fn new(worker: &str, count: usize, nice: u8) -> io::Result<Self> {
        Ok(Self {
            all: threads(worker, count, nice)?,
            single: threads(worker, 1, nice)?,
            beside: threads(&format!("{worker}/short"), 1, nice)?,
            free: Arc::new(Semaphore::new(1)),
            beside_free: Arc::new(Semaphore::new(1)),
            runs_long: watch::Sender::new(false),
            nearly_free: watch::Sender::new(false),
            fit: Arc::new(Semaphore::new(1)),
            gate: Gate::new(),
            worker: worker.to_owned(),
            nice,
        })
    }

    /// The report of a job that runs here, by its requested backend.
    pub(in crate::worker) fn report(&self, requested: Backend) -> BackendReport {
        let used = if requested == Backend::CpuSingle { UsedBackend::CpuSingle } else { UsedBackend::Cpu };
        let count = self.pool(used, ThreadUse::All).current_num_threads();
        BackendReport { requested, used: Some(used), device: Some(device(count)), fallback: None }
    }

    /// Description of the device.
    pub(in crate::worker) fn device(&self) -> String {
        device(self.all.current_num_threads())
    }

    /// Waits until no generation uses the threads.
    pub(in crate::worker) async fn free(&self) -> OwnedSemaphorePermit {
        Arc::clone(&self.free).acquire_owned().await.expect("the semaphore is never closed")
    }

    /// Waits until no generation uses the threads, or until the running generation nearly ends; the
    /// latter once for each generation.
    pub(in crate::worker) async fn free_soon(&self) -> Threads {
        let mut nearly_free = self.nearly_free.subscribe();
        let free = Arc::clone(&self.free);
        let mut free: Queued =
            Box::pin(async move { free.acquire_owned().await.expect("the semaphore is never closed") });
        let threads = tokio::select! {
            biased;
            permit = &mut free => Threads::Free(permit),
            _ = nearly_free.wait_for(|nearly_free| *nearly_free) => Threads::Soon(free),
        };
        self.nearly_free.send_replace(false);
        threads
    }

    /// Waits until a model runs that is not short, and no short one beside it.
    pub(in crate::worker) async fn free_beside_long(&self) -> Threads {
        let free = Arc::clone(&self.beside_free).acquire_owned().await.expect("the semaphore is never closed");
        let _ = self.runs_long.subscribe().wait_for(|runs_long| *runs_long).await;
        Threads::Beside(free)
    }

    /// Waits until no fit runs.
    pub(in crate::worker) async fn free_for_fit(&self) -> OwnedSemaphorePermit {
        Arc::clone(&self.fit).acquire_owned().await.expect("the semaphore is never closed")
    }

    /// Waits for the turn of a running fit if it is due. To be called before a model is claimed.
    pub(in crate::worker) async fn give_turn_to_fit(&self) {
        self.gate.give_turn().await;
    }

    /// Starts a generation or a fit on a thread that may block and whose panics are caught. It
    /// keeps `permit` until it has stopped.
    pub(in crate::worker) fn generate(
        &self,
        generator: Arc<Generator>,
        backend: UsedBackend,
        task: Task,
        threads_used: ThreadUse,
        permit: OwnedSemaphorePermit,
    ) -> Generation {
        let (pool, gate, cancel) =
            (Arc::clone(self.pool(backend, threads_used)), Arc::clone(&self.gate), task.cancel.clone());
        let (worker, count, nice) = (format!("{}/fit", self.worker), pool.current_num_threads(), self.nice);
        let mut long = None;
        match (task.job.kind, threads_used) {
            (JobKind::Model, ThreadUse::NearlyFree) => drop(self.nearly_free.send_replace(true)),
            (JobKind::Model, ThreadUse::All) => {
                task.sink.announce_end(self.nearly_free.clone());
                long = Some(RunningLong::new(&self.runs_long));
            }
            (JobKind::Fit, _) | (JobKind::Model, ThreadUse::Beside) => {}
        }
        let thread = tokio::task::spawn_blocking(move || {
            let Task { job, spec, dir, sink, cancel, memory_limit_bytes, checkpoint } = &task;
            let (spec, memory_limit_bytes, checkpoint) = (spec.as_ref(), *memory_limit_bytes, checkpoint.as_deref());
            let input = GenerationInput { job, spec, backend, dir: dir.path(), memory_limit_bytes, checkpoint };
            match job.kind {
                JobKind::Model => {
                    let _computing = gate.model();
                    let generate = || generator(input, &**sink, cancel).map(GenerationOutput::from);
                    let made = pool.install(|| sink.span.in_scope(generate));
                    // The next model of this worker begins here.
                    drop((long, permit));
                    made
                }
                JobKind::Fit => {
                    let _present = gate.fit();
                    let sink = Yielding { sink, gate: &gate };
                    // The threads of models must stay free while the fit waits on its own.
                    let pool = threads(&worker, count, nice).map_err(FitError::Io)?;
                    pool.install(|| sink.sink.span.in_scope(|| fit_on_cpu(input, &sink, cancel)))
                }
            }
        });
        let result = async move {
            match thread.await {
                Ok(result) => Ok(result?),
                Err(error) => Err(GenerateFailure::Verdict(verdict::of_join(error))),
            }
        };
        Generation::new(result, cancel)
    }

    fn pool(&self, backend: UsedBackend, threads_used: ThreadUse) -> &Arc<ThreadPool> {
        match (threads_used, backend) {
            (ThreadUse::Beside, _) => &self.beside,
            (_, UsedBackend::CpuSingle) => &self.single,
            _ => &self.all,
        }
    }
}

/// A model that runs and is not short.
struct RunningLong(watch::Sender<bool>);

impl RunningLong {
    fn new(runs_long: &watch::Sender<bool>) -> Self {
        runs_long.send_replace(true);
        Self(runs_long.clone())
    }
}

impl Drop for RunningLong {
    fn drop(&mut self) {
        self.0.send_replace(false);
    }
}

/// Sink of a fit that stops while models compute.
struct Yielding<'a> {
    sink: &'a AttemptSink,
    gate: &'a Gate,
}

impl FitSink for Yielding<'_> {
    fn progress(&self, progress: &FitProgress) {
        FitSink::progress(self.sink, progress);
    }

    fn wants_checkpoint(&self) -> bool {
        FitSink::wants_checkpoint(self.sink)
    }

    fn checkpoint(&self, bytes: Vec<u8>) {
        FitSink::checkpoint(self.sink, bytes);
    }

    fn pause(&self, cancel: &CancelToken) {
        self.gate.wait(cancel);
    }
}

/// Description of a CPU with this number of threads.
fn device(threads: usize) -> String {
    format!("cpu, {threads} thread{}", if threads == 1 { "" } else { "s" })
}

/// A pool of threads with the name of a worker and this niceness.
///
/// # Errors
/// The error of creating threads.
pub(in crate::worker) fn threads(worker: &str, count: usize, nice: u8) -> io::Result<Arc<ThreadPool>> {
    let worker = worker.to_owned();
    rayon::ThreadPoolBuilder::new()
        .num_threads(count.max(1))
        .thread_name(move |n| format!("{worker}/{n}"))
        .start_handler(move |_| lower_priority(nice))
        .build()
        .map(Arc::new)
        .map_err(io::Error::other)
}

/// Raises the niceness of this thread, on Linux. On other systems, only processes have a niceness.
pub fn lower_priority(nice: u8) {
    #[cfg(target_os = "linux")]
    {
        use rustix::process::{getpriority_process, setpriority_process};
        // Never lowers the niceness, which only a privileged process may do.
        let set = getpriority_process(None).and_then(|now| setpriority_process(None, now.max(nice.into())));
        if let Err(error) = set {
            tracing::debug!(%error, "could not raise the niceness of a thread");
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = nice;
}

/// The generator on the CPU: grows the stored spec, from the checkpoint if there is a usable one.
///
/// # Errors
/// [`WorkError`].
pub fn generate_on_cpu(
    input: GenerationInput<'_>,
    sink: &dyn Sink,
    cancel: &CancelToken,
) -> Result<Outcome, WorkError> {
    let request = request(input)?;
    Ok(match input.checkpoint.map(|path| Checkpoint::open(&request, path)) {
        Some(Ok(checkpoint)) => {
            tracing::info!(job = %input.job.id, "resumed the model from a checkpoint");
            resume(&request, checkpoint, sink, cancel)?
        }
        Some(Err(error)) => {
            tracing::warn!(job = %input.job.id, %error, "could not use the checkpoint; the model starts from the beginning");
            generate(&request, sink, cancel)?
        }
        None => generate(&request, sink, cancel)?,
    })
}

/// Runs a fit, from the checkpoint if there is a usable one.
fn fit_on_cpu(
    input: GenerationInput<'_>,
    sink: &dyn FitSink,
    cancel: &CancelToken,
) -> Result<GenerationOutput, WorkError> {
    let spec = fit_of(input.job)?;
    let checkpoint = input.checkpoint.and_then(|path| match std::fs::read(path) {
        Ok(bytes) => Some(bytes),
        Err(error) => {
            tracing::warn!(job = %input.job.id, %error, "could not read the checkpoint; the fit starts from the beginning");
            None
        }
    });
    let result = fit(&spec, checkpoint.as_deref(), input.dir, input.memory_limit_bytes, sink, cancel)?;
    let device = device(rayon::current_num_threads());
    let summary = serde_json::json!(result);
    Ok(GenerationOutput { used: input.backend, device, files: Vec::new(), summary, seconds: None })
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use rustix::process::getpriority_process;

    #[test]
    fn only_the_threads_of_a_worker_are_nice() {
        let own = getpriority_process(None).expect("every thread has a priority");
        for nice in [0, 7, 19] {
            let pool = threads("worker", 1, nice).expect("a thread can be started");
            assert_eq!(pool.install(|| getpriority_process(None)), Ok(own.max(nice.into())));
        }
        assert_eq!(getpriority_process(None), Ok(own));
    }
}
