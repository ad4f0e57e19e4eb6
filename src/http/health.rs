//! `GET /healthz` and `GET /readyz`: alive, and able to take work.

use super::AppState;
use super::openapi::StoreAway;
use super::problem::{Kind, Problem};
use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

/// How the service is.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Health {
    /// `ok`.
    status: &'static str,
    /// Version of the service.
    version: &'static str,
}

const OK: Health = Health { status: "ok", version: crate::ENGINE_VERSION };

/// Whether the service is alive.
#[utoipa::path(
    get, path = "/healthz", operation_id = "get_health", tag = "service",
    responses((status = 200, description = "It is alive", body = Health))
)]
pub(super) async fn alive() -> Json<Health> {
    Json(OK)
}

/// Whether the service can take work: the job store answers.
#[utoipa::path(
    get, path = "/readyz", operation_id = "get_readiness", tag = "service",
    responses((status = 200, description = "It can", body = Health), StoreAway)
)]
pub(super) async fn ready(State(state): State<AppState>) -> Result<Json<Health>, Problem> {
    if let Some((_, detail)) = state.status.not_ready() {
        return Err(Problem::new(Kind::StoreUnavailable, detail));
    }
    state.store.ready().await?;
    Ok(Json(OK))
}
