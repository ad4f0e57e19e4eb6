//! `POST /batches` and `POST /batches/validate`: from a request to queued models.

use super::batch::Batch;
use super::check::{CheckedBatch, CheckedPoint, check_body};
use super::read::answer;
use super::request::{BatchRequest, BatchSeeds};
use super::study::StoredStudy;
use crate::generate::Cost;
use crate::http::AppState;
use crate::http::access::{Caller, audit, run_to_completion};
use crate::http::health::check_storage;
use crate::http::models::create::{draw_seed, key_of, new_job, set_location};
use crate::http::wire::blocking::blocking;
use crate::http::wire::json::JsonBody;
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{BodyProblems, BodyUnavailable, QueueFull};
use crate::http::wire::shares::Turn;
use crate::jobs::reuse::exclude_missing_files;
use crate::jobs::{self, NewBatch, NewJob, StoreError, SubmittedBatch};
use crate::spec::openapi::ParameterValue;
use crate::spec::study::Study;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::Response;
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use utoipa::ToSchema;

/// Request many models of one spec, or of the points of a study.
///
/// The service queues all of the models or none. Finished models with the same digest are reused as
/// by `POST /models`.
#[utoipa::path(
    post, path = "/batches", operation_id = "create_batch", tag = "batches",
    params(
        ("idempotency-key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[!-~]+$", description = "1 to 255 visible ASCII characters. The same key with the same body returns the same batch"),
    ),
    request_body(content = BatchRequest, content_type = "application/json"),
    responses(
        (status = 202, description = "Accepted", body = Batch, headers(
            ("location" = String, description = "The batch, relative to this URL"),
            ("retry-after" = u32, description = "Seconds to wait before the next request"),
            ("idempotency-replayed" = String, description = "`true` if the key returned a batch that it had created before"))),
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
    let turn = turn(&state, &caller).await?;
    let checked = check_body(&state, &body, &turn).await.and_then(|checked| check_storage(&state).map(|()| checked));
    let submitted = match checked {
        Ok(checked) => submit(&state, &caller, checked, &body["vary"], key, turn).await?,
        // A repeated request gets its batch, even if limits, live workers or storage have changed
        // in the meantime.
        Err(refusal) => SubmittedBatch::Replayed(earlier(&state, &caller, key).await.ok_or(refusal)?),
    };
    let mut response = answer(StatusCode::ACCEPTED, &Batch::from(submitted.batch()));
    let location = format!("batches/{}", submitted.batch().id);
    set_location(response.headers_mut(), &location, matches!(submitted, SubmittedBatch::Replayed(_)));
    Ok(response)
}

/// Waits for a turn to check and queue a batch. Its models take much more memory than its body.
async fn turn(state: &AppState, caller: &Caller) -> Result<Turn, Problem> {
    state.batches.turn(caller.owner(), state.limits.picture_wait).await.ok_or_else(|| {
        Problem::new(Kind::TooManyBodies, "Many batches are being checked and queued. Try again later.")
            .with_header(header::RETRY_AFTER, 5)
    })
}

/// The batch that an earlier request with the same key and body created.
async fn earlier(state: &AppState, caller: &Caller, key: Option<(String, String)>) -> Option<jobs::Batch> {
    let (key, body) = key?;
    state.store.replayed_batch(caller.owner(), &key, &body).await.ok().flatten()
}

async fn submit(
    state: &AppState,
    caller: &Caller,
    CheckedBatch { request, seeds, study, points }: CheckedBatch,
    vary: &Value,
    idempotency: Option<(String, String)>,
    turn: Turn,
) -> Result<SubmittedBatch, Problem> {
    let seeds = match seeds {
        BatchSeeds::Given(seeds) => seeds,
        BatchSeeds::Drawn(count) => draw(count),
    };
    let (by, priority) = (caller.clone(), request.priority);
    let (mut jobs, seeds) = blocking("Making the batch", turn.clone(), move || {
        let mut jobs = Vec::with_capacity(points.len() * seeds.len());
        for CheckedPoint { spec, cost } in &points {
            let new = new_job(&by, request.clone(), spec, cost);
            jobs.extend(seeds.iter().map(|&seed| NewJob { seed, digest: spec.digest(seed), ..new.clone() }));
        }
        (jobs, seeds)
    })
    .await?;
    let study = study.map(|study| StoredStudy::new(vary.clone(), &study, seeds).to_json());
    exclude_missing_files(&state.store, &state.artifacts, &mut jobs).await?;
    let (owner, quota) = (caller.owner().map(str::to_owned), caller.quota());
    let batch = NewBatch { jobs, owner, quota, priority, study, idempotency };
    let (store, caller) = (state.store.clone(), caller.clone());
    run_to_completion(async move {
        let _turn = turn;
        let submitted = store.submit_batch(batch).await?;
        if matches!(submitted, SubmittedBatch::Accepted(_)) {
            audit(&caller, "batch created", submitted.batch().id);
        }
        Ok::<_, StoreError>(submitted)
    })
    .await
    .map_err(Problem::from)
}

/// Draws `count` different seeds.
fn draw(count: usize) -> Vec<u64> {
    let mut seen = BTreeSet::new();
    std::iter::repeat_with(draw_seed).filter(|seed| seen.insert(*seed)).take(count).collect()
}

/// Result of a check: the request as the service would queue it.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct BatchValidation {
    /// Preset that the specs were resolved on.
    preset: String,
    /// Number of models: the number of points times the number of seeds.
    #[schema(minimum = 1)]
    models: usize,
    /// Seeds of each point; null if the service will draw them.
    #[schema(minimum = 0)]
    seeds: Option<Vec<u64>>,
    /// Points of the study; without a study, a single point without values.
    points: Vec<PointValidation>,
    /// Predicted cost of all models.
    cost: BatchCost,
}

/// A point of a study.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct PointValidation {
    /// Varied values, by JSON pointer.
    #[schema(value_type = BTreeMap<String, ParameterValue>)]
    values: Map<String, Value>,
    /// Predicted cost of one model.
    cost: Cost,
}

/// Predicted cost of a batch.
#[derive(Debug, Default, Serialize, ToSchema)]
pub(super) struct BatchCost {
    /// Seconds for growing all models one after the other, by backend.
    seconds: BTreeMap<String, f64>,
    /// Size of all files, bytes.
    #[schema(minimum = 0)]
    bytes: u64,
    /// Peak memory of the model that needs most memory, bytes.
    #[schema(minimum = 0)]
    memory_bytes: u64,
}

/// Check a request for a batch and predict its cost, without queueing anything.
///
/// The response contains the cost of each point. A full queue can still refuse a request that
/// passes this check.
#[utoipa::path(
    post, path = "/batches/validate", operation_id = "validate_batch", tag = "batches",
    request_body(content = BatchRequest, content_type = "application/json"),
    responses(
        (status = 200, description = "The request is valid", body = BatchValidation),
        BodyProblems, BodyUnavailable,
    )
)]
pub(in crate::http) async fn validate(
    State(state): State<AppState>,
    caller: Caller,
    body: JsonBody,
) -> Result<Json<BatchValidation>, Problem> {
    let CheckedBatch { request, seeds, study, points } =
        check_body(&state, &body, &turn(&state, &caller).await?).await?;
    let mut total = BatchCost::default();
    for Cost { seconds, bytes, memory_bytes, .. } in points.iter().map(|point| &point.cost) {
        for (backend, estimate) in seconds {
            *total.seconds.entry(backend.clone()).or_default() += estimate.seconds * seeds.len() as f64;
        }
        total.bytes = total.bytes.saturating_add(bytes.values().sum::<u64>().saturating_mul(seeds.len() as u64));
        total.memory_bytes = total.memory_bytes.max(*memory_bytes);
    }
    let values = |point: usize| study.as_deref().map_or_else(Map::new, |study| named(study, point));
    Ok(Json(BatchValidation {
        preset: request.preset,
        models: points.len() * seeds.len(),
        points: (0..).zip(points).map(|(i, point)| PointValidation { values: values(i), cost: point.cost }).collect(),
        seeds: match seeds {
            BatchSeeds::Given(seeds) => Some(seeds),
            BatchSeeds::Drawn(_) => None,
        },
        cost: total,
    }))
}

fn named(study: &Study, point: usize) -> Map<String, Value> {
    study.pointers().iter().cloned().zip(study.values(point).cloned()).collect()
}
