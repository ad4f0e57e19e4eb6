//! Bodies of answers about fits.

use super::request::FitRequest;
use crate::fit::FitResult;
use crate::generate::Stage;
use crate::http::dto::{ModelProblem, Queue};
use crate::http::problem::TYPE_PREFIX;
use crate::jobs::{Job, Priority, Status};
use jiff::Timestamp;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::Duration;
use utoipa::ToSchema;
use uuid::Uuid;

/// A fit: the request, its progress and its result.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(in crate::http) struct Fit {
    /// Identifier, a UUIDv7.
    pub id: Uuid,
    /// Status. A fit that has succeeded, failed or was cancelled never changes.
    pub status: Status,
    /// Increases with every change.
    #[schema(minimum = 0)]
    pub version: u64,
    /// Preset that the spec is resolved on.
    pub preset: String,
    /// Labels.
    pub labels: BTreeMap<String, String>,
    /// Of the queued jobs, those of higher priority are started first.
    #[schema(value_type = i64, minimum = -100, maximum = 100)]
    pub priority: Priority,
    /// Who submitted it; null if that was done without a key.
    pub owner: Option<String>,
    /// Name of the worker that runs it, or made the last attempt; null before the first.
    pub worker: Option<String>,
    /// Position and waiting time in the queue, which it shares with models.
    pub queue: Queue,
    /// Progress; null until it has started.
    pub progress: Option<FitProgress>,
    /// Number of attempts so far.
    #[schema(minimum = 0)]
    pub attempts: u32,
    /// When it was accepted.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
    /// When the first attempt started.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub started_at: Option<Timestamp>,
    /// When it ended.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub finished_at: Option<Timestamp>,
    /// When it will be removed; null if it is kept.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub expires_at: Option<Timestamp>,
    /// Why it failed.
    pub problem: Option<ModelProblem>,
    /// SHA-256 of the request with its defaults and the engine version, as lower-case hex.
    pub digest: String,
    /// The request with everything that it left open. Absent in lists and events.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = FitRequest, required = false, nullable = false)]
    pub request: Option<Value>,
    /// The result, once it has succeeded. Absent in lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<FitResult>, required = false)]
    pub result: Option<Option<Value>>,
}

/// Progress of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(in crate::http) struct FitProgress {
    /// `search`, then `verify`.
    pub stage: Stage,
    /// Fraction of the whole, 0 to 1, never decreasing. A search may end before it has used all evaluations.
    pub fraction: f64,
    /// Candidates measured so far.
    #[schema(minimum = 0)]
    pub evaluations: u32,
    /// Candidates at most.
    #[schema(minimum = 0)]
    pub evaluations_most: u32,
    /// Models grown in full so far.
    #[schema(minimum = 0)]
    pub models: u32,
    /// Least misfit so far; see `misfit` of the result.
    pub misfit: Option<f64>,
    /// Seconds until all evaluations are used, at the pace so far.
    pub eta_seconds: Option<f64>,
}

/// How much of a fit an answer has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Parts {
    /// Neither request nor result.
    Summary,
    /// The result.
    Result,
    /// Request and result.
    All,
}

impl Fit {
    /// The fit of a job. Fits are removed `keep` after their end.
    pub(super) fn of(job: &Job, keep: Option<Duration>, parts: Parts) -> Self {
        let left = job.started_at.or(job.finished_at);
        let wait_seconds = left.map(|at| at.duration_since(job.created_at).as_secs_f64().max(0.0));
        // The last progress that a worker reported may be older than the end.
        let grown = job.summary.as_ref().and_then(|result| result.get("models")?.as_array()).map(Vec::len);
        let progress = job.progress.map(|progress| FitProgress {
            stage: progress.stage,
            fraction: if job.status == Status::Succeeded { 1.0 } else { progress.fraction },
            evaluations: progress.step,
            evaluations_most: progress.steps,
            models: grown.and_then(|models| u32::try_from(models).ok()).unwrap_or(progress.sections),
            misfit: progress.misfit,
            eta_seconds: progress.eta_seconds.filter(|_| !job.status.is_ended()),
        });
        Self {
            id: job.id.0,
            status: job.status,
            version: job.version,
            preset: job.preset.clone(),
            labels: job.labels.clone(),
            priority: job.priority,
            owner: job.owner.clone(),
            worker: job.worker.clone(),
            queue: Queue { position: job.queue_position, wait_seconds },
            progress,
            attempts: job.attempts,
            created_at: job.created_at,
            started_at: job.started_at,
            finished_at: job.finished_at,
            expires_at: job.finished_at.zip(keep).and_then(|(end, keep)| end.checked_add(keep).ok()),
            problem: job.problem.as_ref().map(|problem| ModelProblem {
                r#type: format!("{TYPE_PREFIX}{}", problem.kind),
                title: problem.title.clone(),
                detail: problem.detail.clone(),
            }),
            digest: job.digest.clone(),
            request: (parts == Parts::All).then(|| job.spec.clone()),
            result: (parts != Parts::Summary).then(|| job.summary.clone()),
        }
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

/// The result of a check: what would be queued.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(in crate::http) struct FitValidation {
    /// The request with everything that it left open: targets measured in images, the parameters that are varied, their bounds.
    #[schema(value_type = FitRequest)]
    pub(super) request: Value,
    /// Digest of the request.
    pub(super) digest: String,
    /// Predicted seconds on one core, if all evaluations are used.
    pub(super) seconds: f64,
}
