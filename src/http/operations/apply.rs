//! `POST /models/cancel`, `DELETE /models` and `POST /batches/{id}/cancel`.
//!
//! All are operations. A request for few models waits for the end of its operation; if the client
//! disconnects or the request fails, the operation continues.

use super::operation::Operation;
use super::read::answer;
use super::run::complete;
use crate::http::AppState;
use crate::http::access::{Caller, audit, run_to_completion};
use crate::http::batches::batch::Batch;
use crate::http::batches::read::find_batch;
use crate::http::models::create::set_location;
use crate::http::models::select::{self, CONDITIONS, Conditions};
use crate::http::wire::extract::{BatchId, Parameters, no_batch};
use crate::http::wire::faults::RequestFault;
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{BadParameters, BatchMissing, OperationsFull, StoresUnavailable};
use crate::jobs::{BulkAction, ListFilter, NewBulk};
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::{IntoParams, ToSchema};

/// Maximum number of models for which a request waits.
const MAX_AWAITED: u64 = 1000;

/// Result of a request that cancels or deletes many models.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub(in crate::http) struct Applied {
    /// Number of models that were cancelled or deleted; with `dry_run`, the number that would be,
    /// counted up to a million for each status.
    #[schema(minimum = 0)]
    count: u64,
    /// True if the request only counted the models (`dry_run=true`) and changed nothing.
    dry_run: bool,
}

/// Further parameters, for the description of routes.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[expect(dead_code, reason = "only described")]
struct Flags {
    /// `true` to select all models; required if no other parameter selects models
    all: Option<bool>,
    /// `true` to count the models without changing them
    dry_run: Option<bool>,
}

/// Word of the audit log for the change of many models.
fn audited_as(action: BulkAction) -> &'static str {
    match action {
        BulkAction::Cancel => "models cancelled",
        BulkAction::Delete => "models deleted",
    }
}

/// Changes the models that the parameters select. `path` is the way from the URL of the request to
/// the root of the service.
async fn apply(
    state: AppState,
    caller: Caller,
    parameters: &Parameters,
    action: BulkAction,
    path: &'static str,
) -> Result<Response, Problem> {
    let known = [&CONDITIONS[..], &["all", "dry_run"]].concat();
    let mut faults = parameters.faults(&known, &["label"]);
    let filter = select::read(parameters, &caller, &mut faults);
    let [all, dry_run] = ["all", "dry_run"].map(|name| select::flag(parameters, name, &mut faults));
    if !all && !CONDITIONS.iter().any(|name| parameters.get(name).is_some()) {
        faults.push(RequestFault::parameter("all", "must be true if nothing else says which models are meant"));
    }
    Problem::check(faults)?;
    if dry_run {
        let count = state.store.count_affected(action, &filter).await?;
        return Ok(Json(Applied { count, dry_run }).into_response());
    }
    let conditions: Vec<_> = parameters.0.iter().filter(|(name, _)| name != "dry_run").cloned().collect();
    // Debug form: a value with line breaks could otherwise forge lines of the log.
    let described: Vec<String> = conditions.iter().map(|(name, value)| format!("{name}={value:?}")).collect();
    let new = NewBulk { action, filter, conditions, owner: caller.owner().map(str::to_owned) };
    run_to_completion(async move {
        let operation = state.store.create_operation(new).await?;
        let (id, total, described) = (operation.id, operation.total, described.join(", "));
        audit(&caller, audited_as(action), format_args!("{total} models of {described}"));
        if total > MAX_AWAITED {
            state.operations.notify_one();
            let mut response = answer(StatusCode::ACCEPTED, &operation)?;
            set_location(response.headers_mut(), &format!("{path}operations/{id}"), false);
            return Ok(response);
        }
        let ended = complete(&state, id).await.inspect_err(|_| state.operations.notify_one())?;
        let count = ended.map_or(0, |operation| operation.changed);
        Ok(Json(Applied { count, dry_run }).into_response())
    })
    .await
}

/// Cancel all models that match.
///
/// Queued models end immediately, running models within a second. Ended models do not change. The
/// conditions are those of `GET /models`; without a condition, `all=true` is required. The request
/// does not affect models that are accepted after it.
#[utoipa::path(
    post, path = "/models/cancel", operation_id = "cancel_models", tag = "models",
    params(Conditions, Flags),
    responses(
        (status = 200, description = "Number of models that the request changed or, in a dry run, counted",
            body = Applied),
        (status = 202, description = "More than 1,000 models match. The service changes them in the background",
            body = Operation, headers(
            ("location" = String, description = "The operation, relative to this URL"),
            ("etag" = String, description = "The version of the operation"),
            ("retry-after" = u32, description = "Seconds to wait before the next request"))),
        BadParameters, OperationsFull, StoresUnavailable,
    )
)]
pub(in crate::http) async fn cancel(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
) -> Result<Response, Problem> {
    apply(state, caller, &parameters, BulkAction::Cancel, "../").await
}

/// Delete all models that match, and their files.
///
/// Models that have not ended are cancelled first. Files that another model shares are kept. The
/// conditions are those of `GET /models`; without a condition, `all=true` is required. The request
/// does not affect models that are accepted after it.
#[utoipa::path(
    delete, path = "/models", operation_id = "delete_models", tag = "models",
    params(Conditions, Flags),
    responses(
        (status = 200, description = "Number of models that the request changed or, in a dry run, counted",
            body = Applied),
        (status = 202, description = "More than 1,000 models match. The service changes them in the background",
            body = Operation, headers(
            ("location" = String, description = "The operation, relative to this URL"),
            ("etag" = String, description = "The version of the operation"),
            ("retry-after" = u32, description = "Seconds to wait before the next request"))),
        BadParameters, OperationsFull, StoresUnavailable,
    )
)]
pub(in crate::http) async fn delete(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
) -> Result<Response, Problem> {
    apply(state, caller, &parameters, BulkAction::Delete, "").await
}

/// Cancel all models of a batch.
///
/// Queued models end immediately, running models within a second. Ended models do not change.
#[utoipa::path(
    post, path = "/batches/{id}/cancel", operation_id = "cancel_batch", tag = "batches",
    params(("id" = Uuid, Path, description = "Id of the batch")),
    responses((status = 200, description = "The batch", body = Batch), BatchMissing, OperationsFull, StoresUnavailable)
)]
pub(in crate::http) async fn cancel_batch(
    State(state): State<AppState>,
    caller: Caller,
    BatchId(id): BatchId,
) -> Result<Json<Batch>, Problem> {
    find_batch(&state, &caller, id).await?;
    let filter = ListFilter { batch: Some(id), ..ListFilter::default() };
    let conditions = vec![("batch".to_owned(), id.to_string())];
    let owner = caller.owner().map(str::to_owned);
    let new = NewBulk { action: BulkAction::Cancel, filter, conditions, owner };
    let batch = run_to_completion(async move {
        let operation = state.store.create_operation(new).await?;
        audit(&caller, "batch cancelled", id);
        complete(&state, operation.id).await.inspect_err(|_| state.operations.notify_one())?;
        state.store.batch(id).await
    });
    let batch = batch.await?.ok_or_else(|| no_batch(id))?;
    Ok(Json(Batch::from(&batch)))
}
