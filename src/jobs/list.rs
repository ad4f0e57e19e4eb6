//! Lists and counts of jobs, and changes of them.

use super::job::{BatchId, Job, JobId, JobKind, Status};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// Conditions of a list of jobs, newest first.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ListFilter {
    /// Only jobs of this kind.
    pub kind: JobKind,
    /// Only jobs of this owner.
    pub owner: Option<String>,
    /// Only jobs in this status.
    pub status: Option<Status>,
    /// Only jobs of this preset.
    pub preset: Option<String>,
    /// Only jobs that have all of these labels.
    pub labels: Vec<(String, String)>,
    /// Only these jobs; empty for any.
    pub ids: Vec<JobId>,
    /// Only jobs of this batch.
    pub batch: Option<BatchId>,
    /// Only jobs accepted at this time or later.
    pub created_after: Option<Timestamp>,
    /// Only jobs accepted before this time.
    pub created_before: Option<Timestamp>,
    /// Only jobs older than this one (the cursor).
    pub before: Option<JobId>,
    /// Maximum number of jobs.
    pub limit: u32,
}

/// A page of jobs.
#[derive(Clone, Debug)]
pub struct Page {
    /// The jobs.
    pub jobs: Vec<Job>,
    /// Cursor of the next page.
    pub next: Option<JobId>,
}

/// Numbers of jobs by status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Queued and waiting jobs.
    pub queued: u64,
    /// Jobs whose lease a worker holds.
    pub running: u64,
    /// Jobs that ended with a result.
    pub succeeded: u64,
    /// Jobs that ended with a problem.
    pub failed: u64,
    /// Cancelled jobs.
    pub cancelled: u64,
}

impl Counts {
    /// The count of one status.
    pub fn of_mut(&mut self, status: Status) -> &mut u64 {
        match status {
            Status::Queued => &mut self.queued,
            Status::Running => &mut self.running,
            Status::Succeeded => &mut self.succeeded,
            Status::Failed => &mut self.failed,
            Status::Cancelled => &mut self.cancelled,
        }
    }

    /// Number of all jobs.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.queued + self.running + self.succeeded + self.failed + self.cancelled
    }
}

/// A change of a job, as subscribers of [`Store::changes`](super::Store::changes) receive it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// The job.
    pub id: JobId,
    /// Its version after the change; `None` if it was deleted.
    pub version: Option<u64>,
}

impl Change {
    /// The latest change of `job`.
    pub(super) fn of(job: &Job) -> Self {
        Self { id: job.id, version: Some(job.version) }
    }
}
