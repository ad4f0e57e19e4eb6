//! Cancelling and deleting many models: `POST /models/cancel`, `DELETE /models` and
//! `POST /batches/{id}/cancel`.
//!
//! Each transaction changes at most 100 models. If a request fails, some models may be changed
//! already; the client can repeat it. If the client disconnects, the service completes the request.

use super::select::{self, CONDITIONS, Conditions};
use crate::http::AppState;
use crate::http::access::{Caller, audit, run_to_completion};
use crate::http::batches::batch::Batch;
use crate::http::batches::read::find_batch;
use crate::http::wire::extract::{BatchId, Parameters, no_batch};
use crate::http::wire::faults::RequestFault;
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{BadParameters, BatchMissing, StoresUnavailable};
use crate::jobs::{JobId, ListFilter, Status, StoreError};
use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

/// Maximum number of models that a transaction changes.
const MODELS_PER_TRANSACTION: u32 = 100;
/// Maximum number of searches for models to cancel. A search misses a running model that is queued
/// again during the search.
const CANCEL_ROUNDS: usize = 3;

/// Result of a request that cancels or deletes many models.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub(in crate::http) struct Applied {
    /// Number of models that were cancelled or deleted; with `dry_run`, the number that would be.
    #[schema(minimum = 0)]
    count: u64,
    /// True if the request only counted the models (`dry_run=true`) and changed nothing.
    dry_run: bool,
}

/// Change of many models.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum BulkAction {
    Cancel,
    Delete,
}

impl BulkAction {
    fn name(self) -> &'static str {
        match self {
            Self::Cancel => "models cancelled",
            Self::Delete => "models deleted",
        }
    }
}

/// A request to change many models.
struct BulkRequest {
    filter: ListFilter,
    dry_run: bool,
}

impl BulkRequest {
    fn read(parameters: &Parameters, caller: &Caller) -> Result<Self, Problem> {
        let known = [&CONDITIONS[..], &["all", "dry_run"]].concat();
        let mut faults = parameters.faults(&known, &["label"]);
        let filter = select::read(parameters, caller, &mut faults);
        let [all, dry_run] = ["all", "dry_run"].map(|name| select::flag(parameters, name, &mut faults));
        if !all && !CONDITIONS.iter().any(|name| parameters.get(name).is_some()) {
            faults.push(RequestFault::parameter("all", "must be true if nothing else says which models are meant"));
        }
        Problem::check(faults)?;
        Ok(Self { filter, dry_run })
    }
}

/// Progress of a request to change many models.
struct BulkRun {
    state: AppState,
    action: BulkAction,
    request: BulkRequest,
    /// Number of models changed, or found in a dry run.
    count: u64,
}

impl BulkRun {
    /// Changes all models that match the filter.
    async fn run(&mut self) -> Result<(), StoreError> {
        let filter = self.request.filter.clone();
        let statuses: Vec<Option<Status>> = match (self.action, filter.status) {
            (BulkAction::Delete, status) => vec![status],
            (BulkAction::Cancel, None) => vec![Some(Status::Queued), Some(Status::Running)],
            (BulkAction::Cancel, Some(status)) if status.is_ended() => vec![],
            (BulkAction::Cancel, status) => vec![status],
        };
        // Models that are accepted later do not count.
        let Some(&newest) = self.state.store.ids(&ListFilter { limit: 1, ..filter.clone() }).await?.first() else {
            return Ok(());
        };
        let before = Some(JobId(uuid::Uuid::from_u128(newest.0.as_u128().saturating_add(1))));
        let filter = ListFilter { before, ..filter };
        for _ in 0..if self.request.dry_run || statuses.len() < 2 { 1 } else { CANCEL_ROUNDS } {
            let before = self.count;
            for status in &statuses {
                self.change_page_by_page(ListFilter { status: *status, ..filter.clone() }).await?;
            }
            if self.count == before {
                break;
            }
        }
        Ok(())
    }

    /// Changes the models that match a filter, newest first.
    async fn change_page_by_page(&mut self, mut filter: ListFilter) -> Result<(), StoreError> {
        let BulkRequest { filter: requested, dry_run } = &self.request;
        filter.limit = if *dry_run { 1000 } else { MODELS_PER_TRANSACTION };
        loop {
            let ids = self.state.store.ids(&filter).await?;
            let Some(&last) = ids.last() else { return Ok(()) };
            filter.before = Some(last);
            self.count += match dry_run {
                true => ids.len() as u64,
                // A model that has been queued again in the meantime is cancelled as well, unless
                // the request is for running models only.
                false => change(&self.state, self.action, ids, requested.status).await?,
            };
        }
    }
}

/// Changes the models that still have the `status`, in one transaction. Returns their number.
async fn change(
    state: &AppState,
    action: BulkAction,
    ids: Vec<JobId>,
    status: Option<Status>,
) -> Result<u64, StoreError> {
    let result = match action {
        BulkAction::Cancel => state.store.cancel_many(ids, status).await?,
        BulkAction::Delete => state.store.delete_many(ids, status).await?,
    };
    state.forget(result.keys).await;
    Ok(result.jobs)
}

/// Changes the models that the parameters select. Writes an audit line even if the request fails
/// halfway.
async fn change_selected(
    state: AppState,
    caller: Caller,
    parameters: &Parameters,
    action: BulkAction,
) -> Result<Json<Applied>, Problem> {
    let request = BulkRequest::read(parameters, &caller)?;
    let dry_run = request.dry_run;
    // Debug form: a value with line breaks could otherwise forge lines of the log.
    let conditions: Vec<String> = parameters.0.iter().map(|(name, value)| format!("{name}={value:?}")).collect();
    let count = run_to_completion(async move {
        let mut run = BulkRun { state, action, request, count: 0 };
        let done = run.run().await;
        if !dry_run {
            audit(&caller, action.name(), format_args!("{} models of {}", run.count, conditions.join(", ")));
        }
        done.map(|()| run.count)
    });
    Ok(Json(Applied { count: count.await?, dry_run }))
}

/// Cancel all models that match.
///
/// Queued models end immediately, running models within a second. Ended models do not change. The
/// conditions are those of `GET /models`; without a condition, `all=true` is required.
#[utoipa::path(
    post, path = "/models/cancel", operation_id = "cancel_models", tag = "models",
    params(
        Conditions,
        ("all" = Option<bool>, Query,
            description = "`true` to select all models; required if no other parameter selects models"),
        ("dry_run" = Option<bool>, Query, description = "`true` to count the models without changing them"),
    ),
    responses((status = 200, description = "Number of models that the request changed or, in a dry run, \
        counted", body = Applied), BadParameters, StoresUnavailable)
)]
pub(in crate::http) async fn cancel(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
) -> Result<Json<Applied>, Problem> {
    change_selected(state, caller, &parameters, BulkAction::Cancel).await
}

/// Delete all models that match, and their files.
///
/// Models that have not ended are cancelled first. Files that another model shares are kept. The
/// conditions are those of `GET /models`; without a condition, `all=true` is required.
#[utoipa::path(
    delete, path = "/models", operation_id = "delete_models", tag = "models",
    params(
        Conditions,
        ("all" = Option<bool>, Query,
            description = "`true` to select all models; required if no other parameter selects models"),
        ("dry_run" = Option<bool>, Query, description = "`true` to count the models without changing them"),
    ),
    responses((status = 200, description = "Number of models that the request changed or, in a dry run, \
        counted", body = Applied), BadParameters, StoresUnavailable)
)]
pub(in crate::http) async fn delete(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
) -> Result<Json<Applied>, Problem> {
    change_selected(state, caller, &parameters, BulkAction::Delete).await
}

/// Cancel all models of a batch.
///
/// Queued models end immediately, running models within a second. Ended models do not change.
#[utoipa::path(
    post, path = "/batches/{id}/cancel", operation_id = "cancel_batch", tag = "batches",
    params(("id" = Uuid, Path, description = "Id of the batch")),
    responses((status = 200, description = "The batch", body = Batch), BatchMissing, StoresUnavailable)
)]
pub(in crate::http) async fn cancel_batch(
    State(state): State<AppState>,
    caller: Caller,
    BatchId(id): BatchId,
) -> Result<Json<Batch>, Problem> {
    let batch = find_batch(&state, &caller, id).await?;
    let batch = run_to_completion(async move {
        let mut done = Ok(0);
        for ids in batch.jobs.chunks(MODELS_PER_TRANSACTION as usize) {
            done = change(&state, BulkAction::Cancel, ids.to_vec(), None).await;
            if done.is_err() {
                break;
            }
        }
        audit(&caller, "batch cancelled", id);
        done?;
        state.store.batch(id).await
    });
    let batch = batch.await?.ok_or_else(|| no_batch(id))?;
    Ok(Json(Batch::from(&batch)))
}
