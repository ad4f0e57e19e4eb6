//! Batches: jobs that are submitted, listed and deleted together.

use super::job::{BatchId, JobId, NewJob, Priority, Quota};
use super::list::Counts;
use jiff::Timestamp;

/// Jobs to be queued together, all or none.
#[derive(Clone, Debug)]
pub struct NewBatch {
    /// The jobs, in order. The store ignores their own `idempotency`, `priority`, `owner` and
    /// `quota`.
    pub jobs: Vec<NewJob>,
    /// Submitter and owner of all jobs.
    pub owner: Option<String>,
    /// Quota of the owner, these jobs included.
    pub quota: Quota,
    /// Priority of all jobs.
    pub priority: Priority,
    /// Parameter study whose points the jobs are, as JSON. The store does not interpret it.
    pub study: Option<serde_json::Value>,
    /// Idempotency key and a hash of the canonical request body. Keys of batches and of jobs are
    /// separate.
    pub idempotency: Option<(String, String)>,
}

/// A batch without the jobs that were deleted one by one. Deleting the last job deletes the batch
/// and its idempotency key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// Identity.
    pub id: BatchId,
    /// Submitter.
    pub owner: Option<String>,
    /// Time of the submission.
    pub created_at: Timestamp,
    /// Priority of its jobs.
    pub priority: Priority,
    /// Number of its jobs by status.
    pub counts: Counts,
    /// Ids of its jobs, in the order of the request.
    pub jobs: Vec<JobId>,
    /// Index of each job in the request, from 0; deleted jobs leave gaps.
    pub places: Vec<u32>,
    /// Parameter study, as submitted. `None` also if only a later version can read it.
    pub study: Option<serde_json::Value>,
}

/// Result of [`Store::submit_batch`](super::Store::submit_batch).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SubmittedBatch {
    /// The batch was created. Some of its jobs may have succeeded already, as reused models.
    Accepted(Batch),
    /// An earlier request with the same idempotency key and body created this batch.
    Replayed(Batch),
}

impl SubmittedBatch {
    /// The batch, new or not.
    #[must_use]
    pub fn batch(&self) -> &Batch {
        match self {
            Self::Accepted(batch) | Self::Replayed(batch) => batch,
        }
    }
}

/// Conditions of a list of batches, newest first.
#[derive(Clone, Debug, Default)]
pub struct BatchFilter {
    /// Only batches of this owner.
    pub owner: Option<String>,
    /// Only batches accepted at this time or later.
    pub created_after: Option<Timestamp>,
    /// Only batches accepted before this time.
    pub created_before: Option<Timestamp>,
    /// Only batches older than this one (the cursor).
    pub before: Option<BatchId>,
    /// Maximum number of batches; the store returns at most 100.
    pub limit: u32,
}

/// A page of batches.
#[derive(Clone, Debug)]
pub struct BatchPage {
    /// The batches; [`Batch::jobs`] and [`Batch::places`] are empty.
    pub batches: Vec<Batch>,
    /// Cursor of the next page.
    pub next: Option<BatchId>,
}
