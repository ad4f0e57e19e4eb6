//! Settings of a pool of workers.

use crate::jobs::fault::Faults;
use crate::metrics::Metrics;
use crate::status::Status;
use std::path::PathBuf;
use std::time::Duration;

/// Heartbeats without which a worker counts as gone: twice what an idle one lets pass.
pub const ALIVE_HEARTBEATS: u32 = 10;

/// Settings of a pool.
#[derive(Clone, Debug)]
pub struct PoolOptions {
    /// CPU workers, each running one job at a time.
    pub workers: u32,
    /// Threads of each worker, for `cpu`; at least 1.
    pub threads: usize,
    /// Niceness of the threads that compute, 0 to 19: those of HTTP and of the stores run first. Linux only.
    pub nice: u8,
    /// Most jobs that a GPU worker runs together; at least 1.
    pub batch: u32,
    /// Why there is no GPU worker in this process; recorded with jobs that fall back to the CPU.
    pub no_gpu: Option<String>,
    /// Time between renewals of a lease.
    pub heartbeat: Duration,
    /// Length of a lease: several heartbeats.
    pub lease: Duration,
    /// Least time between two records of a job's progress.
    pub progress: Duration,
    /// Time between looks at the queue if no change was notified.
    pub poll: Duration,
    /// Most memory that a job may use, bytes.
    pub memory_limit_bytes: Option<u64>,
    /// Time limit of an attempt's generation, without waiting for a CPU after a GPU was lost; a job that exceeds it fails
    /// (`timeout`). `None`: 10 minutes plus 20 times the seconds predicted for one core.
    pub job_timeout: Option<Duration>,
    /// Time between checkpoints; `None` takes none.
    pub checkpoint_every: Option<Duration>,
    /// Unit of all waits for storage that is unavailable: it is checked after 1, 2, 4 … 15 units, an upload is retried for 60
    /// units before its job is released, and claims rest for 1, 2, 4 … 60 units after such releases.
    pub storage_wait: Duration,
    /// Time after which a worker whose generation was told to stop, and has not, is reported as stuck.
    pub stuck_after: Duration,
    /// Directory for temporary files; may be shared by processes.
    pub scratch: PathBuf,
    /// Name of this machine.
    pub host: String,
    /// Faults to inject.
    pub faults: Faults,
    /// Where the workers count what they do.
    pub metrics: Metrics,
    /// Where the workers report what `/readyz` and `/healthz` show.
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
            storage_wait: Duration::from_secs(1),
            stuck_after: Duration::from_secs(120),
            scratch,
            host: host(),
            faults: Faults::none(),
            metrics: Metrics::default(),
            status: Status::default(),
        }
    }
}

/// Name of this machine, as far as it is known without asking the network.
fn host() -> String {
    std::fs::read_to_string("/proc/sys/kernel/hostname")
        .ok()
        .or_else(|| std::env::var("HOSTNAME").ok())
        .map(|name| name.trim().to_owned())
        .filter(|name| !name.is_empty())
        .unwrap_or_else(|| "localhost".to_owned())
}
