//! `POST /batches`, `GET` and `DELETE /batches/{id}`: many models of one spec, requested and deleted together.
//!
//! A batch is accepted as a whole or not at all. Its models are ordinary models with ids of their own.

use super::AppState;
use super::create::{Accepted, check, draw_seed, key_of};
use super::dto::Batch;
use super::extract::{BatchId, no_batch};
use super::faults::Faults;
use super::headers::IDEMPOTENCY_REPLAYED;
use super::json::JsonBody;
use super::problem::Problem;
use super::request::{BatchRequest, Seeds};
use super::responses::{
    BatchMissing, BatchRequest as BatchRequestDoc, BodyProblems, QueueFull, StoreAway, StoreAwayOrOpening,
};
use crate::jobs::reuse::exclude_missing_files;
use crate::jobs::{self, NewBatch, NewJob, StoreError, SubmittedBatch};
use crate::spec::batch_key;
use crate::trace;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::Value;
use std::collections::BTreeSet;

/// Request many models of one spec.
///
/// Either all of them are queued, or none. Finished models of the same digest are reused as by `POST /models`.
#[utoipa::path(
    post, path = "/batches", operation_id = "create_batch", tag = "batches",
    params(
        ("idempotency-key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[!-~]+$", description = "1 to 255 visible ASCII characters. The same key with the same body returns the same batch"),
    ),
    request_body(content = BatchRequestDoc, content_type = "application/json"),
    responses(
        (status = 202, description = "Accepted", body = Batch, headers(
            ("location" = String, description = "Path of the batch"),
            ("retry-after" = u32, description = "Seconds to wait before the next request"),
            ("idempotency-replayed" = String, description = "`true` if the key returned a batch that it had created before"))),
        BodyProblems, QueueFull, StoreAwayOrOpening,
    )
)]
pub(super) async fn create(
    State(state): State<AppState>,
    headers: HeaderMap,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let key = key_of(&headers, &body)?;
    let submitted = match check_body(&state, &body).await {
        Ok(accepted) => submit(&state, accepted, key).await?,
        // As for a model: a replayed request is not refused because of what has changed since.
        Err(refusal) => SubmittedBatch::Replayed(earlier(&state, key).await.ok_or(refusal)?),
    };
    let mut response = answer(StatusCode::ACCEPTED, &Batch::from(submitted.batch()));
    let headers = response.headers_mut();
    if let Ok(location) = HeaderValue::try_from(format!("/batches/{}", submitted.batch().id)) {
        headers.insert(header::LOCATION, location);
    }
    if matches!(submitted, SubmittedBatch::Replayed(_)) {
        headers.insert(IDEMPOTENCY_REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}

/// Reads and checks a body.
async fn check_body(state: &AppState, body: &Value) -> Result<(Seeds, Accepted), Problem> {
    let mut faults = Faults::default();
    let BatchRequest { seeds, each } = BatchRequest::read(body, state.limits.batch, &mut faults);
    Ok((seeds, check(state, each, faults).await?))
}

/// The batch that the key created before, if there is one.
async fn earlier(state: &AppState, key: Option<(String, String)>) -> Option<jobs::Batch> {
    let (key, body) = key?;
    state.store.replayed_batch(&key, &body).await.ok().flatten()
}

async fn submit(
    state: &AppState,
    (seeds, Accepted { request, spec, .. }): (Seeds, Accepted),
    idempotency: Option<(String, String)>,
) -> Result<SubmittedBatch, StoreError> {
    let canonical_spec = spec.to_json();
    let (key, trace) = (batch_key(&spec), trace::current());
    let job = |seed: u64| NewJob {
        preset: request.preset.clone(),
        seed,
        spec: canonical_spec.clone(),
        outputs: request.outputs.clone(),
        backend: request.backend,
        labels: request.labels.clone(),
        priority: request.priority,
        digest: spec.digest(seed),
        engine: crate::ENGINE_VERSION.to_owned(),
        reuse: request.reuse,
        missing: Vec::new(),
        batch_key: Some(key.clone()),
        idempotency: None,
        submitter: None,
        trace: trace.clone(),
    };
    let seeds = match seeds {
        Seeds::These(seeds) => seeds,
        Seeds::Count(count) => draw(count),
    };
    let mut jobs: Vec<NewJob> = seeds.into_iter().map(job).collect();
    exclude_missing_files(&*state.store, &state.artifacts, &mut jobs).await?;
    state.store.submit_batch(NewBatch { jobs, priority: request.priority, idempotency }).await
}

/// So many random seeds, all different.
fn draw(count: usize) -> Vec<u64> {
    let mut seen = BTreeSet::new();
    std::iter::repeat_with(draw_seed).filter(|seed| seen.insert(*seed)).take(count).collect()
}

fn answer(status: StatusCode, batch: &Batch) -> Response {
    let mut response = (status, Json(batch)).into_response();
    if batch.counts.queued + batch.counts.running > 0 {
        response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("2"));
    }
    response
}

/// Read a batch: the ids of its models, and their number by status.
#[utoipa::path(
    get, path = "/batches/{id}", operation_id = "get_batch", tag = "batches",
    params(("id" = Uuid, Path, description = "Id of the batch")),
    responses(
        (status = 200, description = "The batch", body = Batch, headers(
            ("retry-after" = u32, description = "Seconds to wait before the next request; absent once all models have ended"))),
        BatchMissing, StoreAway,
    )
)]
pub(super) async fn get(State(state): State<AppState>, BatchId(id): BatchId) -> Result<Response, Problem> {
    let batch = state.store.batch(id).await?.ok_or_else(|| no_batch(id))?;
    Ok(answer(StatusCode::OK, &Batch::from(&batch)))
}

/// Delete a batch with all its models; those that have not ended are cancelled.
#[utoipa::path(
    delete, path = "/batches/{id}", operation_id = "delete_batch", tag = "batches",
    params(("id" = Uuid, Path, description = "Id of the batch")),
    responses((status = 204, description = "The batch, its models and their files were deleted"), BatchMissing, StoreAway)
)]
pub(super) async fn delete(State(state): State<AppState>, BatchId(id): BatchId) -> Result<StatusCode, Problem> {
    let keys = state.store.delete_batch(id).await?.ok_or_else(|| no_batch(id))?;
    state.forget(keys).await;
    Ok(StatusCode::NO_CONTENT)
}
