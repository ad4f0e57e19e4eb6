//! All routes on one page, and what surrounds them.

use super::envelope::enclose;
use super::{
    AppState, batches, create, docs, events, files, health, home, metrics, models, openapi, presets, sections, workers,
};
use axum::Router;
use axum::routing::get;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The routes with their descriptions.
pub(super) fn routes() -> OpenApiRouter<AppState> {
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

/// The service. Every error answer of it is a problem, every answer carries a request id.
pub fn router(state: AppState) -> Router {
    let counting = axum::middleware::from_fn_with_state(state.metrics.clone(), metrics::count);
    enclose(Router::from(routes()).route("/", get(home::page)).layer(counting).with_state(state))
}

/// What can be asked of a process that only works: whether it is alive and ready, and its counts.
pub fn watch_router(state: AppState) -> Router {
    let routes = OpenApiRouter::new()
        .routes(routes!(health::alive))
        .routes(routes!(health::ready))
        .routes(routes!(metrics::read));
    enclose(Router::from(routes).with_state(state))
}
