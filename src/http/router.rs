//! All routes, grouped by their access rules.

use super::access::Rule;
use super::access::tickets;
use super::models::{files, retry};
use super::openapi::Description;
use super::openapi::docs;
use super::pictures::{course, cut, preview, report_page, sections, way};
use super::wire::compress::compress;
use super::wire::envelope::enclose;
use super::{AppState, batches, console, events, fits, health, metrics, models, openapi, operations, presets, workers};
use axum::{Extension, Router};
use serde_json::Value;
use std::sync::{Arc, LazyLock};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The routes with their descriptions, except for the files of the console, which everyone may
/// read.
fn routes() -> OpenApiRouter<AppState> {
    let open =
        OpenApiRouter::new().routes(routes!(health::alive)).routes(routes!(health::ready)).routes(routes!(docs::page));
    let any_key = OpenApiRouter::new()
        .routes(routes!(presets::list))
        .routes(routes!(presets::get))
        .routes(routes!(presets::spec_schema))
        .routes(routes!(openapi::document));
    let read = OpenApiRouter::new()
        .routes(routes!(models::read::list))
        .routes(routes!(models::read::get))
        .routes(routes!(models::create::validate))
        .routes(routes!(batches::create::validate))
        .routes(routes!(batches::read::list))
        .routes(routes!(batches::read::get))
        .routes(routes!(batches::table::table))
        .routes(routes!(batches::archive::archive))
        .routes(routes!(events::routes::of_model))
        .routes(routes!(events::routes::of_all))
        .routes(routes!(files::download))
        .routes(routes!(files::report))
        .routes(routes!(report_page::page))
        .routes(routes!(files::manifest))
        .routes(routes!(sections::section))
        .routes(routes!(course::course))
        .routes(routes!(cut::cut))
        .routes(routes!(way::way))
        .routes(routes!(preview::preview))
        .routes(routes!(operations::read::list))
        .routes(routes!(operations::read::get))
        .routes(routes!(fits::read::list))
        .routes(routes!(fits::read::get))
        .routes(routes!(fits::create::validate))
        .routes(routes!(events::routes::of_fit))
        .routes(routes!(workers::list))
        .routes(routes!(tickets::create));
    let submit = OpenApiRouter::new()
        .routes(routes!(models::create::create))
        .routes(routes!(models::read::delete))
        .routes(routes!(models::read::cancel))
        .routes(routes!(retry::retry))
        .routes(routes!(operations::apply::cancel))
        .routes(routes!(operations::apply::delete))
        .routes(routes!(operations::apply::cancel_batch))
        .routes(routes!(operations::read::cancel))
        .routes(routes!(fits::create::create))
        .routes(routes!(fits::read::cancel))
        .routes(routes!(fits::read::delete))
        .routes(routes!(batches::create::create))
        .routes(routes!(batches::read::delete));
    let admin = OpenApiRouter::new()
        .routes(routes!(metrics::read))
        .routes(routes!(workers::pause_all))
        .routes(routes!(workers::resume_all))
        .routes(routes!(workers::pause))
        .routes(routes!(workers::resume))
        .routes(routes!(workers::drain));
    Rule::Open
        .guard(open)
        .merge(Rule::AnyKey.guard(any_key))
        .merge(Rule::Read.guard(read))
        .merge(Rule::Submit.guard(submit))
        .merge(Rule::Admin.guard(admin))
}

/// The OpenAPI description of all routes.
pub(super) fn description() -> &'static Value {
    static DESCRIPTION: LazyLock<Value> = LazyLock::new(|| openapi::describe(routes().into_openapi()));
    &DESCRIPTION
}

/// The description of the service as YAML: the content of `openapi.yaml`.
#[must_use]
pub fn openapi_yaml() -> String {
    openapi::yaml(description())
}

/// The service. Every error response is a problem, and every response has a request id.
pub fn router(state: AppState) -> Router {
    let counting = axum::middleware::from_fn_with_state(state.metrics.clone(), metrics::count);
    let routes = Router::from(routes()).merge(console::routes()).layer(Extension(Description(description)));
    let origins = state.limits.cors_origins.clone();
    let routes = routes.layer(Extension(Arc::clone(&state.access))).layer(counting).with_state(state);
    enclose(compress(routes), &origins)
}

/// Health, readiness and metrics only, for a process without an API and for an address that only
/// operators reach.
pub fn watch_router(state: AppState) -> Router {
    let routes = OpenApiRouter::new()
        .routes(routes!(health::alive))
        .routes(routes!(health::ready))
        .routes(routes!(metrics::read));
    enclose(Router::from(routes).with_state(state), &[])
}
