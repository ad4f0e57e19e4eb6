//! The record of a job.

use crate::fit::FitProgress;
use crate::generate::{Backend, Outputs, Progress};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Identity of a job and of its model: a UUIDv7.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct JobId(pub uuid::Uuid);

impl JobId {
    /// The least id of the millisecond of `at`. Ids begin with the time of the record in milliseconds; if the clock is set
    /// back, with the last time before that, so that they still ascend.
    #[must_use]
    pub fn least_at(at: Timestamp) -> Self {
        Self::of_millisecond(at.as_millisecond())
    }

    /// The least id of the millisecond after that of `at`.
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
    /// Its name in records and answers.
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

    /// Whether it is final: the job never changes again.
    #[must_use]
    pub fn is_ended(self) -> bool {
        !matches!(self, Self::Queued | Self::Running)
    }
}

/// Why a job failed; becomes an RFC 9457 problem over HTTP.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// Short kebab-case kind: `certificate`, `panic`, `memory`, `attempts-exhausted`, `storage`, …
    pub kind: String,
    /// One line.
    pub title: String,
    /// What happened, and where.
    pub detail: String,
}

/// What computes or computed a model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct BackendReport {
    /// The backend asked for.
    pub requested: Backend,
    /// The backend that runs or ran it; null while queued.
    pub used: Option<Backend>,
    /// Name of the device.
    pub device: Option<String>,
    /// Why it is not the backend that one would expect; null if it is.
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
    /// Key in the artifact store (never shown to clients). Several jobs may name the same key (reuse).
    pub key: String,
}

/// The last section, thinned to at most 512 points per ring, so that a page can draw the growing tube.
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

/// How urgent a job is, from −100 to 100: the higher is claimed first. The default is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(transparent)]
pub struct Priority(i8);

impl Priority {
    /// The lowest.
    pub const MIN: i64 = -100;
    /// The highest.
    pub const MAX: i64 = 100;

    /// As a number.
    #[must_use]
    pub fn get(self) -> i64 {
        self.0.into()
    }
}

/// A number outside the range of priorities.
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

/// What one owner may have at a time. `None`: no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Quota {
    /// Queued and running jobs.
    pub unfinished: Option<u64>,
    /// Bytes of files that the records of its jobs name. A file that several jobs share counts for each of them. Checked
    /// before a job is queued, when its own files are not known yet.
    pub bytes: Option<u64>,
}

/// Progress of a job, by its kind.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum JobProgress {
    /// Of a model.
    Model(Progress),
    /// Of a fit.
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

    /// Fraction of the whole, 0 to 1.
    #[must_use]
    pub fn fraction(self) -> f64 {
        match self {
            Self::Model(progress) => progress.fraction,
            Self::Fit(progress) => progress.fraction,
        }
    }

    /// The same with at least this fraction.
    #[must_use]
    pub fn at_least(self, fraction: f64) -> Self {
        let fraction = fraction.max(self.fraction());
        match self {
            Self::Model(progress) => Self::Model(Progress { fraction, ..progress }),
            Self::Fit(progress) => Self::Fit(FitProgress { fraction, ..progress }),
        }
    }

    /// Estimated seconds to the end.
    #[must_use]
    pub fn eta_seconds(self) -> Option<f64> {
        match self {
            Self::Model(progress) => progress.eta_seconds,
            Self::Fit(progress) => progress.eta_seconds,
        }
    }
}

/// What a job makes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JobKind {
    /// A model: `spec` is its specification.
    #[default]
    Model,
    /// A fit of parameters to measures: `spec` is its request with everything that it leaves open.
    Fit,
}

/// A job to be queued.
#[derive(Clone, Debug)]
pub struct NewJob {
    /// What it makes.
    pub kind: JobKind,
    /// Preset name.
    pub preset: String,
    /// Seed.
    pub seed: u64,
    /// The resolved spec in canonical form.
    pub spec: serde_json::Value,
    /// What to write.
    pub outputs: Outputs,
    /// Backend asked for.
    pub backend: Backend,
    /// Labels.
    pub labels: BTreeMap<String, String>,
    /// How urgent it is. Not part of the digest: a finished model is reused whatever its priority was.
    pub priority: Priority,
    /// Digest of spec, seed and engine version.
    pub digest: String,
    /// The engine version of the digest.
    pub engine: String,
    /// Whether a model with the same digest may be reused, now or when it has finished (it must have all `outputs`, and have been
    /// made by the backend asked for: `cpu` and `cpu-single` give the same bytes; `auto` accepts any).
    pub reuse: bool,
    /// Keys of files that were found missing in the artifact store: no model that names one of them is reused. See
    /// [`exclude_missing_files`](super::reuse::exclude_missing_files).
    pub missing: Vec<String>,
    /// Which jobs a GPU may run together with it: those of the same key, see [`crate::spec::batch_key`]. `None`: a GPU runs
    /// it alone.
    pub batch_key: Option<String>,
    /// Idempotency key, with a hash of the canonical request body.
    pub idempotency: Option<(String, String)>,
    /// Who submits it: whose it is, and whose turn it takes in the queue. `None` without keys; all such jobs share one turn.
    pub owner: Option<String>,
    /// What its owner may have, this job included.
    pub quota: Quota,
    /// The trace that its attempts belong to, as W3C `traceparent`.
    pub trace: Option<String>,
    /// The failed job that it repeats, into whose batch it goes.
    pub retry_of: Option<JobId>,
}

#[cfg(test)]
impl NewJob {
    /// A job for tests, with a digest of its own for each seed.
    pub(super) fn sample(seed: u64) -> Self {
        Self {
            kind: JobKind::Model,
            preset: "pig".into(),
            seed,
            spec: serde_json::json!({}),
            outputs: vec![crate::generate::Output::Glb].into(),
            backend: Backend::Auto,
            labels: BTreeMap::new(),
            priority: Priority::default(),
            digest: seed.to_string(),
            engine: crate::ENGINE_VERSION.into(),
            reuse: false,
            missing: Vec::new(),
            batch_key: None,
            idempotency: None,
            owner: None,
            quota: Quota::default(),
            trace: None,
            retry_of: None,
        }
    }
}

/// The whole record of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Identity.
    pub id: JobId,
    /// What it makes.
    pub kind: JobKind,
    /// Who submitted it; `None` if that was done without a key.
    pub owner: Option<String>,
    /// State.
    pub status: Status,
    /// Grows by at least one with every change of the record.
    pub version: u64,
    /// Preset name.
    pub preset: String,
    /// Seed.
    pub seed: u64,
    /// The resolved spec in canonical form.
    pub spec: serde_json::Value,
    /// The files asked for.
    pub outputs: Outputs,
    /// Labels.
    pub labels: BTreeMap<String, String>,
    /// How urgent it is.
    pub priority: Priority,
    /// The trace that its attempts belong to, as W3C `traceparent`.
    pub trace: Option<String>,
    /// What computes it.
    pub backend: BackendReport,
    /// Position in the queue from 0, while queued, among the jobs that ask for the same backend. Exact up to 1000; jobs
    /// further back report 1000.
    pub queue_position: Option<u64>,
    /// Last progress, once it has started.
    pub progress: Option<JobProgress>,
    /// Last live section.
    pub section: Option<LiveSection>,
    /// Attempts so far.
    pub attempts: u32,
    /// The worker of the last attempt: the one that holds the lease, while it runs.
    pub worker: Option<String>,
    /// Whether a client has cancelled it while it was running.
    pub cancel_requested: bool,
    /// When it was accepted.
    pub created_at: Timestamp,
    /// When the first attempt began.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
    /// Its files, once succeeded.
    pub files: Vec<File>,
    /// Counts and measures in short, with the figures of the certificate, once succeeded.
    pub summary: Option<serde_json::Value>,
    /// Why it failed.
    pub problem: Option<Problem>,
    /// Digest of spec, seed and engine version.
    pub digest: String,
    /// The engine version of the digest. If a worker of another version runs the job, its files are not reused for
    /// other jobs of this digest.
    pub engine: String,
    /// The batch that it belongs to.
    pub batch: Option<BatchId>,
    /// Key of the newest checkpoint in the artifact store, until the job ends.
    pub checkpoint: Option<String>,
    /// The model whose files it reuses.
    pub reused_from: Option<JobId>,
    /// The failed job that it repeats.
    pub retry_of: Option<JobId>,
}
