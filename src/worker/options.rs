//! Settings of a pool of workers.

use crate::jobs::fault::Faults;
use crate::metrics::Metrics;
use crate::status::Status;
use std::path::PathBuf;
use std::time::Duration;

/// Settings of a pool.
#[derive(Clone, Debug)]
pub struct PoolOptions {
    /// CPU workers, each with a job at a time.
    pub workers: u32,
    /// Threads of each worker, for `cpu`; at least 1.
    pub threads: usize,
    /// Most jobs that a GPU worker runs together; at least 1.
    pub batch: u32,
    /// Why there is no GPU worker in this process, in words for the record of a job that falls back.
    pub no_gpu: Option<String>,
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
    /// State of this process: its workers report devices being opened and stuck jobs here.
    pub status: Status,
}

impl PoolOptions {
    /// The defaults of the command line, with scratch files under `scratch`.
    #[must_use]
    pub fn new(scratch: PathBuf) -> Self {
        Self {
            workers: 1,
            threads: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            batch: 16,
            no_gpu: None,
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
            status: Status::default(),
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
