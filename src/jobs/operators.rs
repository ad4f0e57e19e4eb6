//! Installations for operators: workers, their pauses, and the use of connections.

use super::job::JobId;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// Kind of a worker, by what it grows models on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WorkerKind {
    /// A GPU.
    Gpu,
    /// CPU threads.
    Cpu,
}

impl WorkerKind {
    /// The name in JSON and metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Gpu => "gpu",
            Self::Cpu => "cpu",
        }
    }
}

/// A worker in the list of workers.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerInfo {
    /// Name, unique in the installation: host, process and ordinal.
    pub id: String,
    /// Host name.
    pub host: String,
    /// Kind.
    pub kind: WorkerKind,
    /// Name of the device.
    pub device: String,
    /// Jobs whose leases it holds, the oldest first. The store fills them in, and ignores them in
    /// [`Store::worker_seen`](super::Store::worker_seen).
    pub jobs: Vec<JobId>,
    /// Number of jobs that it has ended.
    pub jobs_done: u64,
    /// Time of the last heartbeat.
    pub heartbeat_at: Timestamp,
    /// Pause of this worker alone. The store fills it in, like `jobs`.
    pub pause: Option<Pause>,
}

impl WorkerInfo {
    /// State of the worker, without a pause of all workers.
    #[must_use]
    pub fn state(&self) -> WorkerState {
        match &self.pause {
            None => WorkerState::Active,
            Some(Pause { drain: false, .. }) => WorkerState::Paused,
            Some(_) if self.jobs.is_empty() => WorkerState::Drained,
            Some(_) => WorkerState::Draining,
        }
    }
}

/// A pause of one or all workers: they claim no jobs, and running jobs continue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pause {
    /// True if the operator waits for the last job to end, to remove the worker.
    pub drain: bool,
    /// Start of the pause.
    pub since: Timestamp,
    /// Person who requested the pause, if known.
    pub by: Option<String>,
}

/// State of a worker with regard to new jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WorkerState {
    /// Claims jobs.
    Active,
    /// Claims no jobs; running jobs continue.
    Paused,
    /// Claims no jobs, and completes running jobs.
    Draining,
    /// Claims no jobs and runs none, so the worker can be removed.
    Drained,
}

impl WorkerState {
    /// All states.
    pub const ALL: [Self; 4] = [Self::Active, Self::Paused, Self::Draining, Self::Drained];

    /// The name in JSON and metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Active => "active",
            Self::Paused => "paused",
            Self::Draining => "draining",
            Self::Drained => "drained",
        }
    }
}

/// Instruction of an operator to workers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instruction {
    /// Claim jobs again.
    Resume,
    /// Claim no jobs.
    Pause,
    /// Claim no jobs; the worker counts as drained once it runs none.
    Drain,
}

/// Use of a pool of connections to the database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolUse {
    /// Name of the pool: `readers` and `writer` for SQLite, `postgres`.
    pub name: &'static str,
    /// Number of open connections.
    pub open: u32,
    /// Number of open connections that are not in use.
    pub idle: u32,
    /// Maximum number of open connections.
    pub most: u32,
}
