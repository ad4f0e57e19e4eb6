//! Settings of a pool of workers.

use crate::jobs::fault::Faults;
use crate::metrics::Metrics;
use crate::status::Status;
use std::path::PathBuf;
use std::time::Duration;

/// Age of the last heartbeat up to which a worker is live, in heartbeat intervals. An idle worker
/// reports at half this age.
pub const ALIVE_HEARTBEATS: u32 = 10;

/// Settings of a pool.
#[derive(Clone, Debug)]
pub struct PoolOptions {
    /// Number of CPU workers. Each grows one model at a time, and beside it one short model and one
    /// fit.
    pub workers: u32,
    /// Number of threads of each worker for `cpu`; at least 1.
    pub threads: usize,
    /// Niceness of the computing threads, 0 to 19, so that the threads of HTTP and the stores take
    /// precedence. Linux only.
    pub nice: u8,
    /// Maximum number of jobs in a GPU batch; at least 1.
    pub batch: u32,
    /// Reason why this process has no GPU worker; recorded with jobs that fall back to the CPU.
    pub no_gpu: Option<String>,
    /// Time between renewals of a lease.
    pub heartbeat: Duration,
    /// Duration of a lease: several heartbeats.
    pub lease: Duration,
    /// Minimum time between two records of a job's progress.
    pub progress: Duration,
    /// Time between two claims if no change is notified.
    pub poll: Duration,
    /// Maximum memory of a job, bytes.
    pub memory_limit_bytes: Option<u64>,
    /// Time limit of the generation of an attempt, without the wait for a CPU after the loss of a
    /// GPU. A job that exceeds it fails (`timeout`). `None`: 10 minutes plus 20 times the predicted
    /// time on one core.
    pub job_timeout: Option<Duration>,
    /// Time between checkpoints; `None` for no checkpoints.
    pub checkpoint_every: Option<Duration>,
    /// Time after which a fit is released if a fit of another owner waits.
    pub fit_turn: Duration,
    /// Unit of all waits for unavailable storage. Checks follow after 1, 2, 4 … 15 units; an upload
    /// is retried for 60 units before its job is released; claims pause for 1, 2, 4 … 60 units
    /// after such releases.
    pub storage_wait: Duration,
    /// Time after which a worker counts as stuck because its generation was told to stop and still
    /// runs.
    pub stuck_after: Duration,
    /// Directory for temporary files, which processes may share.
    pub scratch: PathBuf,
    /// Name of this machine.
    pub host: String,
    /// Faults to inject.
    pub faults: Faults,
    /// Metrics of the workers.
    pub metrics: Metrics,
    /// Status that `/readyz` and `/healthz` show.
    pub status: Status,
}

impl PoolOptions {
    /// The defaults of the command line, with temporary files under `scratch`.
    #[must_use]
    pub fn new(scratch: PathBuf) -> Self {
        Self {
            workers: 1,
            threads: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            nice: 10,
            batch: 16,
            no_gpu: None,
            heartbeat: Duration::from_secs(2),
            lease: Duration::from_secs(8),
            progress: Duration::from_millis(250),
            poll: Duration::from_secs(1),
            memory_limit_bytes: None,
            job_timeout: None,
            checkpoint_every: Some(Duration::from_secs(30)),
            fit_turn: Duration::from_secs(300),
            storage_wait: Duration::from_secs(1),
            stuck_after: Duration::from_secs(120),
            scratch,
            host: host(),
            faults: Faults::default(),
            metrics: Metrics::default(),
            status: Status::default(),
        }
    }
}

/// Name of this machine, found without the network.
fn host() -> String {
    std::fs::read_to_string("/proc/sys/kernel/hostname")
        .ok()
        .or_else(|| std::env::var("HOSTNAME").ok())
        .map(|name| name.trim().to_owned())
        .filter(|name| !name.is_empty())
        .unwrap_or_else(|| "localhost".to_owned())
}
