//! `GET /batches`; `GET` and `DELETE /batches/{id}`. Reading the models of a batch.

use super::batch::{Batch, BatchList};
use crate::http::AppState;
use crate::http::access::{Caller, audited};
use crate::http::models::select;
use crate::http::wire::extract::{BatchId, Parameters, no_batch};
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{BadParameters, BatchMissing, StoresUnavailable};
use crate::jobs::{self, BatchFilter, BatchId as StoredBatchId, Job, JobId, ListFilter, StoreError};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::collections::BTreeMap;

/// Number of models that are read at a time.
const PAGE: u32 = 100;

/// A batch as a response.
pub(super) fn answer(status: StatusCode, batch: &Batch) -> Response {
    let mut response = (status, Json(batch)).into_response();
    if batch.counts.queued + batch.counts.running > 0 {
        response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("2"));
    }
    response
}

/// List batches, newest first, without the ids of their models.
///
/// Each batch has the number of its models by status.
#[utoipa::path(
    get, path = "/batches", operation_id = "list_batches", tag = "batches",
    params(
        ("owner" = Option<String>, Query, pattern = "^[^\\u0000]*$", description = "Only batches of this owner; without the scope `admin`, only the caller's own name is allowed"),
        ("created_after" = Option<String>, Query, format = DateTime, description = "Only batches accepted at this time (RFC 3339) or later"),
        ("created_before" = Option<String>, Query, format = DateTime, description = "Only batches accepted before this time (RFC 3339)"),
        ("limit" = Option<u32>, Query, minimum = 1, maximum = 100,
            description = "Maximum number of batches on the page; 20 by default"),
        ("cursor" = Option<String>, Query, format = Uuid, description = "`next` of the previous page"),
    ),
    responses((status = 200, description = "A page of batches", body = BatchList), BadParameters, StoresUnavailable)
)]
pub(in crate::http) async fn list(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
) -> Result<Json<BatchList>, Problem> {
    let mut faults = parameters.faults(&["owner", "created_after", "created_before", "limit", "cursor"], &[]);
    let ListFilter { owner, created_after, created_before, .. } = select::read(&parameters, &caller, &mut faults);
    let (limit, before) = select::page(&parameters, &mut faults);
    Problem::check(faults)?;
    let before = before.map(|JobId(id)| StoredBatchId(id));
    let page = state.store.batches(&BatchFilter { owner, created_after, created_before, before, limit }).await?;
    let batches = page.batches.iter().map(|batch| Batch { models: None, study: None, ..Batch::from(batch) }).collect();
    Ok(Json(BatchList { batches, next: page.next.map(|id| id.to_string()) }))
}

/// Read a batch: the ids of its models, their number by status, and its study.
///
/// Models that were deleted individually are not listed.
#[utoipa::path(
    get, path = "/batches/{id}", operation_id = "get_batch", tag = "batches",
    params(("id" = Uuid, Path, description = "Id of the batch")),
    responses(
        (status = 200, description = "The batch", body = Batch, headers(
            ("retry-after" = u32, description = "Seconds to wait before the next request; absent once all models have ended"))),
        BatchMissing, StoresUnavailable,
    )
)]
pub(in crate::http) async fn get(
    State(state): State<AppState>,
    caller: Caller,
    BatchId(id): BatchId,
) -> Result<Response, Problem> {
    let batch = find_batch(&state, &caller, id).await?;
    Ok(answer(StatusCode::OK, &Batch::from(&batch)))
}

/// Delete a batch with all its models; models that have not ended are cancelled first.
///
/// Files that another model shares are kept.
#[utoipa::path(
    delete, path = "/batches/{id}", operation_id = "delete_batch", tag = "batches",
    params(("id" = Uuid, Path, description = "Id of the batch")),
    responses(
        (status = 204, description = "The batch, its models and their files were deleted"),
        BatchMissing, StoresUnavailable,
    )
)]
pub(in crate::http) async fn delete(
    State(state): State<AppState>,
    caller: Caller,
    BatchId(id): BatchId,
) -> Result<StatusCode, Problem> {
    find_batch(&state, &caller, id).await?;
    let store = state.store.clone();
    let deleted = audited(&caller, "batch deleted", id, async move { store.delete_batch(id).await });
    let keys = deleted.await?.ok_or_else(|| no_batch(id))?;
    state.forget(keys).await;
    Ok(StatusCode::NO_CONTENT)
}

/// A batch that the caller may see.
pub(in crate::http) async fn find_batch(
    state: &AppState,
    caller: &Caller,
    id: StoredBatchId,
) -> Result<jobs::Batch, Problem> {
    caller.batch(state.store.batch(id).await?).ok_or_else(|| no_batch(id))
}

/// Calls `each` with the place and the record of every model of a batch, in their order. Skips
/// models that have been deleted.
pub(super) async fn each_model(
    state: &AppState,
    batch: &jobs::Batch,
    mut each: impl FnMut(u32, &Job),
) -> Result<(), StoreError> {
    let places: BTreeMap<JobId, u32> = batch.jobs.iter().copied().zip(batch.places.iter().copied()).collect();
    let mut after = None;
    loop {
        let page = state.store.batch_jobs(batch.id, after, PAGE).await?;
        let Some(last) = page.last() else { return Ok(()) };
        after = Some(last.id);
        for job in &page {
            if let Some(place) = places.get(&job.id) {
                each(*place, job);
            }
        }
    }
}
