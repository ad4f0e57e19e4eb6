//! Listing, reading, cancelling and deleting models: `GET /models`; `GET`, `DELETE /models/{id}`;
//! `POST /models/{id}/cancel`.

use super::files::find_model;
use super::model::{Detail, LinkBase, Model, ModelList};
use super::select::{self, Conditions};
use crate::http::AppState;
use crate::http::access::{Caller, audited};
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::{ModelId, Parameters, no_model};
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{BadParameters, ModelMissing, StoresUnavailable};
use crate::http::workforce::JobContext;
use crate::jobs::{Job, JobId, JobProgress, ListFilter};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// The entity tag of a job: its version, and its position in the queue and the reason why it waits,
/// which change without a new version.
pub(in crate::http) fn tag(job: &Job, context: &JobContext) -> ETag {
    let version = job.version;
    match (job.queue_position, context.queue_reason(job)) {
        (None | Some(0), None) => ETag::strong(version),
        (Some(place), None) => ETag::strong(format_args!("{version}-{place}")),
        (place, Some(reason)) => {
            ETag::strong(format_args!("{version}-{}-{}", place.unwrap_or_default(), reason.name()))
        }
    }
}

/// A model as a response.
pub(in crate::http) async fn answer(
    state: &AppState,
    status: StatusCode,
    job: &Job,
    detail: Detail,
    base: LinkBase,
) -> Result<Response, Problem> {
    let context = state.job_context([job]).await;
    let model = Model::of(job, &context, detail, base);
    Ok((status, [(header::ETAG, tag(job, &context).header()?)], Json(model)).into_response())
}

/// `Retry-After` of a job that has not ended: its remaining time, between 1 and 30 seconds.
pub(in crate::http) fn retry_after(job: &Job) -> HeaderValue {
    let eta = job.progress.and_then(JobProgress::eta_seconds).unwrap_or(1.0);
    HeaderValue::from(eta.ceil().clamp(1.0, 30.0) as u32)
}

/// List models, newest first.
///
/// The list contains the models that match all conditions. `next` is the `cursor` of the next page.
#[utoipa::path(
    get, path = "/models", operation_id = "list_models", tag = "models",
    params(
        Conditions,
        ("view" = Option<Detail>, Query, description = "`summary` leaves out the specs; `full` by default"),
        ("limit" = Option<u32>, Query, minimum = 1, maximum = 100,
            description = "Maximum number of models on the page; 20 by default"),
        ("cursor" = Option<String>, Query, format = Uuid, description = "`next` of the previous page"),
    ),
    responses((status = 200, description = "A page of models", body = ModelList), BadParameters, StoresUnavailable)
)]
pub(in crate::http) async fn list(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
) -> Result<Json<ModelList>, Problem> {
    let mut faults = parameters.faults(&[&select::CONDITIONS[..], &["view", "limit", "cursor"]].concat(), &["label"]);
    let detail = Detail::read(&parameters, Detail::Full, &mut faults);
    let filter = select::read(&parameters, &caller, &mut faults);
    let (limit, before) = select::page(&parameters, &mut faults);
    Problem::check(faults)?;
    let page = state.store.list(&ListFilter { limit, before, ..filter }).await?;
    let context = state.job_context(&page.jobs).await;
    let models = page.jobs.iter().map(|job| Model::of(job, &context, detail, LinkBase::Root)).collect();
    Ok(Json(ModelList { models, next: page.next.map(|id| id.to_string()) }))
}

/// Read a model.
///
/// An ended model never changes until it is deleted.
#[utoipa::path(
    get, path = "/models/{id}", operation_id = "get_model", tag = "models",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("view" = Option<Detail>, Query, description = "`summary` leaves out the spec; `full` by default"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The model", body = Model, headers(
            ("etag" = String, description = "The version, in the queue followed by the position and the reason for the wait, if the \
                position is not 0 or there is a reason"),
            ("retry-after" = Option<u32>,
                description = "Seconds to wait before the next request. Absent after the end"))),
        (status = 304, description = "The model has not changed"),
        ModelMissing, BadParameters, StoresUnavailable,
    )
)]
pub(in crate::http) async fn get(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let mut faults = parameters.faults(&["view"], &[]);
    let detail = Detail::read(&parameters, Detail::Full, &mut faults);
    Problem::check(faults)?;
    let job = find_model(&state, &caller, id).await?;
    let cache = HeaderValue::from_static("no-cache");
    let tag = tag(&job, &state.job_context([&job]).await);
    let mut response = if tag.matches_none(&headers) {
        tag.not_modified(cache)?
    } else {
        let mut response = answer(&state, StatusCode::OK, &job, detail, LinkBase::Models).await?;
        response.headers_mut().insert(header::CACHE_CONTROL, cache);
        response
    };
    if !job.status.is_ended() {
        response.headers_mut().insert(header::RETRY_AFTER, retry_after(&job));
    }
    Ok(response)
}

/// Cancel a model.
///
/// A queued model ends immediately, a running model within a second. An ended model does not
/// change.
#[utoipa::path(
    post, path = "/models/{id}/cancel", operation_id = "cancel_model", tag = "models",
    params(("id" = Uuid, Path, description = "Id of the model")),
    responses((status = 200, description = "The model", body = Model), ModelMissing, StoresUnavailable)
)]
pub(in crate::http) async fn cancel(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
) -> Result<Response, Problem> {
    find_model(&state, &caller, id).await?;
    let job = cancel_job(&state, &caller, "model cancelled", id).await?.ok_or_else(|| no_model(id))?;
    answer(&state, StatusCode::OK, &job, Detail::Full, LinkBase::Model).await
}

/// Delete a model and its files; if it has not ended, it is cancelled first.
///
/// Files that another model shares are kept.
#[utoipa::path(
    delete, path = "/models/{id}", operation_id = "delete_model", tag = "models",
    params(("id" = Uuid, Path, description = "Id of the model")),
    responses((status = 204, description = "The model was deleted"), ModelMissing, StoresUnavailable)
)]
pub(in crate::http) async fn delete(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
) -> Result<StatusCode, Problem> {
    find_model(&state, &caller, id).await?;
    delete_job(&state, &caller, "model deleted", id).await?.ok_or_else(|| no_model(id))
}

/// Cancels a job and removes its checkpoint. `None` if the job does not exist. The caller must have
/// access to the job, which cannot change: the owner of a job stays the same.
pub(in crate::http) async fn cancel_job(
    state: &AppState,
    caller: &Caller,
    action: &'static str,
    id: JobId,
) -> Result<Option<Job>, Problem> {
    let store = state.store.clone();
    let job = audited(caller, action, id, async move { store.cancel(id).await }).await?;
    if let Some(job) = &job
        && job.status.is_ended()
    {
        state.forget(job.checkpoint.iter().cloned().collect()).await;
    }
    Ok(job)
}

/// Deletes a job and its files. `None` if the job does not exist.
pub(in crate::http) async fn delete_job(
    state: &AppState,
    caller: &Caller,
    action: &'static str,
    id: JobId,
) -> Result<Option<StatusCode>, Problem> {
    let store = state.store.clone();
    let deleted = audited(caller, action, id, async move { store.delete(id).await }).await?;
    let Some(keys) = deleted else { return Ok(None) };
    state.forget(keys).await;
    Ok(Some(StatusCode::NO_CONTENT))
}
