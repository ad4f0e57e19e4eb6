//! Bodies of responses and events about models. Members that do not apply are null, never absent.

pub use crate::generate::Warning as ModelWarning;
use crate::generate::{Output, Progress, Stage, Summary};
use crate::http::wire::extract::Parameters;
use crate::http::wire::faults::{Faults, RequestFault};
use crate::http::wire::problem::TYPE_PREFIX;
use crate::http::workforce::JobContext;
use crate::jobs::{BackendReport, Job, JobProgress, LiveSection, Priority, QueueReason, Status};
use crate::model::{BodyKind, LengthUnit};
use crate::spec::{ModelSpec, SharedJson};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Display;
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
    /// Version, which increases with every change.
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
    /// Requested unit of the formats that have a choice; null for the default unit of each format.
    pub units: Option<LengthUnit>,
    /// Labels.
    pub labels: BTreeMap<String, String>,
    /// Priority in the queue. Workers claim queued models of higher priority first.
    #[schema(value_type = i64, minimum = -100, maximum = 100)]
    pub priority: Priority,
    /// Owner of the key with which the request was submitted; null if it was submitted without a
    /// key.
    pub owner: Option<String>,
    /// Id of the batch to which the model belongs; null if it belongs to none.
    pub batch: Option<Uuid>,
    /// Requested and used backend.
    pub backend: BackendReport,
    /// Name of the worker that runs the current or ran the last attempt; null before the first
    /// attempt.
    pub worker: Option<String>,
    /// Place in the queue.
    pub queue: Queue,
    /// Progress; null until a worker reports it.
    pub progress: Option<Progress>,
    /// Number of attempts so far, including those that a worker released without a fault of the
    /// model: they do not count against the limit of attempts.
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
    /// Files of the model; empty until it has succeeded.
    pub files: Vec<ModelFile>,
    /// Counts and measures and, in `certificate`, figures of the certificate; null until the model
    /// has succeeded.
    #[schema(value_type = Option<Summary>)]
    pub summary: Option<Value>,
    /// Warnings about poor growth; empty if there are none, and until the model has succeeded.
    pub warnings: Vec<ModelWarning>,
    /// Problem that caused the failure; null without a failure.
    pub problem: Option<ModelProblem>,
    /// SHA-256 of the canonical spec (without `solver.search`), the seed and the engine version, as
    /// lower-case hex.
    pub digest: String,
    /// Id of the finished model whose files this model shares; null if it was grown.
    pub reused_from: Option<Uuid>,
    /// Id of the failed model that this model retries; null if it is not a retry.
    pub retry_of: Option<Uuid>,
    /// The complete resolved spec, as `GET /schema` describes it. Present with `view=full`, absent
    /// with `view=summary`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = ModelSpec, required = false, nullable = false)]
    pub spec: Option<SharedJson>,
}

/// Place of a model in the queue: position, waiting time, and the reason if no worker claims it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub struct Queue {
    /// Number of models that are ahead in the queue and request the same backend: models of higher
    /// priority, of an earlier turn between submitters, or older ones. Counted up to 1000; null
    /// after the model has left the queue.
    #[schema(minimum = 0, maximum = 1000)]
    pub position: Option<u64>,
    /// False if 1000 or more models are ahead, so `position` is 1000; null after the model has left
    /// the queue.
    pub position_is_exact: Option<bool>,
    /// Reason why no worker starts the model; null if the model waits for the models ahead, and
    /// after it has left the queue. The reason is at most a few seconds old.
    pub reason: Option<QueueReason>,
    /// Seconds between acceptance and the first attempt or, without an attempt, the end; null while
    /// the model waits.
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
    /// Reference to the file, relative to the URL of the response or stream that contains it.
    #[schema(format = "uri-reference")]
    pub href: String,
}

/// Problem that caused a failure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct ModelProblem {
    /// `urn:oviduct:problem:` and a stable slug: `certificate`, `panic`, `memory`,
    /// `attempts-exhausted`, `storage`, …
    pub r#type: String,
    /// Title, the same for every problem of the type.
    pub title: String,
    /// Description of the error and its place.
    pub detail: String,
}

impl Model {
    /// The model of a job, with references relative to `base`.
    #[must_use]
    pub(in crate::http) fn of(job: &Job, context: &JobContext, detail: Detail, base: LinkBase) -> Self {
        let file = |file: &crate::jobs::File| ModelFile {
            href: format!("{}/files/{}", base.model(job.id), file.name),
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
            queue: Queue::of(job, context),
            progress: if job.status == Status::Succeeded { Some(completed(job)) } else { reported(job) },
            attempts: job.attempts,
            created_at: job.created_at,
            started_at: job.started_at,
            finished_at: job.finished_at,
            expires_at: expires_at(job, context.keep),
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
    pub(in crate::http) fn of(job: &Job, context: &JobContext) -> Self {
        let left = job.started_at.or(job.finished_at);
        let wait_seconds = left.map(|at| at.duration_since(job.created_at).as_secs_f64().max(0.0));
        let position = job.queue_position;
        let position_is_exact = position.map(|position| position < Job::MAX_QUEUE_POSITION);
        Self { position, position_is_exact, reason: context.queue_reason(job), wait_seconds }
    }
}

impl ModelProblem {
    pub(in crate::http) fn of(problem: &crate::jobs::Problem) -> Self {
        Self {
            r#type: format!("{TYPE_PREFIX}{}", problem.kind),
            title: problem.title.clone(),
            detail: problem.detail.clone(),
        }
    }
}

/// Time at which a job is removed: `keep` after its end.
pub(in crate::http) fn expires_at(job: &Job, keep: Option<Duration>) -> Option<Timestamp> {
    job.finished_at.zip(keep).and_then(|(end, keep)| end.checked_add(keep).ok())
}

/// Progress that the worker of a model last reported.
fn reported(job: &Job) -> Option<Progress> {
    job.progress.and_then(JobProgress::model)
}

/// The summary without the means by region: 150 numbers, which tables of batches and the report
/// contain.
fn without_means(mut summary: Value) -> Value {
    if let Some(members) = summary.as_object_mut() {
        members.remove("morphometry");
    }
    summary
}

/// Warnings in the summary of a job. Summaries of older versions have none.
fn warnings(job: &Job) -> Vec<ModelWarning> {
    let found = job.summary.as_ref().and_then(|summary| summary.get("warnings"));
    found.and_then(|list| Vec::deserialize(list).ok()).unwrap_or_default()
}

/// Progress of a succeeded model. The last progress that a worker reported may be older than the
/// end, and a reused model has none.
fn completed(job: &Job) -> Progress {
    let number = |value: Option<&Value>| value.and_then(Value::as_u64).and_then(|n| u32::try_from(n).ok()).unwrap_or(0);
    let found = |pointer: &str| number(job.summary.as_ref().and_then(|summary| summary.pointer(pointer)));
    // Only a piece can end before the tube does. The whole spec is read only for a piece, because
    // this takes time.
    let to = job.spec.pointer("/piece/to").and_then(Value::as_f64).unwrap_or(1.0);
    let piece = (to < 1.0).then(|| ModelSpec::from_stored(&job.spec)).flatten();
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

/// Data of an event: the whole state of a model, without its spec unless `view=full`. In `section`
/// events, the data also has the latest section.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ModelEvent {
    /// The model.
    #[serde(flatten)]
    pub model: Model,
    /// Latest section. Only in `section` events.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub section: Option<LiveSection>,
}

/// Data of the `end` event of a deleted model or fit.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub(in crate::http) struct DeletedEvent {
    /// Id of the model or fit.
    pub id: Uuid,
    /// `deleted`.
    pub status: Deleted,
}

/// Status in the last event of a deleted model or fit.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(in crate::http) enum Deleted {
    /// The model was deleted.
    Deleted,
}

/// Members of each model that a response or event has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = View)]
pub(in crate::http) enum Detail {
    /// All except the spec, which never changes and has most of the bytes.
    Summary,
    /// All.
    Full,
}

impl Detail {
    /// Reads the parameter `view`; `default` if it is absent or invalid.
    pub(in crate::http) fn read(parameters: &Parameters, default: Self, faults: &mut Faults) -> Self {
        match parameters.get("view") {
            None => default,
            Some("summary") => Self::Summary,
            Some("full") => Self::Full,
            Some(_) => {
                faults.push(RequestFault::parameter("view", "must be summary or full"));
                default
            }
        }
    }
}

/// The path that a response was requested from. Its references are relative to it (RFC 3986,
/// section 4.2): a proxy may strip a prefix from paths, so the service never refers to a path from
/// the root.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::http) enum LinkBase {
    /// `/models`, `/events`, `/batches`.
    Root,
    /// `/models/{id}`.
    Models,
    /// `/models/{id}/events`, or another resource of a model.
    Model,
}

impl LinkBase {
    /// A reference to a model.
    pub(in crate::http) fn model(self, id: impl Display) -> String {
        match self {
            Self::Root => format!("models/{id}"),
            Self::Models => id.to_string(),
            Self::Model => format!("../{id}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_resolve_under_any_prefix() {
        for prefix in ["http://localhost:8080", "https://lab.example/tools/oviduct"] {
            for (at, paths) in [
                (LinkBase::Root, vec!["/models", "/events", "/models?limit=3", "/batches"]),
                (LinkBase::Models, vec!["/models/7", "/models/7?view=full"]),
                (LinkBase::Model, vec!["/models/7/events", "/models/7/cancel", "/models/7/retry"]),
            ] {
                for path in paths {
                    let base = reqwest::Url::parse(&format!("{prefix}{path}")).unwrap();
                    let resolved = base.join(&format!("{}/files/model.glb", at.model(7))).unwrap();
                    assert_eq!(resolved.as_str(), format!("{prefix}/models/7/files/model.glb"), "{path}");
                }
            }
        }
    }
}
