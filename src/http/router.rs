//! All routes.

use super::envelope::enclose;
use super::openapi::Description;
use super::{
    AppState, batches, create, docs, events, files, health, home, metrics, models, openapi, presets, sections, workers,
};
use axum::routing::get;
use axum::{Extension, Router};
use serde_json::Value;
use std::sync::LazyLock;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The routes with their descriptions.
fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(models::list, create::create))
        .routes(routes!(create::validate))
        .routes(routes!(models::get, models::delete))
        .routes(routes!(models::cancel))
        .routes(routes!(batches::create))
        .routes(routes!(batches::get, batches::delete))
        .routes(routes!(events::of_model))
        .routes(routes!(events::of_all))
        .routes(routes!(files::download))
        .routes(routes!(files::report))
        .routes(routes!(sections::section))
        .routes(routes!(presets::list))
        .routes(routes!(presets::get))
        .routes(routes!(presets::spec_schema))
        .routes(routes!(workers::list))
        .routes(routes!(health::alive))
        .routes(routes!(health::ready))
        .routes(routes!(metrics::read))
        .routes(routes!(openapi::document))
        .routes(routes!(docs::page))
}

/// The description of all routes.
pub(super) fn description() -> &'static Value {
    static DESCRIPTION: LazyLock<Value> = LazyLock::new(|| openapi::describe(routes().into_openapi()));
    &DESCRIPTION
}

/// The description of the service as YAML: what `openapi.yaml` holds.
#[must_use]
pub fn openapi_yaml() -> String {
    openapi::yaml(description())
}

/// The service. Every error response is a problem, every response has a request id.
pub fn router(state: AppState) -> Router {
    let counting = axum::middleware::from_fn_with_state(state.metrics.clone(), metrics::count);
    let routes = Router::from(routes()).route("/", get(home::page)).layer(Extension(Description(description)));
    enclose(routes.layer(counting).with_state(state))
}

/// Health, readiness and metrics only: for a process without an API, and for an address that only operators reach.
pub fn watch_router(state: AppState) -> Router {
    let routes = OpenApiRouter::new()
        .routes(routes!(health::alive))
        .routes(routes!(health::ready))
        .routes(routes!(metrics::read));
    enclose(Router::from(routes).with_state(state))
}
