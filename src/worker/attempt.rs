//! One attempt at a job, from its claim to its end.

use super::generator::{Generator, Work, WorkError};
use super::keeper::{Interrupt, Keeper, Phase};
use super::live::Live;
use super::pool::PoolOptions;
use super::saver::Saver;
use super::upload::{self, UploadError};
use super::verdict::{self, Verdict};
use crate::clock::Clock;
use crate::generate::{Backend, CancelToken, Outcome};
use crate::jobs::artifacts::Artifacts;
use crate::jobs::scratch::{AttemptDir, Scratch};
use crate::jobs::{BackendReport, ClaimedJob, Finished, Store, StoreError};
use bytes::Bytes;
use rayon::ThreadPool;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::{JoinError, JoinHandle};

/// How long the record of an attempt that was broken off waits for its thread.
const STOP_WAIT: Duration = Duration::from_millis(300);
/// How long an attempt that is given back waits for its last checkpoint to be taken and stored.
const SAVE_WAIT: Duration = Duration::from_secs(6);

/// What all workers of a pool share.
pub(super) struct Context {
    pub(super) store: Arc<dyn Store>,
    pub(super) artifacts: Artifacts,
    pub(super) generator: Arc<dyn Generator>,
    pub(super) options: PoolOptions,
    pub(super) clock: Clock,
    pub(super) scratch: Scratch,
    pub(super) phase: watch::Receiver<Phase>,
}

/// The threads of one worker.
pub(super) struct Threads {
    /// For `cpu`.
    pub(super) all: Arc<ThreadPool>,
    /// For `cpu-single`.
    pub(super) single: Arc<ThreadPool>,
}

impl Threads {
    /// What runs a job asked of `requested`, and its report as long as it runs.
    fn choose(&self, requested: Backend) -> (Arc<ThreadPool>, BackendReport) {
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

/// What an attempt leaves behind.
#[derive(Default)]
struct Leavings {
    /// A generation that was broken off and has not stopped yet.
    generation: Option<Generation>,
    /// The checkpoint that the record named last.
    checkpoint: Option<String>,
}

/// A generation on a thread of its own. Dropping it asks it to stop; the thread cannot be dropped.
struct Generation {
    thread: JoinHandle<Result<Outcome, WorkError>>,
    cancel: CancelToken,
}

impl Drop for Generation {
    fn drop(&mut self) {
        self.cancel.cancel();
    }
}

/// How the work of an attempt went.
enum Ending {
    /// The files are stored; all is ready to be committed.
    Stored(Box<Finished>),
    /// It was broken off.
    Interrupted(Interrupt),
    /// It failed.
    Failed(Verdict),
}

/// Runs a claimed job and ends it. Returns whether the job has ended by it.
pub(super) async fn run(context: &Context, threads: &Threads, claimed: ClaimedJob) -> bool {
    let (id, attempt) = (claimed.job().id, claimed.attempt());
    tracing::info!(job = %id, attempt, "attempt begins");
    if attempt == 1 {
        let waited = context.clock.now().duration_since(claimed.job().created_at);
        context.options.metrics.waited(Duration::try_from(waited).unwrap_or_default());
    }
    let (pool, backend) = threads.choose(claimed.job().backend.requested);
    let mut leavings = Leavings::default();
    let ending = work(context, pool, backend.clone(), &claimed, &mut leavings).await;
    let (how, result) = end(context, claimed, backend, ending).await;
    context.options.metrics.attempt(if matches!(result, Err(StoreError::Fenced)) { "lost" } else { how });
    if let Some(mut generation) = leavings.generation {
        // What was broken off is recorded at once, even where a stage is slow to stop; the worker's threads are
        // free only now. What it made or how it failed is of no interest any more.
        generation.cancel.cancel();
        let _ = (&mut generation.thread).await;
    }
    match result {
        Ok(()) => tracing::info!(job = %id, attempt, "attempt {how}"),
        Err(StoreError::Fenced) => tracing::warn!(job = %id, attempt, "attempt {how}, but its lease was lost"),
        Err(ref error) => tracing::error!(job = %id, attempt, %error, "attempt {how}, but that was not recorded"),
    }
    let ended = result.is_ok() && !matches!(how, "lost" | "given back" | "retried");
    if let Some(checkpoint) = leavings.checkpoint.filter(|_| ended)
        && let Err(error) = context.artifacts.delete(&[checkpoint]).await
    {
        tracing::warn!(job = %id, %error, "the checkpoint of an ended job is left to the sweep");
    }
    ended
}

/// Records how the work went.
async fn end(
    context: &Context,
    claimed: ClaimedJob,
    backend: BackendReport,
    ending: Ending,
) -> (&'static str, Result<(), StoreError>) {
    let store = &context.store;
    match ending {
        Ending::Stored(finished) => ("succeeded", commit(context, claimed, *finished).await),
        Ending::Interrupted(Interrupt::Lost) => ("lost", Ok(())),
        Ending::Interrupted(Interrupt::Cancelled) => ("cancelled", store.cancelled(claimed).await.map(drop)),
        Ending::Interrupted(Interrupt::Shutdown) => ("given back", store.release(claimed).await),
        Ending::Failed(Verdict::Fail(problem)) => ("failed", store.fail(claimed, backend, problem).await.map(drop)),
        Ending::Failed(Verdict::Retry(problem)) => ("retried", store.retry(claimed, problem).await.map(drop)),
    }
}

async fn commit(context: &Context, claimed: ClaimedJob, finished: Finished) -> Result<(), StoreError> {
    let files = finished.files.clone();
    if let Err(injected) = context.options.faults.point("before-commit").await {
        upload::remove(context, &files).await;
        return match verdict::of_injected(injected) {
            Verdict::Fail(problem) | Verdict::Retry(problem) => context.store.retry(claimed, problem).await.map(drop),
        };
    }
    match context.store.finish(claimed, finished).await {
        Ok(_) => {}
        Err(StoreError::Fenced) => {
            upload::remove(context, &files).await;
            return Err(StoreError::Fenced);
        }
        // Whether it was committed is not known: the files stay, and go with the sweep if it was not.
        Err(error) => return Err(error),
    }
    if let Err(injected) = context.options.faults.point("after-commit").await {
        tracing::warn!(%injected, "the commit stands");
    }
    Ok(())
}

/// Generates and stores the files, keeping the lease.
async fn work(
    context: &Context,
    pool: Arc<ThreadPool>,
    backend: BackendReport,
    claimed: &ClaimedJob,
    leavings: &mut Leavings,
) -> Ending {
    if let Err(injected) = context.options.faults.point("after-claim").await {
        return Ending::Failed(verdict::of_injected(injected));
    }
    let dir = match context.scratch.attempt(claimed.job().id, claimed.attempt()) {
        Ok(dir) => Arc::new(dir),
        Err(error) => return Ending::Failed(verdict::of_scratch(&error)),
    };
    let cancel = CancelToken::default();
    let every = context.options.checkpoint_every;
    let live = Arc::new(Live::new(context.options.faults.clone(), cancel.clone(), every));
    let mut keeper = Keeper::new(context, claimed, backend.clone(), &live);
    let mut saver = Saver::new(context, claimed, &live);

    let from = match keeper.keep(saver.load()).await {
        Ok(from) => from,
        Err(interrupt) => return Ending::Interrupted(interrupt),
    };
    let mut generation = generate(context, pool, claimed, from, &dir, &live, cancel);
    let kept = keep_in_time(context, &mut keeper, &mut saver, &mut generation.thread).await;
    leavings.checkpoint = saver.named();
    let joined = match kept {
        Ok(joined) => joined,
        Err(broken) => {
            let mut running = true;
            if let Broken::Interrupt(Interrupt::Shutdown) = broken {
                running = last_checkpoint(context, &live, &mut saver, &mut generation.thread).await;
                leavings.checkpoint = saver.named();
            }
            generation.cancel.cancel();
            // Most stop within milliseconds: then the record says so once it is true.
            if running && tokio::time::timeout(STOP_WAIT, &mut generation.thread).await.is_err() {
                leavings.generation = Some(generation);
            }
            return match broken {
                Broken::Interrupt(interrupt) => Ending::Interrupted(interrupt),
                Broken::Late(limit) => Ending::Failed(verdict::of_timeout(limit)),
            };
        }
    };
    let result = match joined {
        Ok(Ok(outcome)) => Ok(outcome),
        Ok(Err(error)) => Err(verdict::of_error(&error)),
        Err(error) => Err(verdict::of_join(error)),
    };
    let outcome = match (result, live.injected()) {
        (_, Some(injected)) => return Ending::Failed(verdict::of_injected(injected)),
        (Ok(outcome), None) => outcome,
        (Err(verdict), None) => return Ending::Failed(verdict),
    };

    let seconds = outcome.seconds;
    for (stage, seconds) in [
        ("simulate", seconds.simulate),
        ("mesh", seconds.mesh),
        ("certify", seconds.certify),
        ("export", seconds.export),
    ] {
        context.options.metrics.stage(stage, seconds);
    }
    let files = upload::files(claimed, &outcome);
    let uploaded = keeper.keep(upload::upload(context, &live, &files, dir.path())).await;
    let ending = match uploaded {
        Ok(Ok(())) => {
            let backend = BackendReport { used: Some(outcome.used), device: Some(outcome.device), ..backend };
            let engine = crate::ENGINE_VERSION.to_owned();
            let finished = Finished { backend, files, summary: outcome.summary, engine };
            return Ending::Stored(Box::new(finished));
        }
        Ok(Err(UploadError::Injected(injected))) => Ending::Failed(verdict::of_injected(injected)),
        Ok(Err(error @ UploadError::Storage { .. })) => Ending::Failed(verdict::of_storage(error.to_string())),
        Err(interrupt) => Ending::Interrupted(interrupt),
    };
    upload::remove(context, &files).await;
    ending
}

/// Why a generation was broken off.
enum Broken {
    Interrupt(Interrupt),
    /// It took longer than this.
    Late(Duration),
}

/// Drives a generation while keeping the lease and storing checkpoints, within the time that a job may take.
async fn keep_in_time<T>(
    context: &Context,
    keeper: &mut Keeper<'_>,
    saver: &mut Saver<'_>,
    thread: &mut JoinHandle<T>,
) -> Result<Result<T, JoinError>, Broken> {
    let limit = context.options.job_timeout;
    let late = async {
        match limit {
            Some(limit) => {
                tokio::time::sleep(limit).await;
                limit
            }
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        kept = keeper.keep(thread) => kept.map_err(Broken::Interrupt),
        limit = late => Err(Broken::Late(limit)),
        never = saver.run() => match never {},
    }
}

/// Waits a little for a last checkpoint. Returns whether the thread is still at work.
async fn last_checkpoint<T>(context: &Context, live: &Live, saver: &mut Saver<'_>, thread: &mut JoinHandle<T>) -> bool {
    live.ask_for_checkpoint();
    if !live.takes_checkpoints() {
        return true;
    }
    // Nobody renews the lease meanwhile.
    let left = context.options.lease.saturating_sub(context.options.heartbeat).mul_f32(0.75);
    tokio::select! {
        () = saver.save_next() => true,
        () = tokio::time::sleep(left.min(SAVE_WAIT)) => true,
        _ = thread => false,
    }
}

/// Runs the generator on a thread that may block and whose panic is caught.
fn generate(
    context: &Context,
    pool: Arc<ThreadPool>,
    claimed: &ClaimedJob,
    from: Option<Bytes>,
    dir: &Arc<AttemptDir>,
    live: &Arc<Live>,
    cancel: CancelToken,
) -> Generation {
    let generator = Arc::clone(&context.generator);
    let memory_limit_bytes = context.options.memory_limit_bytes;
    let (job, dir, live, token) = (claimed.job().clone(), Arc::clone(dir), Arc::clone(live), cancel.clone());
    let thread = tokio::task::spawn_blocking(move || {
        let work = Work { job: &job, dir: dir.path(), memory_limit_bytes, checkpoint: from.as_deref() };
        pool.install(|| generator.generate(work, &*live, &token))
    });
    Generation { thread, cancel }
}
