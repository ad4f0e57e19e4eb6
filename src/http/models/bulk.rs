//! `POST /models/cancel`, `DELETE /models` and `POST /batches/{id}/cancel`: cancel or delete many models.
//!
//! Models are found and changed some at a time, each time in one transaction. A request that fails has done a part, and can be
//! repeated; one whose client disconnects goes on.

use super::select::{self, CONDITIONS, Conditions};
use crate::http::AppState;
use crate::http::access::{Caller, audit, run_to_completion};
use crate::http::dto::{Applied, Batch};
use crate::http::wire::extract::{BatchId, Parameters, no_batch};
use crate::http::wire::faults::{Fault, Faults};
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{BadParameters, BatchMissing, StoreAway};
use crate::jobs::{JobId, ListFilter, Status, StoreError};
use axum::Json;
use axum::extract::State;

/// Most models that one transaction changes.
const AT_A_TIME: u32 = 100;
/// Times that models to be cancelled are looked for: one that runs and is queued again meanwhile may be missed once.
const ROUNDS: usize = 3;

/// What is done to models.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Action {
    Cancel,
    Delete,
}

impl Action {
    fn name(self) -> &'static str {
        match self {
            Self::Cancel => "models cancelled",
            Self::Delete => "models deleted",
        }
    }
}

/// A request for many models.
struct Request {
    filter: ListFilter,
    dry_run: bool,
}

impl Request {
    fn read(parameters: &Parameters, caller: &Caller) -> Result<Self, Problem> {
        let known = [&CONDITIONS[..], &["all", "dry_run"]].concat();
        let mut faults = parameters.faults(&known, &["label"]);
        let filter = select::read(parameters, caller, &mut faults);
        let [all, dry_run] = ["all", "dry_run"].map(|name| flag(parameters, name, &mut faults));
        if !all && !CONDITIONS.iter().any(|name| parameters.get(name).is_some()) {
            faults.push(Fault::parameter("all", "must be true if nothing else says which models are meant"));
        }
        Problem::check(faults)?;
        Ok(Self { filter, dry_run })
    }
}

/// What is being done to the models of a request.
struct Run {
    state: AppState,
    action: Action,
    request: Request,
    /// Models done, or in a dry run found.
    count: u64,
}

impl Run {
    /// Does it to all models of the filter.
    async fn all(&mut self) -> Result<(), StoreError> {
        let filter = self.request.filter.clone();
        let statuses: Vec<Option<Status>> = match (self.action, filter.status) {
            (Action::Delete, status) => vec![status],
            (Action::Cancel, None) => vec![Some(Status::Queued), Some(Status::Running)],
            (Action::Cancel, Some(status)) if status.is_ended() => vec![],
            (Action::Cancel, status) => vec![status],
        };
        // Models that are accepted meanwhile are not among them.
        let Some(&newest) = self.state.store.ids(&ListFilter { limit: 1, ..filter.clone() }).await?.first() else {
            return Ok(());
        };
        let before = Some(JobId(uuid::Uuid::from_u128(newest.0.as_u128().saturating_add(1))));
        let filter = ListFilter { before, ..filter };
        for _ in 0..if self.request.dry_run || statuses.len() < 2 { 1 } else { ROUNDS } {
            let before = self.count;
            for status in &statuses {
                self.round(ListFilter { status: *status, ..filter.clone() }).await?;
            }
            if self.count == before {
                break;
            }
        }
        Ok(())
    }

    /// Goes through the models of a filter once, newest first.
    async fn round(&mut self, mut filter: ListFilter) -> Result<(), StoreError> {
        let Request { filter: asked, dry_run } = &self.request;
        filter.limit = if *dry_run { 1000 } else { AT_A_TIME };
        loop {
            let ids = self.state.store.ids(&filter).await?;
            let Some(&last) = ids.last() else { return Ok(()) };
            filter.before = Some(last);
            self.count += match dry_run {
                true => ids.len() as u64,
                // One that is queued again meanwhile is cancelled too, unless the client asked for those that run.
                false => change(&self.state, self.action, ids, asked.status).await?,
            };
        }
    }
}

fn flag(parameters: &Parameters, name: &str, faults: &mut Faults) -> bool {
    match parameters.get(name) {
        Some("true") => true,
        None | Some("false") => false,
        Some(_) => {
            faults.push(Fault::parameter(name, "must be true or false"));
            false
        }
    }
}

/// Changes those of these models that are still in `status`, in one transaction; gives their number.
async fn change(state: &AppState, action: Action, ids: Vec<JobId>, status: Option<Status>) -> Result<u64, StoreError> {
    let applied = match action {
        Action::Cancel => state.store.cancel_many(ids, status).await?,
        Action::Delete => state.store.delete_many(ids, status).await?,
    };
    if !applied.keys.is_empty() {
        state.forget(applied.keys).await;
    }
    Ok(applied.jobs)
}

/// Does what a request asks for, and records it, also if it fails on the way.
async fn answer(
    state: AppState,
    caller: Caller,
    parameters: &Parameters,
    action: Action,
) -> Result<Json<Applied>, Problem> {
    let request = Request::read(parameters, &caller)?;
    let dry_run = request.dry_run;
    // A value may contain line breaks, which would forge lines of a log.
    let conditions: Vec<String> = parameters.0.iter().map(|(name, value)| format!("{name}={value:?}")).collect();
    let count = run_to_completion(async move {
        let mut run = Run { state, action, request, count: 0 };
        let done = run.all().await;
        if !dry_run {
            audit(&caller, action.name(), format_args!("{} models of {}", run.count, conditions.join(", ")));
        }
        done.map(|()| run.count)
    });
    Ok(Json(Applied { count: count.await?, dry_run }))
}

/// Cancel all models that match.
///
/// Queued models end at once, running ones within a second; ended models do not change. The conditions are those of
/// `GET /models`; without any, `all=true` is needed.
#[utoipa::path(
    post, path = "/models/cancel", operation_id = "cancel_models", tag = "models",
    params(
        Conditions,
        ("all" = Option<bool>, Query, description = "Whether all models are meant, if no other parameter says which"),
        ("dry_run" = Option<bool>, Query, description = "Whether models are only counted"),
    ),
    responses((status = 200, description = "What was done", body = Applied), BadParameters, StoreAway)
)]
pub(in crate::http) async fn cancel(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
) -> Result<Json<Applied>, Problem> {
    answer(state, caller, &parameters, Action::Cancel).await
}

/// Delete all models that match, and their files.
///
/// Models that have not ended are cancelled; files that another model shares are kept. The conditions are those of
/// `GET /models`; without any, `all=true` is needed.
#[utoipa::path(
    delete, path = "/models", operation_id = "delete_models", tag = "models",
    params(
        Conditions,
        ("all" = Option<bool>, Query, description = "Whether all models are meant, if no other parameter says which"),
        ("dry_run" = Option<bool>, Query, description = "Whether models are only counted"),
    ),
    responses((status = 200, description = "What was done", body = Applied), BadParameters, StoreAway)
)]
pub(in crate::http) async fn delete(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
) -> Result<Json<Applied>, Problem> {
    answer(state, caller, &parameters, Action::Delete).await
}

/// Cancel all models of a batch.
///
/// Queued models end at once, running ones within a second; ended models do not change.
#[utoipa::path(
    post, path = "/batches/{id}/cancel", operation_id = "cancel_batch", tag = "batches",
    params(("id" = Uuid, Path, description = "Id of the batch")),
    responses((status = 200, description = "The batch", body = Batch), BatchMissing, StoreAway)
)]
pub(in crate::http) async fn cancel_batch(
    State(state): State<AppState>,
    caller: Caller,
    BatchId(id): BatchId,
) -> Result<Json<Batch>, Problem> {
    let batch = caller.batch(state.store.batch(id).await?).ok_or_else(|| no_batch(id))?;
    let batch = run_to_completion(async move {
        let mut done = Ok(0);
        for some in batch.jobs.chunks(AT_A_TIME as usize) {
            done = change(&state, Action::Cancel, some.to_vec(), None).await;
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
