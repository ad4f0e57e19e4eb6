//! Installations for operators: workers, their pauses, and the use of connections.

use super::job::JobId;
use crate::generate::Backend;
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
    /// Condition that keeps the worker from claiming jobs.
    pub condition: Option<WorkerCondition>,
}

/// Condition that keeps a live worker from claiming jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WorkerCondition {
    /// The artifact store or the scratch directory of the worker refuses files.
    Storage,
}

/// Reason why workers do not claim a queued job, other than the jobs ahead of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum QueueReason {
    /// No live worker can run the job.
    NoWorker,
    /// All live workers that can run the job are paused or drained.
    Paused,
    /// No worker that could claim the job can store its files.
    Storage,
    /// An equal model is ahead in the queue or being grown. The job will share its files.
    EqualModel,
}

impl QueueReason {
    /// The name in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NoWorker => "no-worker",
            Self::Paused => "paused",
            Self::Storage => "storage",
            Self::EqualModel => "equal-model",
        }
    }
}

/// Numbers of live workers of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkerCounts {
    /// Live workers.
    pub live: u64,
    /// Live workers that are neither paused nor drained, individually or with all workers.
    pub unpaused: u64,
    /// Unpaused workers without a [`WorkerCondition`]. They claim jobs.
    pub claiming: u64,
}

/// Numbers of live workers by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Workforce {
    /// CPU workers.
    pub cpu: WorkerCounts,
    /// GPU workers.
    pub gpu: WorkerCounts,
}

impl Workforce {
    /// Reason why no worker claims jobs that request this backend; `None` if one does.
    #[must_use]
    pub fn obstacle(&self, requested: Backend) -> Option<QueueReason> {
        let kinds: &[WorkerCounts] = match requested {
            Backend::Auto => &[self.cpu, self.gpu],
            Backend::Gpu => &[self.gpu],
            Backend::Cpu | Backend::CpuSingle => &[self.cpu],
        };
        let none = |number: fn(&WorkerCounts) -> u64| kinds.iter().all(|kind| number(kind) == 0);
        if none(|kind| kind.live) {
            Some(QueueReason::NoWorker)
        } else if none(|kind| kind.unpaused) {
            Some(QueueReason::Paused)
        } else if none(|kind| kind.claiming) {
            Some(QueueReason::Storage)
        } else {
            None
        }
    }
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
