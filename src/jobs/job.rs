//! The record of a job.

use crate::fit::FitProgress;
use crate::generate::{Backend, Outputs, Progress, UsedBackend};
use crate::lock::Mutex;
use crate::spec::SharedJson;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;

/// Identity of a job and of its model: a UUIDv7.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct JobId(pub uuid::Uuid);

impl JobId {
    /// The smallest id of the millisecond of `at`. Ids begin with the time of the submission in
    /// milliseconds. If the clock is set back, they keep the last time before that, so they still
    /// ascend.
    #[must_use]
    pub fn least_at(at: Timestamp) -> Self {
        Self::of_millisecond(at.as_millisecond())
    }

    /// The smallest id of the millisecond after that of `at`.
    #[must_use]
    pub fn least_after(at: Timestamp) -> Self {
        Self::of_millisecond(at.as_millisecond() + 1)
    }

    fn of_millisecond(milliseconds: i64) -> Self {
        Self(uuid::Uuid::from_u128(u128::try_from(milliseconds).unwrap_or_default() << 80))
    }
}

impl std::fmt::Display for JobId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.hyphenated().fmt(f)
    }
}

/// Generates ids of jobs and batches. Each id is larger than all earlier ones of this process, even
/// within one millisecond.
#[derive(Debug)]
pub(super) struct IdGenerator(Mutex<uuid::ContextV7>);

impl IdGenerator {
    pub(super) fn new() -> Self {
        Self(Mutex::new(uuid::ContextV7::new()))
    }

    /// A new id of the time `now`.
    pub(super) fn next(&self, now: Timestamp) -> uuid::Uuid {
        let seconds = u64::try_from(now.as_second()).unwrap_or_default();
        let nanos = u32::try_from(now.subsec_nanosecond()).unwrap_or_default();
        uuid::Uuid::new_v7(uuid::Timestamp::from_unix(&*self.0.lock(), seconds, nanos))
    }
}

/// Identity of a batch: a UUIDv7.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct BatchId(pub uuid::Uuid);

impl std::fmt::Display for BatchId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.hyphenated().fmt(f)
    }
}

/// The state of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// Waiting for a worker.
    Queued,
    /// A worker holds its lease.
    Running,
    /// Ended with a certified model.
    Succeeded,
    /// Ended with a problem.
    Failed,
    /// Cancelled by a client.
    Cancelled,
}

impl Status {
    /// Name in records and responses.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// True if the status is final: the job never changes again.
    #[must_use]
    pub fn is_ended(self) -> bool {
        !matches!(self, Self::Queued | Self::Running)
    }
}

/// Problem of a job that failed; becomes an RFC 9457 problem over HTTP.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// Kind in kebab-case: `certificate`, `panic`, `memory`, `attempts-exhausted`, `storage`, …
    pub kind: String,
    /// Title of one line.
    pub title: String,
    /// Description of the error and its place.
    pub detail: String,
}

/// Requested backend of a model, and the backend and device that compute or computed it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct BackendReport {
    /// Requested backend.
    pub requested: Backend,
    /// Backend that computes or computed the model; null while the model is queued.
    #[schema(value_type = Option<Backend>)]
    pub used: Option<UsedBackend>,
    /// Name of the device.
    pub device: Option<String>,
    /// Reason why an `auto` model runs on the CPU instead of a GPU; null without such a reason.
    pub fallback: Option<String>,
}

/// A stored file of a model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct File {
    /// Name, such as `model.glb`.
    pub name: String,
    /// Media type.
    pub media_type: String,
    /// Size.
    pub bytes: u64,
    /// SHA-256, lower-case hex.
    pub sha256: String,
    /// Key of the object in the artifact store (never shown to clients). Several jobs may name the
    /// same key (reuse).
    pub key: String,
    /// Position of the first byte in a *pack*, an object with several files of an attempt. `None`
    /// if the object is this file alone.
    #[serde(default)]
    pub start: Option<u64>,
}

impl File {
    /// The bytes of the object that `range` of this file occupies. Never reaches into another file.
    #[must_use]
    pub fn place(&self, range: Range<u64>) -> Range<u64> {
        let start = self.start.unwrap_or_default();
        start + range.start.min(self.bytes)..start + range.end.min(self.bytes)
    }
}

/// Latest section, thinned to at most 512 points per contour, for drawing the growing tube.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LiveSection {
    /// Index among the recorded sections.
    pub index: u32,
    /// Time step.
    pub step: u32,
    /// Position along the tube, micrometres.
    pub z_um: f64,
    /// Inner contour, micrometres.
    pub inner: Vec<[f32; 2]>,
    /// Outer contour, micrometres.
    pub outer: Vec<[f32; 2]>,
}

/// Priority of a job, from −100 to 100. Workers claim jobs of higher priority first. The default is
/// 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(transparent)]
pub struct Priority(i8);

impl Priority {
    /// The lowest priority.
    pub const MIN: i64 = -100;
    /// The highest priority.
    pub const MAX: i64 = 100;

    /// The priority as a number.
    #[must_use]
    pub fn get(self) -> i64 {
        self.0.into()
    }
}

/// Error of a number outside the range of priorities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a priority is an integer from {} to {}, not {}", Priority::MIN, Priority::MAX, .0)]
pub struct NoPriority(i64);

impl TryFrom<i64> for Priority {
    type Error = NoPriority;

    fn try_from(value: i64) -> Result<Self, NoPriority> {
        let small = i8::try_from(value).ok().filter(|_| (Self::MIN..=Self::MAX).contains(&value));
        small.map(Self).ok_or(NoPriority(value))
    }
}

/// Limits of one owner. `None` means no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Quota {
    /// Queued and running jobs; a fit counts as [`NewJob::weight`] jobs.
    pub unfinished: Option<u64>,
    /// Bytes of files that the jobs of the owner name. A file that several jobs share counts for
    /// each of them. The store checks the limit before it queues a job, when the files of this job
    /// are not known yet.
    pub bytes: Option<u64>,
}

/// Progress of a job, by the kind of the job.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum JobProgress {
    /// Progress of a model.
    Model(Progress),
    /// Progress of a fit.
    Fit(FitProgress),
}

impl JobProgress {
    /// The progress of a model.
    #[must_use]
    pub fn model(self) -> Option<Progress> {
        if let Self::Model(progress) = self { Some(progress) } else { None }
    }

    /// The progress of a fit.
    #[must_use]
    pub fn fit(self) -> Option<FitProgress> {
        if let Self::Fit(progress) = self { Some(progress) } else { None }
    }

    /// Completed fraction, 0 to 1.
    #[must_use]
    pub fn fraction(self) -> f64 {
        match self {
            Self::Model(progress) => progress.fraction,
            Self::Fit(progress) => progress.fraction,
        }
    }

    /// This progress with at least this fraction.
    #[must_use]
    pub fn at_least(self, fraction: f64) -> Self {
        let fraction = fraction.max(self.fraction());
        match self {
            Self::Model(progress) => Self::Model(Progress { fraction, ..progress }),
            Self::Fit(progress) => Self::Fit(FitProgress { fraction, ..progress }),
        }
    }

    /// This progress after `seconds` in which the work did not report any, by its estimate of the
    /// remaining time. The fraction approaches 1 and never reaches it.
    #[must_use]
    pub fn after(self, seconds: f64) -> Self {
        let Some(eta) = self.eta_seconds().filter(|eta| *eta > 0.0) else { return self };
        let left = (-seconds / eta).exp();
        let fraction = 1.0 - (1.0 - self.fraction()) * left;
        let eta_seconds = Some(eta * left);
        match self {
            Self::Model(progress) => Self::Model(Progress { fraction, eta_seconds, ..progress }),
            Self::Fit(progress) => Self::Fit(FitProgress { fraction, eta_seconds, ..progress }),
        }
    }

    /// Estimated time to the end, seconds.
    #[must_use]
    pub fn eta_seconds(self) -> Option<f64> {
        match self {
            Self::Model(progress) => progress.eta_seconds,
            Self::Fit(progress) => progress.eta_seconds,
        }
    }
}

/// Kind of a job.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JobKind {
    /// A model: `spec` is its specification.
    #[default]
    Model,
    /// A fit of parameters to measures: `spec` is its request with all defaults filled in.
    Fit,
}

/// A job to be queued.
#[derive(Clone, Debug)]
pub struct NewJob {
    /// Kind.
    pub kind: JobKind,
    /// Preset name.
    pub preset: String,
    /// Seed.
    pub seed: u64,
    /// The resolved spec in canonical form.
    pub spec: SharedJson,
    /// Files to write.
    pub outputs: Outputs,
    /// Requested backend.
    pub backend: Backend,
    /// Labels.
    pub labels: BTreeMap<String, String>,
    /// Priority. Not part of the digest, so models of any priority are reused.
    pub priority: Priority,
    /// Digest of spec, seed and engine version.
    pub digest: String,
    /// Engine version of the digest.
    pub engine: String,
    /// True if a model with the same digest may be reused, immediately or when its growth ends.
    /// That model must have all `outputs`, and the requested backend must have grown it: `cpu` and
    /// `cpu-single` produce the same bytes, and `auto` accepts any backend.
    pub reuse: bool,
    /// Keys of files that the artifact store does not have. No model that names one of them is
    /// reused; see [`exclude_missing_files`](super::reuse::exclude_missing_files).
    pub missing: Vec<String>,
    /// Key of the jobs that a GPU may simulate together with this one, see
    /// [`crate::spec::batch_key`]. With `None`, a GPU simulates the job alone.
    pub batch_key: Option<String>,
    /// True if the model is predicted to take at most [`NewJob::SHORT_SECONDS`] on one core, so that
    /// a CPU worker may run it beside a longer one.
    pub short: bool,
    /// Idempotency key and a hash of the canonical request body.
    pub idempotency: Option<(String, String)>,
    /// Submitter: the owner of the job, whose turn it takes in the queue. `None` without keys; all
    /// such jobs share one turn.
    pub owner: Option<String>,
    /// Quota of the owner, this job included.
    pub quota: Quota,
    /// Number of jobs as which this one counts against the quota of unfinished jobs.
    pub weight: u32,
    /// Trace of its attempts, as W3C `traceparent`.
    pub trace: Option<String>,
    /// The failed job that this one repeats. It joins the batch of that job.
    pub retry_of: Option<JobId>,
}

impl NewJob {
    /// Maximum predicted time of a short model on one core, seconds.
    pub const SHORT_SECONDS: f64 = 1.0;
}

/// Result of [`Store::submit`](super::Store::submit).
#[derive(Clone, Debug, PartialEq)]
pub enum Submitted {
    /// The job was queued.
    Queued(Job),
    /// The job succeeded immediately, with the files of a finished model of the same digest.
    Reused(Job),
    /// An earlier request with the same idempotency key and body created this job.
    Replayed(Job),
}

impl Submitted {
    /// The job, new or not.
    #[must_use]
    pub fn job(&self) -> &Job {
        match self {
            Self::Queued(job) | Self::Reused(job) | Self::Replayed(job) => job,
        }
    }
}

impl Job {
    /// Position that jobs with at least this many jobs ahead report; smaller positions are exact.
    pub const MAX_QUEUE_POSITION: u64 = 1000;
}

/// The record of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Identity.
    pub id: JobId,
    /// Kind.
    pub kind: JobKind,
    /// Submitter; `None` if the request had no key.
    pub owner: Option<String>,
    /// Status.
    pub status: Status,
    /// Version, which grows by at least one with every change of the record.
    pub version: u64,
    /// Preset name.
    pub preset: String,
    /// Seed.
    pub seed: u64,
    /// The resolved spec in canonical form.
    pub spec: SharedJson,
    /// Requested files.
    pub outputs: Outputs,
    /// Labels.
    pub labels: BTreeMap<String, String>,
    /// Priority.
    pub priority: Priority,
    /// Trace of its attempts, as W3C `traceparent`.
    pub trace: Option<String>,
    /// Backend and device that compute it.
    pub backend: BackendReport,
    /// Position in the queue from 0, among the jobs with the same requested backend; `None` unless
    /// queued. Jobs further back than [`Job::MAX_QUEUE_POSITION`] report that number.
    pub queue_position: Option<u64>,
    /// True if the job is queued and waits for an equal model that is queued or running.
    pub waits_for_equal: bool,
    /// Latest progress of the present attempt.
    pub progress: Option<JobProgress>,
    /// Latest live section.
    pub section: Option<LiveSection>,
    /// Number of attempts so far.
    pub attempts: u32,
    /// Worker of the last attempt. It holds the lease while the job runs.
    pub worker: Option<String>,
    /// True if a client has cancelled the job while it was running.
    pub cancel_requested: bool,
    /// Time of the submission.
    pub created_at: Timestamp,
    /// Time of the first claim.
    pub started_at: Option<Timestamp>,
    /// End of the job.
    pub finished_at: Option<Timestamp>,
    /// Files of a job that succeeded.
    pub files: Vec<File>,
    /// Counts, main measures and figures of the certificate of a job that succeeded.
    pub summary: Option<serde_json::Value>,
    /// Problem of a job that failed.
    pub problem: Option<Problem>,
    /// Digest of spec, seed and engine version.
    pub digest: String,
    /// Engine version of the digest. If a worker of another version runs the job, its files are not
    /// reused for other jobs of this digest.
    pub engine: String,
    /// Batch of the job.
    pub batch: Option<BatchId>,
    /// Key of the newest checkpoint in the artifact store, until the job ends.
    pub checkpoint: Option<String>,
    /// The model whose files this one reuses.
    pub reused_from: Option<JobId>,
    /// The failed job that this one repeats.
    pub retry_of: Option<JobId>,
}
