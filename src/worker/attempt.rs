//! One attempt at a job, from its claim to its end. An attempt that a GPU cannot do goes on on the CPU.

use super::generator::{Generator, Work, WorkError};
use super::keeper::{Interrupt, Keeper, Phase};
use super::live::Live;
use super::pool::PoolOptions;
use super::saver::Saver;
use super::upload::{self, UploadError};
use super::verdict::{self, Verdict};
use crate::clock::{Clock, Stopwatch};
use crate::generate::{Backend, CancelToken, GenerateError, Outcome};
use crate::jobs::artifacts::Artifacts;
use crate::jobs::scratch::{AttemptDir, Scratch};
use crate::jobs::{BackendReport, ClaimedJob, Finished, Store, StoreError};
use bytes::Bytes;
use rayon::ThreadPool;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

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

/// Why a generation gave no model.
pub(super) enum Unmade {
    /// For the model's sake, or the service's.
    Verdict(Verdict),
    /// The GPU could not do it, for this reason.
    Gpu(String),
}

type Made = Pin<Box<dyn Future<Output = Result<Outcome, Unmade>> + Send>>;

/// A generation on threads of its own. Dropping it asks it to stop; the threads cannot be dropped.
pub(super) struct Generation {
    made: Made,
    cancel: CancelToken,
    /// Its turn on the CPU, where it has to wait for one.
    turn: Option<OwnedSemaphorePermit>,
}

impl Generation {
    /// `made` resolves when the threads have stopped working on it, also after `cancel`.
    pub(super) fn new(made: Made, cancel: CancelToken) -> Self {
        Self { made, cancel, turn: None }
    }
}

impl Drop for Generation {
    fn drop(&mut self) {
        self.cancel.cancel();
    }
}

/// What an attempt works with.
pub(super) struct Prepared {
    pub(super) dir: Arc<AttemptDir>,
    pub(super) live: Arc<Live>,
    pub(super) cancel: CancelToken,
}

/// Where an attempt goes on that a GPU could not do.
pub(super) struct Second<'a> {
    pub(super) threads: &'a Threads,
    pub(super) turn: &'a Arc<Semaphore>,
}

impl Second<'_> {
    async fn take_turn(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(self.turn).acquire_owned().await.ok()
    }
}

/// What an attempt leaves behind.
#[derive(Default)]
struct Leavings {
    /// A generation that was broken off and has not stopped yet.
    generation: Option<Generation>,
    /// The checkpoint that the record named last.
    checkpoint: Option<String>,
}

/// Where the generation of an attempt comes from.
pub(super) enum Start {
    /// It is to be begun on these threads of the CPU.
    Cpu(Arc<ThreadPool>),
    /// It has begun, as a member of a batch.
    Made(Generation),
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

/// Runs a claimed job on the CPU and ends it; `why` is said where it was asked of `auto`. Returns whether the job has
/// ended by it.
pub(super) async fn run_on_cpu(context: &Context, threads: &Threads, why: Option<String>, claimed: ClaimedJob) -> bool {
    let (pool, mut report) = threads.choose(claimed.job().backend.requested);
    report.fallback = why.filter(|_| report.requested == Backend::Auto);
    match prepare(context, &claimed).await {
        Ok(prepared) => run(context, claimed, report, prepared, Start::Cpu(pool), None).await,
        Err(verdict) => refuse(context, claimed, report, verdict).await,
    }
}

/// Makes an attempt ready.
pub(super) async fn prepare(context: &Context, claimed: &ClaimedJob) -> Result<Prepared, Verdict> {
    let (id, attempt, options) = (claimed.job().id, claimed.attempt(), &context.options);
    tracing::info!(job = %id, attempt, "attempt begins");
    if attempt == 1 {
        let waited = context.clock.now().duration_since(claimed.job().created_at);
        options.metrics.waited(Duration::try_from(waited).unwrap_or_default());
    }
    options.faults.point("after-claim").await.map_err(verdict::of_injected)?;
    let dir = context.scratch.attempt(id, attempt).map_err(|error| verdict::of_scratch(&error))?;
    let cancel = CancelToken::default();
    let live = Arc::new(Live::new(options.faults.clone(), cancel.clone(), options.checkpoint_every));
    Ok(Prepared { dir: Arc::new(dir), live, cancel })
}

/// Ends an attempt that could not be made ready. Returns whether the job has ended by it.
pub(super) async fn refuse(context: &Context, claimed: ClaimedJob, report: BackendReport, verdict: Verdict) -> bool {
    conclude(context, claimed, report, Ending::Failed(verdict), Leavings::default()).await
}

/// Follows the generation of a claimed job, stores its files, and ends it. Returns whether the job has ended by it.
pub(super) async fn run(
    context: &Context,
    claimed: ClaimedJob,
    mut report: BackendReport,
    prepared: Prepared,
    start: Start,
    second: Option<&Second<'_>>,
) -> bool {
    let mut leavings = Leavings::default();
    let ending = work(context, &claimed, &mut report, &prepared, start, second, &mut leavings).await;
    drop(prepared);
    conclude(context, claimed, report, ending, leavings).await
}

/// Records how an attempt went, and waits for what it left at work. Returns whether the job has ended by it.
async fn conclude(
    context: &Context,
    claimed: ClaimedJob,
    report: BackendReport,
    ending: Ending,
    leavings: Leavings,
) -> bool {
    let (id, attempt) = (claimed.job().id, claimed.attempt());
    let (used, fallback) = (report.used, report.fallback.clone());
    let (how, result) = end(context, claimed, report, ending).await;
    context.options.metrics.attempt(if matches!(result, Err(StoreError::Fenced)) { "lost" } else { how });
    if let Some(mut generation) = leavings.generation {
        // What was broken off is recorded at once, even where a stage is slow to stop; the worker's threads are
        // free only now. What it made or how it failed is of no interest any more.
        generation.cancel.cancel();
        let _ = (&mut generation.made).await;
    }
    match result {
        Ok(()) => tracing::info!(job = %id, attempt, ?used, fallback, "attempt {how}"),
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
    claimed: &ClaimedJob,
    report: &mut BackendReport,
    prepared: &Prepared,
    start: Start,
    second: Option<&Second<'_>>,
    leavings: &mut Leavings,
) -> Ending {
    let watch = Stopwatch::start();
    let live = &prepared.live;
    let mut keeper = Keeper::new(context, claimed, report.clone(), live);
    let mut saver = Saver::new(context, claimed, live);
    let mut generation = match start {
        Start::Made(generation) => generation,
        Start::Cpu(pool) => match keeper.keep(saver.load()).await {
            Ok(from) => generate(context, pool, claimed, from, prepared, report.used.unwrap_or_default()),
            Err(interrupt) => return Ending::Interrupted(interrupt),
        },
    };
    let result = loop {
        let kept = keep_in_time(context, &watch, &mut keeper, &mut saver, &mut generation.made).await;
        leavings.checkpoint = saver.named();
        let made = match kept {
            Ok(made) => made,
            Err(broken) => {
                let mut running = true;
                // A GPU takes no checkpoints that another attempt could go on from.
                if let (Broken::Interrupt(Interrupt::Shutdown), true) = (&broken, report.used != Some(Backend::Gpu)) {
                    running = last_checkpoint(context, live, &mut saver, &mut generation.made).await;
                    leavings.checkpoint = saver.named();
                }
                generation.cancel.cancel();
                // Most stop within milliseconds: then the record says so once it is true.
                if running && tokio::time::timeout(STOP_WAIT, &mut generation.made).await.is_err() {
                    leavings.generation = Some(generation);
                }
                return match broken {
                    Broken::Interrupt(interrupt) => Ending::Interrupted(interrupt),
                    Broken::Late(limit) => Ending::Failed(verdict::of_timeout(limit)),
                };
            }
        };
        let reason = match made {
            Ok(outcome) => break Ok(outcome),
            Err(Unmade::Verdict(verdict)) => break Err(verdict),
            Err(Unmade::Gpu(reason)) => reason,
        };
        let Some(second) = second.filter(|_| report.requested == Backend::Auto) else {
            break Err(Verdict::Fail(verdict::of_gpu(reason)));
        };
        tracing::warn!(job = %claimed.job().id, reason, "the job goes on on the CPU");
        let (turn, from) = match keeper.keep(async { (second.take_turn().await, saver.load().await) }).await {
            Ok(ready) => ready,
            Err(interrupt) => return Ending::Interrupted(interrupt),
        };
        let (pool, cpu) = second.threads.choose(Backend::Cpu);
        *report = BackendReport { requested: report.requested, fallback: Some(reason), ..cpu };
        keeper.report(report.clone());
        // The old generation takes its token with it.
        let cancel = CancelToken::default();
        live.restart(cancel.clone());
        let prepared = Prepared { cancel, dir: Arc::clone(&prepared.dir), live: Arc::clone(live) };
        generation = generate(context, pool, claimed, from, &prepared, Backend::Cpu);
        generation.turn = turn;
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
    let uploaded = keeper.keep(upload::upload(context, live, &files, prepared.dir.path())).await;
    let ending = match uploaded {
        Ok(Ok(())) => {
            *report = BackendReport { used: Some(outcome.used), device: Some(outcome.device), ..report.clone() };
            let engine = crate::ENGINE_VERSION.to_owned();
            let finished = Finished { backend: report.clone(), files, summary: outcome.summary, engine };
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
    since: &Stopwatch,
    keeper: &mut Keeper<'_>,
    saver: &mut Saver<'_>,
    made: impl Future<Output = T>,
) -> Result<T, Broken> {
    let limit = context.options.job_timeout;
    let late = async {
        match limit {
            Some(limit) => {
                tokio::time::sleep(limit.saturating_sub(since.elapsed())).await;
                limit
            }
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        kept = keeper.keep(made) => kept.map_err(Broken::Interrupt),
        limit = late => Err(Broken::Late(limit)),
        never = saver.run() => match never {},
    }
}

/// Waits a little for a last checkpoint. Returns whether the thread is still at work.
async fn last_checkpoint<T>(
    context: &Context,
    live: &Live,
    saver: &mut Saver<'_>,
    made: impl Future<Output = T>,
) -> bool {
    live.ask_for_checkpoint();
    if !live.takes_checkpoints() {
        return true;
    }
    // Nobody renews the lease meanwhile.
    let left = context.options.lease.saturating_sub(context.options.heartbeat).mul_f32(0.75);
    tokio::select! {
        () = saver.save_next() => true,
        () = tokio::time::sleep(left.min(SAVE_WAIT)) => true,
        _ = made => false,
    }
}

/// Runs the CPU's generator on a thread that may block and whose panic is caught.
fn generate(
    context: &Context,
    pool: Arc<ThreadPool>,
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
        pool.install(|| generator.generate(work, &*live, &token))
    });
    let made = async move {
        match thread.await {
            Ok(Ok(outcome)) => Ok(outcome),
            Ok(Err(WorkError::Generate(GenerateError::Gpu(error)))) => Err(Unmade::Gpu(error.to_string())),
            Ok(Err(error)) => Err(Unmade::Verdict(verdict::of_error(&error))),
            Err(error) => Err(Unmade::Verdict(verdict::of_join(error))),
        }
    };
    Generation::new(Box::pin(made), prepared.cancel.clone())
}
