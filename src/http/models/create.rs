//! `POST /models` and `POST /models/validate`: from a request to a queued model.
//!
//! All checks are made before anything is queued.

use super::detail::Detail;
use super::links::At;
use super::read::{answer, retry_after};
use super::request::{ModelRequest, SEED_MAX};
use crate::generate::{Backend, Cost, Output, OverLimit};
use crate::http::AppState;
use crate::http::access::{Caller, audit, run_to_completion};
use crate::http::dto::Model;
use crate::http::events::Reader;
use crate::http::health::not_ready;
use crate::http::wire::faults::{Fault, Faults};
use crate::http::wire::headers::{IDEMPOTENCY_REPLAYED, PREFERENCE_APPLIED, idempotency_key, wait};
use crate::http::wire::json::{JsonBody, canonical};
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{
    BodyProblems, ModelRequest as ModelRequestDoc, QueueFull, SpecPatch, StoreAwayOrOpening,
};
use crate::jobs::reuse::exclude_missing_files;
use crate::jobs::{Job, JobKind, NewJob, StoreError, Submitted, WorkerKind};
use crate::spec::{ModelSpec, Preset, batch_key, preset, presets};
use crate::status::Condition;
use crate::trace;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::time::Duration;
use utoipa::ToSchema;

/// A request that passed all checks; only a full queue can refuse it.
pub(in crate::http) struct Accepted {
    pub(in crate::http) request: ModelRequest,
    pub(in crate::http) spec: ModelSpec,
    cost: Cost,
}

/// Reads and checks a body.
async fn check_body(state: &AppState, body: &Value) -> Result<Accepted, Problem> {
    let mut faults = Faults::default();
    let request = ModelRequest::read(body, &mut faults);
    check(state, request, faults).await
}

/// Checks a request in which `faults` were found so far.
pub(in crate::http) async fn check(
    state: &AppState,
    request: ModelRequest,
    mut faults: Faults,
) -> Result<Accepted, Problem> {
    let resolved = find_preset(&request, &mut faults).map(|preset| ModelSpec::resolve(preset, &request.spec));
    if let Some(Err(wrong)) = &resolved {
        faults.extend(wrong.iter().map(|f| Fault::at(format!("/spec{}", f.pointer), &f.detail)));
    }
    let spec = match resolved {
        Some(Ok(spec)) if faults.is_empty() => spec,
        _ => return Err(Problem::invalid(faults)),
    };
    check_limits(state, request, spec).await
}

/// Checks what a model would cost, and whether there is a worker for it.
pub(super) async fn check_limits(
    state: &AppState,
    request: ModelRequest,
    spec: ModelSpec,
) -> Result<Accepted, Problem> {
    let cost = cost(&request, &spec);
    state.limits.cost.check(&cost).map_err(|over| too_much(&cost, &over))?;
    check_backend(state, &request).await?;
    Ok(Accepted { request, spec, cost })
}

/// The preset of a request, or a fault.
pub(in crate::http) fn find_preset(request: &ModelRequest, faults: &mut Faults) -> Option<&'static Preset> {
    let found = preset(&request.preset);
    if found.is_none() && !faults.names("/preset") {
        let names: Vec<_> = presets().iter().map(|p| p.name.as_str()).collect();
        faults.push(Fault::at("/preset", format!("is unknown; the presets are {}", names.join(", "))));
    }
    found
}

/// The predicted cost of a model with the outputs of the request.
pub(in crate::http) fn cost(request: &ModelRequest, spec: &ModelSpec) -> Cost {
    Cost::new(spec, &request.outputs)
}

pub(in crate::http) fn too_much(cost: &Cost, over: &[OverLimit]) -> Problem {
    let place = |over: &OverLimit| if over.quantity == Output::Glb.name() { "/outputs" } else { "/spec" };
    let errors = over.iter().map(|o| Fault::at(place(o), o.to_string())).collect();
    let detail = over.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
    let limits: serde_json::Map<_, _> = over.iter().map(|o| (o.quantity.to_owned(), o.limit.into())).collect();
    Problem::new(Kind::CostLimit, detail)
        .with_errors(errors)
        .with("prediction", serde_json::to_value(cost).unwrap_or_default())
        .with("limit", Value::Object(limits))
}

/// Refuses a request for a GPU if no GPU worker is alive. While workers of this process open their devices, that is not
/// known yet, so the request waits for at most [`crate::http::Limits::gpu_wait`].
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
    let fault = Fault::at("/backend", "no GPU worker is available");
    Err(Problem::new(Kind::GpuUnavailable, detail).with_errors(vec![fault]))
}

/// Request a model.
///
/// It is queued and grown in the background. Follow it by `GET /models/{id}` or its events.
#[utoipa::path(
    post, path = "/models", operation_id = "create_model", tag = "models",
    params(
        ("prefer" = Option<String>, Header, description = "`wait=N`: hold the response until the model has ended, at most N seconds (1 to 60). If too many responses are held already, it is sent at once, without `preference-applied`"),
        ("idempotency-key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[!-~]+$", description = "1 to 255 visible ASCII characters. The same key with the same body returns the same model"),
    ),
    request_body(content = ModelRequestDoc, content_type = "application/json"),
    responses(
        (status = 202, description = "Accepted: queued or running", body = Model, headers(
            ("location" = String, description = "The model, relative to this URL"),
            ("retry-after" = u32, description = "Seconds to wait before the next request"),
            ("preference-applied" = String, description = "`wait=N`, if the response was held"),
            ("idempotency-replayed" = String, description = "`true` if the key returned a model that it had created before"))),
        (status = 201, description = "A finished model with the same digest and preset was reused: it has succeeded already", body = Model, headers(
            ("location" = String, description = "The model, relative to this URL"))),
        (status = 200, description = "Ended: during the requested wait, or before the key was used again", body = Model, headers(
            ("location" = String, description = "The model, relative to this URL"),
            ("preference-applied" = String, description = "`wait=N`, if the response was held"),
            ("idempotency-replayed" = String, description = "`true` if the key returned a model that it had created before"))),
        BodyProblems, QueueFull, StoreAwayOrOpening,
    )
)]
pub(in crate::http) async fn create(
    State(state): State<AppState>,
    caller: Caller,
    headers: HeaderMap,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let key = key_of(&headers, &body)?;
    let submitted = match check_body(&state, &body).await {
        Ok(Accepted { request, spec, .. }) => {
            queue(&state, &caller, NewJob { idempotency: key, ..new_job(&caller, request, &spec) }).await?
        }
        // A replayed request is not refused because of what has changed since: a lower limit, or a GPU worker that has gone.
        Err(refusal) => Submitted::Replayed(earlier(&state, caller.owner(), key).await.ok_or(refusal)?),
    };
    let mut job = submitted.job().clone();
    tracing::Span::current().record("model", tracing::field::display(job.id));
    let waited = wait(&headers).and_then(|time| Some((time, state.held.try_acquire().ok()?)));
    if let Some((time, _)) = waited {
        job = until_ended(&state, job, time).await;
    }
    let mut response = created(&state, &submitted, &job, At::Root)?;
    let headers = response.headers_mut();
    if let Some(Ok(applied)) = waited.map(|(time, _)| HeaderValue::try_from(format!("wait={}", time.as_secs()))) {
        headers.insert(PREFERENCE_APPLIED, applied);
    }
    Ok(response)
}

/// The answer to a submission, with the job as it is now.
pub(in crate::http) fn created(
    state: &AppState,
    submitted: &Submitted,
    job: &Job,
    at: At,
) -> Result<Response, Problem> {
    let status = match submitted {
        Submitted::Reused(_) => StatusCode::CREATED,
        _ if job.status.is_ended() => StatusCode::OK,
        _ => StatusCode::ACCEPTED,
    };
    let mut response = answer(state, status, job, Detail::Full, at)?;
    let headers = response.headers_mut();
    set_location(headers, &at.model(job.id), matches!(submitted, Submitted::Replayed(_)));
    if status == StatusCode::ACCEPTED {
        headers.insert(header::RETRY_AFTER, retry_after(job));
    }
    Ok(response)
}

/// Says where the answer to a submission lies, and whether it was replayed.
pub(in crate::http) fn set_location(headers: &mut HeaderMap, location: &str, replayed: bool) {
    if let Ok(location) = HeaderValue::try_from(location) {
        headers.insert(header::LOCATION, location);
    }
    if replayed {
        headers.insert(IDEMPOTENCY_REPLAYED, HeaderValue::from_static("true"));
    }
}

/// The idempotency key, if there is one, with a hash of the body.
pub(in crate::http) fn key_of(headers: &HeaderMap, body: &Value) -> Result<Option<(String, String)>, Problem> {
    Ok(idempotency_key(headers)?.map(|key| (key, hex::encode(Sha256::digest(canonical(body))))))
}

/// The model that the key created before, if there is one.
pub(in crate::http) async fn earlier(
    state: &AppState,
    owner: Option<&str>,
    key: Option<(String, String)>,
) -> Option<Job> {
    let (key, body) = key?;
    state.store.replayed(owner, &key, &body).await.ok().flatten()
}

/// The job of an accepted request.
pub(in crate::http) fn new_job(caller: &Caller, request: ModelRequest, spec: &ModelSpec) -> NewJob {
    let seed = request.seed.unwrap_or_else(draw_seed);
    NewJob {
        kind: JobKind::Model,
        preset: request.preset,
        seed,
        spec: spec.to_json(),
        outputs: request.outputs,
        backend: request.backend,
        labels: request.labels,
        priority: request.priority,
        digest: spec.digest(seed),
        engine: crate::ENGINE_VERSION.to_owned(),
        reuse: request.reuse,
        missing: Vec::new(),
        batch_key: Some(batch_key(spec)),
        idempotency: None,
        owner: caller.owner().map(str::to_owned),
        quota: caller.quota(),
        trace: trace::current(),
        retry_of: None,
    }
}

/// Queues a job, or reuses a finished model that has all its files.
pub(in crate::http) async fn queue(
    state: &AppState,
    caller: &Caller,
    mut new: NewJob,
) -> Result<Submitted, StoreError> {
    exclude_missing_files(&state.store, &state.artifacts, std::slice::from_mut(&mut new)).await?;
    let action = if new.retry_of.is_some() { "model retried" } else { "model created" };
    let (store, caller) = (state.store.clone(), caller.clone());
    run_to_completion(async move {
        let submitted = store.submit(new).await?;
        if !matches!(submitted, Submitted::Replayed(_)) {
            audit(&caller, action, submitted.job().id);
        }
        Ok(submitted)
    })
    .await
}

/// A random seed: 53 of the random bits of a UUIDv4.
pub(in crate::http) fn draw_seed() -> u64 {
    uuid::Uuid::new_v4().as_u64_pair().1 & SEED_MAX
}

/// The job once it has ended, or as it is when the time is up, it is deleted, or the service closes. It is queued already,
/// so the wait goes on while the store is unavailable.
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
        Ok(now) => now.unwrap_or(job),
        Err(error) => {
            tracing::warn!(%error, "a model could not be read after a wait");
            job
        }
    }
}

/// The result of a check: what would be queued.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Validation {
    /// Preset that the spec was resolved on.
    preset: String,
    /// Seed; null if a random one will be drawn.
    #[schema(minimum = 0)]
    seed: Option<u64>,
    /// The complete resolved spec.
    #[schema(value_type = SpecPatch)]
    spec: Value,
    /// Digest of the model; null if the seed will be drawn.
    digest: Option<String>,
    /// Predicted cost.
    cost: Cost,
}

/// Check a request and predict its cost, without queueing anything.
///
/// The answer has the complete spec. A request that passes can still be refused by a full queue.
#[utoipa::path(
    post, path = "/models/validate", operation_id = "validate_model", tag = "models",
    request_body(content = ModelRequestDoc, content_type = "application/json"),
    responses((status = 200, description = "The request is valid", body = Validation), BodyProblems, StoreAwayOrOpening)
)]
pub(in crate::http) async fn validate(
    State(state): State<AppState>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let Accepted { request, spec, cost } = check_body(&state, &body).await?;
    let digest = request.seed.map(|seed| spec.digest(seed));
    Ok(Json(Validation { preset: request.preset, seed: request.seed, spec: spec.to_json(), digest, cost })
        .into_response())
}
