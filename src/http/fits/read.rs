//! `GET /fits`; `GET`, `DELETE /fits/{id}`, `POST /fits/{id}/cancel`.

use super::fit::{Fit, FitDetail, FitList};
use super::{FitId, no_fit};
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::read::{cancel_job, delete_job, retry_after, tag};
use crate::http::models::select;
use crate::http::wire::extract::Parameters;
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{BadParameters, FitMissing, StoresUnavailable};
use crate::jobs::{Job, JobId, JobKind, ListFilter};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Parameters that filter a list of fits.
const CONDITIONS: [&str; 6] = ["status", "preset", "label", "owner", "created_after", "created_before"];

/// List fits, newest first.
#[utoipa::path(
    get, path = "/fits", operation_id = "list_fits", tag = "fits",
    params(
        ("status" = Option<crate::jobs::Status>, Query, description = "Only fits of this status"),
        ("preset" = Option<String>, Query, pattern = "^[^\\u0000]*$", description = "Only fits of this preset"),
        ("label" = Option<Vec<String>>, Query, max_items = 16, pattern = "^[^:\\u0000]+:[^\\u0000]*$",
            description = "Only fits with this label, `key:value`. May be repeated; fits must have all labels"),
        ("owner" = Option<String>, Query, pattern = "^[^\\u0000]*$",
            description = "Only fits of this owner; without the scope `admin`, only the caller's own name is \
                allowed"),
        ("created_after" = Option<String>, Query, format = DateTime,
            description = "Only fits accepted at this time (RFC 3339) or later"),
        ("created_before" = Option<String>, Query, format = DateTime,
            description = "Only fits accepted before this time (RFC 3339)"),
        ("limit" = Option<u32>, Query, minimum = 1, maximum = 100,
            description = "Maximum number of fits on the page; 20 by default"),
        ("cursor" = Option<String>, Query, format = Uuid, description = "`next` of the previous page"),
    ),
    responses((status = 200, description = "A page of fits", body = FitList), BadParameters, StoresUnavailable)
)]
pub(in crate::http) async fn list(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
) -> Result<Json<FitList>, Problem> {
    let mut faults = parameters.faults(&[&CONDITIONS[..], &["limit", "cursor"]].concat(), &["label"]);
    let filter = select::read(&parameters, &caller, &mut faults);
    let (limit, before) = select::page(&parameters, &mut faults);
    Problem::check(faults)?;
    let filter = ListFilter { kind: JobKind::Fit, limit, before, ..filter };
    let page = state.store.list(&filter).await?;
    let context = state.job_context(&page.jobs).await;
    let fits = page.jobs.iter().map(|job| Fit::of(job, &context, FitDetail::Summary)).collect();
    Ok(Json(FitList { fits, next: page.next.map(|id| id.to_string()) }))
}

/// Read a fit.
///
/// An ended fit never changes until it is deleted.
#[utoipa::path(
    get, path = "/fits/{id}", operation_id = "get_fit", tag = "fits",
    params(
        ("id" = Uuid, Path, description = "Id of the fit"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The fit", body = Fit, headers(
            ("etag" = String, description = "The version, in the queue followed by the position and the reason for the wait, if the \
                position is not 0 or there is a reason"),
            ("retry-after" = Option<u32>,
                description = "Seconds to wait before the next request. Absent after the end"))),
        (status = 304, description = "The fit has not changed"),
        FitMissing, BadParameters, StoresUnavailable,
    )
)]
pub(in crate::http) async fn get(
    State(state): State<AppState>,
    caller: Caller,
    FitId(id): FitId,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    Problem::check(parameters.faults(&[], &[]))?;
    let job = find_fit(&state, &caller, id).await?;
    let cache = HeaderValue::from_static("no-cache");
    let context = state.job_context([&job]).await;
    let tag = tag(&job, &context);
    let mut response = if tag.matches_none(&headers) {
        tag.not_modified(cache)?
    } else {
        let fit = Fit::of(&job, &context, FitDetail::Full);
        ([(header::ETAG, tag.header()?), (header::CACHE_CONTROL, cache)], Json(fit)).into_response()
    };
    if !job.status.is_ended() {
        response.headers_mut().insert(header::RETRY_AFTER, retry_after(&job));
    }
    Ok(response)
}

/// Cancel a fit.
///
/// A queued fit ends immediately, a running fit within a second. An ended fit does not change.
#[utoipa::path(
    post, path = "/fits/{id}/cancel", operation_id = "cancel_fit", tag = "fits",
    params(("id" = Uuid, Path, description = "Id of the fit")),
    responses((status = 200, description = "The fit", body = Fit), FitMissing, StoresUnavailable)
)]
pub(in crate::http) async fn cancel(
    State(state): State<AppState>,
    caller: Caller,
    FitId(id): FitId,
) -> Result<Json<Fit>, Problem> {
    find_fit(&state, &caller, id).await?;
    let job = cancel_job(&state, &caller, "fit cancelled", id).await?.ok_or_else(|| no_fit(id))?;
    Ok(Json(Fit::of(&job, &state.job_context([&job]).await, FitDetail::Full)))
}

/// Delete a fit; if it has not ended, it is cancelled first.
#[utoipa::path(
    delete, path = "/fits/{id}", operation_id = "delete_fit", tag = "fits",
    params(("id" = Uuid, Path, description = "Id of the fit")),
    responses((status = 204, description = "The fit was deleted"), FitMissing, StoresUnavailable)
)]
pub(in crate::http) async fn delete(
    State(state): State<AppState>,
    caller: Caller,
    FitId(id): FitId,
) -> Result<StatusCode, Problem> {
    find_fit(&state, &caller, id).await?;
    delete_job(&state, &caller, "fit deleted", id).await?.ok_or_else(|| no_fit(id))
}

/// A fit that the caller may see.
async fn find_fit(state: &AppState, caller: &Caller, id: JobId) -> Result<Job, Problem> {
    caller.fit(state.store.get(id).await?).ok_or_else(|| no_fit(id))
}
