//! `GET /operations`, `GET /operations/{id}`, `POST /operations/{id}/cancel`.

use super::operation::{Operation, OperationList};
use super::{PathId, no_operation};
use crate::http::AppState;
use crate::http::access::{Caller, audited};
use crate::http::models::select;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::Parameters;
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{BadParameters, OperationMissing, StoresUnavailable};
use crate::jobs::{BulkOperation, JobId, OperationId};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// `Retry-After` of an operation that has not ended, seconds.
const RETRY_AFTER: HeaderValue = HeaderValue::from_static("1");

/// An operation as a response.
pub(super) fn answer(status: StatusCode, operation: &BulkOperation) -> Result<Response, Problem> {
    let tag = ETag::strong(operation.version).header()?;
    let mut response = (status, [(header::ETAG, tag)], Json(Operation::from(operation))).into_response();
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    if !operation.status.is_ended() {
        response.headers_mut().insert(header::RETRY_AFTER, RETRY_AFTER);
    }
    Ok(response)
}

/// List operations on many models, newest first.
///
/// Operations that ended more than a week ago are not listed.
#[utoipa::path(
    get, path = "/operations", operation_id = "list_operations", tag = "operations",
    params(
        ("owner" = Option<String>, Query, pattern = "^[^\\u0000]*$",
            description = "Only operations of this owner; without the scope `admin`, only the caller's own name is \
                allowed"),
        ("limit" = Option<u32>, Query, minimum = 1, maximum = 100,
            description = "Maximum number of operations on the page; 20 by default"),
        ("cursor" = Option<String>, Query, format = Uuid, description = "`next` of the previous page"),
    ),
    responses(
        (status = 200, description = "A page of operations", body = OperationList),
        BadParameters, StoresUnavailable,
    )
)]
pub(in crate::http) async fn list(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
) -> Result<Json<OperationList>, Problem> {
    let mut faults = parameters.faults(&["owner", "limit", "cursor"], &[]);
    let owner = select::read(&parameters, &caller, &mut faults).owner;
    let (limit, before) = select::page(&parameters, &mut faults);
    Problem::check(faults)?;
    let before = before.map(|JobId(id)| OperationId(id));
    let page = state.store.operations(owner.as_deref(), before, limit).await?;
    let operations = page.operations.iter().map(Operation::from).collect();
    Ok(Json(OperationList { operations, next: page.next.map(|id| id.to_string()) }))
}

/// Read an operation on many models.
///
/// An ended operation never changes.
#[utoipa::path(
    get, path = "/operations/{id}", operation_id = "get_operation", tag = "operations",
    params(
        ("id" = Uuid, Path, description = "Id of the operation"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The operation", body = Operation, headers(
            ("etag" = String, description = "The version"),
            ("retry-after" = Option<u32>,
                description = "Seconds to wait before the next request. Absent after the end"))),
        (status = 304, description = "The operation has not changed"),
        OperationMissing, BadParameters, StoresUnavailable,
    )
)]
pub(in crate::http) async fn get(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    Problem::check(parameters.faults(&[], &[]))?;
    let operation = find(&state, &caller, id).await?;
    let tag = ETag::strong(operation.version);
    if tag.matches_none(&headers) {
        return tag.not_modified(HeaderValue::from_static("no-cache"));
    }
    answer(StatusCode::OK, &operation)
}

/// Cancel an operation on many models.
///
/// Models that it has changed stay so. An ended operation does not change.
#[utoipa::path(
    post, path = "/operations/{id}/cancel", operation_id = "cancel_operation", tag = "operations",
    params(("id" = Uuid, Path, description = "Id of the operation")),
    responses((status = 200, description = "The operation", body = Operation), OperationMissing, StoresUnavailable)
)]
pub(in crate::http) async fn cancel(
    State(state): State<AppState>,
    caller: Caller,
    PathId(id): PathId,
) -> Result<Response, Problem> {
    find(&state, &caller, id).await?;
    let store = state.store.clone();
    let change = async move { store.cancel_operation(id).await };
    let operation = audited(&caller, "operation cancelled", id, change).await?.ok_or_else(|| no_operation(id))?;
    answer(StatusCode::OK, &operation)
}

/// An operation that the caller may see.
async fn find(state: &AppState, caller: &Caller, id: OperationId) -> Result<BulkOperation, Problem> {
    let operation = state.store.operation(id).await?;
    operation.filter(|operation| caller.sees(operation.owner.as_deref())).ok_or_else(|| no_operation(id))
}
