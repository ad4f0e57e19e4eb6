//! `GET /models`, `GET`, `DELETE /models/{id}`, `POST /models/{id}/cancel`: what there is, and stopping it.

use super::AppState;
use super::conditional::ETag;
use super::dto::{Model, ModelList};
use super::extract::{ModelId, Parameters, no_model, parse_id};
use super::openapi::{BadParameters, ModelMissing, StoreAway};
use super::problem::{Fault, Problem};
use super::request::LABELS_MAX;
use crate::jobs::{Job, ListFilter, Status};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Models on a page where the request does not say.
const PAGE: u32 = 20;
/// Most models on a page.
const PAGE_MAX: u32 = 100;

/// The tag of a model's state. Its version; while it stands behind others in the queue, with its place there, which
/// changes without a new version.
pub(super) fn tag(job: &Job) -> ETag {
    match job.queue_position {
        None | Some(0) => ETag::strong(job.version),
        Some(place) => ETag::strong(format_args!("{}-{place}", job.version)),
    }
}

/// The model as an answer.
pub(super) fn answer(state: &AppState, status: StatusCode, job: &Job) -> Result<Response, Problem> {
    Ok((status, [(header::ETAG, tag(job).header()?)], Json(Model::of(job, state.limits.keep))).into_response())
}

/// When to look again at a model that has not ended: as long as it will take, between 1 and 30 seconds.
pub(super) fn retry_after(job: &Job) -> HeaderValue {
    let eta = job.progress.and_then(|p| p.eta_seconds).unwrap_or(1.0);
    HeaderValue::from(eta.ceil().clamp(1.0, 30.0) as u32)
}

/// List models, newest first.
#[utoipa::path(
    get, path = "/models", operation_id = "list_models", tag = "models",
    params(
        ("status" = Option<Status>, Query, description = "Only of this status"),
        ("preset" = Option<String>, Query, pattern = "^[^\\u0000]*$", description = "Only of this preset"),
        ("label" = Option<Vec<String>>, Query, max_items = 16, pattern = "^[^:\\u0000]+:[^\\u0000]*$", description = "Only with this label, `key:value`; may stand up to 16 times: all must fit"),
        ("limit" = Option<u32>, Query, minimum = 1, maximum = 100, description = "Most models on the page; 20 where it is left out"),
        ("cursor" = Option<String>, Query, format = Uuid, description = "`next` of the page before"),
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
            // No record holds NUL, and not every database lets one ask for it.
            "preset" | "label" if value.contains('\0') => Some("must not contain NUL".to_owned()),
            "preset" => {
                filter.preset = Some(value.clone());
                None
            }
            "label" if filter.labels.len() == LABELS_MAX => Some(format!("may stand {LABELS_MAX} times at most")),
            "label" => match value.split_once(':') {
                Some((key, value)) => {
                    filter.labels.push((key.to_owned(), value.to_owned()));
                    None
                }
                None => Some("must be a key and a value with a colon between".to_owned()),
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

/// Read one model.
#[utoipa::path(
    get, path = "/models/{id}", operation_id = "get_model", tag = "models",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("if-none-match" = Option<String>, Header, description = "Tags that the client has"),
    ),
    responses(
        (status = 200, description = "The model", body = Model, headers(
            ("etag" = String, description = "The version; while others stand before it in the queue, with its place"),
            ("retry-after" = Option<u32>, description = "Seconds after which to look again, while it has not ended"))),
        (status = 304, description = "Nothing has changed"),
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

/// Stop a model.
///
/// A queued one ends at once, a running one within a second; an ended one stays as it is.
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

/// Remove a model and its files; it is stopped where needed.
///
/// Files that another model shares stay.
#[utoipa::path(
    delete, path = "/models/{id}", operation_id = "delete_model", tag = "models",
    params(("id" = Uuid, Path, description = "Id of the model")),
    responses((status = 204, description = "It is gone"), ModelMissing, StoreAway)
)]
pub(super) async fn delete(State(state): State<AppState>, ModelId(id): ModelId) -> Result<StatusCode, Problem> {
    let keys = state.store.delete(id).await?.ok_or_else(|| no_model(id))?;
    state.forget(keys).await;
    Ok(StatusCode::NO_CONTENT)
}
