//! Bodies of responses about fits.

use super::request::FitRequest;
use crate::fit::{FitProgress, FitResult, FitStage};
use crate::http::models::model::{ModelProblem, Queue, expires_at};
use crate::http::workforce::JobContext;
use crate::jobs::{Job, JobProgress, Priority, Status};
use crate::spec::SharedJson;
use jiff::Timestamp;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use utoipa::ToSchema;
use uuid::Uuid;

/// A fit: the request, its progress and its result.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(in crate::http) struct Fit {
    /// Identifier, a UUIDv7.
    pub id: Uuid,
    /// Status. A fit that has succeeded, failed or was cancelled never changes.
    pub status: Status,
    /// Version, which increases with every change.
    #[schema(minimum = 0)]
    pub version: u64,
    /// Preset that the spec is resolved on.
    pub preset: String,
    /// Labels.
    pub labels: BTreeMap<String, String>,
    /// Priority in the queue. Workers claim queued jobs of higher priority first.
    #[schema(value_type = i64, minimum = -100, maximum = 100)]
    pub priority: Priority,
    /// Owner of the key with which the request was submitted; null if it was submitted without a
    /// key.
    pub owner: Option<String>,
    /// Name of the worker that runs the current or ran the last attempt; null before the first
    /// attempt.
    pub worker: Option<String>,
    /// Place in the queue, which fits and models share.
    pub queue: Queue,
    /// Progress; null until a worker reports it.
    pub progress: Option<FitProgress>,
    /// Number of attempts so far.
    #[schema(minimum = 0)]
    pub attempts: u32,
    /// Time at which the request was accepted.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
    /// Time at which the first attempt started.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub started_at: Option<Timestamp>,
    /// Time of the end: success, failure or cancellation. Null before the end.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub finished_at: Option<Timestamp>,
    /// Time at which the service will delete the record and the files; null before the end, and if
    /// the service keeps them.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub expires_at: Option<Timestamp>,
    /// Problem that caused the failure; null without a failure.
    pub problem: Option<ModelProblem>,
    /// SHA-256 of the request with its defaults and the engine version, as lower-case hex.
    pub digest: String,
    /// The complete request, including defaults. Absent in lists and events.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = FitRequest, required = false, nullable = false)]
    pub request: Option<SharedJson>,
    /// Result; null until the fit has succeeded. Absent in lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<FitResult>, required = false)]
    pub result: Option<Option<Value>>,
}

/// Optional members of a [`Fit`] in a response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::http) enum FitDetail {
    /// Neither request nor result.
    Summary,
    /// The result.
    Result,
    /// Request and result.
    Full,
}

impl Fit {
    /// The fit of a job.
    pub(in crate::http) fn of(job: &Job, context: &JobContext, detail: FitDetail) -> Self {
        Self {
            id: job.id.0,
            status: job.status,
            version: job.version,
            preset: job.preset.clone(),
            labels: job.labels.clone(),
            priority: job.priority,
            owner: job.owner.clone(),
            worker: job.worker.clone(),
            queue: Queue::of(job, context),
            progress: progress(job),
            attempts: job.attempts,
            created_at: job.created_at,
            started_at: job.started_at,
            finished_at: job.finished_at,
            expires_at: expires_at(job, context.keep),
            problem: job.problem.as_ref().map(ModelProblem::of),
            digest: job.digest.clone(),
            request: (detail == FitDetail::Full).then(|| job.spec.clone()),
            result: (detail != FitDetail::Summary).then(|| job.summary.clone()),
        }
    }
}

/// Progress of a fit.
fn progress(job: &Job) -> Option<FitProgress> {
    if job.status == Status::Succeeded {
        return Some(completed(job));
    }
    let last = job.progress.and_then(JobProgress::fit)?;
    Some(FitProgress { eta_seconds: last.eta_seconds.filter(|_| !job.status.is_ended()), ..last })
}

/// Progress of a fit that has succeeded. The last progress that its worker reported may be older
/// than the end.
fn completed(job: &Job) -> FitProgress {
    let result = job.summary.as_ref();
    let count = |value: Option<u64>| value.and_then(|n| u32::try_from(n).ok()).unwrap_or(0);
    FitProgress {
        stage: FitStage::Verify,
        fraction: 1.0,
        evaluations: count(result.and_then(|result| result.pointer("/search/evaluations")?.as_u64())),
        evaluations_most: count(job.spec.get("evaluations").and_then(Value::as_u64)),
        models: count(result.and_then(|result| Some(result.get("models")?.as_array()?.len() as u64))),
        misfit: result.and_then(|result| result.pointer("/search/misfit")?.as_f64()),
        eta_seconds: None,
    }
}

/// A page of fits, newest first.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(in crate::http) struct FitList {
    /// The fits.
    pub fits: Vec<Fit>,
    /// Value of `cursor` for the next page; null on the last page.
    pub next: Option<String>,
}

/// Result of a check: the request as the service would queue it.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(in crate::http) struct FitValidation {
    /// The complete request, including targets measured in images, varied parameters and their
    /// bounds.
    #[schema(value_type = FitRequest)]
    pub(super) request: Value,
    /// Digest of the request.
    pub(super) digest: String,
    /// Predicted seconds on one core if all evaluations are used.
    pub(super) seconds: f64,
    /// Number of queued and running models as which the fit counts against the quota of its owner.
    #[schema(minimum = 1)]
    pub(super) counts_as: u32,
}
