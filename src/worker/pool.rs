//! The workers of a process: claim loop, signs of life, shutdown.

use super::attempt::{self, Context, Threads};
use super::generator::Generator;
use super::keeper::Phase;
use crate::clock::Clock;
use crate::generate::Backend;
use crate::jobs::artifacts::Artifacts;
use crate::jobs::fault::Faults;
use crate::jobs::scratch::Scratch;
use crate::jobs::{Change, ClaimedJob, JobId, Store, WorkerInfo};
use crate::metrics::Metrics;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

/// Longest wait between claims while the store is away.
const LONGEST_WAIT: Duration = Duration::from_secs(10);
/// How long a shutdown waits for work that was told to stop.
const LAST_WAIT: Duration = Duration::from_secs(10);
/// Heartbeats between the signs of life of a worker of which nothing is new.
const SEEN_EVERY: u32 = 5;

/// Settings of a pool.
#[derive(Clone, Debug)]
pub struct PoolOptions {
    /// Workers, each with a job at a time.
    pub workers: u32,
    /// Threads of each worker, for `cpu`; at least 1.
    pub threads: usize,
    /// Time between renewals of a lease.
    pub heartbeat: Duration,
    /// Length of a lease: several heartbeats.
    pub lease: Duration,
    /// Least time between two records of progress of a job.
    pub progress: Duration,
    /// Time between looks at the queue where no change was told.
    pub poll: Duration,
    /// Memory that a job may use.
    pub memory_limit_bytes: Option<u64>,
    /// Time that an attempt's generation may take; a job that takes longer fails.
    pub job_timeout: Option<Duration>,
    /// Time between checkpoints; `None` takes none.
    pub checkpoint_every: Option<Duration>,
    /// Tries to store a file before the job fails.
    pub storage_tries: u32,
    /// Wait after the first try, doubled after each further one.
    pub storage_wait: Duration,
    /// Folder for files on their way; may be shared by processes.
    pub scratch: PathBuf,
    /// Name of this machine.
    pub host: String,
    /// Faults to inject.
    pub faults: Faults,
    /// Where the workers count what they do.
    pub metrics: Metrics,
}

impl PoolOptions {
    /// The defaults of the command line, with scratch files under `scratch`.
    #[must_use]
    pub fn new(scratch: PathBuf) -> Self {
        Self {
            workers: 1,
            threads: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            heartbeat: Duration::from_secs(2),
            lease: Duration::from_secs(8),
            progress: Duration::from_millis(250),
            poll: Duration::from_secs(1),
            memory_limit_bytes: None,
            job_timeout: None,
            checkpoint_every: Some(Duration::from_secs(30)),
            // Waits of 0.5, 1, 2 … 30 s: an artifact store may be away for about a minute.
            storage_tries: 8,
            storage_wait: Duration::from_millis(500),
            scratch,
            host: host(),
            faults: Faults::none(),
            metrics: Metrics::default(),
        }
    }
}

/// Name of this machine, as far as it can be known without asking the network.
fn host() -> String {
    std::fs::read_to_string("/proc/sys/kernel/hostname")
        .ok()
        .or_else(|| std::env::var("HOSTNAME").ok())
        .map(|name| name.trim().to_owned())
        .filter(|name| !name.is_empty())
        .unwrap_or_else(|| "localhost".to_owned())
}

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
    at: Mutex<At>,
}

/// What a worker is at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct At {
    job: Option<JobId>,
    done: u64,
}

impl WorkerPool {
    /// Starts the workers. Must be called within a tokio runtime.
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
        let (phase, receiver) = watch::channel(Phase::Run);
        let scratch = Scratch::open(&options.scratch)?;
        let workers = options.workers;
        let context = Arc::new(Context { store, artifacts, generator, options, clock, scratch, phase: receiver });
        let mut tasks = JoinSet::new();
        let mut slots = Vec::new();
        for ordinal in 0..workers {
            let id = format!("{}-{}-{ordinal}", context.options.host, std::process::id());
            let threads = Threads { all: threads(&id, context.options.threads)?, single: threads(&id, 1)? };
            slots.push(Arc::new(Slot { id, context: Arc::clone(&context), threads, at: Mutex::default() }));
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

/// Claims and runs jobs until the pool drains.
async fn claim_loop(slot: Arc<Slot>) {
    let context = &slot.context;
    let mut phase = context.phase.clone();
    let mut wait = context.options.poll;
    loop {
        // Listening before looking: what is queued in between is told.
        let mut changes = context.store.changes();
        if *phase.borrow_and_update() != Phase::Run {
            let at = slot.at(|_| {});
            slot.seen(at).await;
            return;
        }
        let away = match context.store.claim(&slot.id, Backend::Cpu, context.options.lease, 1).await {
            Ok(mut claimed) => {
                wait = context.options.poll;
                if let Some(claimed) = claimed.pop() {
                    slot.run(claimed).await;
                    continue;
                }
                false
            }
            Err(error) => {
                tracing::warn!(worker = slot.id, %error, "claiming failed");
                wait = (wait * 2).min(LONGEST_WAIT);
                true
            }
        };
        tokio::select! {
            _ = phase.changed() => {}
            () = sleep(wait) => {}
            () = new_job(&mut changes), if !away => {}
        }
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
            if beat.is_multiple_of(SEEN_EVERY) || *told != Some(at) {
                slot.seen(at).await;
                *told = Some(at);
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
    async fn run(&self, claimed: ClaimedJob) {
        self.at(|at| at.job = Some(claimed.job().id));
        let ended = attempt::run(&self.context, &self.threads, claimed).await;
        self.at(|at| *at = At { job: None, done: at.done + u64::from(ended) });
    }

    fn at(&self, change: impl FnOnce(&mut At)) -> At {
        let mut at = self.at.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut at);
        *at
    }

    async fn seen(&self, At { job, done }: At) {
        let worker = WorkerInfo {
            id: self.id.clone(),
            host: self.context.options.host.clone(),
            backend: Backend::Cpu,
            device: attempt::device(self.threads.all.current_num_threads()),
            job,
            jobs_done: done,
            heartbeat_at: self.context.clock.now(),
        };
        if let Err(error) = self.context.store.worker_seen(&worker).await {
            tracing::warn!(worker = self.id, %error, "no sign of life could be left");
        }
    }
}
