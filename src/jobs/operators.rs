//! What operators see of an installation and ask of it: its workers, their pauses, the use of connections.

use super::job::JobId;
use crate::generate::Backend;
use jiff::Timestamp;
use serde::Serialize;

/// A worker, as listed.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerInfo {
    /// Name, unique in the installation: host, process and ordinal.
    pub id: String,
    /// Host name.
    pub host: String,
    /// Its backend.
    pub backend: Backend,
    /// Name of the device.
    pub device: String,
    /// The jobs whose leases it holds, the oldest first. Filled in by the store; ignored by
    /// [`Store::worker_seen`](super::Store::worker_seen).
    pub jobs: Vec<JobId>,
    /// Jobs it has ended.
    pub jobs_done: u64,
    /// Last heartbeat.
    pub heartbeat_at: Timestamp,
    /// Its own pause, if it has one. Filled in by the store, like `jobs`.
    pub pause: Option<Pause>,
}

impl WorkerInfo {
    /// Whether it claims, leaving aside a pause of all workers.
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

/// Since when workers claim nothing. Jobs that run go on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pause {
    /// Whether the end of the last job is awaited, so that the worker can be removed.
    pub drain: bool,
    /// When it began.
    pub since: Timestamp,
    /// Who asked for it, if known.
    pub by: Option<String>,
}

/// What a worker does about new jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WorkerState {
    /// Claims jobs.
    Active,
    /// Claims nothing; what it runs goes on.
    Paused,
    /// Claims nothing, and ends what it runs.
    Draining,
    /// Claims nothing and runs nothing: it can be removed.
    Drained,
}

impl WorkerState {
    /// Every state.
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

/// What a worker is told to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instruction {
    /// Claim again.
    Resume,
    /// Claim nothing.
    Pause,
    /// Claim nothing, and be drained once nothing runs.
    Drain,
}

/// The use of a pool of connections to the database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolUse {
    /// Which pool: `readers` and `writer` of SQLite, `postgres`.
    pub name: &'static str,
    /// Connections that are open.
    pub open: u32,
    /// Those of them that nobody uses.
    pub idle: u32,
    /// Most that may be open.
    pub most: u32,
}
