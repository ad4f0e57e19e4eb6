//! `POST /models` and `POST /models/validate`: from a request to a queued model.
//!
//! Everything that can be refused is refused before anything is queued.

use super::AppState;
use super::dto::Model;
use super::faults::Faults;
use super::headers::{IDEMPOTENCY_REPLAYED, PREFERENCE_APPLIED, idempotency_key, wait};
use super::json::{JsonBody, canonical};
use super::models::{answer, retry_after};
use super::openapi::{BodyProblems, ModelRequest as ModelRequestDoc, QueueFull, StoreAway};
use super::problem::{Fault, Kind, Problem};
use super::request::{ModelRequest, SEED_MAX};
use crate::generate::Backend;
use crate::jobs::reuse::exclude_missing_files;
use crate::jobs::{Job, NewJob, StoreError, Submitted};
use crate::spec::{Cost, ModelSpec, OverLimit, batch_key, preset, presets};
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

/// A request that will be taken, save for a full queue.
pub(super) struct Accepted {
    pub(super) request: ModelRequest,
    pub(super) spec: ModelSpec,
    cost: Cost,
}

/// Checks everything about a body.
async fn check_body(state: &AppState, body: &Value) -> Result<Accepted, Problem> {
    let mut faults = Faults::default();
    let request = ModelRequest::read(body, &mut faults);
    check(state, request, faults).await
}

/// Checks everything about a request in which `faults` were found so far.
pub(super) async fn check(state: &AppState, request: ModelRequest, mut faults: Faults) -> Result<Accepted, Problem> {
    let resolved = preset(&request.preset).map(|preset| ModelSpec::resolve(preset, &request.spec));
    match &resolved {
        Some(Err(wrong)) => faults.extend(wrong.iter().map(|f| Fault::at(format!("/spec{}", f.pointer), &f.detail))),
        None if !faults.names("/preset") => {
            let names: Vec<_> = presets().iter().map(|p| p.name.as_str()).collect();
            faults.push(Fault::at("/preset", format!("is unknown; there are {}", names.join(", "))));
        }
        _ => {}
    }
    let spec = match resolved {
        Some(Ok(spec)) if faults.is_empty() => spec,
        _ => return Err(Problem::invalid(faults)),
    };
    let outputs: Vec<String> =
        request.outputs.iter().filter_map(|o| serde_json::to_value(o).ok()?.as_str().map(str::to_owned)).collect();
    let cost = spec.cost(&outputs.iter().map(String::as_str).collect::<Vec<_>>());
    state.limits.cost.check(&cost).map_err(|over| too_much(&cost, &over))?;
    if request.backend == Backend::Gpu && !gpu_alive(state).await? {
        let detail = "No GPU worker has been alive for five minutes; ask for `auto` or `cpu`.";
        return Err(Problem::new(Kind::GpuUnavailable, detail)
            .with_errors(vec![Fault::at("/backend", "no GPU worker is available")]));
    }
    Ok(Accepted { request, spec, cost })
}

fn too_much(cost: &Cost, over: &[OverLimit]) -> Problem {
    let errors = over.iter().map(|o| Fault::at("/spec", o.to_string())).collect();
    let detail = over.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
    let limits: serde_json::Map<_, _> = over.iter().map(|o| (o.quantity.clone(), o.limit.into())).collect();
    Problem::new(Kind::CostLimit, detail)
        .with_errors(errors)
        .with("prediction", serde_json::to_value(cost).unwrap_or_default())
        .with("limit", Value::Object(limits))
}

async fn gpu_alive(state: &AppState) -> Result<bool, Problem> {
    Ok(state.store.alive(Backend::Gpu, state.limits.gpu_memory).await? > 0)
}

/// Ask for a model.
///
/// It is queued and grown in the background; follow it by `GET /models/{id}` or its events.
#[utoipa::path(
    post, path = "/models", operation_id = "create_model", tag = "models",
    params(
        ("prefer" = Option<String>, Header, description = "`wait=N`: hold the answer until the model has ended, at most N seconds (1 to 60). Where too many answers are held already, it comes at once, without `preference-applied`"),
        ("idempotency-key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[!-~]+$", description = "1 to 255 visible ASCII characters: the same key with the same body gives the same model"),
    ),
    request_body(content = ModelRequestDoc, content_type = "application/json"),
    responses(
        (status = 202, description = "Accepted: queued or running", body = Model, headers(
            ("location" = String, description = "Address of the model"),
            ("retry-after" = u32, description = "Seconds after which to look again"),
            ("preference-applied" = String, description = "`wait=N`, where it was asked for and the answer was held"),
            ("idempotency-replayed" = String, description = "`true` where the key had made the model before"))),
        (status = 201, description = "A finished model with the same digest and preset was taken: succeeded already", body = Model, headers(
            ("location" = String, description = "Address of the model"))),
        (status = 200, description = "Ended: within the wait asked for, or before the key came again", body = Model, headers(
            ("location" = String, description = "Address of the model"),
            ("preference-applied" = String, description = "`wait=N`, where it was asked for and the answer was held"),
            ("idempotency-replayed" = String, description = "`true` where the key had made the model before"))),
        BodyProblems, QueueFull, StoreAway,
    )
)]
pub(super) async fn create(
    State(state): State<AppState>,
    headers: HeaderMap,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let key = key_of(&headers, &body)?;
    // Subscribed before the model exists, so that its end cannot be missed.
    let (mut watch, number) = (state.feed.watch(), state.feed.head());
    let submitted = match check_body(&state, &body).await {
        Ok(accepted) => submit(&state, accepted, key).await?,
        // What was taken once is not refused for what came later: a lower limit, a GPU that went away.
        Err(refusal) => Submitted::Replayed(earlier(&state, key).await.ok_or(refusal)?),
    };
    let replayed = matches!(submitted, Submitted::Replayed(_));
    let mut job = submitted.job().clone();
    tracing::Span::current().record("model", tracing::field::display(job.id));
    let waited = wait(&headers).and_then(|time| Some((time, state.held.try_acquire().ok()?)));
    if let Some((time, _)) = waited {
        job = until_ended(&state, job, time, &mut watch, number).await;
    }
    let status = match () {
        () if job.reused_from.is_some() => StatusCode::CREATED,
        () if job.status.is_ended() => StatusCode::OK,
        () => StatusCode::ACCEPTED,
    };
    let mut response = answer(&state, status, &job)?;
    let headers = response.headers_mut();
    if let Ok(location) = HeaderValue::try_from(format!("/models/{}", job.id)) {
        headers.insert(header::LOCATION, location);
    }
    if status == StatusCode::ACCEPTED {
        headers.insert(header::RETRY_AFTER, retry_after(&job));
    }
    if let Some(Ok(applied)) = waited.map(|(time, _)| HeaderValue::try_from(format!("wait={}", time.as_secs()))) {
        headers.insert(PREFERENCE_APPLIED, applied);
    }
    if replayed {
        headers.insert(IDEMPOTENCY_REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}

/// The idempotency key, where there is one, with a hash of the body that it stands for.
pub(super) fn key_of(headers: &HeaderMap, body: &Value) -> Result<Option<(String, String)>, Problem> {
    Ok(idempotency_key(headers)?.map(|key| (key, hex::encode(Sha256::digest(canonical(body))))))
}

/// The model that the key made before, where it is known.
async fn earlier(state: &AppState, key: Option<(String, String)>) -> Option<Job> {
    let (key, body) = key?;
    state.store.replayed(&key, &body).await.ok().flatten()
}

async fn submit(
    state: &AppState,
    Accepted { request, spec, .. }: Accepted,
    idempotency: Option<(String, String)>,
) -> Result<Submitted, StoreError> {
    let seed = request.seed.unwrap_or_else(draw_seed);
    let mut new = NewJob {
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
        batch_key: Some(batch_key(&spec)),
        idempotency,
        submitter: None,
        trace: trace::current(),
    };
    exclude_missing_files(&*state.store, &state.artifacts, std::slice::from_mut(&mut new)).await?;
    state.store.submit(new).await
}

/// A seed nobody chose: 53 of the random bits of a UUIDv4.
pub(super) fn draw_seed() -> u64 {
    uuid::Uuid::new_v4().as_u64_pair().1 & SEED_MAX
}

/// The job once it has ended, or as it is when the time is up, it is deleted, or the service closes. It has been taken,
/// so a store that is away changes nothing about the answer: the wait goes on.
async fn until_ended(
    state: &AppState,
    mut job: Job,
    time: Duration,
    watch: &mut tokio::sync::watch::Receiver<u64>,
    mut number: u64,
) -> Job {
    let end = tokio::time::sleep(time);
    tokio::pin!(end);
    while !job.status.is_ended() {
        tokio::select! {
            () = state.feed.changed(job.id, watch, number) => {}
            () = tokio::time::sleep(state.limits.event_poll) => {}
            () = &mut end => break,
            () = state.shutdown.cancelled() => break,
        }
        number = state.feed.head();
        match state.store.get(job.id).await {
            Ok(Some(now)) => job = now,
            Ok(None) => break,
            Err(error) => tracing::warn!(%error, "a model that is waited for could not be read"),
        }
    }
    job
}

/// What a request would give.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Validation {
    /// Preset.
    preset: String,
    /// Seed; null where one will be drawn.
    #[schema(minimum = 0)]
    seed: Option<u64>,
    /// The whole resolved spec.
    #[schema(value_type = Object)]
    spec: Value,
    /// Digest; null where the seed will be drawn.
    digest: Option<String>,
    /// Predicted cost.
    cost: Cost,
}

/// Check a request and predict its cost; queues nothing.
#[utoipa::path(
    post, path = "/models/validate", operation_id = "validate_model", tag = "models",
    request_body(content = ModelRequestDoc, content_type = "application/json"),
    responses((status = 200, description = "The request is valid", body = Validation), BodyProblems, StoreAway)
)]
pub(super) async fn validate(State(state): State<AppState>, JsonBody(body): JsonBody) -> Result<Response, Problem> {
    let Accepted { request, spec, cost } = check_body(&state, &body).await?;
    let digest = request.seed.map(|seed| spec.digest(seed));
    Ok(Json(Validation { preset: request.preset, seed: request.seed, spec: spec.to_json(), digest, cost })
        .into_response())
}
