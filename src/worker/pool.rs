//! The workers of a process: claim loop, signs of life, shutdown.

use super::attempt::{self, Context, Next};
use super::batch::{self, Gpu};
use super::follow::Cpu;
use super::generation::{self, Threads};
use super::generator::{BatchGenerator, Generator};
use super::health::Health;
use super::keeper::Phase;
use super::options::PoolOptions;
use super::share::{self, Share};
use super::turn::Turns;
use crate::clock::Clock;
use crate::generate::Backend;
use crate::jobs::artifacts::Artifacts;
use crate::jobs::scratch::Scratch;
use crate::jobs::{Change, ClaimedJob, Store, StoreError, WorkerInfo};
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::{JoinError, JoinSet};
use tokio::time::{sleep, timeout};

/// Longest wait between claims while the store is away.
const LONGEST_WAIT: Duration = Duration::from_secs(10);
/// How long a shutdown waits for work that was told to stop.
const LAST_WAIT: Duration = Duration::from_secs(10);
/// Claims that a worker holds at once: while one is computed, the one before is being stored or the next one is ready.
const CLAIMS: usize = 2;
/// How long a worker that is busy leaves what was just queued to those that are not.
const STANDS_BACK: Duration = Duration::from_millis(250);
/// Heartbeats between the signs of life of a worker of which nothing is new.
const SEEN_EVERY: u32 = 5;

/// Running workers. Dropping it breaks them off, leaving their leases to run out; see [`WorkerPool::shutdown`].
#[derive(Debug)]
pub struct WorkerPool {
    phase: watch::Sender<Phase>,
    tasks: JoinSet<()>,
}

/// One worker of a pool.
struct Slot {
    id: String,
    context: Arc<Context>,
    threads: Threads,
    /// Whose turn it is on the threads.
    turns: Arc<Turns>,
    /// The right to claim; given back when what was claimed is nearly done.
    next: Arc<Semaphore>,
    /// Places of claims that are not done with.
    places: Arc<Semaphore>,
    /// What makes it a GPU worker.
    gpu: Option<Gpu>,
    at: Mutex<At>,
    /// Held from the reading of `at` until it is told, so that what is told last is true.
    word: tokio::sync::Mutex<()>,
}

/// What a worker needs to take on more.
struct Ready {
    next: Next,
    _place: OwnedSemaphorePermit,
}

/// What a worker is at.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct At {
    done: u64,
    gpu: GpuState,
}

/// How it stands with the GPU of a worker.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum GpuState {
    /// Not asked for yet, or there is none.
    #[default]
    Unknown,
    Open,
    Unable,
}

impl WorkerPool {
    /// Starts CPU workers. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// Where the scratch folder or the threads cannot be made.
    pub fn start(
        store: Arc<dyn Store>,
        artifacts: Artifacts,
        generator: Arc<dyn Generator>,
        options: PoolOptions,
        clock: Clock,
    ) -> io::Result<Self> {
        Self::start_with_gpus(store, artifacts, generator, Vec::new(), options, clock)
    }

    /// Starts CPU workers, and a GPU worker for each of `gpus`. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// Where the scratch folder or the threads cannot be made.
    pub fn start_with_gpus(
        store: Arc<dyn Store>,
        artifacts: Artifacts,
        generator: Arc<dyn Generator>,
        gpus: Vec<Arc<dyn BatchGenerator>>,
        options: PoolOptions,
        clock: Clock,
    ) -> io::Result<Self> {
        let (phase, receiver) = watch::channel(Phase::Run);
        let scratch = Scratch::open(&options.scratch)?;
        let workers = options.workers;
        let context = Arc::new(Context {
            store,
            artifacts,
            generator,
            options,
            clock,
            scratch,
            health: Health::default(),
            phase: receiver,
        });
        let mut tasks = JoinSet::new();
        let mut slots = Vec::new();
        let names = (0..gpus.len()).map(|n| format!("gpu{n}")).chain((0..workers).map(|n| n.to_string()));
        let gpus = gpus.into_iter().map(Some).chain(std::iter::repeat_with(|| None));
        for (name, generator) in names.zip(gpus) {
            let id = format!("{}-{}-{name}", context.options.host, std::process::id());
            let all = context.options.threads.max(1);
            let threads = Threads { all: threads(&id, all)?, single: threads(&id, 1)? };
            let gpu = match generator {
                None => None,
                Some(generator) => {
                    let pool = self::threads(&format!("{id}-batch"), all + 1)?;
                    Some(Gpu { generator, pool })
                }
            };
            slots.push(Arc::new(Slot {
                id,
                context: Arc::clone(&context),
                threads,
                turns: Arc::new(Turns::new()),
                next: Arc::new(Semaphore::new(1)),
                places: Arc::new(Semaphore::new(CLAIMS)),
                gpu,
                at: Mutex::default(),
                word: tokio::sync::Mutex::default(),
            }));
        }
        for slot in &slots {
            tasks.spawn(claim_loop(Arc::clone(slot)));
        }
        tasks.spawn(signs_of_life(slots, context));
        Ok(Self { phase, tasks })
    }

    /// Stops: no new claims at once; running jobs get `grace` to end, then they are given back to the queue
    /// at their old place, without counting as an attempt. Comes back at the latest 10 s after the grace.
    pub async fn shutdown(mut self, grace: Duration) {
        self.phase.send_replace(Phase::Drain);
        if timeout(grace, self.ended()).await.is_err() {
            self.phase.send_replace(Phase::GiveBack);
            if timeout(LAST_WAIT, self.ended()).await.is_err() {
                tracing::error!("a generation did not stop in time; what it makes is of no use any more");
            }
        }
    }

    async fn ended(&mut self) {
        while let Some(task) = self.tasks.join_next().await {
            if let Err(error) = task {
                tracing::error!(%error, "a worker ended badly");
            }
        }
    }
}

fn threads(worker: &str, count: usize) -> io::Result<Arc<rayon::ThreadPool>> {
    let worker = worker.to_owned();
    rayon::ThreadPoolBuilder::new()
        .num_threads(count.max(1))
        .thread_name(move |n| format!("{worker}/{n}"))
        .build()
        .map(Arc::new)
        .map_err(io::Error::other)
}

/// Claims jobs until the pool drains, and runs them. The next is claimed as soon as the one before is nearly done (its
/// certificate is under way, or its device is free), so that the worker's threads never wait for the stores.
async fn claim_loop(slot: Arc<Slot>) {
    let context = &slot.context;
    let mut phase = context.phase.clone();
    let mut wait = context.options.poll;
    let mut attempts = JoinSet::new();
    loop {
        let ready = tokio::select! {
            biased;
            _ = phase.wait_for(|phase| *phase != Phase::Run) => break,
            ready = slot.ready() => ready,
        };
        // Listening before looking: what is queued in between is told.
        let mut changes = context.store.changes();
        // Where no attempt can be made none is begun.
        let claimed = match context.scratch.probe() {
            Ok(()) => slot.claim().await.map_err(|error| error.to_string()),
            Err(error) => Err(format!("no scratch folder can be made: {error}")),
        };
        let away = match claimed {
            Ok((claimed, share)) => {
                wait = context.options.poll;
                if !claimed.is_empty() {
                    attempts.spawn(Arc::clone(&slot).run(claimed, share, ready));
                    log_panics(&mut attempts);
                    continue;
                }
                false
            }
            Err(error) => {
                tracing::warn!(worker = slot.id, error, "claiming failed");
                wait = (wait * 2).min(LONGEST_WAIT);
                true
            }
        };
        drop(ready);
        tokio::select! {
            _ = phase.changed() => {}
            () = sleep(wait) => {}
            () = new_job(&mut changes), if !away => slot.stand_back().await,
        }
    }
    while let Some(ended) = attempts.join_next().await {
        log_panic(ended);
    }
    slot.tell().await;
}

/// Of attempts that have ended.
fn log_panics(attempts: &mut JoinSet<()>) {
    while let Some(ended) = attempts.try_join_next() {
        log_panic(ended);
    }
}

fn log_panic(ended: Result<(), JoinError>) {
    if let Err(error) = ended {
        tracing::error!(%error, "an attempt ended badly; its lease runs out");
    }
}

/// Until a job was queued that nobody has seen yet, or changes were missed. Whatever else makes a job ready to be
/// claimed (a retry, a lease that ran out) comes with time, and is found by the next look.
async fn new_job(changes: &mut Receiver<Change>) {
    loop {
        match changes.recv().await {
            Ok(Change { version: Some(1), .. }) | Err(RecvError::Lagged(_)) => return,
            Ok(_) => {}
            Err(RecvError::Closed) => return std::future::pending().await,
        }
    }
}

/// Tells that the workers are there: with each heartbeat where something is new, now and then where not.
async fn signs_of_life(slots: Vec<Arc<Slot>>, context: Arc<Context>) {
    let mut phase = context.phase.clone();
    let mut told: Vec<Option<At>> = vec![None; slots.len()];
    for beat in 0u32.. {
        for (slot, told) in slots.iter().zip(&mut told) {
            let at = slot.at(|_| {});
            if beat.is_multiple_of(SEEN_EVERY) || told.as_ref() != Some(&at) {
                *told = Some(slot.tell().await);
            }
        }
        tokio::select! {
            // Each worker has the last word itself.
            _ = phase.wait_for(|phase| *phase != Phase::Run) => return,
            () = sleep(context.options.heartbeat) => {}
        }
    }
}

impl Slot {
    /// Once the worker can take on more.
    async fn ready(&self) -> Ready {
        let (place, next) = (Arc::clone(&self.places), Arc::clone(&self.next));
        let (place, next) = match (place.acquire_owned().await, next.acquire_owned().await) {
            (Ok(place), Ok(next)) => (place, next),
            // Nobody closes them.
            _ => return std::future::pending().await,
        };
        self.context.health.rest().await;
        // What a GPU worker claims does not wait for threads of the CPU.
        if self.gpu.is_none() {
            self.turns.near().await;
        }
        Ready { next, _place: place }
    }

    /// Leaves what was just queued to workers that are free, for a moment.
    async fn stand_back(&self) {
        if self.gpu.is_none() {
            self.turns.free_within(STANDS_BACK).await;
        }
    }

    /// Claims what this worker may run now. A GPU worker whose GPU cannot be opened still takes one job at a time, for
    /// those asked of `gpu` must end too, and say why.
    async fn claim(&self) -> Result<(Vec<ClaimedJob>, Share), StoreError> {
        let Context { store, options, .. } = &*self.context;
        let (share, backend, limit) = match &self.gpu {
            Some(gpu) => {
                let limit = if self.opened(gpu).await { options.batch.max(1) } else { 1 };
                (Share::ByName, Backend::Gpu, limit)
            }
            None => {
                let share = share::of_cpu(&self.context).await?;
                let backend = share.backend();
                (share, backend, 1)
            }
        };
        Ok((store.claim(&self.id, backend, options.lease, limit).await?, share))
    }

    /// Makes the GPU ready.
    async fn opened(&self, gpu: &Gpu) -> bool {
        let generator = Arc::clone(&gpu.generator);
        let opened = tokio::task::spawn_blocking(move || generator.open()).await;
        let opened = opened.unwrap_or_else(|panic| Err(panic.to_string()));
        let before = self.at(|_| {}).gpu;
        let state = if opened.is_ok() { GpuState::Open } else { GpuState::Unable };
        self.at(|at| at.gpu = state);
        if before != state {
            match &opened {
                Ok(()) => tracing::info!(worker = self.id, device = gpu.generator.device(), "the GPU is ready"),
                Err(reason) => tracing::error!(worker = self.id, reason, "the GPU could not be opened"),
            }
            self.tell().await;
        }
        opened.is_ok()
    }

    async fn run(self: Arc<Self>, claimed: Vec<ClaimedJob>, share: Share, ready: Ready) {
        let Ready { next, _place } = ready;
        let cpu = Cpu { threads: &self.threads, turns: &self.turns };
        let mut ended = 0;
        if let Some(gpu) = &self.gpu {
            ended += batch::run(&self.context, gpu, &cpu, claimed, next).await;
        } else if let Some(claimed) = claimed.into_iter().next() {
            // A CPU worker claims one at a time.
            ended += u64::from(attempt::run_on_cpu(&self.context, &cpu, &share, claimed, next).await);
        }
        self.at(|at| at.done += ended);
    }

    fn at(&self, change: impl FnOnce(&mut At)) -> At {
        let mut at = self.at.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut at);
        at.clone()
    }

    /// Tells what the worker is at now.
    async fn tell(&self) -> At {
        let _word = self.word.lock().await;
        let at = self.at(|_| {});
        self.seen(at.clone()).await;
        at
    }

    /// Leaves a sign of life; not for a GPU worker without its GPU, which nobody should count on.
    async fn seen(&self, At { done, gpu }: At) {
        if self.gpu.is_some() && gpu != GpuState::Open {
            return;
        }
        let (backend, device) = match &self.gpu {
            Some(gpu) => (Backend::Gpu, gpu.generator.device()),
            None => (Backend::Cpu, generation::device(self.threads.all.current_num_threads())),
        };
        let worker = WorkerInfo {
            id: self.id.clone(),
            host: self.context.options.host.clone(),
            backend,
            device,
            jobs: Vec::new(),
            jobs_done: done,
            heartbeat_at: self.context.clock.now(),
        };
        if let Err(error) = self.context.store.worker_seen(&worker).await {
            tracing::warn!(worker = self.id, %error, "no sign of life could be left");
        }
    }
}
