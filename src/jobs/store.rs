//! The contract of a job store. One test suite runs over every implementation.

pub use super::error::{Quantity, StoreError};

use super::job::{
    BackendReport, BatchId, File, Job, JobId, JobKind, JobProgress, LiveSection, NewJob, Priority, Problem, Quota,
    Status,
};
use super::keys::KeyStore;
use super::operators::{Instruction, Pause, PoolUse, WorkerInfo};
use super::state::{AttemptEnd, Fence};
use crate::clock::Clock;
use crate::generate::Backend;
use async_trait::async_trait;
use jiff::Timestamp;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::sync::broadcast;

/// The backends that a request may ask for; each has a lane of the queue.
pub(super) const LANES: [Backend; 4] = [Backend::Auto, Backend::Gpu, Backend::Cpu, Backend::CpuSingle];

/// Settings of every store.
#[derive(Clone, Debug)]
pub struct StoreOptions {
    /// Time of leases and records.
    pub clock: Clock,
    /// Counted attempts (vanished workers, faults that may pass) after which a job fails; at least 1.
    pub max_attempts: u32,
    /// Most jobs queued at a time.
    pub queue_limit: u64,
    /// Maximum number of connections to PostgreSQL, not counting the one that receives notifications; at least 2.
    pub connections: u32,
    /// Maximum number of connections that read a SQLite file; at least 1.
    pub readers: u32,
}

impl Default for StoreOptions {
    fn default() -> Self {
        Self { clock: Clock::System, max_attempts: 5, queue_limit: 10_000, connections: 12, readers: 4 }
    }
}

/// The result of a submission.
#[derive(Clone, Debug, PartialEq)]
pub enum Submitted {
    /// Queued.
    Queued(Job),
    /// Succeeded at once, with the files of a finished model of the same digest.
    Reused(Job),
    /// The job that was made before with the same idempotency key and body.
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

/// Jobs to be queued together, all or none.
#[derive(Clone, Debug)]
pub struct NewBatch {
    /// The jobs, in order; their own `idempotency`, `priority`, `owner` and `quota` are ignored.
    pub jobs: Vec<NewJob>,
    /// Who submits it, and so owns all of them.
    pub owner: Option<String>,
    /// What its owner may have, these jobs included.
    pub quota: Quota,
    /// How urgent all of them are.
    pub priority: Priority,
    /// The parameter study that they are the points of, as JSON; the store does not look into it.
    pub study: Option<serde_json::Value>,
    /// Idempotency key, with a hash of the canonical request body. Keys of batches and of jobs are separate.
    pub idempotency: Option<(String, String)>,
}

/// Numbers of jobs by status.
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
    /// Cancelled.
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

    /// All jobs.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.queued + self.running + self.succeeded + self.failed + self.cancelled
    }
}

/// A batch. Jobs that were deleted one by one are missing; the batch and its idempotency key are deleted with the last job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// Identity.
    pub id: BatchId,
    /// Who submitted it.
    pub owner: Option<String>,
    /// When it was accepted.
    pub created_at: Timestamp,
    /// How urgent its jobs are.
    pub priority: Priority,
    /// Its jobs by status.
    pub counts: Counts,
    /// Its jobs, in the order of the request.
    pub jobs: Vec<JobId>,
    /// The place of each of its jobs among those that were submitted, from 0: their order, with gaps where jobs were deleted.
    pub places: Vec<u32>,
    /// The parameter study, as it was submitted; `None` also if only a later version can read it.
    pub study: Option<serde_json::Value>,
}

/// The result of a batch submission.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SubmittedBatch {
    /// Queued; some jobs may have succeeded at once as reused models.
    Accepted(Batch),
    /// The batch that was made before with the same idempotency key and body.
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
    /// Only jobs that make this.
    pub kind: JobKind,
    /// Only of this owner.
    pub owner: Option<String>,
    /// Only of this status.
    pub status: Option<Status>,
    /// Only of this preset.
    pub preset: Option<String>,
    /// Only with all of these labels.
    pub labels: Vec<(String, String)>,
    /// Only these; empty for any.
    pub ids: Vec<JobId>,
    /// Only of this batch.
    pub batch: Option<BatchId>,
    /// Only those accepted then or later.
    pub created_after: Option<Timestamp>,
    /// Only those accepted before.
    pub created_before: Option<Timestamp>,
    /// Only those older than this one (the cursor).
    pub before: Option<JobId>,
    /// At most this many.
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

/// Which batches to list; newest first.
#[derive(Clone, Debug, Default)]
pub struct BatchFilter {
    /// Only of this owner.
    pub owner: Option<String>,
    /// Only those accepted then or later.
    pub created_after: Option<Timestamp>,
    /// Only those accepted before.
    pub created_before: Option<Timestamp>,
    /// Only those older than this one (the cursor).
    pub before: Option<BatchId>,
    /// At most this many, and at most 100.
    pub limit: u32,
}

/// A page of batches, without the ids of their jobs.
#[derive(Clone, Debug)]
pub struct BatchPage {
    /// The batches; their `jobs` are left empty.
    pub batches: Vec<Batch>,
    /// Where the next page begins.
    pub next: Option<BatchId>,
}

/// What was done to many jobs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Applied {
    /// Number of jobs that it changed.
    pub jobs: u64,
    /// Keys for removal from the artifact store.
    pub keys: Vec<String>,
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

    /// The fence of its writes.
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
    /// The fault in one line, if there was one.
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
                Some(AttemptEnd::Released) => "released",
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

/// The answer to a heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Directive {
    /// Continue; the lease was renewed.
    Continue,
    /// A client has cancelled the job: stop.
    Cancel,
    /// The lease is held by another worker, or the job has ended or was deleted: stop, write nothing.
    Lost,
}

/// The result of a job that succeeded.
#[derive(Clone, Debug)]
pub struct Finished {
    /// What computed it.
    pub backend: BackendReport,
    /// Its files, already in the artifact store.
    pub files: Vec<File>,
    /// Counts and measures in short.
    pub summary: serde_json::Value,
    /// The engine version that made them. If it is not that of the job's digest, the model is never reused.
    pub engine: String,
}

/// A change of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// Which job.
    pub id: JobId,
    /// Its version now; `None` if it was deleted.
    pub version: Option<u64>,
}

/// A periodic task that one process at a time does for all that share the stores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpkeepTask {
    /// Removing models by age and size.
    Retention,
    /// Removing files that no record names.
    Orphans,
}

impl UpkeepTask {
    /// The name of its lock.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Retention => "retention",
            Self::Orphans => "orphans",
        }
    }
}

/// A job store. Every call is atomic, and durable when it returns.
#[async_trait]
pub trait Store: KeyStore {
    /// Queues a job, or answers with an earlier one.
    async fn submit(&self, new: NewJob) -> Result<Submitted, StoreError>;
    /// The job that its owner made with this idempotency key and body, if any; see [`NewJob::idempotency`].
    async fn replayed(&self, owner: Option<&str>, key: &str, body: &str) -> Result<Option<Job>, StoreError>;
    /// The finished model of the same owner that [`Store::submit`] would reuse for `new`, if any.
    async fn reusable(&self, new: &NewJob) -> Result<Option<Job>, StoreError>;
    /// A job by id.
    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError>;
    /// A page of jobs, newest first.
    async fn list(&self, filter: &ListFilter) -> Result<Page, StoreError>;
    /// Cancels: a queued job ends at once; a running one is asked to stop; an ended one stays unchanged. If the job ends by
    /// this call, [`Job::checkpoint`] is the key that its record named until now, for removal from the artifact store.
    async fn cancel(&self, id: JobId) -> Result<Option<Job>, StoreError>;
    /// Removes the record, which fences out a running attempt. Returns the keys for removal from the artifact store: that of
    /// its checkpoint, and those of files that no other job names. `None` if there is no such job.
    async fn delete(&self, id: JobId) -> Result<Option<Vec<String>>, StoreError>;

    /// The ids of the jobs of a page, newest first.
    async fn ids(&self, filter: &ListFilter) -> Result<Vec<JobId>, StoreError>;
    /// Cancels these jobs as [`Store::cancel`] does, in one transaction. Jobs that have ended, do not exist or are not in
    /// `status` (any more) are passed over.
    async fn cancel_many(&self, ids: Vec<JobId>, status: Option<Status>) -> Result<Applied, StoreError>;
    /// Removes these jobs as [`Store::delete`] does, in one transaction; only those in `status`.
    async fn delete_many(&self, ids: Vec<JobId>, status: Option<Status>) -> Result<Applied, StoreError>;
    /// Queues jobs that wait for the growth of an equal job that has ended: a process of a version before shared growth ended
    /// it. Gives those that were queued.
    async fn queue_stranded(&self) -> Result<Vec<JobId>, StoreError>;

    /// Queues all jobs of a batch in one transaction, or none ([`StoreError::QueueFull`] if there is no room for all).
    /// Each is an ordinary job; finished models are reused as by [`Store::submit`]. Ids ascend in the order of the jobs.
    async fn submit_batch(&self, new: NewBatch) -> Result<SubmittedBatch, StoreError>;
    /// The batch that its owner made with this idempotency key and body, if any.
    async fn replayed_batch(&self, owner: Option<&str>, key: &str, body: &str) -> Result<Option<Batch>, StoreError>;
    /// The jobs of a batch after `after`, in the order of the request, without their positions in the queue; at most `limit`.
    async fn batch_jobs(&self, id: BatchId, after: Option<JobId>, limit: u32) -> Result<Vec<Job>, StoreError>;
    /// A batch by id.
    async fn batch(&self, id: BatchId) -> Result<Option<Batch>, StoreError>;
    /// A page of batches, newest first.
    async fn batches(&self, filter: &BatchFilter) -> Result<BatchPage, StoreError>;
    /// Removes a batch with all its jobs, in one transaction; returns as [`Store::delete`] does.
    async fn delete_batch(&self, id: BatchId) -> Result<Option<Vec<String>>, StoreError>;

    /// Claims up to `limit` jobs that `backend` may run, none while the worker or all workers are paused, in the order in which they are due: the higher priority first;
    /// within a priority, submitters take turns, and the jobs of each go oldest first. For [`Backend::Gpu`], the jobs after
    /// the first are due jobs with the first one's [`NewJob::batch_key`], by priority, turn and age; without a key, there are
    /// none.
    ///
    /// Jobs whose lease has expired are put back to their place in the queue before, unless the database has been available
    /// to this process for less than `lease`: then their holders may not have been able to renew. Jobs without attempts left
    /// fail instead (`attempts-exhausted`, with the history), cancelled ones end as cancelled. A job that this version cannot
    /// read fails (`spec`).
    async fn claim(
        &self,
        worker: &str,
        backend: Backend,
        lease: Duration,
        limit: u32,
    ) -> Result<Vec<ClaimedJob>, StoreError>;
    /// How many jobs are queued that `backend` may run, counted up to 1000 for each backend asked for.
    async fn waiting(&self, backend: Backend) -> Result<u64, StoreError>;
    /// Renews the lease and records progress. Only if something is new does the version grow, and are others notified.
    async fn heartbeat(
        &self,
        claimed: &ClaimedJob,
        lease: Duration,
        backend: &BackendReport,
        progress: Option<&JobProgress>,
        section: Option<&LiveSection>,
    ) -> Result<Directive, StoreError>;
    /// Records `key` as the newest checkpoint of the job, from which the next attempt continues. Returns the key that it
    /// replaces, for removal from the artifact store. Fails with [`StoreError::Fenced`] if the lease was lost. The version
    /// does not grow. The key outlives the attempt; it is removed from the record when the job ends.
    async fn set_checkpoint(&self, claimed: &ClaimedJob, key: &str) -> Result<Option<String>, StoreError>;
    /// Ends the job as succeeded. Files and state become visible together.
    async fn finish(&self, claimed: ClaimedJob, finished: Finished) -> Result<Job, StoreError>;
    /// Ends the job as failed.
    async fn fail(&self, claimed: ClaimedJob, backend: BackendReport, problem: Problem) -> Result<Job, StoreError>;
    /// Ends the job as cancelled.
    async fn cancelled(&self, claimed: ClaimedJob) -> Result<Job, StoreError>;
    /// Returns the job to its place in the queue; the attempt does not count. If there is a problem, the attempt's row
    /// records it as `kind: detail`. A job that was cancelled meanwhile ends as cancelled.
    async fn release(&self, claimed: ClaimedJob, problem: Option<Problem>) -> Result<(), StoreError>;
    /// Queues the job again after a fault that may pass; the attempt counts. The job is due again after a delay (1 s, doubled
    /// for each counted attempt); after the last attempt it fails (`attempts-exhausted`, with the history).
    async fn retry(&self, claimed: ClaimedJob, problem: Problem) -> Result<Job, StoreError>;
    /// The attempts of a job, oldest first; empty if there is no such job.
    async fn attempts(&self, id: JobId) -> Result<Vec<Attempt>, StoreError>;

    /// Records a worker's heartbeat.
    async fn worker_seen(&self, worker: &WorkerInfo) -> Result<(), StoreError>;
    /// Workers seen in the last five minutes.
    async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError>;
    /// Workers seen within this time, by the store's clock.
    async fn workers_within(&self, within: Duration) -> Result<Vec<WorkerInfo>, StoreError>;
    /// How many workers of `backend` were seen within this time, by the store's clock.
    async fn alive(&self, backend: Backend, within: Duration) -> Result<u64, StoreError>;
    /// How many of those have no pause of their own.
    async fn claimers(&self, backend: Backend, within: Duration) -> Result<u64, StoreError>;
    /// Pauses all workers, also those that start later, or ends that pause; the pauses of single workers stay. A pause
    /// holds for every claim that begins after this returns. `by` is who asked for it. No effect if it is so already.
    async fn set_paused(&self, paused: bool, by: Option<&str>) -> Result<(), StoreError>;
    /// The pause of all workers, if there is one.
    async fn paused(&self) -> Result<Option<Pause>, StoreError>;
    /// Pauses, drains or resumes one worker, as [`Store::set_paused`] does all. It holds for the worker of this name until
    /// it is resumed, also after a restart under the same name. Returns whether [`Store::workers`] lists the worker; if not,
    /// nothing happens.
    async fn instruct(&self, worker: &str, instruction: Instruction, by: Option<&str>) -> Result<bool, StoreError>;

    /// Takes the lock of an upkeep task for `lease`, or renews it. Returns whether `owner` now holds it.
    async fn acquire_upkeep(&self, task: UpkeepTask, owner: &str, lease: Duration) -> Result<bool, StoreError>;
    /// Those of `keys` that any job names, as a file or as a checkpoint, or that belong to a running attempt.
    async fn keys_in_use(&self, keys: &[String]) -> Result<BTreeSet<String>, StoreError>;
    /// Jobs that ended more than `age` ago by the store's clock, or all that have ended, ordered by their end; at most
    /// `limit`.
    async fn ended(&self, age: Option<Duration>, limit: u32) -> Result<Vec<JobId>, StoreError>;
    /// Bytes of all files that jobs name, each key counted once.
    async fn stored_bytes(&self) -> Result<u64, StoreError>;
    /// All jobs by status, at one moment. The cost does not depend on their number.
    async fn counts(&self) -> Result<Counts, StoreError>;
    /// Queued jobs by the backend asked for. The cost does not depend on their number.
    async fn queued_by_backend(&self) -> Result<[(Backend, u64); 4], StoreError>;
    /// Time since the oldest queued job was accepted, by the backend asked for; zero if none is queued. The cost does not
    /// depend on their number.
    async fn queue_ages(&self) -> Result<[(Backend, Duration); 4], StoreError>;

    /// Changes as they happen. A receiver that lags gets an error and must read the records again.
    fn changes(&self) -> broadcast::Receiver<Change>;
    /// The use of this process's connections to the database.
    fn pools(&self) -> Vec<PoolUse> {
        Vec::new()
    }
    /// Fails if the store is unavailable.
    async fn ready(&self) -> Result<(), StoreError>;
    /// Closes the store, which cannot be used afterwards.
    async fn close(&self) {}
}
