//! `POST /models` and `POST /models/validate`: from a request to a queued model.
//!
//! A request is checked completely before anything is queued.

use super::model::{Detail, LinkBase, Model};
use super::read::{answer, retry_after};
use super::request::ModelRequest;
use super::specs::Resolved;
use crate::generate::{Backend, Cost, Output, OverLimit};
use crate::http::AppState;
use crate::http::access::{Caller, audit, run_to_completion};
use crate::http::events::Reader;
use crate::http::health::{check_storage, not_ready};
use crate::http::wire::faults::body_reader;
use crate::http::wire::headers::{IDEMPOTENCY_REPLAYED, PREFERENCE_APPLIED, idempotency_key, wait};
use crate::http::wire::json::JsonBody;
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{BodyProblems, BodyUnavailable, QueueFull};
use crate::jobs::reuse::exclude_missing_files;
use crate::jobs::{Job, JobKind, NewJob, StoreError, Submitted, WorkerKind};
use crate::spec::{
    Fault, JsonReader, ModelSpec, Preset, SEED_MAX, SharedJson, batch_key, canonical_json, preset, presets,
};
use crate::status::Condition;
use crate::trace;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::sync::Arc;
use std::time::Duration;
use utoipa::ToSchema;

/// A request that passed all checks. Only a full queue can refuse it.
pub(in crate::http) struct CheckedModel {
    pub(in crate::http) request: ModelRequest,
    pub(in crate::http) spec: Arc<ModelSpec>,
    pub(in crate::http) cost: Arc<Cost>,
}

/// Reads and checks a body.
async fn check_body(state: &AppState, body: &Value) -> Result<CheckedModel, Problem> {
    let mut reader = body_reader();
    let request = ModelRequest::read(&mut reader, body);
    check(state, request, reader).await
}

/// Checks a request that `reader` has read.
pub(in crate::http) async fn check(
    state: &AppState,
    request: ModelRequest,
    mut reader: JsonReader,
) -> Result<CheckedModel, Problem> {
    let spec = find_preset(&request, &mut reader).and_then(|preset| {
        state.specs.resolve(preset, &request.spec).map_err(|faults| reader.extend("/spec", faults)).ok()
    });
    match spec.filter(|_| reader.count() == 0) {
        Some(resolved) => check_limits(state, request, &resolved).await,
        None => Err(Problem::invalid(reader)),
    }
}

/// Checks the predicted cost of a model, and that a worker for it exists.
pub(super) async fn check_limits(
    state: &AppState,
    request: ModelRequest,
    resolved: &Resolved,
) -> Result<CheckedModel, Problem> {
    let cost = resolved.cost(&request.outputs);
    state.limits.cost.check(&cost).map_err(|over| too_much(&cost, &over))?;
    check_backend(state, &request).await?;
    Ok(CheckedModel { request, spec: Arc::clone(&resolved.spec), cost })
}

/// Returns the preset of a request, or records a fault.
pub(in crate::http) fn find_preset(request: &ModelRequest, reader: &mut JsonReader) -> Option<&'static Preset> {
    let found = preset(&request.preset);
    if found.is_none() && !reader.faults().iter().any(|fault| fault.pointer == "/preset") {
        let names: Vec<_> = presets().iter().map(|p| p.name.as_str()).collect();
        reader.fault::<()>("/preset", format!("is unknown; the presets are {}", names.join(", ")));
    }
    found
}

/// The problem of a predicted cost that exceeds limits.
pub(in crate::http) fn too_much(cost: &Cost, over: &[OverLimit]) -> Problem {
    let place = |over: &OverLimit| if over.quantity == Output::Glb.name() { "/outputs" } else { "/spec" };
    let errors: Vec<Fault> = over.iter().map(|o| Fault::new(place(o), o.to_string())).collect();
    let detail = over.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
    let limits: serde_json::Map<_, _> = over.iter().map(|o| (o.quantity.to_owned(), o.limit.into())).collect();
    Problem::new(Kind::CostLimit, detail)
        .with_errors(errors)
        .with("prediction", serde_json::to_value(cost).unwrap_or_default())
        .with("limit", Value::Object(limits))
}

/// Refuses a request for a GPU if no GPU worker is alive. Workers of this process are not alive
/// until they have opened their devices, so the request waits for them, at most for
/// [`crate::http::Limits::gpu_wait`].
pub(in crate::http) async fn check_backend(state: &AppState, request: &ModelRequest) -> Result<(), Problem> {
    if request.backend != Backend::Gpu || state.limits.gpu_expected {
        return Ok(());
    }
    let alive = async || {
        Ok::<_, StoreError>(state.store.count_live_workers(WorkerKind::Gpu, state.limits.gpu_memory).await? > 0)
    };
    if alive().await? {
        return Ok(());
    }
    let condition = Condition::OpeningDevices;
    if !state.status.cleared(condition, state.limits.gpu_wait).await {
        let detail = "GPU workers are still opening their devices. Try again later.";
        return Err(not_ready(condition, detail));
    }
    if alive().await? {
        return Ok(());
    }
    let detail = "No GPU worker has sent a heartbeat for five minutes. Request `auto` or `cpu`.";
    let fault = Fault::new("/backend", "no GPU worker is available");
    Err(Problem::new(Kind::GpuUnavailable, detail).with_errors([fault]))
}

/// Request a model.
///
/// The service queues the model and grows it in the background. Follow the model with
/// `GET /models/{id}` or its events.
#[utoipa::path(
    post, path = "/models", operation_id = "create_model", tag = "models",
    params(
        ("prefer" = Option<String>, Header,
            description = "`wait=N`: hold the response until the model has ended, at most N seconds (1 to 60). If \
                the service already holds too many responses, it responds immediately, without `preference-applied`"),
        ("idempotency-key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[!-~]+$", description = "1 to 255 visible ASCII characters. The same key with the same body returns the same model"),
    ),
    request_body(content = ModelRequest, content_type = "application/json"),
    responses(
        (status = 202, description = "Accepted. The model is queued or running", body = Model, headers(
            ("location" = String, description = "The model, relative to this URL"),
            ("retry-after" = u32, description = "Seconds to wait before the next request"),
            ("preference-applied" = String, description = "`wait=N`, if the response was held"),
            ("idempotency-replayed" = String, description = "`true` if the key returned a model that it had created before"))),
        (status = 201, description = "A finished model with the same digest and preset was reused, so the new model \
            has already succeeded", body = Model, headers(
            ("location" = String, description = "The model, relative to this URL"))),
        (status = 200, description = "The model has ended, during the requested wait or before the key was used \
            again", body = Model, headers(
            ("location" = String, description = "The model, relative to this URL"),
            ("preference-applied" = String, description = "`wait=N`, if the response was held"),
            ("idempotency-replayed" = String, description = "`true` if the key returned a model that it had created before"))),
        BodyProblems, QueueFull, BodyUnavailable,
    )
)]
pub(in crate::http) async fn create(
    State(state): State<AppState>,
    caller: Caller,
    headers: HeaderMap,
    body: JsonBody,
) -> Result<Response, Problem> {
    let key = key_of(&headers, &body)?;
    let checked = check_body(&state, &body).await.and_then(|checked| check_storage(&state).map(|()| checked));
    let submitted = match checked {
        Ok(CheckedModel { request, spec, cost }) => {
            let new = NewJob { idempotency: key, ..new_job(&caller, request, &spec, &cost) };
            queue(&state, &caller, "model created", new).await?
        }
        // A repeated request gets its model, even if limits, live workers or storage have changed
        // in the meantime.
        Err(refusal) => Submitted::Replayed(earlier(&state, caller.owner(), key).await.ok_or(refusal)?),
    };
    // A held response needs no memory for its request.
    drop(body);
    let mut job = submitted.job().clone();
    tracing::Span::current().record("model", tracing::field::display(job.id));
    let waited = wait(&headers).and_then(|time| Some((time, state.held.take(caller.owner(), 1).ok()?)));
    if let Some((time, _)) = waited {
        job = until_ended(&state, job, time).await;
    }
    let mut response = created(&state, &submitted, &job, LinkBase::Root).await?;
    let headers = response.headers_mut();
    if let Some(Ok(applied)) = waited.map(|(time, _)| HeaderValue::try_from(format!("wait={}", time.as_secs()))) {
        headers.insert(PREFERENCE_APPLIED, applied);
    }
    Ok(response)
}

/// The response to a submission, with the present state of its job.
pub(in crate::http) async fn created(
    state: &AppState,
    submitted: &Submitted,
    job: &Job,
    base: LinkBase,
) -> Result<Response, Problem> {
    let status = match submitted {
        Submitted::Reused(_) => StatusCode::CREATED,
        _ if job.status.is_ended() => StatusCode::OK,
        _ => StatusCode::ACCEPTED,
    };
    let mut response = answer(state, status, job, Detail::Full, base).await?;
    let headers = response.headers_mut();
    set_location(headers, &base.model(job.id), matches!(submitted, Submitted::Replayed(_)));
    if status == StatusCode::ACCEPTED {
        headers.insert(header::RETRY_AFTER, retry_after(job));
    }
    Ok(response)
}

/// Adds the headers of a response to a submission: the location of the new resource, and that the
/// response is `replayed`.
pub(in crate::http) fn set_location(headers: &mut HeaderMap, location: &str, replayed: bool) {
    if let Ok(location) = HeaderValue::try_from(location) {
        headers.insert(header::LOCATION, location);
    }
    if replayed {
        headers.insert(IDEMPOTENCY_REPLAYED, HeaderValue::from_static("true"));
    }
}

/// The idempotency key and a hash of the body. Equal bodies have equal hashes, whatever their
/// layout.
pub(in crate::http) fn key_of(headers: &HeaderMap, body: &Value) -> Result<Option<(String, String)>, Problem> {
    Ok(idempotency_key(headers)?.map(|key| (key, hex::encode(Sha256::digest(canonical_json(body))))))
}

/// The job that an earlier request with the same key and body created.
pub(in crate::http) async fn earlier(
    state: &AppState,
    owner: Option<&str>,
    key: Option<(String, String)>,
) -> Option<Job> {
    let (key, body) = key?;
    state.store.replayed(owner, &key, &body).await.ok().flatten()
}

/// The job of a checked request.
pub(in crate::http) fn new_job(caller: &Caller, request: ModelRequest, spec: &ModelSpec, cost: &Cost) -> NewJob {
    let seed = request.seed.unwrap_or_else(draw_seed);
    NewJob {
        kind: JobKind::Model,
        preset: request.preset,
        seed,
        spec: spec.json(),
        outputs: request.outputs,
        backend: request.backend,
        labels: request.labels,
        priority: request.priority,
        digest: spec.digest(seed),
        engine: crate::ENGINE_VERSION.to_owned(),
        reuse: request.reuse,
        missing: Vec::new(),
        batch_key: Some(batch_key(spec)),
        short: cost.longest_seconds() <= NewJob::SHORT_SECONDS,
        idempotency: None,
        owner: caller.owner().map(str::to_owned),
        quota: caller.quota(),
        weight: 1,
        trace: trace::current(),
        retry_of: None,
    }
}

/// Queues a job, or reuses a finished model that has all its files. The audit log names the
/// `action`.
pub(in crate::http) async fn queue(
    state: &AppState,
    caller: &Caller,
    action: &'static str,
    mut new: NewJob,
) -> Result<Submitted, StoreError> {
    let (store, artifacts, caller) = (state.store.clone(), state.artifacts.clone(), caller.clone());
    run_to_completion(async move {
        let submitted = match store.submit_new(new.clone()).await? {
            Some(submitted) => submitted,
            None => {
                exclude_missing_files(&store, &artifacts, std::slice::from_mut(&mut new)).await?;
                store.submit(new).await?
            }
        };
        if !matches!(submitted, Submitted::Replayed(_)) {
            audit(&caller, action, submitted.job().id);
        }
        Ok(submitted)
    })
    .await
}

/// Draws a seed: 53 random bits of a UUIDv4.
pub(in crate::http) fn draw_seed() -> u64 {
    uuid::Uuid::new_v4().as_u64_pair().1 & SEED_MAX
}

/// Waits until a job has ended, at most for `time`, and returns its state then. The wait ends early
/// if the job is deleted or the service shuts down. The job is queued already, so the wait
/// continues while the job store is unavailable.
async fn until_ended(state: &AppState, job: Job, time: Duration) -> Job {
    if job.status.is_ended() {
        return job;
    }
    let mut reader = Reader::of_job(&state.feed, job.id);
    let ended = async {
        // The end may have been reported before the reader existed.
        state.feed.refresh(job.id).await;
        reader.ended().await;
    };
    tokio::select! {
        () = ended => {}
        () = tokio::time::sleep(time) => {}
        () = state.shutdown.cancelled() => {}
    }
    match state.store.get(job.id).await {
        Ok(latest) => latest.unwrap_or(job),
        Err(error) => {
            tracing::warn!(%error, "a model could not be read after a wait");
            job
        }
    }
}

/// Result of a check: the request as the service would queue it.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Validation {
    /// Preset that the spec was resolved on.
    preset: String,
    /// Seed; null if a random one will be drawn.
    #[schema(minimum = 0)]
    seed: Option<u64>,
    /// The complete resolved spec.
    #[schema(value_type = ModelSpec)]
    spec: SharedJson,
    /// Digest of the model; null if the seed will be drawn.
    digest: Option<String>,
    /// Predicted cost.
    cost: Cost,
}

/// Check a request and predict its cost, without queueing anything.
///
/// The response contains the complete spec. A full queue can still refuse a request that passes
/// this check.
#[utoipa::path(
    post, path = "/models/validate", operation_id = "validate_model", tag = "models",
    request_body(content = ModelRequest, content_type = "application/json"),
    responses(
        (status = 200, description = "The request is valid", body = Validation),
        BodyProblems, BodyUnavailable,
    )
)]
pub(in crate::http) async fn validate(State(state): State<AppState>, body: JsonBody) -> Result<Response, Problem> {
    let CheckedModel { request, spec, cost } = check_body(&state, &body).await?;
    let digest = request.seed.map(|seed| spec.digest(seed));
    Ok(Json(Validation {
        preset: request.preset,
        seed: request.seed,
        spec: spec.json(),
        digest,
        cost: Arc::unwrap_or_clone(cost),
    })
    .into_response())
}
