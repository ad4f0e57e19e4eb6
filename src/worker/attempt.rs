//! One attempt at a job, from its claim to its end. A job of `auto` that a GPU could not grow is grown on the CPU within the
//! same attempt.

use super::backend::cpu::Cpu;
use super::backend::{self, GenerateFailure, Generation, Made, Task};
use super::checkpoint::{Checkpoints, Mailbox};
use super::context::Context;
use super::lease::{Claim, Interrupt, Lease};
use super::progress::AttemptSink;
use super::upload::{self, UploadError};
use super::verdict::{self, Verdict};
use crate::clock::Stopwatch;
use crate::generate::{Backend, CancelToken};
use crate::jobs::scratch::AttemptDir;
use crate::jobs::state::AttemptEnd;
use crate::jobs::{BackendReport, ClaimedJob, File, Finished, JobId, JobKind, StoreError};
use crate::metrics::Fallback;
use crate::trace;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

/// How long the record of an interrupted attempt waits for its thread to stop.
const STOP_WAIT: Duration = Duration::from_millis(300);
/// How long an attempt that is released waits for its last checkpoint to be taken and stored.
const SAVE_WAIT: Duration = Duration::from_secs(6);
/// How long a job that was claimed before the threads were free waits for them; then another worker may have it.
const SOON: Duration = Duration::from_secs(3);
/// How long an interrupted upload may take to stop.
const SETTLE: Duration = Duration::from_millis(500);
/// The default time limit of a generation: this floor, and so many times the predicted seconds on one core. Machines that run
/// several workers on the same cores, and batches that share a GPU, are slower than predicted.
const TIME_FLOOR: Duration = Duration::from_secs(600);
const TIME_FACTOR: f64 = 20.0;

/// One attempt at a job.
pub(super) struct Attempt<'a> {
    context: &'a Context,
    /// The name of the worker, for the status of the process.
    worker: &'a str,
    claim: Claim,
    lease: Lease<'a>,
    dir: Arc<AttemptDir>,
    sink: Arc<AttemptSink>,
    checkpoints: Checkpoints<'a>,
    cancel: CancelToken,
    /// A generation that was told to stop and has not yet.
    stopping: Option<Generation>,
}

/// Where the generation of an attempt comes from.
pub(super) enum Start {
    /// It is to be started on the CPU, with the right to use its threads; without it, once they are free, if that is soon.
    Cpu(Option<OwnedSemaphorePermit>),
    /// It runs as a member of a batch.
    Running(Generation),
}

/// How the work of an attempt ended.
enum Ending {
    /// The files are stored; the record is ready to be committed.
    Stored(Box<Finished>),
    Failed(Verdict),
    Interrupted(Interrupt),
}

impl From<Interrupt> for Ending {
    fn from(interrupt: Interrupt) -> Self {
        Self::Interrupted(interrupt)
    }
}

impl From<Verdict> for Ending {
    fn from(verdict: Verdict) -> Self {
        Self::Failed(verdict)
    }
}

/// How an attempt ends, for metrics and logs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Succeeded,
    Failed,
    Cancelled,
    Retried,
    Released,
    Lost,
    Deleted,
}

impl End {
    /// The value of the metric's label.
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
    /// Prepares an attempt at a claimed job, which `report` says what computes. `None` if that failed: the attempt has ended
    /// then.
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
            tracing::info!("attempt begins");
            observe_wait(context, &claim.job).await;
            options.faults.point("after-claim").await.map_err(verdict::of_injected)?;
            context.scratch.attempt(id, attempt).map_err(|error| verdict::of_scratch(error.to_string()))
        };
        match prepare.instrument(span.clone()).await {
            Ok(dir) => {
                let cancel = CancelToken::default();
                let mailbox = Mailbox::new(options.checkpoint_every);
                let sink = AttemptSink::new(mailbox, span, options.faults.clone(), cancel.clone());
                let (lease, checkpoints) = (Lease::new(context), Checkpoints::new(context, &claim.job));
                let (dir, sink) = (Arc::new(dir), Arc::new(sink));
                Some(Self { context, worker, claim, lease, dir, sink, checkpoints, cancel, stopping: None })
            }
            Err(verdict) => {
                record(context, claim, Ending::Failed(verdict)).instrument(span).await;
                None
            }
        }
    }

    /// What a batch needs to grow this job.
    pub(super) fn task(&self) -> Task {
        Task {
            job: self.claim.job.job().clone(),
            dir: Arc::clone(&self.dir),
            sink: Arc::clone(&self.sink),
            cancel: self.cancel.clone(),
            memory_limit_bytes: self.context.options.memory_limit_bytes,
            checkpoint: None,
        }
    }

    /// Follows the generation, stores its files and ends the attempt. Returns whether the job has ended.
    pub(super) async fn run(mut self, start: Start, cpu: &Cpu) -> bool {
        let span = self.sink.span().clone();
        let run = async {
            let ending =
                self.work(start, cpu).await.map_or_else(|ending| ending, |done| Ending::Stored(Box::new(done)));
            self.conclude(ending).await
        };
        run.instrument(span).await
    }

    async fn work(&mut self, start: Start, cpu: &Cpu) -> Result<Finished, Ending> {
        let result = self.follow(start, cpu).await;
        let made = match self.sink.injected() {
            Some(injected) if !matches!(result, Err(Ending::Interrupted(_))) => {
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
            upload::remove(self.context, &files).await;
            return Err(ending);
        }
        let summary = made.summary;
        self.claim.report.used = Some(made.used);
        self.claim.report.device = Some(made.device);
        let (backend, engine) = (self.claim.report.clone(), crate::ENGINE_VERSION.to_owned());
        Ok(Finished { backend, files, summary, engine })
    }

    /// What the generation made. Its threads are free by then, unless it was told to stop and has not yet.
    async fn follow(&mut self, start: Start, cpu: &Cpu) -> Result<Made, Ending> {
        let mut time = self.time_limit();
        let mut generation = match start {
            Start::Running(generation) => generation,
            Start::Cpu(Some(permit)) => self.generate_on(cpu, permit).await?,
            Start::Cpu(None) => {
                let free = timeout(SOON, cpu.free());
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
            if (report.requested, report.used) != (Backend::Auto, Some(Backend::Gpu)) {
                return Err(Verdict::Fail(verdict::of_gpu(reason)).into());
            }
            tracing::warn!(reason, "the GPU could not grow the model; it is grown on the CPU");
            self.context.options.metrics.fallback(Fallback::Device);
            // Waiting for the CPU does not count against the time limit.
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

    /// Starts the generation on the CPU, from the checkpoint that an earlier attempt left.
    async fn generate_on(&mut self, cpu: &Cpu, permit: OwnedSemaphorePermit) -> Result<Generation, Ending> {
        let checkpoint = self.checkpoints.load(self.dir.path());
        let checkpoint = self.lease.hold(&self.claim, &self.sink.progress, checkpoint).await?;
        let backend = self.claim.report.used.unwrap_or_default();
        let task = Task { checkpoint, ..self.task() };
        Ok(cpu.generate(Arc::clone(&self.context.generator), backend, task, permit))
    }

    /// How long the generations of this attempt may take together. `None`, for no limit, if the spec is not valid: then the
    /// generation fails at once.
    fn time_limit(&self) -> Option<Duration> {
        self.context.options.job_timeout.or_else(|| {
            let predicted = backend::predict(self.claim.job.job())?;
            Some(default_time_limit(predicted.seconds))
        })
    }

    /// Drives a generation while its lease is renewed and its checkpoints are stored, for `time` at most.
    async fn hold_in_time(
        &mut self,
        generation: &mut Generation,
        time: Option<Duration>,
    ) -> Result<Result<Made, GenerateFailure>, Ending> {
        let Self { claim, lease, sink, checkpoints, .. } = self;
        let late = async {
            match time {
                Some(time) => sleep(time).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            held = lease.hold(claim, &sink.progress, generation.result()) => Ok(held?),
            () = late => Err(verdict::of_timeout(time.unwrap_or_default()).into()),
            never = checkpoints.store_all(&claim.job, &sink.checkpoints) => match never {},
        }
    }

    /// Stops a generation; one that is released takes a last checkpoint before.
    async fn stop(&mut self, mut generation: Generation, ending: &Ending) {
        let mut running = true;
        // A GPU takes no checkpoints that another attempt could resume from.
        let is_released = matches!(ending, Ending::Interrupted(Interrupt::Shutdown));
        if is_released && self.claim.report.used != Some(Backend::Gpu) && self.sink.checkpoints.is_enabled() {
            running = self.take_last_checkpoint(&mut generation).await;
        }
        generation.stop();
        // Most stop within milliseconds; then the record is true when it says so.
        if running && timeout(STOP_WAIT, generation.result()).await.is_err() {
            self.stopping = Some(generation);
        }
    }

    /// Waits a little for a last checkpoint. Returns whether the generation still runs.
    async fn take_last_checkpoint(&mut self, generation: &mut Generation) -> bool {
        let Self { context, claim, sink, checkpoints, .. } = self;
        sink.checkpoints.request();
        // The lease is not renewed meanwhile.
        let left = context.options.lease.saturating_sub(context.options.heartbeat).mul_f32(0.75);
        tokio::select! {
            () = checkpoints.store_next(&claim.job, &sink.checkpoints) => true,
            () = sleep(left.min(SAVE_WAIT)) => true,
            _ = generation.result() => false,
        }
    }

    /// Stores the files while the lease is renewed.
    async fn store(&mut self, files: &[File]) -> Result<(), Ending> {
        let stop = CancellationToken::new();
        let mut upload = Box::pin(upload::upload(self.context, &self.sink, files, self.dir.path(), &stop));
        let uploaded = self.lease.hold(&self.claim, &self.sink.progress, &mut upload).await;
        if uploaded.is_err() {
            // A file that a thread is writing can be removed only once it is complete.
            stop.cancel();
            let _ = timeout(SETTLE, &mut upload).await;
        }
        uploaded?.map_err(|error| {
            Ending::Failed(match error {
                UploadError::Injected(injected) => verdict::of_injected(injected),
                UploadError::Store { .. } => verdict::of_storage(error.to_string()),
                UploadError::Scratch(detail) => verdict::of_scratch(detail),
                UploadError::Damaged(detail) => verdict::of_damage(detail),
            })
        })
    }

    /// Records how the attempt ended, and waits for a generation that has not stopped yet. Returns whether the job has ended.
    async fn conclude(self, ending: Ending) -> bool {
        let Self { context, worker, claim, dir, sink, checkpoints, stopping, .. } = self;
        let id = claim.job.job().id;
        // Its files make room before the storage is checked.
        drop((dir, sink));
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

/// The time limit of a generation that is predicted to take so many seconds on one core.
fn default_time_limit(seconds: f64) -> Duration {
    TIME_FLOOR + Duration::try_from_secs_f64(seconds * TIME_FACTOR).unwrap_or(TIME_FLOOR)
}

/// Counts how long a job waited in the queue, when an attempt at it begins for the first time. An attempt that a GPU worker
/// released because the job did not fit its batch never began.
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
    // Both times are by the store's clock.
    if let Some(began) = began {
        let waited = Duration::try_from(began.duration_since(job.created_at)).unwrap_or_default();
        context.options.metrics.waited(waited);
    }
}

/// Waits until a generation that was told to stop has stopped. What it returns is of no use any more.
async fn wait_for(context: &Context, worker: &str, id: JobId, mut generation: Generation) {
    let (status, patience) = (&context.options.status, context.options.stuck_after);
    if timeout(patience, generation.result()).await.is_err() {
        // Probes show it to anyone, so it does not name the model.
        let detail = format!("worker {worker} was told to stop a model and has not within {} s", patience.as_secs());
        tracing::error!(model = %id, detail, "a worker is stuck");
        let key = format!("{worker} {id}");
        status.stuck(&key, detail);
        let _ = generation.result().await;
        status.unstuck(&key);
        tracing::info!(worker, "the worker is free again");
    }
}

/// Records how an attempt ended, in the store, the metrics and the log. Returns whether the job has ended.
async fn record(context: &Context, claim: Claim, ending: Ending) -> bool {
    let Claim { job: claimed, report } = claim;
    let (id, used, device) = (claimed.job().id, report.used, report.device.clone());
    let (fallback, is_model) = (report.fallback.clone(), claimed.job().kind == JobKind::Model);
    if let Ending::Failed(Verdict::Storage { problem, scratch }) = &ending {
        let space = || backend::predict(claimed.job()).map_or(0, |predicted| predicted.bytes);
        context.storage.job_released(&problem.detail, scratch.then(space)).await;
    }
    let (end, result) = write(context, claimed, report, ending).await;
    let counted = match &result {
        Err(StoreError::Fenced) if matches!(context.store.get(id).await, Ok(None)) => End::Deleted,
        Err(StoreError::Fenced) => End::Lost,
        _ => end,
    };
    let (how, metrics) = (end.name(), &context.options.metrics);
    metrics.attempt(counted.name());
    if let (true, End::Succeeded, Ok(()), Some(used), Some(device)) = (is_model, end, &result, used, &device) {
        metrics.made(used.name(), device.clone());
    }
    match &result {
        Ok(()) => tracing::info!(used = used.map(Backend::name), device, fallback, "attempt {how}"),
        Err(StoreError::Fenced) if counted == End::Deleted => {
            tracing::info!("attempt {how}, but its model was deleted");
        }
        Err(StoreError::Fenced) => tracing::warn!("attempt {how}, but its lease was lost"),
        Err(error) => tracing::error!(%error, "attempt {how}, but that was not recorded"),
    }
    result.is_ok() && matches!(end, End::Succeeded | End::Failed | End::Cancelled)
}

/// Writes the end of an attempt to the store.
async fn write(
    context: &Context,
    claimed: ClaimedJob,
    report: BackendReport,
    ending: Ending,
) -> (End, Result<(), StoreError>) {
    let store = &context.store;
    match ending {
        Ending::Stored(finished) => commit(context, claimed, *finished).await,
        Ending::Failed(Verdict::Fail(problem)) => (End::Failed, store.fail(claimed, report, problem).await.map(drop)),
        Ending::Failed(Verdict::Retry(problem)) => (End::Retried, store.retry(claimed, problem).await.map(drop)),
        Ending::Failed(Verdict::Release(problem) | Verdict::Storage { problem, .. }) => {
            (End::Released, store.release(claimed, Some(problem)).await)
        }
        Ending::Interrupted(Interrupt::Lost) => (End::Lost, Ok(())),
        Ending::Interrupted(Interrupt::Deleted) => (End::Deleted, Ok(())),
        Ending::Interrupted(Interrupt::Cancelled) => (End::Cancelled, store.cancelled(claimed).await.map(drop)),
        Ending::Interrupted(Interrupt::Shutdown) => (End::Released, store.release(claimed, None).await),
    }
}

async fn commit(context: &Context, claimed: ClaimedJob, finished: Finished) -> (End, Result<(), StoreError>) {
    let files = finished.files.clone();
    if let Err(injected) = context.options.faults.point("before-commit").await {
        upload::remove(context, &files).await;
        return (End::Retried, context.store.retry(claimed, verdict::injected(injected)).await.map(drop));
    }
    let result = context.store.finish(claimed, finished).await.map(drop);
    // After another error it may have been committed or not: the files stay, and are swept if it was not.
    if matches!(result, Err(StoreError::Fenced)) {
        upload::remove(context, &files).await;
    }
    if let (Ok(()), Err(injected)) = (&result, context.options.faults.point("after-commit").await) {
        tracing::warn!(%injected, "the commit is not affected");
    }
    (End::Succeeded, result)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_time_limit_grows_with_the_predicted_cost() {
        assert_eq!(default_time_limit(0.0), TIME_FLOOR);
        assert_eq!(default_time_limit(30.0), TIME_FLOOR + Duration::from_secs(600));
        assert_eq!(default_time_limit(f64::INFINITY), 2 * TIME_FLOOR, "a prediction that is no time is not trusted");
    }
}
