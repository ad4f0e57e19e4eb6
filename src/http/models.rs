//! `GET /models`, `GET`, `DELETE /models/{id}`, `POST /models/{id}/cancel`: list, read, delete and cancel models.

use super::AppState;
use super::conditional::ETag;
use super::dto::{Model, ModelList};
use super::extract::{ModelId, Parameters, no_model, parse_id};
use super::faults::Fault;
use super::problem::Problem;
use super::request::LABELS_MAX;
use super::responses::{BadParameters, ModelMissing, StoreAway};
use crate::jobs::{Job, ListFilter, Status};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Models on a page by default.
const PAGE: u32 = 20;
/// Most models on a page.
const PAGE_MAX: u32 = 100;

/// The tag of a model's state: its version, and its position in the queue, which changes without a new version.
pub(super) fn tag(job: &Job) -> ETag {
    match job.queue_position {
        None | Some(0) => ETag::strong(job.version),
        Some(place) => ETag::strong(format_args!("{}-{place}", job.version)),
    }
}

/// The model as a response.
pub(super) fn answer(state: &AppState, status: StatusCode, job: &Job) -> Result<Response, Problem> {
    Ok((status, [(header::ETAG, tag(job).header()?)], Json(Model::of(job, state.limits.keep))).into_response())
}

/// When to ask again for a model that has not ended: after the time that it will take, between 1 and 30 seconds.
pub(super) fn retry_after(job: &Job) -> HeaderValue {
    let eta = job.progress.and_then(|p| p.eta_seconds).unwrap_or(1.0);
    HeaderValue::from(eta.ceil().clamp(1.0, 30.0) as u32)
}

/// List models, newest first.
#[utoipa::path(
    get, path = "/models", operation_id = "list_models", tag = "models",
    params(
        ("status" = Option<Status>, Query, description = "Only models of this status"),
        ("preset" = Option<String>, Query, pattern = "^[^\\u0000]*$", description = "Only models of this preset"),
        ("label" = Option<Vec<String>>, Query, max_items = 16, pattern = "^[^:\\u0000]+:[^\\u0000]*$", description = "Only models with this label, `key:value`. May be given up to 16 times: models with all of them"),
        ("limit" = Option<u32>, Query, minimum = 1, maximum = 100, description = "Most models on the page; 20 by default"),
        ("cursor" = Option<String>, Query, format = Uuid, description = "`next` of the previous page"),
    ),
    responses((status = 200, description = "A page of models", body = ModelList), BadParameters, StoreAway)
)]
pub(super) async fn list(State(state): State<AppState>, parameters: Parameters) -> Result<Json<ModelList>, Problem> {
    let page = state.store.list(&filter(&parameters)?).await?;
    let models = page.jobs.iter().map(|job| Model::of(job, state.limits.keep)).collect();
    Ok(Json(ModelList { models, next: page.next.map(|id| id.to_string()) }))
}

fn filter(parameters: &Parameters) -> Result<ListFilter, Problem> {
    let mut faults = parameters.faults(&["status", "preset", "label", "limit", "cursor"], &["label"]);
    let mut filter = ListFilter { limit: PAGE, ..ListFilter::default() };
    for (name, value) in &parameters.0 {
        let fault = match name.as_str() {
            "status" => match serde_json::from_value(value.as_str().into()) {
                Ok(status) => {
                    filter.status = Some(status);
                    None
                }
                Err(_) => Some("must be queued, running, succeeded, failed or cancelled".to_owned()),
            },
            // No record holds NUL, and PostgreSQL refuses it in a query.
            "preset" | "label" if value.contains('\0') => Some("must not contain NUL".to_owned()),
            "preset" => {
                filter.preset = Some(value.clone());
                None
            }
            "label" if filter.labels.len() == LABELS_MAX => Some(format!("may be given at most {LABELS_MAX} times")),
            "label" => match value.split_once(':') {
                Some((key, value)) => {
                    filter.labels.push((key.to_owned(), value.to_owned()));
                    None
                }
                None => Some("must be a key and a value, separated by a colon".to_owned()),
            },
            "limit" => match value.parse() {
                Ok(limit @ 1..=PAGE_MAX) => {
                    filter.limit = limit;
                    None
                }
                _ => Some(format!("must be an integer from 1 to {PAGE_MAX}")),
            },
            "cursor" => match parse_id(value) {
                Some(id) => {
                    filter.before = Some(id);
                    None
                }
                None => Some("must be the `next` of a page".to_owned()),
            },
            _ => None,
        };
        faults.extend(fault.map(|detail| Fault::parameter(name, detail)));
    }
    if faults.is_empty() { Ok(filter) } else { Err(Problem::invalid(faults)) }
}

/// Read a model.
#[utoipa::path(
    get, path = "/models/{id}", operation_id = "get_model", tag = "models",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The model", body = Model, headers(
            ("etag" = String, description = "The version, followed by the position in the queue if that is not 0"),
            ("retry-after" = Option<u32>, description = "Seconds to wait before the next request; absent once it has ended"))),
        (status = 304, description = "The model has not changed"),
        ModelMissing, StoreAway,
    )
)]
pub(super) async fn get(
    State(state): State<AppState>,
    ModelId(id): ModelId,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let job = state.store.get(id).await?.ok_or_else(|| no_model(id))?;
    let cache = HeaderValue::from_static("no-cache");
    let mut response = if tag(&job).matches_none(&headers) {
        tag(&job).not_modified(cache)?
    } else {
        let mut response = answer(&state, StatusCode::OK, &job)?;
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
/// A queued model ends at once, a running one within a second. An ended model does not change.
#[utoipa::path(
    post, path = "/models/{id}/cancel", operation_id = "cancel_model", tag = "models",
    params(("id" = Uuid, Path, description = "Id of the model")),
    responses((status = 200, description = "The model", body = Model), ModelMissing, StoreAway)
)]
pub(super) async fn cancel(State(state): State<AppState>, ModelId(id): ModelId) -> Result<Response, Problem> {
    let job = state.store.cancel(id).await?.ok_or_else(|| no_model(id))?;
    if let Some(checkpoint) = job.checkpoint.clone().filter(|_| job.status.is_ended()) {
        state.forget(vec![checkpoint]).await;
    }
    answer(&state, StatusCode::OK, &job)
}

/// Delete a model and its files. It is cancelled if it has not ended.
///
/// Files that another model shares are kept.
#[utoipa::path(
    delete, path = "/models/{id}", operation_id = "delete_model", tag = "models",
    params(("id" = Uuid, Path, description = "Id of the model")),
    responses((status = 204, description = "The model was deleted"), ModelMissing, StoreAway)
)]
pub(super) async fn delete(State(state): State<AppState>, ModelId(id): ModelId) -> Result<StatusCode, Problem> {
    let keys = state.store.delete(id).await?.ok_or_else(|| no_model(id))?;
    state.forget(keys).await;
    Ok(StatusCode::NO_CONTENT)
}
