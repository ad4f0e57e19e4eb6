//! Bodies of responses. Members that do not apply are null, never absent.

use super::batches::study::BatchStudy;
use super::models::detail::Detail;
use super::models::links::At;
pub use super::openapi::shapes::ModelWarning;
use super::openapi::shapes::Summary;
use super::wire::problem::TYPE_PREFIX;
use super::wire::responses::SpecPatch;
use crate::generate::{Output, Progress, Stage};
use crate::jobs::{
    BackendReport, Job, JobProgress, LiveSection, Priority, Status, WorkerInfo, WorkerKind, WorkerState,
};
use crate::model::{BodyKind, LengthUnit};
use crate::spec::ModelSpec;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::Duration;
use utoipa::ToSchema;
use uuid::Uuid;

/// A model: the request, its progress and its result.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Model {
    /// Identifier, a UUIDv7.
    pub id: Uuid,
    /// Status. A model that has succeeded, failed or was cancelled never changes.
    pub status: Status,
    /// Increases with every change.
    #[schema(minimum = 0)]
    pub version: u64,
    /// Preset that the spec was resolved on.
    pub preset: String,
    /// Seed.
    #[schema(minimum = 0, maximum = 9007199254740991i64)]
    pub seed: u64,
    /// Requested file formats.
    pub outputs: Vec<Output>,
    /// Bodies whose surfaces are written.
    pub bodies: Vec<BodyKind>,
    /// Unit of the formats that have a choice; null: the habit of each.
    pub units: Option<LengthUnit>,
    /// Labels.
    pub labels: BTreeMap<String, String>,
    /// Of the queued models, those of higher priority are started first.
    #[schema(value_type = i64, minimum = -100, maximum = 100)]
    pub priority: Priority,
    /// Who submitted it; null if that was done without a key.
    pub owner: Option<String>,
    /// Id of the batch that it belongs to.
    pub batch: Option<Uuid>,
    /// Requested and used backend.
    pub backend: BackendReport,
    /// Name of the worker that grows it, or made the last attempt; null before the first.
    pub worker: Option<String>,
    /// Position and waiting time in the queue.
    pub queue: Queue,
    /// Progress; null until it has started.
    pub progress: Option<Progress>,
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
    /// Its files, once it has succeeded.
    pub files: Vec<ModelFile>,
    /// Counts and measures, and in `certificate` the figures of the certificate, once it has succeeded.
    #[schema(value_type = Option<Summary>)]
    pub summary: Option<Value>,
    /// Signs of poor growth, once it has succeeded; empty if there are none.
    pub warnings: Vec<ModelWarning>,
    /// Why it failed.
    pub problem: Option<ModelProblem>,
    /// SHA-256 of the canonical spec (without `solver.search`), the seed and the engine version, as lower-case hex.
    pub digest: String,
    /// Id of the finished model whose files it shares.
    pub reused_from: Option<Uuid>,
    /// Id of the failed model that it repeats.
    pub retry_of: Option<Uuid>,
    /// The complete resolved spec, as `GET /schema` describes it. Present with `view=full`, absent with `view=summary`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = SpecPatch, required = false, nullable = false)]
    pub spec: Option<Value>,
}

/// Position and waiting time of a model in the queue.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub struct Queue {
    /// Number of models ahead of it that request the same backend: those of higher priority, of an earlier turn between
    /// submitters, or older ones. Counted up to 1000; null once it has left the queue.
    #[schema(minimum = 0)]
    pub position: Option<u64>,
    /// Seconds between acceptance and the first attempt; null while it waits.
    pub wait_seconds: Option<f64>,
}

/// A file of a model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct ModelFile {
    /// Name, such as `model.glb`.
    pub name: String,
    /// Media type.
    pub media_type: String,
    /// Size in bytes.
    #[schema(minimum = 0)]
    pub bytes: u64,
    /// SHA-256, lower-case hex.
    pub sha256: String,
    /// Where to download it: a reference relative to the URL of the answer or stream that names it.
    #[schema(format = "uri-reference")]
    pub href: String,
}

/// Why a model failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct ModelProblem {
    /// `urn:oviduct:problem:` and a stable slug: `certificate`, `panic`, `memory`, `attempts-exhausted`, `storage`, …
    pub r#type: String,
    /// The same for every problem of the type.
    pub title: String,
    /// What happened, and where.
    pub detail: String,
}

impl Model {
    /// The model of a job, in an answer whose URL lies `at`. Models are removed `keep` after their end.
    #[must_use]
    pub(super) fn of(job: &Job, keep: Option<Duration>, detail: Detail, at: At) -> Self {
        let file = |file: &crate::jobs::File| ModelFile {
            href: format!("{}/files/{}", at.model(job.id), file.name),
            name: file.name.clone(),
            media_type: file.media_type.clone(),
            bytes: file.bytes,
            sha256: file.sha256.clone(),
        };
        Self {
            id: job.id.0,
            status: job.status,
            version: job.version,
            preset: job.preset.clone(),
            seed: job.seed,
            outputs: job.outputs.formats.clone(),
            bodies: job.outputs.bodies.clone(),
            units: job.outputs.units,
            labels: job.labels.clone(),
            priority: job.priority,
            owner: job.owner.clone(),
            batch: job.batch.map(|id| id.0),
            backend: job.backend.clone(),
            worker: job.worker.clone(),
            queue: Queue::of(job),
            progress: if job.status == Status::Succeeded { Some(whole(job)) } else { reported(job) },
            attempts: job.attempts,
            created_at: job.created_at,
            started_at: job.started_at,
            finished_at: job.finished_at,
            expires_at: expires_at(job, keep),
            files: job.files.iter().map(file).collect(),
            summary: job.summary.clone().map(without_means),
            warnings: warnings(job),
            problem: job.problem.as_ref().map(ModelProblem::of),
            digest: job.digest.clone(),
            reused_from: job.reused_from.map(|id| id.0),
            retry_of: job.retry_of.map(|id| id.0),
            spec: (detail == Detail::Full).then(|| job.spec.clone()),
        }
    }
}

impl Queue {
    /// Position and waiting time of a job.
    pub(super) fn of(job: &Job) -> Self {
        let left = job.started_at.or(job.finished_at);
        let wait_seconds = left.map(|at| at.duration_since(job.created_at).as_secs_f64().max(0.0));
        Self { position: job.queue_position, wait_seconds }
    }
}

impl ModelProblem {
    /// The problem of a job.
    pub(super) fn of(problem: &crate::jobs::Problem) -> Self {
        Self {
            r#type: format!("{TYPE_PREFIX}{}", problem.kind),
            title: problem.title.clone(),
            detail: problem.detail.clone(),
        }
    }
}

/// When a job is removed, `keep` after its end.
pub(super) fn expires_at(job: &Job, keep: Option<Duration>) -> Option<Timestamp> {
    job.finished_at.zip(keep).and_then(|(end, keep)| end.checked_add(keep).ok())
}

/// The progress that a worker last reported of a model.
fn reported(job: &Job) -> Option<Progress> {
    job.progress.and_then(JobProgress::model)
}

/// A summary without the means by region, 150 numbers for tables of batches; the report of a model has them.
fn without_means(mut summary: Value) -> Value {
    if let Some(members) = summary.as_object_mut() {
        members.remove("morphometry");
    }
    summary
}

/// The warnings in the summary of a job. A summary of an older version has none.
fn warnings(job: &Job) -> Vec<ModelWarning> {
    let found = job.summary.as_ref().and_then(|summary| summary.get("warnings"));
    found.and_then(|list| Vec::deserialize(list).ok()).unwrap_or_default()
}

/// Progress of a succeeded model: complete, even if it was reused or ended before a worker reported any.
fn whole(job: &Job) -> Progress {
    let number = |value: Option<&Value>| value.and_then(Value::as_u64).and_then(|n| u32::try_from(n).ok()).unwrap_or(0);
    let found = |pointer: &str| number(job.summary.as_ref().and_then(|summary| summary.pointer(pointer)));
    // Only a piece may end before the tube does; reading the whole spec takes time.
    let to = job.spec.pointer("/piece/to").and_then(Value::as_f64).unwrap_or(1.0);
    let piece = (to < 1.0).then(|| ModelSpec::from_json(&job.spec).ok()).flatten();
    let steps = piece.map_or_else(|| number(job.spec.get("steps")), |spec| *spec.recorded().end());
    Progress {
        stage: Stage::Store,
        fraction: 1.0,
        step: steps,
        steps,
        particles: found("/particles/end").max(reported(job).map_or(0, |last| last.particles)),
        sections: found("/sections").max(reported(job).map_or(0, |last| last.sections)),
        eta_seconds: None,
    }
}

/// A page of models, newest first.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ModelList {
    /// The models.
    pub models: Vec<Model>,
    /// Value of `cursor` for the next page; null on the last page.
    pub next: Option<String>,
}

/// A batch: many models of one spec, or of the points of a study, requested together. Models that were deleted individually are not listed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct Batch {
    /// Identifier, a UUIDv7.
    pub id: Uuid,
    /// Who submitted it; null if that was done without a key.
    pub owner: Option<String>,
    /// When it was accepted.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
    /// Priority of its models.
    #[schema(value_type = i64, minimum = -100, maximum = 100)]
    pub priority: Priority,
    /// Number of its models by status.
    pub counts: BatchCounts,
    /// Ids of its models, in the order of the seeds; of a study, in the order of the points, each with its seeds; then those of
    /// retries. Absent in lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false, nullable = false)]
    pub models: Option<Vec<Uuid>>,
    /// The study that its models are the points of; null if it has none. Absent in lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<BatchStudy>, required = false)]
    pub study: Option<Option<BatchStudy>>,
}

/// A page of batches, newest first.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct BatchList {
    /// The batches.
    pub batches: Vec<Batch>,
    /// Value of `cursor` for the next page; null on the last page.
    pub next: Option<String>,
}

/// What a request for many models did.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub(super) struct Applied {
    /// Number of models that were cancelled or deleted, or with `dry_run` would be.
    #[schema(minimum = 0)]
    pub count: u64,
    /// Whether nothing was done.
    pub dry_run: bool,
}

/// Number of models of a batch by status.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct BatchCounts {
    /// All models.
    #[schema(minimum = 0)]
    pub total: u64,
    /// Models that wait for a worker.
    #[schema(minimum = 0)]
    pub queued: u64,
    /// Models that a worker grows.
    #[schema(minimum = 0)]
    pub running: u64,
    /// Models that have succeeded.
    #[schema(minimum = 0)]
    pub succeeded: u64,
    /// Models that have failed.
    #[schema(minimum = 0)]
    pub failed: u64,
    /// Models that were cancelled.
    #[schema(minimum = 0)]
    pub cancelled: u64,
}

impl From<&crate::jobs::Batch> for Batch {
    fn from(batch: &crate::jobs::Batch) -> Self {
        let counts = &batch.counts;
        Self {
            id: batch.id.0,
            owner: batch.owner.clone(),
            created_at: batch.created_at,
            priority: batch.priority,
            counts: BatchCounts {
                total: counts.total(),
                queued: counts.queued,
                running: counts.running,
                succeeded: counts.succeeded,
                failed: counts.failed,
                cancelled: counts.cancelled,
            },
            models: Some(batch.jobs.iter().map(|job| job.0).collect()),
            study: Some(BatchStudy::of(batch)),
        }
    }
}

/// The data of an event: the whole state of a model, without its spec unless `view=full`, and in `section` events its
/// latest contour.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ModelEvent {
    /// The model.
    #[serde(flatten)]
    pub model: Model,
    /// The latest contour; only in `section` events.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub section: Option<LiveSection>,
}

/// The data of the `end` event of a deleted model or fit.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub(super) struct DeletedEvent {
    /// Its id.
    pub id: Uuid,
    /// `deleted`.
    pub status: Deleted,
}

/// The status in the last event of what was deleted.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum Deleted {
    /// The model was deleted.
    Deleted,
}

/// A worker.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Worker {
    /// Name, unique in the installation.
    pub id: String,
    /// Host name.
    pub host: String,
    /// Backend.
    #[schema(value_type = crate::generate::Backend)]
    pub backend: WorkerKind,
    /// Name of the device.
    pub device: String,
    /// Id of the oldest model that it grows.
    pub job: Option<Uuid>,
    /// Ids of the models that it grows, oldest first: one, or those of a GPU batch.
    pub jobs: Vec<Uuid>,
    /// Number of models it has finished.
    #[schema(minimum = 0)]
    pub jobs_done: u64,
    /// Last heartbeat.
    #[schema(value_type = String, format = DateTime)]
    pub heartbeat_at: Timestamp,
    /// Whether it starts models, unless all workers are paused.
    pub state: WorkerState,
    /// Its own pause; null if it is active.
    pub pause: Option<Pause>,
}

/// A pause of a worker or of all.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct Pause {
    /// When it began.
    #[schema(value_type = String, format = DateTime)]
    pub since: Timestamp,
    /// Who asked for it; null if unknown, and for callers without the scope `admin`.
    pub by: Option<String>,
}

impl From<crate::jobs::Pause> for Pause {
    fn from(pause: crate::jobs::Pause) -> Self {
        Self { since: pause.since, by: pause.by }
    }
}

impl From<WorkerInfo> for Worker {
    fn from(worker: WorkerInfo) -> Self {
        let state = worker.state();
        Self {
            id: worker.id,
            host: worker.host,
            backend: worker.kind,
            device: worker.device,
            job: worker.jobs.first().map(|id| id.0),
            jobs: worker.jobs.iter().map(|id| id.0).collect(),
            jobs_done: worker.jobs_done,
            heartbeat_at: worker.heartbeat_at,
            state,
            pause: worker.pause.map(Into::into),
        }
    }
}

/// Workers that sent a heartbeat within the last minutes.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct WorkerList {
    /// The pause of all workers; null while those that are active start models.
    pub pause: Option<Pause>,
    /// The workers.
    pub workers: Vec<Worker>,
}
