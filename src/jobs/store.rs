//! The contract of a job store. One test suite runs over every implementation.

use super::job::{BackendReport, BatchId, File, Job, JobId, LiveSection, NewJob, Priority, Problem, Status};
use super::state::{AttemptEnd, Fence};
use crate::clock::Clock;
use crate::generate::{Backend, Progress};
use async_trait::async_trait;
use jiff::Timestamp;
use std::time::Duration;
use tokio::sync::broadcast;

/// Settings that every store has.
#[derive(Clone, Debug)]
pub struct StoreOptions {
    /// Time of leases and records.
    pub clock: Clock,
    /// Attempts that may be lost to vanished workers and passing faults before a job fails; at least 1.
    pub max_attempts: u32,
    /// Most jobs queued at a time.
    pub queue_limit: u64,
    /// Maximum number of connections to PostgreSQL, not counting the one that receives notifications; at least 2.
    pub connections: u32,
}

impl Default for StoreOptions {
    fn default() -> Self {
        Self { clock: Clock::System, max_attempts: 5, queue_limit: 10_000, connections: 12 }
    }
}

/// What became of a submission.
#[derive(Clone, Debug, PartialEq)]
pub enum Submitted {
    /// Queued.
    Queued(Job),
    /// Already succeeded, with the files of a finished model of the same digest.
    Reused(Job),
    /// The same idempotency key and body were seen before: the job made then.
    Replayed(Job),
}

impl Submitted {
    /// The job.
    #[must_use]
    pub fn job(&self) -> &Job {
        match self {
            Self::Queued(job) | Self::Reused(job) | Self::Replayed(job) => job,
        }
    }
}

/// Jobs to be queued together: all or none.
#[derive(Clone, Debug)]
pub struct NewBatch {
    /// The jobs, in order; their own `idempotency` and `priority` are not looked at.
    pub jobs: Vec<NewJob>,
    /// How urgent all of them are.
    pub priority: Priority,
    /// Idempotency key, with a hash of the canonical request body. Keys of batches and of jobs are apart.
    pub idempotency: Option<(String, String)>,
}

/// How many jobs stand where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Waiting.
    pub queued: u64,
    /// Held by workers.
    pub running: u64,
    /// Ended with a model.
    pub succeeded: u64,
    /// Ended with a problem.
    pub failed: u64,
    /// Ended by request.
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

    /// All of them.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.queued + self.running + self.succeeded + self.failed + self.cancelled
    }
}

/// A batch as it stands. Jobs deleted one by one are missing from it; it goes with the last of them, and its key too.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// Identity.
    pub id: BatchId,
    /// When it was accepted.
    pub created_at: Timestamp,
    /// How urgent its jobs are.
    pub priority: Priority,
    /// Its jobs by status.
    pub counts: Counts,
    /// Its jobs, in the order in which they were asked for.
    pub jobs: Vec<JobId>,
}

/// What became of a batch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SubmittedBatch {
    /// Taken; some jobs may be reused models and have ended already.
    Accepted(Batch),
    /// The same idempotency key and body were seen before: the batch made then.
    Replayed(Batch),
}

impl SubmittedBatch {
    /// The batch.
    #[must_use]
    pub fn batch(&self) -> &Batch {
        match self {
            Self::Accepted(batch) | Self::Replayed(batch) => batch,
        }
    }
}

/// Which jobs to list; newest first.
#[derive(Clone, Debug, Default)]
pub struct ListFilter {
    /// Only of this status.
    pub status: Option<Status>,
    /// Only of this preset.
    pub preset: Option<String>,
    /// Only with all of these labels.
    pub labels: Vec<(String, String)>,
    /// Only those older than this one (the cursor).
    pub before: Option<JobId>,
    /// At most so many.
    pub limit: u32,
}

/// A page of jobs.
#[derive(Clone, Debug)]
pub struct Page {
    /// The jobs.
    pub jobs: Vec<Job>,
    /// Where the next page begins.
    pub next: Option<JobId>,
}

/// A job that a worker holds the lease of. Only [`Store::claim`] makes one; [`Store::finish`],
/// [`Store::fail`], [`Store::cancelled`], [`Store::release`] and [`Store::retry`] consume it.
#[derive(Debug)]
pub struct ClaimedJob {
    pub(super) job: Job,
    pub(super) worker: String,
    pub(super) attempt: u32,
}

impl ClaimedJob {
    /// The record as it was when claimed.
    #[must_use]
    pub fn job(&self) -> &Job {
        &self.job
    }

    /// Number of this attempt, from 1.
    #[must_use]
    pub fn attempt(&self) -> u32 {
        self.attempt
    }

    /// What its writes are fenced with.
    pub(super) fn fence(&self) -> Fence {
        Fence { attempt: self.attempt, worker: self.worker.clone() }
    }
}

/// One attempt at a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attempt {
    /// Number, from 1.
    pub attempt: u32,
    /// Worker that claimed it.
    pub worker: String,
    /// When it began.
    pub started_at: Timestamp,
    /// When it ended; `None` while it runs.
    pub ended_at: Option<Timestamp>,
    /// How it ended.
    pub outcome: Option<AttemptEnd>,
    /// The fault in one line, where there was one.
    pub detail: Option<String>,
}

impl Attempt {
    /// The problem of a job that failed because its attempts are used up, with their history.
    #[must_use]
    pub fn exhausted(history: &[Self]) -> Problem {
        use std::fmt::Write as _;
        let mut detail = String::new();
        for attempt in history {
            let how = match attempt.outcome {
                Some(AttemptEnd::Vanished) => "the worker vanished",
                Some(AttemptEnd::Retried) => "failed",
                Some(AttemptEnd::Released) => "given back",
                Some(AttemptEnd::Succeeded | AttemptEnd::Failed | AttemptEnd::Cancelled) | None => "ended",
            };
            let gap = if detail.is_empty() { "" } else { "; " };
            // Writing to a String cannot fail.
            let _ = write!(detail, "{gap}attempt {} by {}: {how}", attempt.attempt, attempt.worker);
            if let Some(at) = attempt.ended_at {
                let _ = write!(detail, " at {at}");
            }
            if let Some(fault) = &attempt.detail {
                let _ = write!(detail, " ({fault})");
            }
        }
        Problem { kind: "attempts-exhausted".into(), title: "No attempt came to an end".into(), detail }
    }
}

/// What a heartbeat tells the worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Directive {
    /// Go on; the lease was renewed.
    Continue,
    /// The job was asked to stop.
    Cancel,
    /// The lease is another's, or the job has ended or gone: stop, write nothing.
    Lost,
}

/// A success to be recorded.
#[derive(Clone, Debug)]
pub struct Finished {
    /// What computed it.
    pub backend: BackendReport,
    /// Files, already in the artifact store.
    pub files: Vec<File>,
    /// Counts and measures in short.
    pub summary: serde_json::Value,
    /// The engine version that made them. Where it is not that of the job's digest, the model is never reused.
    pub engine: String,
}

/// A worker as others see it.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkerInfo {
    /// Name, unique in the installation: host, process and ordinal.
    pub id: String,
    /// Host name.
    pub host: String,
    /// What it computes with.
    pub backend: Backend,
    /// Device in words.
    pub device: String,
    /// The jobs whose leases it holds, the oldest first. The store knows; what [`Store::worker_seen`] says is not asked.
    pub jobs: Vec<JobId>,
    /// Jobs it has ended.
    pub jobs_done: u64,
    /// Last sign of life.
    pub heartbeat_at: Timestamp,
}

/// Something about a job changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// Which job.
    pub id: JobId,
    /// Its version now; `None` where it was deleted.
    pub version: Option<u64>,
}

/// Why the store refused or failed.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The idempotency key was used with another body.
    #[error("the idempotency key was used before with another request body")]
    IdempotencyConflict,
    /// No more jobs are taken until the queue is shorter.
    #[error("the queue is full ({limit} jobs)")]
    QueueFull {
        /// The limit.
        limit: u64,
    },
    /// The worker's lease was lost; nothing was written.
    #[error("the lease was lost to another attempt")]
    Fenced,
    /// The database is away or failed.
    #[error("the job store failed: {0}")]
    Database(String),
}

/// Where jobs are kept. All calls are atomic and durable when they return.
#[async_trait]
pub trait Store: Send + Sync + 'static {
    /// Queues a job, or answers with an earlier one.
    async fn submit(&self, new: NewJob) -> Result<Submitted, StoreError>;
    /// The job that this idempotency key made with this body, where there is one; see [`NewJob::idempotency`].
    async fn replayed(&self, key: &str, body: &str) -> Result<Option<Job>, StoreError>;
    /// A job by id.
    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError>;
    /// A page of jobs, newest first.
    async fn list(&self, filter: &ListFilter) -> Result<Page, StoreError>;
    /// Cancels: a queued job ends at once, a running one is asked to stop; an ended one stays as it is. One that ends by it
    /// is given with the key of its checkpoint, which the record names no more, for removal from the artifact store.
    async fn cancel(&self, id: JobId) -> Result<Option<Job>, StoreError>;
    /// Removes the record (a running attempt is thereby fenced out). Returns the keys of files that no
    /// other job names any more, and that of its checkpoint, for removal from the artifact store; `None` where there
    /// is no such job.
    async fn delete(&self, id: JobId) -> Result<Option<Vec<String>>, StoreError>;

    /// Queues all jobs of a batch in one transaction, or none ([`StoreError::QueueFull`] where not all find room).
    /// Each is a job like any other; finished models are reused as [`Store::submit`] does. Ids ascend in the order
    /// of the jobs.
    async fn submit_batch(&self, new: NewBatch) -> Result<SubmittedBatch, StoreError>;
    /// The batch that this idempotency key made with this body, where there is one.
    async fn replayed_batch(&self, key: &str, body: &str) -> Result<Option<Batch>, StoreError>;
    /// A batch by id.
    async fn batch(&self, id: BatchId) -> Result<Option<Batch>, StoreError>;
    /// Removes a batch with all its jobs, in one transaction; returns as [`Store::delete`] does.
    async fn delete_batch(&self, id: BatchId) -> Result<Option<Vec<String>>, StoreError>;

    /// Claims up to `limit` jobs that `backend` may run, in the order in which they are due: the higher
    /// priority first; within one, submitters take turns, and the jobs of each go oldest first. Jobs whose lease has expired go back to
    /// their place in the queue before, so that a long queue cannot hold them up; those whose attempts are used
    /// up fail instead (`attempts-exhausted`, with the history), those asked to stop end as cancelled. A job that this
    /// version cannot read fails (`spec`), and holds up no other.
    async fn claim(
        &self,
        worker: &str,
        backend: Backend,
        lease: Duration,
        limit: u32,
    ) -> Result<Vec<ClaimedJob>, StoreError>;
    /// How many jobs wait that `backend` may run, counted up to 1000 for each backend asked for.
    async fn waiting(&self, backend: Backend) -> Result<u64, StoreError>;
    /// Renews the lease and records progress. The version grows, and others are told, only where something is new.
    async fn heartbeat(
        &self,
        claimed: &ClaimedJob,
        lease: Duration,
        backend: &BackendReport,
        progress: Option<&Progress>,
        section: Option<&LiveSection>,
    ) -> Result<Directive, StoreError>;
    /// Names `key` as the newest checkpoint of the job: the next attempt begins there. Returns the key that it
    /// replaces, for removal from the artifact store. Fails as [`StoreError::Fenced`] where the lease was lost. The
    /// version does not grow. The name outlives the attempt; it goes when the job ends, and with it the right of the
    /// file to be kept.
    async fn set_checkpoint(&self, claimed: &ClaimedJob, key: &str) -> Result<Option<String>, StoreError>;
    /// Ends the job as succeeded. Files and state become visible together.
    async fn finish(&self, claimed: ClaimedJob, finished: Finished) -> Result<Job, StoreError>;
    /// Ends the job as failed.
    async fn fail(&self, claimed: ClaimedJob, backend: BackendReport, problem: Problem) -> Result<Job, StoreError>;
    /// Ends the job as cancelled.
    async fn cancelled(&self, claimed: ClaimedJob) -> Result<Job, StoreError>;
    /// Gives the job back to the queue, at the same place; the attempt does not count. A job that was asked to
    /// stop ends as cancelled instead.
    async fn release(&self, claimed: ClaimedJob) -> Result<(), StoreError>;
    /// As [`Store::release`]; the attempt's row records why, as `kind: detail`.
    async fn release_because(&self, claimed: ClaimedJob, problem: Problem) -> Result<(), StoreError>;
    /// Gives the job back after a fault that may pass; the attempt counts. It waits a little before it can be
    /// claimed again (1 s, doubled for each attempt that counted); the last attempt ends it as failed
    /// (`attempts-exhausted`, with the history).
    async fn retry(&self, claimed: ClaimedJob, problem: Problem) -> Result<Job, StoreError>;
    /// The history of a job's attempts, oldest first; empty where there is no such job.
    async fn attempts(&self, id: JobId) -> Result<Vec<Attempt>, StoreError>;

    /// Records a worker's sign of life.
    async fn worker_seen(&self, worker: &WorkerInfo) -> Result<(), StoreError>;
    /// Workers seen in the last minutes.
    async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError>;
    /// How many workers that compute with `backend` were seen within this time, by the store's clock.
    async fn alive(&self, backend: Backend, within: Duration) -> Result<u64, StoreError>;
    /// Whether an artifact key is named by any job, as a file or as a checkpoint (for the sweep of orphans).
    async fn names_key(&self, key: &str) -> Result<bool, StoreError>;

    /// Jobs that ended longer than `age` ago by the store's clock (all that have ended, for [`Duration::ZERO`]), the first to
    /// end first, at most `limit`.
    async fn ended_before(&self, age: Duration, limit: u32) -> Result<Vec<JobId>, StoreError>;
    /// Bytes of all files that jobs name, each key counted once.
    async fn stored_bytes(&self) -> Result<u64, StoreError>;
    /// All jobs by status, of one moment. Costs the same however many there are.
    async fn counts(&self) -> Result<Counts, StoreError>;

    /// Changes as they happen; a receiver that lags is told so and reads the records again.
    fn changes(&self) -> broadcast::Receiver<Change>;
    /// Fails where the store is away.
    async fn ready(&self) -> Result<(), StoreError>;
    /// Closes it in good order; it cannot be used afterwards.
    async fn close(&self) {}
}
