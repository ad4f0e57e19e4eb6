//! `GET /healthz` and `GET /readyz`: liveness and readiness of the process.

use super::AppState;
use super::wire::problem::{Kind, Problem};
use super::wire::responses::{Unhealthy, Unready};
use crate::jobs::{StoreError, with_causes};
use crate::status::Condition;
use axum::Json;
use axum::extract::State;
use axum::http::header;
use serde::Serialize;
use std::future::Future;
use std::time::Duration;
use utoipa::ToSchema;

/// The state of the service.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Health {
    /// `ok`.
    status: &'static str,
    /// Version of the service.
    version: &'static str,
}

const OK: Health = Health { status: "ok", version: crate::ENGINE_VERSION };

/// Check whether the process works.
///
/// The response is 503 if a worker has been stuck for minutes. The process should then be
/// restarted.
#[utoipa::path(
    get, path = "/healthz", operation_id = "get_health", tag = "service",
    responses((status = 200, description = "The process works", body = Health), Unhealthy)
)]
pub(super) async fn alive(State(state): State<AppState>) -> Result<Json<Health>, Problem> {
    let stuck = state.status.stuck_workers();
    if stuck.is_empty() {
        return Ok(Json(OK));
    }
    let detail = format!("Workers have not stopped although they were told to: {}.", stuck.join("; "));
    Err(Problem::new(Kind::WorkersStuck, detail).with("workers", stuck).with_header(header::RETRY_AFTER, LATER))
}

/// Check whether the process accepts work.
///
/// The response is 503 while the job store is unavailable, the artifact store or the scratch
/// directory refuses files, or the process is opening its GPUs or shutting down.
#[utoipa::path(
    get, path = "/readyz", operation_id = "get_readiness", tag = "service",
    responses((status = 200, description = "The process accepts work", body = Health), Unready)
)]
pub(super) async fn ready(State(state): State<AppState>) -> Result<Json<Health>, Problem> {
    if let Some((condition, detail)) = state.status.not_ready() {
        return Err(not_ready(condition, detail));
    }
    match tokio::join!(check_jobs(&state), check_artifacts(&state)) {
        (Ok(()), Ok(())) => Ok(Json(OK)),
        (Err(store), artifacts) => {
            let detail = match artifacts {
                Ok(()) => "The job store is unavailable. Try again later.",
                Err(_) => "The job store and the artifact store are unavailable. Try again later.",
            };
            Err(Problem::from(StoreError::Database(store.into())).with_detail(detail))
        }
        // The message is only logged, because it can contain host names and paths.
        (Ok(()), Err(error)) => {
            tracing::error!(error, "the artifact store is unavailable");
            let detail = "The artifact store is unavailable: it did not accept a test file.";
            Err(Problem::new(Kind::StorageUnavailable, detail).with_header(header::RETRY_AFTER, LATER))
        }
    }
}

async fn check_jobs(state: &AppState) -> Result<(), String> {
    let (store, availability) = (state.store.clone(), state.store_availability.clone());
    let check = async move {
        let read = async {
            store.ready().await.map_err(|error| match error {
                StoreError::Database(cause) => with_causes(&*cause),
                other => other.to_string(),
            })
        };
        availability.check(read).await
    };
    in_time(JOBS_CHECK_TIME, check, || state.store_availability.outage()).await
}

async fn check_artifacts(state: &AppState) -> Result<(), String> {
    let artifacts = state.artifacts.clone();
    let check = async move { artifacts.check().await.map_err(|error| error.to_string()) };
    in_time(ARTIFACTS_CHECK_TIME, check, || state.artifacts.outage()).await
}

/// Returns the result of `check`. A check that takes longer than `limit`, such as on a busy disk,
/// continues in the background. Until it ends, the known `outage` is the result.
async fn in_time(
    limit: Duration,
    check: impl Future<Output = Result<(), String>> + Send + 'static,
    outage: impl FnOnce() -> Option<String>,
) -> Result<(), String> {
    match tokio::time::timeout(limit, tokio::spawn(check)).await {
        Ok(Ok(checked)) => checked,
        Ok(Err(panic)) => Err(panic.to_string()),
        Err(_) => outage().map_or(Ok(()), Err),
    }
}

/// Refuses a submission while this process cannot store files. The record would use up the reserve
/// that the job store needs for deletions, which free space.
pub(super) fn check_storage(state: &AppState) -> Result<(), Problem> {
    let detail = state.status.detail(Condition::Storage);
    detail.map_or(Ok(()), |detail| Err(not_ready(Condition::Storage, detail)))
}

/// The problem of a process that does not accept work.
pub(super) fn not_ready(condition: Condition, detail: impl Into<String>) -> Problem {
    Problem::new(Kind::NotReady, detail).with("condition", condition.name()).with_header(header::RETRY_AFTER, LATER)
}

/// Maximum time for which a probe waits for the job store: a little longer than a check of a
/// server. Probes of orchestrators often time out after 1 s.
const JOBS_CHECK_TIME: Duration = Duration::from_millis(900);
/// Maximum time for which a probe waits for the artifact store, whose check writes a file.
const ARTIFACTS_CHECK_TIME: Duration = Duration::from_millis(50);
/// `Retry-After`, in seconds.
const LATER: u32 = 5;
