//! What clients see: the shapes of answers. Members that do not apply are null, never absent.

use super::problem::TYPE_PREFIX;
use crate::generate::{Output, Progress, Stage};
use crate::jobs::{BackendReport, Job, LiveSection, Priority, Status, WorkerInfo};
use jiff::Timestamp;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::Duration;
use utoipa::ToSchema;
use uuid::Uuid;

/// A model: what was asked for, how far it is, what came of it.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Model {
    /// Identity, a UUIDv7.
    pub id: Uuid,
    /// Where it stands; an ended model never changes.
    pub status: Status,
    /// Grows with every change.
    #[schema(minimum = 0)]
    pub version: u64,
    /// Preset that the spec was resolved on.
    pub preset: String,
    /// Seed.
    #[schema(minimum = 0, maximum = 9007199254740991i64)]
    pub seed: u64,
    /// The whole resolved spec, as `GET /schema` describes it.
    #[schema(value_type = Object)]
    pub spec: Value,
    /// Formats asked for.
    pub outputs: Vec<Output>,
    /// Labels.
    pub labels: BTreeMap<String, String>,
    /// How urgent it is: of what waits, the higher is begun first.
    #[schema(value_type = i64, minimum = -100, maximum = 100)]
    pub priority: Priority,
    /// What computes it.
    pub backend: BackendReport,
    /// Its way through the queue.
    pub queue: Queue,
    /// How far it is; null until it has started.
    pub progress: Option<Progress>,
    /// Attempts so far.
    #[schema(minimum = 0)]
    pub attempts: u32,
    /// When it was accepted.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
    /// When the first attempt began.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub started_at: Option<Timestamp>,
    /// When it ended.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub finished_at: Option<Timestamp>,
    /// When it will be removed; null where it is kept.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub expires_at: Option<Timestamp>,
    /// Its files, once succeeded.
    pub files: Vec<ModelFile>,
    /// Counts and measures in short, once succeeded.
    #[schema(value_type = Option<Object>)]
    pub summary: Option<Value>,
    /// Why it failed.
    pub problem: Option<ModelProblem>,
    /// SHA-256 of the canonical spec (without `solver.search`), the seed and the engine's version.
    pub digest: String,
    /// The finished model whose files it shares.
    pub reused_from: Option<Uuid>,
}

/// The way of a model through the queue.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub struct Queue {
    /// Models ahead of it, among those that ask for the same backend: of higher priority, of an earlier turn between
    /// submitters, or older. Counted up to 1000; null once it has left the queue.
    #[schema(minimum = 0)]
    pub position: Option<u64>,
    /// Seconds it waited; null while it waits.
    pub wait_seconds: Option<f64>,
}

/// A file of a model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct ModelFile {
    /// Name, such as `model.glb`.
    pub name: String,
    /// Media type.
    pub media_type: String,
    /// Size.
    #[schema(minimum = 0)]
    pub bytes: u64,
    /// SHA-256, lower-case hex.
    pub sha256: String,
    /// Where to get it.
    pub href: String,
}

/// Why a model failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct ModelProblem {
    /// `urn:oviduct:problem:` and a slug: `certificate`, `panic`, `memory`, `attempts-exhausted`, `storage`, …
    pub r#type: String,
    /// One line.
    pub title: String,
    /// What happened and where.
    pub detail: String,
}

impl Model {
    /// The model of a job, where models are kept so long after their end.
    #[must_use]
    pub fn of(job: &Job, keep: Option<Duration>) -> Self {
        let file = |file: &crate::jobs::File| ModelFile {
            href: format!("/models/{}/files/{}", job.id, file.name),
            name: file.name.clone(),
            media_type: file.media_type.clone(),
            bytes: file.bytes,
            sha256: file.sha256.clone(),
        };
        let problem = |problem: &crate::jobs::Problem| ModelProblem {
            r#type: format!("{TYPE_PREFIX}{}", problem.kind),
            title: problem.title.clone(),
            detail: problem.detail.clone(),
        };
        let left = job.started_at.or(job.finished_at);
        let wait_seconds = left.map(|at| at.duration_since(job.created_at).as_secs_f64().max(0.0));
        Self {
            id: job.id.0,
            status: job.status,
            version: job.version,
            preset: job.preset.clone(),
            seed: job.seed,
            spec: job.spec.clone(),
            outputs: job.outputs.clone(),
            labels: job.labels.clone(),
            priority: job.priority,
            backend: job.backend.clone(),
            queue: Queue { position: job.queue_position, wait_seconds },
            progress: if job.status == Status::Succeeded { Some(whole(job)) } else { job.progress },
            attempts: job.attempts,
            created_at: job.created_at,
            started_at: job.started_at,
            finished_at: job.finished_at,
            expires_at: job.finished_at.zip(keep).and_then(|(end, keep)| end.checked_add(keep).ok()),
            files: job.files.iter().map(file).collect(),
            summary: job.summary.clone(),
            problem: job.problem.as_ref().map(problem),
            digest: job.digest.clone(),
            reused_from: job.reused_from.map(|id| id.0),
        }
    }
}

/// Progress of a succeeded model: all of it, also where it was grown (or reused) before a worker told of any.
fn whole(job: &Job) -> Progress {
    let number = |value: Option<&Value>| value.and_then(Value::as_u64).and_then(|n| u32::try_from(n).ok()).unwrap_or(0);
    let found = |pointer: &str| number(job.summary.as_ref().and_then(|summary| summary.pointer(pointer)));
    let steps = number(job.spec.get("steps"));
    Progress {
        stage: Stage::Store,
        fraction: 1.0,
        step: steps,
        steps,
        particles: found("/particles/end").max(job.progress.map_or(0, |last| last.particles)),
        sections: found("/sections").max(job.progress.map_or(0, |last| last.sections)),
        eta_seconds: None,
    }
}

/// Some models, newest first.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ModelList {
    /// The models.
    pub models: Vec<Model>,
    /// Value of `cursor` for the next page; null on the last.
    pub next: Option<String>,
}

/// A batch: many models of one spec, asked for together. Models deleted one by one are missing from it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct Batch {
    /// Identity, a UUIDv7.
    pub id: Uuid,
    /// When it was accepted.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
    /// How urgent its models are.
    #[schema(value_type = i64, minimum = -100, maximum = 100)]
    pub priority: Priority,
    /// Its models by status.
    pub counts: BatchCounts,
    /// Ids of its models, in the order of the seeds.
    pub models: Vec<Uuid>,
}

/// How many models of a batch stand where.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct BatchCounts {
    /// All of them.
    #[schema(minimum = 0)]
    pub total: u64,
    /// Waiting.
    #[schema(minimum = 0)]
    pub queued: u64,
    /// Being grown.
    #[schema(minimum = 0)]
    pub running: u64,
    /// Ended with a model.
    #[schema(minimum = 0)]
    pub succeeded: u64,
    /// Ended with a problem.
    #[schema(minimum = 0)]
    pub failed: u64,
    /// Ended by request.
    #[schema(minimum = 0)]
    pub cancelled: u64,
}

impl From<&crate::jobs::Batch> for Batch {
    fn from(batch: &crate::jobs::Batch) -> Self {
        let counts = &batch.counts;
        Self {
            id: batch.id.0,
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
            models: batch.jobs.iter().map(|job| job.0).collect(),
        }
    }
}

/// The data of an event: the whole state of a model, and in `section` events its last contour.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ModelEvent {
    /// The model.
    #[serde(flatten)]
    pub model: Model,
    /// The last contour; only in `section` events.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub section: Option<LiveSection>,
}

/// The data of the `end` event of a deleted model.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub(super) struct DeletedEvent {
    /// Which model.
    pub id: Uuid,
    /// `deleted`.
    pub status: Deleted,
}

/// The status that a model has only in the last event of its stream.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum Deleted {
    /// It is no more.
    Deleted,
}

/// A worker.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Worker {
    /// Name, unique in the installation.
    pub id: String,
    /// Host name.
    pub host: String,
    /// What it computes with.
    pub backend: crate::generate::Backend,
    /// Device in words.
    pub device: String,
    /// The oldest of the models that it grows.
    pub job: Option<Uuid>,
    /// The models that it grows: one, or those of a GPU's batch, the oldest first.
    pub jobs: Vec<Uuid>,
    /// Models it has ended.
    #[schema(minimum = 0)]
    pub jobs_done: u64,
    /// Last sign of life.
    #[schema(value_type = String, format = DateTime)]
    pub heartbeat_at: Timestamp,
}

impl From<WorkerInfo> for Worker {
    fn from(worker: WorkerInfo) -> Self {
        Self {
            id: worker.id,
            host: worker.host,
            backend: worker.backend,
            device: worker.device,
            job: worker.jobs.first().map(|id| id.0),
            jobs: worker.jobs.iter().map(|id| id.0).collect(),
            jobs_done: worker.jobs_done,
            heartbeat_at: worker.heartbeat_at,
        }
    }
}

/// Workers seen in the last minutes.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct WorkerList {
    /// The workers.
    pub workers: Vec<Worker>,
}
