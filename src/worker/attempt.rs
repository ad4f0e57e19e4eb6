//! One attempt at a job, from its claim to its end. An attempt that a GPU cannot do goes on on the CPU.

use super::follow::{Broken, Cpu, Follower, Leavings, Start};
use super::generator::Generator;
use super::health::Health;
use super::keeper::{Interrupt, Phase};
use super::live::Live;
use super::options::PoolOptions;
use super::share::Share;
use super::upload::{self, UploadError};
use super::verdict::{self, Verdict};
use crate::clock::Clock;
use crate::generate::{Backend, CancelToken};
use crate::jobs::artifacts::Artifacts;
use crate::jobs::scratch::{AttemptDir, Scratch};
use crate::jobs::{BackendReport, ClaimedJob, Finished, JobId, Store, StoreError};
use crate::trace;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio_util::sync::CancellationToken;
use tracing::{Instrument, Span};

/// What all workers of a pool share.
pub(super) struct Context {
    pub(super) store: Arc<dyn Store>,
    pub(super) artifacts: Artifacts,
    pub(super) generator: Arc<dyn Generator>,
    pub(super) options: PoolOptions,
    pub(super) clock: Clock,
    pub(super) scratch: Scratch,
    pub(super) health: Health,
    pub(super) phase: watch::Receiver<Phase>,
}

/// The right to claim the next job, or batch.
pub(super) type Next = OwnedSemaphorePermit;

/// What an attempt works with.
pub(super) struct Prepared {
    pub(super) dir: Arc<AttemptDir>,
    pub(super) live: Arc<Live>,
    pub(super) cancel: CancelToken,
}

/// How long an upload that is broken off may take to come to rest.
const SETTLE: Duration = Duration::from_millis(500);

/// How the work of an attempt went.
enum Ending {
    /// The files are stored; all is ready to be committed.
    Stored(Box<Finished>),
    /// There is nothing to commit.
    Broken(Broken),
}

/// Runs a claimed job on the CPU and ends it; keeps the right to claim the `next` one until it is nearly done. Returns
/// whether the job has ended by it.
pub(super) async fn run_on_cpu(
    context: &Context,
    cpu: &Cpu<'_>,
    share: &Share,
    claimed: ClaimedJob,
    next: Next,
) -> bool {
    let (pool, mut report) = cpu.threads.choose(claimed.job().backend.requested);
    if let (Share::Auto { why, cause }, Backend::Auto) = (share, report.requested) {
        report.fallback = Some(why.clone());
        context.options.metrics.fallback(*cause);
    }
    match prepare(context, &claimed).await {
        Ok(prepared) => {
            prepared.live.keep(next);
            run(context, claimed, report, prepared, Start::Cpu(pool), cpu).await
        }
        Err(refusal) => refuse(context, claimed, report, refusal).await,
    }
}

/// Why an attempt could not be made ready.
pub(super) struct Refusal {
    verdict: Verdict,
    span: Span,
}

/// Makes an attempt ready.
pub(super) async fn prepare(context: &Context, claimed: &ClaimedJob) -> Result<Prepared, Refusal> {
    let (id, attempt, options) = (claimed.job().id, claimed.attempt(), &context.options);
    let span = tracing::info_span!("attempt", job = %id, attempt);
    trace::adopt(&span, claimed.job().trace.as_deref());
    let dir = async {
        tracing::info!("attempt begins");
        if attempt == 1 {
            // Both by the store's clock.
            let job = claimed.job();
            let waited = job.started_at.unwrap_or(job.created_at).duration_since(job.created_at);
            options.metrics.waited(Duration::try_from(waited).unwrap_or_default());
        }
        options.faults.point("after-claim").await.map_err(verdict::of_injected)?;
        context.scratch.attempt(id, attempt).map_err(|error| verdict::of_scratch(&error))
    };
    match dir.instrument(span.clone()).await {
        Ok(dir) => {
            let cancel = CancelToken::default();
            let live = Live::new(options.faults.clone(), cancel.clone(), options.checkpoint_every).within(span);
            Ok(Prepared { dir: Arc::new(dir), live: Arc::new(live), cancel })
        }
        Err(verdict) => Err(Refusal { verdict, span }),
    }
}

/// Ends an attempt that could not be made ready. Returns whether the job has ended by it.
pub(super) async fn refuse(context: &Context, claimed: ClaimedJob, report: BackendReport, refusal: Refusal) -> bool {
    let ending = Ending::Broken(Broken::Failed(refusal.verdict));
    conclude(context, claimed, report, ending, Leavings::default()).instrument(refusal.span).await
}

/// Follows the generation of a claimed job, stores its files, and ends it. Returns whether the job has ended by it.
pub(super) async fn run(
    context: &Context,
    claimed: ClaimedJob,
    mut report: BackendReport,
    prepared: Prepared,
    start: Start,
    cpu: &Cpu<'_>,
) -> bool {
    let span = prepared.live.span().clone();
    let attempt = async {
        let mut follower = Follower::new(context, &claimed, &prepared, &report);
        let ending = work(&mut follower, context, &claimed, &mut report, &prepared, start, cpu).await;
        let leavings = follower.leavings();
        drop(prepared);
        conclude(context, claimed, report, ending, leavings).await
    };
    attempt.instrument(span).await
}

/// Records how an attempt went, and waits for what it left at work. Returns whether the job has ended by it.
async fn conclude(
    context: &Context,
    claimed: ClaimedJob,
    report: BackendReport,
    ending: Ending,
    leavings: Leavings,
) -> bool {
    let (used, fallback) = (report.used, report.fallback.clone());
    let device = report.device.clone();
    let made = matches!(ending, Ending::Stored(_));
    match &ending {
        Ending::Stored(_) => context.health.well(),
        Ending::Broken(Broken::Failed(verdict)) if verdict.is_of_machine() => context.health.fault(),
        Ending::Broken(_) => {}
    }
    if let Some(generation) = &leavings.generation {
        generation.is_stuck();
    }
    let id = claimed.job().id;
    let (how, result) = end(context, claimed, report, ending).await;
    let told = match &result {
        Err(StoreError::Fenced) if is_gone(context, id).await => DELETED,
        Err(StoreError::Fenced) => "lost",
        _ => how,
    };
    context.options.metrics.attempt(told);
    if let (true, Ok(()), Some(used), Some(device)) = (made, &result, used, &device) {
        context.options.metrics.made(used.name(), device.clone());
    }
    if let Some(mut generation) = leavings.generation {
        // What was broken off is recorded at once, even where a stage is slow to stop; the worker's threads are
        // free only now. What it made or how it failed is of no interest any more.
        generation.stop();
        let _ = generation.made().await;
        drop(generation);
    }
    match result {
        Ok(()) => tracing::info!(used = used.map(Backend::name), device, fallback, "attempt {how}"),
        Err(StoreError::Fenced) if told == DELETED => tracing::info!("attempt {how}, but its model was deleted"),
        Err(StoreError::Fenced) => tracing::warn!("attempt {how}, but its lease was lost"),
        Err(ref error) => tracing::error!(%error, "attempt {how}, but that was not recorded"),
    }
    let ended = result.is_ok() && !matches!(how, DELETED | "lost" | "given back" | "retried");
    if let Some(checkpoint) = leavings.checkpoint.filter(|_| ended)
        && let Err(error) = context.artifacts.delete(&[checkpoint]).await
    {
        tracing::warn!(%error, "the checkpoint of an ended job is left to the sweep");
    }
    ended
}

/// What becomes of an attempt whose model was deleted meanwhile.
const DELETED: &str = "deleted";

/// Whether the job was deleted, as far as is known.
async fn is_gone(context: &Context, id: JobId) -> bool {
    matches!(context.store.get(id).await, Ok(None))
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
        Ending::Broken(Broken::Interrupted(Interrupt::Lost)) => ("lost", Ok(())),
        Ending::Broken(Broken::Interrupted(Interrupt::Gone)) => (DELETED, Ok(())),
        Ending::Broken(Broken::Interrupted(Interrupt::Cancelled)) => {
            ("cancelled", store.cancelled(claimed).await.map(drop))
        }
        Ending::Broken(Broken::Interrupted(Interrupt::Shutdown)) => ("given back", store.release(claimed).await),
        Ending::Broken(Broken::Failed(Verdict::Fail(problem))) => {
            ("failed", store.fail(claimed, backend, problem).await.map(drop))
        }
        Ending::Broken(Broken::Failed(Verdict::Retry(problem))) => {
            ("retried", store.retry(claimed, problem).await.map(drop))
        }
        Ending::Broken(Broken::Failed(Verdict::GiveBack(problem))) => {
            tracing::warn!(kind = problem.kind, problem.detail, "{}", problem.title);
            ("given back", store.release(claimed).await)
        }
    }
}

async fn commit(context: &Context, claimed: ClaimedJob, finished: Finished) -> Result<(), StoreError> {
    let files = finished.files.clone();
    if let Err(injected) = context.options.faults.point("before-commit").await {
        upload::remove(context, &files).await;
        return match verdict::of_injected(injected) {
            Verdict::Fail(problem) | Verdict::Retry(problem) | Verdict::GiveBack(problem) => {
                context.store.retry(claimed, problem).await.map(drop)
            }
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

/// Follows the generation and stores the files, keeping the lease.
async fn work(
    follower: &mut Follower<'_>,
    context: &Context,
    claimed: &ClaimedJob,
    report: &mut BackendReport,
    prepared: &Prepared,
    start: Start,
    cpu: &Cpu<'_>,
) -> Ending {
    let outcome = match follower.outcome(start, report, cpu).await {
        Ok(outcome) => outcome,
        Err(broken) => return Ending::Broken(broken),
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
    let stop = CancellationToken::new();
    let mut upload = Box::pin(upload::upload(context, &prepared.live, &files, prepared.dir.path(), &stop));
    let uploaded = follower.keep(&mut upload).await;
    if uploaded.is_err() {
        // What a thread is just writing appears even where nobody waits for it; only then can all be removed.
        stop.cancel();
        let _ = tokio::time::timeout(SETTLE, &mut upload).await;
    }
    drop(upload);
    let broken = match uploaded {
        Ok(Ok(())) => {
            *report = BackendReport { used: Some(outcome.used), device: Some(outcome.device), ..report.clone() };
            let engine = crate::ENGINE_VERSION.to_owned();
            let finished = Finished { backend: report.clone(), files, summary: outcome.summary, engine };
            return Ending::Stored(Box::new(finished));
        }
        Ok(Err(UploadError::Injected(injected))) => Broken::Failed(verdict::of_injected(injected)),
        Ok(Err(error @ UploadError::Storage { .. })) => Broken::Failed(verdict::of_storage(error.to_string())),
        Err(interrupt) => Broken::Interrupted(interrupt),
    };
    upload::remove(context, &files).await;
    Ending::Broken(broken)
}
