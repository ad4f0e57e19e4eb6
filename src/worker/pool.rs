//! The workers of a process: slots that claim jobs and run them, their heartbeats, shutdown.

use super::attempt::{Attempt, Start};
use super::backend::Generation;
use super::backend::cpu::{Cpu, Threads};
use super::backend::gpu::Gpu;
use super::busy::Busy;
use super::context::{Context, Phase};
use super::generator::{BatchGenerator, Generator};
use super::options::PoolOptions;
use super::policy::{CpuFallback, Storage, cpu_fallback};
use super::verdict;
use crate::generate::Backend;
use crate::jobs::artifacts::Artifacts;
use crate::jobs::scratch::{Scratch, drop_blocking};
use crate::jobs::{Change, ClaimScope, ClaimedJob, Job, Store, StoreError, WorkerCondition, WorkerInfo, WorkerKind};
use crate::lock::Mutex;
use crate::panics::panic_message;
use crate::status::{Condition, Status};
use futures_util::FutureExt;
use futures_util::future::join_all;
use jiff::Timestamp;
use std::any::Any;
use std::io;
use std::iter::repeat_with;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::{JoinError, JoinSet};
use tokio::time::{sleep, timeout};

/// Maximum wait between claims while the job store is unavailable.
const MAX_CLAIM_WAIT: Duration = Duration::from_secs(10);
/// Maximum time for which a shutdown waits for generations that were told to stop.
const STOP_WAIT: Duration = Duration::from_secs(10);
/// Maximum number of claims (of a model or a GPU batch) of a worker: it computes one while it
/// stores the files of the previous. A fit and a short model are claimed beside them.
const CLAIMS: usize = 2;
/// Number of heartbeat intervals between two reports of a worker in the same state.
const SEEN_EVERY: u32 = 5;

/// Running workers. Dropping the pool interrupts them and lets their leases expire; see
/// [`WorkerPool::shutdown`].
#[derive(Debug)]
pub struct WorkerPool {
    phase: watch::Sender<Phase>,
    tasks: JoinSet<()>,
    scratch: Arc<Scratch>,
}

/// One worker of a pool.
struct Slot {
    id: String,
    context: Arc<Context>,
    cpu: Cpu,
    /// Device of a GPU worker.
    gpu: Option<Gpu>,
    claims: Arc<Semaphore>,
    busy: Arc<Busy>,
    state: Mutex<WorkerStatus>,
    /// True after the last heartbeat. Held from reading `state` until it is recorded, so that the
    /// last record is current.
    stopped: tokio::sync::Mutex<bool>,
}

/// Jobs that a loop of a worker claims. A CPU worker has a loop for each, a GPU worker one for
/// models.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Work {
    Models,
    /// Short models, while a longer one runs.
    ShortModels,
    Fits,
}

/// The rights that a worker needs to run a claim.
struct RunPermit {
    /// Right to use the CPU threads or the device.
    compute: Threads,
    /// Right to hold one more claim of models.
    _claim: Option<OwnedSemaphorePermit>,
}

/// Part of a worker's state that its heartbeat publishes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct WorkerStatus {
    jobs_done: u64,
    gpu: GpuState,
    /// Set by [`Slot::state`].
    condition: Option<WorkerCondition>,
}

/// The state of a worker's GPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum GpuState {
    /// Not opened yet, or no GPU worker.
    #[default]
    Unknown,
    Open,
    Failed,
}

impl WorkerPool {
    /// Starts CPU workers, and a GPU worker for each of `gpus`. Must be called within a tokio
    /// runtime.
    ///
    /// # Errors
    /// The error of creating the scratch directory or threads.
    pub fn start(
        store: Store,
        artifacts: Artifacts,
        generator: Arc<Generator>,
        gpus: Vec<Arc<dyn BatchGenerator>>,
        options: PoolOptions,
    ) -> io::Result<Self> {
        let (phase, receiver) = watch::channel(Phase::Run);
        let scratch = Arc::new(Scratch::open(&options.scratch)?);
        let storage = Storage::new(options.storage_wait, options.status.clone());
        let context = Context {
            store,
            artifacts,
            generator,
            options,
            scratch: Arc::clone(&scratch),
            storage,
            phase: receiver,
            surfaces_lag: AtomicBool::new(false),
        };
        let context = Arc::new(context);
        let devices = gpus.len();
        let mut slots = Vec::new();
        for (n, generator) in gpus.into_iter().enumerate() {
            slots.push(Slot::new(&context, &format!("gpu{n}"), Some(generator))?);
        }
        for n in 0..context.options.workers {
            slots.push(Slot::new(&context, &n.to_string(), None)?);
        }
        let status = context.options.status.clone();
        if devices > 0 {
            let plural = if devices == 1 { "" } else { "s" };
            status.set(Condition::OpeningDevices, format!("The process is opening {devices} GPU{plural}."));
        }
        let opening = Arc::new(Opening(status));
        let mut tasks = JoinSet::new();
        for slot in &slots {
            tasks.spawn(run_slot(Arc::clone(slot), Arc::clone(&opening)));
        }
        tasks.spawn(async move {
            while let Err(panic) = AssertUnwindSafe(report_workers(&slots, &context)).catch_unwind().await {
                note_panic(&context, "heartbeats", panic).await;
            }
        });
        Ok(Self { phase, tasks, scratch })
    }

    /// Stops the workers. They claim nothing more; running jobs have `grace` to end, then they are
    /// released to their place in the queue, and the attempts do not count. Returns at most 10 s
    /// after the grace.
    pub async fn shutdown(mut self, grace: Duration) {
        self.phase.send_replace(Phase::Drain);
        if timeout(grace, self.ended()).await.is_err() {
            self.phase.send_replace(Phase::Release);
            if timeout(STOP_WAIT, self.ended()).await.is_err() {
                tracing::error!("a generation did not stop in time; its result will be discarded");
            }
        }
        drop_blocking(self.scratch).await;
    }

    async fn ended(&mut self) {
        while let Some(task) = self.tasks.join_next().await {
            if let Err(error) = task {
                tracing::error!(%error, "a worker panicked; its leases will expire");
            }
        }
    }
}

/// Held by GPU workers that have not tried to open their device. The process is not ready until all
/// have dropped it.
struct Opening(Status);

impl Drop for Opening {
    fn drop(&mut self) {
        self.0.clear(Condition::OpeningDevices);
    }
}

/// Claims jobs and runs them until the pool drains.
async fn run_slot(slot: Arc<Slot>, opening: Arc<Opening>) {
    if let Some(gpu) = &slot.gpu {
        slot.open(gpu).await;
    }
    drop(opening);
    let beside = async {
        if slot.gpu.is_none() {
            tokio::join!(claim_until_drained(&slot, Work::ShortModels), claim_until_drained(&slot, Work::Fits));
        }
    };
    tokio::join!(claim_until_drained(&slot, Work::Models), beside);
    slot.stop().await;
}

/// Claims jobs and runs them until the pool drains and all have ended. Continues after a panic: a
/// worker that claims nothing would look alive.
async fn claim_until_drained(slot: &Arc<Slot>, work: Work) {
    let mut attempts = JoinSet::new();
    while let Err(panic) = AssertUnwindSafe(claim_jobs(slot, work, &mut attempts)).catch_unwind().await {
        note_panic(&slot.context, "claims", panic).await;
    }
    while let Some(ended) = attempts.join_next().await {
        log_panic(ended);
    }
}

/// Reports a panic of a task of the pool, and waits until the task may start again.
async fn note_panic(context: &Context, task: &'static str, panic: Box<dyn Any + Send>) {
    tracing::error!(task, panic = panic_message(&*panic), "a task of the workers panicked; it is restarted");
    drop(panic);
    context.options.metrics.task_panicked(task, 1);
    sleep(context.options.poll).await;
}

/// Claims jobs and starts their attempts until the pool drains.
///
/// The worker claims the next job when its device is free, or once for each generation shortly
/// before its threads are free, so that they do not wait for the stores. The upload of the previous
/// job may still be in progress.
async fn claim_jobs(slot: &Arc<Slot>, work: Work, attempts: &mut JoinSet<()>) {
    let context = &slot.context;
    let mut phase = context.phase.clone();
    let mut wait = context.options.poll;
    loop {
        let permit = tokio::select! {
            biased;
            _ = phase.wait_for(|phase| *phase != Phase::Run) => break,
            permit = slot.permit(work) => permit,
        };
        // Subscribes before the claim, so that no job is missed that is queued in between.
        let mut changes = context.store.changes();
        let unavailable = match slot.claim(work).await {
            Ok((claimed, fallback)) => {
                wait = context.options.poll;
                if !claimed.is_empty() {
                    attempts.spawn(Arc::clone(slot).run(claimed, fallback, permit));
                    while let Some(ended) = attempts.try_join_next() {
                        log_panic(ended);
                    }
                    continue;
                }
                false
            }
            Err(error) => {
                tracing::warn!(worker = slot.id, %error, "could not claim jobs; the worker will retry");
                wait = (wait * 2).min(MAX_CLAIM_WAIT);
                true
            }
        };
        drop(permit);
        tokio::select! {
            _ = phase.changed() => {}
            () = sleep(wait) => {}
            // Other work can wait for the next poll.
            () = new_job(&mut changes), if !unavailable && work == Work::Models => {}
        }
    }
}

fn log_panic(ended: Result<(), JoinError>) {
    if let Err(error) = ended {
        tracing::error!(%error, "an attempt panicked; its lease will expire");
    }
}

/// Waits until a job is queued or changes were missed. Polling finds a job that becomes due later,
/// by a retry or an expired lease.
async fn new_job(changes: &mut Receiver<Change>) {
    loop {
        match changes.recv().await {
            Ok(Change { version: Some(1), .. }) | Err(RecvError::Lagged(_)) => return,
            Ok(_) => {}
            Err(RecvError::Closed) => return std::future::pending().await,
        }
    }
}

/// Sends the heartbeats of the workers: of workers whose state has changed at each interval, of all
/// workers less often.
async fn report_workers(slots: &[Arc<Slot>], context: &Context) {
    let mut phase = context.phase.clone();
    let mut recorded: Vec<Option<WorkerStatus>> = vec![None; slots.len()];
    for beat in 0u32.. {
        for (slot, recorded) in slots.iter().zip(&mut recorded) {
            if beat.is_multiple_of(SEEN_EVERY) || recorded.as_ref() != Some(&slot.state()) {
                *recorded = Some(slot.record().await);
            }
        }
        tokio::select! {
            // Each worker ends its entry in the list itself.
            _ = phase.wait_for(|phase| *phase != Phase::Run) => return,
            () = sleep(context.options.heartbeat) => {}
        }
    }
}

impl Slot {
    fn new(context: &Arc<Context>, name: &str, generator: Option<Arc<dyn BatchGenerator>>) -> io::Result<Arc<Self>> {
        let id = format!("{}-{}-{name}", context.options.host, std::process::id());
        let threads = context.options.threads.max(1);
        let nice = context.options.nice;
        let cpu = Cpu::new(&id, threads, nice)?;
        let gpu = generator.map(|generator| Gpu::new(&id, threads, nice, generator)).transpose()?;
        let busy = Busy::new(&context.options.metrics, if gpu.is_some() { WorkerKind::Gpu } else { WorkerKind::Cpu });
        Ok(Arc::new(Self {
            id,
            context: Arc::clone(context),
            cpu,
            gpu,
            claims: Arc::new(Semaphore::new(CLAIMS)),
            busy,
            state: Mutex::default(),
            stopped: tokio::sync::Mutex::default(),
        }))
    }

    /// Waits until the worker can run one more claim and store its files.
    async fn permit(&self, work: Work) -> RunPermit {
        let claim = if work == Work::Models { Some(self.claim_permit().await) } else { None };
        let compute = match (&self.gpu, work) {
            (Some(gpu), _) => Threads::Free(gpu.free().await),
            (None, Work::Models) => self.cpu.free_soon().await,
            (None, Work::ShortModels) => self.cpu.free_beside_long().await,
            (None, Work::Fits) => Threads::Free(self.cpu.free_for_fit().await),
        };
        self.context.storage.wait_until_available(&self.context.artifacts, &self.context.scratch).await;
        if work == Work::Models {
            self.cpu.give_turn_to_fit().await;
        }
        RunPermit { compute, _claim: claim }
    }

    /// Waits until the worker can hold one more claim. Notes whether the device of a GPU worker is
    /// idle in the meantime.
    async fn claim_permit(&self) -> OwnedSemaphorePermit {
        let lags = |lag| self.context.surfaces_lag.store(lag, Ordering::Relaxed);
        let claim = Arc::clone(&self.claims).acquire_owned();
        tokio::pin!(claim);
        let acquired = match &self.gpu {
            None => claim.await,
            Some(gpu) => tokio::select! {
                biased;
                acquired = &mut claim => {
                    lags(false);
                    acquired
                }
                _ = gpu.free() => {
                    lags(true);
                    claim.await
                }
            },
        };
        acquired.expect("the semaphore is never closed")
    }

    /// Claims jobs that this worker may run. A GPU worker whose device cannot be opened claims one
    /// job at a time, because jobs of `gpu` must end too, with the reason.
    async fn claim(&self, work: Work) -> Result<(Vec<ClaimedJob>, Option<CpuFallback>), StoreError> {
        let Context { store, options, .. } = &*self.context;
        let (fallback, scope, limit) = match &self.gpu {
            None if work == Work::Fits => (None, ClaimScope::Fits, 1),
            Some(gpu) => {
                let limit = if self.open(gpu).await { options.batch.max(1) } else { 1 };
                (None, ClaimScope::Gpu, limit)
            }
            None => {
                let surfaces_lag = self.context.surfaces_lag.load(Ordering::Relaxed);
                let fallback = cpu_fallback(store, options, surfaces_lag).await?;
                let scope = match (work, &fallback) {
                    (Work::ShortModels, Some(_)) => ClaimScope::CpuShort,
                    (Work::ShortModels, None) => ClaimScope::CpuOnlyShort,
                    (_, Some(_)) => ClaimScope::Cpu,
                    (_, None) => ClaimScope::CpuOnly,
                };
                (fallback, scope, 1)
            }
        };
        let claim = self.context.storage.claim(store.claim(&self.id, scope, options.lease, limit)).await;
        Ok((claim.transpose()?.unwrap_or_default(), fallback))
    }

    /// Opens the device, or opens it again if it was lost. Returns true if it is open.
    async fn open(&self, gpu: &Gpu) -> bool {
        let opened = gpu.open().await;
        let state = if opened.is_ok() { GpuState::Open } else { GpuState::Failed };
        let before = std::mem::replace(&mut self.state.lock().gpu, state);
        if before != state {
            match &opened {
                Ok(()) => tracing::info!(worker = self.id, device = gpu.device(), "opened the GPU"),
                Err(reason) => tracing::error!(
                    worker = self.id,
                    reason,
                    "could not open the GPU; its worker releases or fails the jobs that need it"
                ),
            }
            self.record().await;
        }
        opened.is_ok()
    }

    async fn run(self: Arc<Self>, claimed: Vec<ClaimedJob>, fallback: Option<CpuFallback>, permit: RunPermit) {
        let RunPermit { compute, _claim } = permit;
        let _running = self.busy.begin();
        let ended = match (&self.gpu, compute) {
            (Some(gpu), Threads::Free(device)) => self.run_batch(gpu, claimed, device).await,
            (_, compute) => self.run_one(claimed, fallback, compute).await,
        };
        self.state.lock().jobs_done += ended;
    }

    /// Runs a job on the CPU. Returns the number of jobs that have ended.
    async fn run_one(&self, claimed: Vec<ClaimedJob>, fallback: Option<CpuFallback>, compute: Threads) -> u64 {
        // A CPU worker claims one job at a time.
        let Some(claimed) = claimed.into_iter().next() else { return 0 };
        let mut report = self.cpu.report(claimed.job().backend.requested);
        if let (Some((why, cause)), Backend::Auto) = (fallback, report.requested) {
            report.fallback = Some(why);
            self.context.options.metrics.fallback(cause);
        }
        match Attempt::begin(&self.context, &self.id, claimed, report).await {
            Some(attempt) => u64::from(attempt.run(Start::Cpu(compute), &self.cpu).await),
            None => 0,
        }
    }

    /// Runs the jobs that fit on the device together, and releases the others. Returns the number
    /// of jobs that have ended.
    async fn run_batch(&self, gpu: &Gpu, claimed: Vec<ClaimedJob>, device: OwnedSemaphorePermit) -> u64 {
        let jobs: Vec<Job> = claimed.iter().map(|claimed| claimed.job().clone()).collect();
        let (admitted, refused) = match gpu.admit(jobs).await {
            Ok(admitted) => (admitted, None),
            // The first job ends with the reason.
            Err(reason) => (vec![Some(None)], Some(reason)),
        };
        let (mut attempts, mut tasks) = (Vec::new(), Vec::new());
        for (claimed, admitted) in claimed.into_iter().zip(admitted.into_iter().chain(repeat_with(|| None))) {
            let Some(plan) = admitted else {
                self.release_misfit(claimed).await;
                continue;
            };
            let report = gpu.report(claimed.job().backend.requested);
            if let Some(attempt) = Attempt::begin(&self.context, &self.id, claimed, report).await {
                tasks.push((attempt.task(), plan));
                attempts.push(attempt);
            }
        }
        tracing::info!(device = gpu.device(), jobs = attempts.len(), "a GPU batch began");
        let generations = match refused {
            None => gpu.generate(tasks, device),
            Some(reason) => {
                drop(device);
                attempts.iter().map(|_| Generation::refused(reason.clone())).collect()
            }
        };
        let members = attempts.into_iter().zip(generations);
        let ends = join_all(members.map(|(attempt, generation)| attempt.run(Start::Running(generation), &self.cpu)));
        ends.await.into_iter().map(u64::from).sum()
    }

    async fn release_misfit(&self, claimed: ClaimedJob) {
        let id = claimed.job().id;
        if let Err(error) = self.context.store.release(claimed, Some(verdict::of_misfit())).await {
            tracing::warn!(job = %id, %error, "could not release a job that does not fit the GPU batch; its lease will expire");
        }
    }

    fn state(&self) -> WorkerStatus {
        let condition = self.context.storage.is_unavailable().then_some(WorkerCondition::Storage);
        WorkerStatus { condition, ..self.state.lock().clone() }
    }

    /// Removes the worker from the list of workers, after its last heartbeat.
    async fn stop(&self) {
        let mut stopped = self.stopped.lock().await;
        *stopped = true;
        if let Err(error) = self.context.store.worker_stopped(&self.id).await {
            tracing::warn!(worker = self.id, %error, "could not remove a stopped worker from the list of workers");
        }
    }

    /// Sends a heartbeat with the present state of the worker, unless it has stopped.
    async fn record(&self) -> WorkerStatus {
        let stopped = self.stopped.lock().await;
        let state = self.state();
        if *stopped {
            return state;
        }
        let (kind, device) = match &self.gpu {
            // A GPU worker without its device must not count as live.
            Some(_) if state.gpu != GpuState::Open => return state,
            Some(gpu) => (WorkerKind::Gpu, gpu.device()),
            None => (WorkerKind::Cpu, self.cpu.device()),
        };
        let worker = WorkerInfo {
            id: self.id.clone(),
            host: self.context.options.host.clone(),
            kind,
            device,
            jobs: Vec::new(),
            jobs_done: state.jobs_done,
            heartbeat_at: Timestamp::UNIX_EPOCH,
            pause: None,
            condition: state.condition,
        };
        if let Err(error) = self.context.store.worker_seen(&worker).await {
            tracing::warn!(worker = self.id, %error, "could not record the heartbeat of a worker");
        }
        state
    }
}
