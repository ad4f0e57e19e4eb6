//! `GET /workers`: who grows models, on what, and how they fare.

use super::AppState;
use super::dto::WorkerList;
use super::openapi::StoreAway;
use super::problem::Problem;
use axum::Json;
use axum::extract::State;

/// List the workers seen in the last minutes.
#[utoipa::path(
    get, path = "/workers", operation_id = "list_workers", tag = "service",
    responses((status = 200, description = "The workers", body = WorkerList), StoreAway)
)]
pub(super) async fn list(State(state): State<AppState>) -> Result<Json<WorkerList>, Problem> {
    let workers = state.store.workers().await?.into_iter().map(Into::into).collect();
    Ok(Json(WorkerList { workers }))
}
