//! `GET /workers`: the workers of the installation, their devices and their models.

use super::AppState;
use super::dto::WorkerList;
use super::problem::Problem;
use super::responses::StoreAway;
use axum::Json;
use axum::extract::State;

/// List the workers that sent a heartbeat within the last minutes.
#[utoipa::path(
    get, path = "/workers", operation_id = "list_workers", tag = "service",
    responses((status = 200, description = "The workers", body = WorkerList), StoreAway)
)]
pub(super) async fn list(State(state): State<AppState>) -> Result<Json<WorkerList>, Problem> {
    let workers = state.store.workers().await?.into_iter().map(Into::into).collect();
    Ok(Json(WorkerList { workers }))
}
