//! One attempt at a job, from its claim to its end. If a GPU could not grow a job of `auto`, the
//! same attempt grows it on the CPU.

use super::backend::cpu::{Cpu, ThreadUse, Threads};
use super::backend::{self, GenerateFailure, Generation, GenerationOutput, Task};
use super::checkpoint::{Checkpoints, Mailbox};
use super::context::Context;
use super::lease::{Claim, Interrupt, Lease};
use super::progress::{AttemptSink, NEARLY_FREE};
use super::upload::{self, UploadError};
use super::verdict::{self, Verdict};
use crate::clock::Stopwatch;
use crate::generate::{Backend, CancelToken, UsedBackend};
use crate::jobs::scratch::{AttemptDir, drop_blocking};
use crate::jobs::state::AttemptEnd;
use crate::jobs::{BackendReport, ClaimedJob, File, Finished, JobId, JobKind, Status, StoreError};
use crate::metrics::Fallback;
use crate::spec::ModelSpec;
use crate::trace;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

/// Maximum time for which the record of an interrupted attempt waits for the generation to stop.
const GENERATION_STOP_WAIT: Duration = Duration::from_millis(300);
/// Maximum time for which a released attempt waits for its last checkpoint to be taken and stored.
const CHECKPOINT_WAIT: Duration = Duration::from_secs(6);
/// Maximum time for which a job that was claimed early waits for the CPU threads. After that, the
/// job is released to other workers.
const THREAD_WAIT: Duration = Duration::from_secs(3);
/// Maximum time for which an interrupted attempt waits for its upload to stop.
const UPLOAD_STOP_WAIT: Duration = Duration::from_millis(500);
/// Constant part of the default time limit of a generation.
const TIME_FLOOR: Duration = Duration::from_secs(600);
/// Factor of the predicted time on one core in the default time limit. Machines that run several
/// workers on the same cores, and GPU batches, are slower than predicted.
const TIME_FACTOR: f64 = 20.0;

/// One attempt at a job.
pub(super) struct Attempt<'a> {
    context: &'a Context,
    /// Name of the worker, for the status of the process.
    worker: &'a str,
    claim: Claim,
    lease: Lease<'a>,
    dir: Arc<AttemptDir>,
    sink: Arc<AttemptSink>,
    checkpoints: Checkpoints<'a>,
    cancel: CancelToken,
    /// Threads that a generation on the CPU uses.
    threads_used: ThreadUse,
    /// The spec of a model, once it has been read.
    spec: Option<ModelSpec>,
    /// A generation that was told to stop and still runs.
    stopping: Option<Generation>,
}

/// Source of the generation of an attempt.
pub(super) enum Start {
    /// The attempt starts it on the CPU. It waits at most [`THREAD_WAIT`] for threads that are not
    /// free.
    Cpu(Threads),
    /// It runs already, as a member of a GPU batch.
    Running(Generation),
}

/// Reason why an attempt has no result.
enum NoResult {
    Failed(Verdict),
    Interrupted(Interrupt),
}

impl From<Interrupt> for NoResult {
    fn from(interrupt: Interrupt) -> Self {
        Self::Interrupted(interrupt)
    }
}

impl From<Verdict> for NoResult {
    fn from(verdict: Verdict) -> Self {
        Self::Failed(verdict)
    }
}

/// Result of the work of an attempt. If it is `Ok`, the files are stored, and the record can be
/// committed.
type WorkResult = Result<Finished, NoResult>;

/// Outcome of an attempt, for metrics and logs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum AttemptOutcome {
    Succeeded,
    Failed,
    Cancelled,
    Retried,
    Released,
    Lost,
    Deleted,
}

impl AttemptOutcome {
    /// Value of the label of the metric.
    fn name(self) -> &'static str {
        match self {
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
            Self::Retried => "retried",
            Self::Released => "released",
            Self::Lost => "lost",
            Self::Deleted => "deleted",
        }
    }
}

impl<'a> Attempt<'a> {
    /// Begins an attempt at a claimed job: creates its scratch directory, sink and lease. `report`
    /// names the backend and device. Returns `None` if this fails; the failure is then recorded and
    /// the attempt has ended.
    pub(super) async fn begin(
        context: &'a Context,
        worker: &'a str,
        job: ClaimedJob,
        report: BackendReport,
    ) -> Option<Self> {
        let (id, attempt, options) = (job.job().id, job.attempt(), &context.options);
        let span = tracing::info_span!("attempt", job = %id, attempt);
        trace::adopt(&span, job.job().trace.as_deref());
        let claim = Claim { job, report };
        let prepare = async {
            tracing::info!("attempt began");
            observe_wait(context, &claim.job).await;
            options.faults.point("after-claim").await.map_err(verdict::of_injected)?;
            context.scratch.attempt(id, attempt).map_err(|error| verdict::of_scratch(&error))
        };
        match prepare.instrument(span.clone()).await {
            Ok(dir) => {
                let cancel = CancelToken::default();
                let mailbox = Mailbox::new(options.checkpoint_every);
                let sink = AttemptSink::new(mailbox, span, options.faults.clone(), cancel.clone());
                let (lease, checkpoints) = (Lease::new(context), Checkpoints::new(context, &claim.job));
                let (dir, sink) = (Arc::new(dir), Arc::new(sink));
                Some(Self {
                    context,
                    worker,
                    claim,
                    lease,
                    dir,
                    sink,
                    checkpoints,
                    cancel,
                    threads_used: ThreadUse::All,
                    spec: None,
                    stopping: None,
                })
            }
            Err(verdict) => {
                record(context, claim, Err(verdict.into())).instrument(span).await;
                None
            }
        }
    }

    /// The task of a GPU batch for this job.
    pub(super) fn task(&self) -> Task {
        Task {
            job: self.claim.job.job().clone(),
            spec: self.spec.clone(),
            dir: Arc::clone(&self.dir),
            sink: Arc::clone(&self.sink),
            cancel: self.cancel.clone(),
            memory_limit_bytes: self.context.options.memory_limit_bytes,
            checkpoint: None,
        }
    }

    /// Waits for the generation, stores its files and ends the attempt. Returns true if the job has
    /// ended.
    pub(super) async fn run(mut self, start: Start, cpu: &Cpu) -> bool {
        let span = self.sink.span.clone();
        let run = async {
            let ending = self.work(start, cpu).await;
            self.conclude(ending).await
        };
        run.instrument(span).await
    }

    async fn work(&mut self, start: Start, cpu: &Cpu) -> WorkResult {
        let result = self.follow(start, cpu).await;
        let made = match self.sink.injected() {
            Some(injected) if !matches!(result, Err(NoResult::Interrupted(_))) => {
                return Err(verdict::of_injected(injected).into());
            }
            _ => result?,
        };
        if let Some(seconds) = made.seconds {
            let metrics = &self.context.options.metrics;
            metrics.stage("simulate", seconds.simulate);
            metrics.stage("mesh", seconds.mesh);
            metrics.stage("certify", seconds.certify);
            metrics.stage("measure", seconds.measure);
            metrics.stage("export", seconds.export);
        }
        let files = upload::files(&self.claim.job, &made.files);
        if let Err(ending) = self.store(&files).await {
            match ending {
                NoResult::Interrupted(Interrupt::Lost | Interrupt::Deleted) => {
                    upload::remove_unused(self.context, &files).await;
                }
                _ => upload::remove(self.context, &files).await,
            }
            return Err(ending);
        }
        let summary = made.summary;
        self.claim.report.used = Some(made.used);
        self.claim.report.device = Some(made.device);
        let (backend, engine) = (self.claim.report.clone(), crate::ENGINE_VERSION.to_owned());
        Ok(Finished { backend, files, summary, engine })
    }

    /// Waits for the output of the generation. Its threads are then free, unless it was told to
    /// stop and still runs.
    async fn follow(&mut self, start: Start, cpu: &Cpu) -> Result<GenerationOutput, NoResult> {
        let (predicted, spec) =
            backend::predict(self.claim.job.job()).map(|predicted| (predicted.seconds, predicted.spec)).unzip();
        self.spec = spec.flatten();
        self.threads_used = match start {
            Start::Cpu(Threads::Beside(_)) => ThreadUse::Beside,
            _ if predicted.is_some_and(|seconds| seconds < NEARLY_FREE) => ThreadUse::NearlyFree,
            _ => ThreadUse::All,
        };
        let mut time = self.time_limit(predicted);
        let mut generation = match start {
            Start::Running(generation) => generation,
            Start::Cpu(Threads::Free(permit) | Threads::Beside(permit)) => self.generate_on(cpu, permit).await?,
            Start::Cpu(Threads::Soon(free)) => {
                let free = timeout(THREAD_WAIT, free);
                let permit = self.lease.hold(&self.claim, &self.sink.progress, free).await?;
                self.generate_on(cpu, permit.map_err(|_| verdict::of_busy_worker())?).await?
            }
        };
        loop {
            let since = Stopwatch::start();
            let reason = match self.hold_in_time(&mut generation, time).await {
                Ok(Ok(outcome)) => return Ok(outcome),
                Ok(Err(GenerateFailure::Verdict(verdict))) => return Err(verdict.into()),
                Ok(Err(GenerateFailure::Gpu(reason))) => reason,
                Err(ending) => {
                    self.stop(generation, &ending).await;
                    return Err(ending);
                }
            };
            drop(generation);
            let report = &self.claim.report;
            if (report.requested, report.used) != (Backend::Auto, Some(UsedBackend::Gpu)) {
                return Err(Verdict::Fail(verdict::of_gpu(reason)).into());
            }
            tracing::warn!(reason, "the GPU could not grow the model; the CPU will grow it");
            self.context.options.metrics.fallback(Fallback::Device);
            // The wait for the CPU does not count against the time limit.
            time = time.map(|time| time.saturating_sub(since.elapsed()));
            let permit = self.lease.hold(&self.claim, &self.sink.progress, cpu.free()).await?;
            self.claim.report = BackendReport { fallback: Some(reason), ..cpu.report(Backend::Auto) };
            self.lease.report_soon();
            // The generation on the GPU keeps its token, which stays cancelled.
            self.cancel = CancelToken::default();
            self.sink.restart(self.cancel.clone());
            generation = self.generate_on(cpu, permit).await?;
        }
    }

    /// Starts the generation on the CPU, from the checkpoint of an earlier attempt if there is one.
    async fn generate_on(&mut self, cpu: &Cpu, permit: OwnedSemaphorePermit) -> Result<Generation, NoResult> {
        let checkpoint = self.checkpoints.load(self.dir.path());
        let checkpoint = self.lease.hold(&self.claim, &self.sink.progress, checkpoint).await?;
        let backend = self.claim.report.used.unwrap_or(UsedBackend::Cpu);
        let task = Task { checkpoint, ..self.task() };
        Ok(cpu.generate(Arc::clone(&self.context.generator), backend, task, self.threads_used, permit))
    }

    /// Time limit of all generations of this attempt together. `None`, for no limit, if the spec is
    /// not valid; the generation then fails immediately.
    fn time_limit(&self, predicted_seconds: Option<f64>) -> Option<Duration> {
        self.context.options.job_timeout.or_else(|| {
            let limit = default_time_limit(predicted_seconds?);
            // Models may take three quarters of the time of a fit.
            Some(if self.claim.job.job().kind == JobKind::Fit { 4 * limit } else { limit })
        })
    }

    /// Drives a generation for at most `time`, while renewing its lease and storing its
    /// checkpoints.
    async fn hold_in_time(
        &mut self,
        generation: &mut Generation,
        time: Option<Duration>,
    ) -> Result<Result<GenerationOutput, GenerateFailure>, NoResult> {
        let Self { context, claim, lease, sink, checkpoints, .. } = self;
        let late = async {
            match time {
                Some(time) => sleep(time).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            held = lease.hold(claim, &sink.progress, generation.result()) => Ok(held?),
            () = late => Err(verdict::of_timeout(time.unwrap_or_default()).into()),
            () = turn_over(context, &claim.job, sink) => Err(Interrupt::TurnOver.into()),
            never = checkpoints.store_all(&claim.job, &sink.checkpoints) => match never {},
        }
    }

    /// Stops a generation. Before a release it takes a last checkpoint.
    async fn stop(&mut self, mut generation: Generation, ending: &NoResult) {
        let mut running = true;
        // A GPU takes no checkpoints that another attempt could resume from.
        let is_released = matches!(ending, NoResult::Interrupted(Interrupt::Shutdown | Interrupt::TurnOver));
        if is_released && self.claim.report.used != Some(UsedBackend::Gpu) && self.sink.checkpoints.is_enabled() {
            running = self.take_last_checkpoint(&mut generation).await;
        }
        generation.stop();
        // A generation usually stops within milliseconds, before the record says that it did.
        if running && timeout(GENERATION_STOP_WAIT, generation.result()).await.is_err() {
            self.stopping = Some(generation);
        }
    }

    /// Waits for a last checkpoint, for at most [`CHECKPOINT_WAIT`]. Returns true if the generation
    /// still runs.
    async fn take_last_checkpoint(&mut self, generation: &mut Generation) -> bool {
        let Self { context, claim, sink, checkpoints, .. } = self;
        sink.checkpoints.request();
        // Nothing renews the lease in the meantime.
        let left = context.options.lease.saturating_sub(context.options.heartbeat).mul_f32(0.75);
        tokio::select! {
            () = checkpoints.store_next(&claim.job, &sink.checkpoints) => true,
            () = sleep(left.min(CHECKPOINT_WAIT)) => true,
            _ = generation.result() => false,
        }
    }

    /// Stores the files while renewing the lease.
    async fn store(&mut self, files: &[File]) -> Result<(), NoResult> {
        let stop = CancellationToken::new();
        let mut upload = Box::pin(upload::upload(self.context, &self.sink, files, self.dir.path(), &stop));
        let uploaded = self.lease.hold(&self.claim, &self.sink.progress, &mut upload).await;
        if uploaded.is_err() {
            // A file that a thread is writing can be removed only once it is complete.
            stop.cancel();
            let _ = timeout(UPLOAD_STOP_WAIT, &mut upload).await;
        }
        uploaded?.map_err(|error| {
            NoResult::Failed(match error {
                UploadError::Injected(injected) => verdict::of_injected(injected),
                UploadError::Store { .. } => verdict::of_storage(&error),
                UploadError::Unreadable { ref source, .. } if verdict::is_storage_fault(source) => {
                    verdict::of_scratch(&error)
                }
                UploadError::Unreadable { .. } | UploadError::Damaged { .. } => verdict::of_damage(&error),
            })
        })
    }

    /// Records the end of the attempt, and waits for a generation that still runs. Returns true if
    /// the job has ended.
    async fn conclude(self, ending: WorkResult) -> bool {
        let Self { context, worker, claim, dir, sink, checkpoints, stopping, .. } = self;
        let id = claim.job.job().id;
        // Before the storage is checked, because its files take space.
        drop_blocking((dir, sink)).await;
        let ended = record(context, claim, ending).await;
        if let Some(generation) = stopping {
            wait_for(context, worker, id, generation).await;
        }
        if ended {
            checkpoints.remove_last().await;
        }
        ended
    }
}

/// Waits until the turn of a fit is over and the fit of another owner waits. Never returns for a
/// model, nor while a release would lose work.
async fn turn_over(context: &Context, claimed: &ClaimedJob, sink: &AttemptSink) {
    if claimed.job().kind == JobKind::Model {
        return std::future::pending().await;
    }
    loop {
        sleep(context.options.fit_turn).await;
        match context.store.fit_waits(claimed).await {
            Ok(true) if sink.may_release() => return,
            Ok(_) => {}
            Err(error) => tracing::warn!(%error, "could not look for waiting fits; the fit goes on"),
        }
    }
}

/// Default time limit of a generation with a predicted time of `seconds` on one core.
fn default_time_limit(seconds: f64) -> Duration {
    TIME_FLOOR + Duration::try_from_secs_f64(seconds * TIME_FACTOR).unwrap_or(TIME_FLOOR)
}

/// Reports the time that a job waited in the queue, at the first attempt that begins. An attempt
/// that a GPU worker released because the job did not fit its batch did not begin.
async fn observe_wait(context: &Context, claimed: &ClaimedJob) {
    let job = claimed.job();
    let began = if claimed.attempt() == 1 {
        job.started_at
    } else {
        let attempts = context.store.attempts(job.id).await.unwrap_or_default();
        let (last, before) = match attempts.split_last() {
            Some((last, before)) if last.attempt == claimed.attempt() => (last, before),
            _ => return,
        };
        let misfit = format!("{}: ", verdict::MISFIT);
        let never_began = before.iter().all(|attempt| {
            let detail = attempt.detail.as_deref().unwrap_or_default();
            attempt.outcome == Some(AttemptEnd::Released) && detail.starts_with(&misfit)
        });
        never_began.then_some(last.started_at)
    };
    // Both times are by the clock of the store.
    if let Some(began) = began {
        let waited = Duration::try_from(began.duration_since(job.created_at)).unwrap_or_default();
        context.options.metrics.waited(waited);
    }
}

/// Waits until a generation that was told to stop has stopped, and discards its result.
async fn wait_for(context: &Context, worker: &str, id: JobId, mut generation: Generation) {
    let (status, limit) = (&context.options.status, context.options.stuck_after);
    if timeout(limit, generation.result()).await.is_err() {
        // Does not name the model, because probes show the detail to everyone.
        let detail = format!("worker {worker} was told to stop a model and has not within {} s", limit.as_secs());
        tracing::error!(model = %id, detail, "a worker is stuck");
        let key = format!("{worker} {id}");
        status.stuck(&key, detail);
        let _ = generation.result().await;
        status.unstuck(&key);
        tracing::info!(worker, "the worker is free again");
    }
}

/// Records the end of an attempt in the store, the metrics and the log. Returns true if the job has
/// ended.
async fn record(context: &Context, claim: Claim, ending: WorkResult) -> bool {
    let Claim { job: claimed, report } = claim;
    let (id, used, device) = (claimed.job().id, report.used, report.device.clone());
    let (fallback, is_model) = (report.fallback.clone(), claimed.job().kind == JobKind::Model);
    if let Err(NoResult::Failed(Verdict::Storage { problem, scratch })) = &ending {
        let space = || backend::predict(claimed.job()).map_or(0, |predicted| predicted.bytes);
        context.storage.job_released(&problem.detail, scratch.then(space)).await;
    }
    let (end, result) = write(context, claimed, report, ending).await;
    let counted = match &result {
        Err(StoreError::Fenced) if matches!(context.store.get(id).await, Ok(None)) => AttemptOutcome::Deleted,
        Err(StoreError::Fenced) => AttemptOutcome::Lost,
        _ => end,
    };
    let (how, metrics) = (end.name(), &context.options.metrics);
    metrics.attempt(counted.name());
    if let (true, AttemptOutcome::Succeeded, Ok(()), Some(used), Some(device)) = (is_model, end, &result, used, &device)
    {
        metrics.made(Backend::from(used).name(), device.clone());
    }
    match &result {
        Ok(()) => tracing::info!(used = used.map(|used| Backend::from(used).name()), device, fallback, "attempt {how}"),
        Err(StoreError::Fenced) if counted == AttemptOutcome::Deleted => {
            tracing::info!("attempt {how}, but its model was deleted");
        }
        Err(StoreError::Fenced) => tracing::warn!("attempt {how}, but its lease was lost"),
        Err(error) => {
            tracing::error!(%error, "attempt {how}, but the job store did not record it; its lease will expire");
        }
    }
    result.is_ok() && matches!(end, AttemptOutcome::Succeeded | AttemptOutcome::Failed | AttemptOutcome::Cancelled)
}

/// Writes the end of an attempt to the store.
async fn write(
    context: &Context,
    claimed: ClaimedJob,
    report: BackendReport,
    ending: WorkResult,
) -> (AttemptOutcome, Result<(), StoreError>) {
    let store = &context.store;
    match ending {
        Ok(finished) => commit(context, claimed, finished).await,
        Err(NoResult::Failed(Verdict::Fail(problem))) => {
            end_of(AttemptOutcome::Failed, store.fail(claimed, report, problem).await)
        }
        Err(NoResult::Failed(Verdict::Retry(problem))) => {
            (AttemptOutcome::Retried, store.retry(claimed, problem).await.map(drop))
        }
        Err(NoResult::Failed(Verdict::Release(problem) | Verdict::Storage { problem, .. })) => {
            (AttemptOutcome::Released, store.release(claimed, Some(problem)).await)
        }
        Err(NoResult::Interrupted(Interrupt::Lost)) => (AttemptOutcome::Lost, Ok(())),
        Err(NoResult::Interrupted(Interrupt::Deleted)) => (AttemptOutcome::Deleted, Ok(())),
        Err(NoResult::Interrupted(Interrupt::Cancelled)) => {
            (AttemptOutcome::Cancelled, store.cancelled(claimed).await.map(drop))
        }
        Err(NoResult::Interrupted(Interrupt::Shutdown)) => {
            (AttemptOutcome::Released, store.release(claimed, None).await)
        }
        Err(NoResult::Interrupted(Interrupt::TurnOver)) => (AttemptOutcome::Released, store.yield_turn(claimed).await),
    }
}

async fn commit(
    context: &Context,
    claimed: ClaimedJob,
    finished: Finished,
) -> (AttemptOutcome, Result<(), StoreError>) {
    let files = finished.files.clone();
    if let Err(injected) = context.options.faults.point("before-commit").await {
        upload::remove(context, &files).await;
        return (AttemptOutcome::Retried, context.store.retry(claimed, verdict::injected(injected)).await.map(drop));
    }
    let (end, result) = end_of(AttemptOutcome::Succeeded, context.store.finish(claimed, finished).await);
    // After another error the outcome of the commit is unknown: the files stay, and if it failed,
    // the orphan sweep removes them.
    if matches!(result, Err(StoreError::Fenced)) {
        upload::remove_unused(context, &files).await;
    } else if end == AttemptOutcome::Cancelled {
        upload::remove(context, &files).await;
    }
    if let (Ok(()), Err(injected)) = (&result, context.options.faults.point("after-commit").await) {
        tracing::warn!(%injected, "a fault was injected after the commit, which it does not affect");
    }
    (end, result)
}

/// The end that the store recorded: a job that was cancelled in the meantime is cancelled.
fn end_of(end: AttemptOutcome, recorded: Result<Status, StoreError>) -> (AttemptOutcome, Result<(), StoreError>) {
    let is_cancelled = matches!(recorded, Ok(Status::Cancelled));
    (if is_cancelled { AttemptOutcome::Cancelled } else { end }, recorded.map(drop))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_time_limit_grows_with_the_predicted_cost() {
        assert_eq!(default_time_limit(0.0), TIME_FLOOR);
        assert_eq!(default_time_limit(30.0), TIME_FLOOR + Duration::from_secs(600));
        assert_eq!(default_time_limit(f64::INFINITY), 2 * TIME_FLOOR, "an infinite prediction is ignored");
    }
}
