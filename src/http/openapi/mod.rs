//! The description of the service (OpenAPI 3.1), generated from the routes and their types.
//!
//! The committed `openapi.yaml` equals this description, byte for byte; a test compares them. To
//! regenerate the file, run `cargo run -- openapi > openapi.yaml`.
//!
//! | file | subject |
//! |---|---|
//! | `operations` | problems, headers and security of all operations; media types |
//! | `schemas` | schemas that utoipa cannot derive |
//! | `docs` | the description as a page |
//! | `examples` | examples of requests and responses |

pub(in crate::http) mod docs;
mod examples;
mod operations;
pub(in crate::http) mod schemas;

use super::models::model::{DeletedEvent, ModelEvent};
use crate::generate::{Backend, Output};
use crate::http::wire::faults::RequestFault;
use crate::http::wire::problem::ProblemBody;
use crate::measure::Certificate;
use crate::model::{BodyKind, LengthUnit};
use axum::Extension;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};
use std::sync::OnceLock;
use utoipa::OpenApi;

#[derive(OpenApi)]
#[openapi(
    components(schemas(
        crate::http::models::model::Detail, ProblemBody, RequestFault, Backend, Output, BodyKind, LengthUnit,
        crate::http::pictures::sections::SectionFormat, crate::http::pictures::slides::Stain,
        crate::render::NamedView, super::batches::table::TableFormat, super::batches::archive::ArchiveFormat,
        ModelEvent, DeletedEvent, Certificate
    )),
    tags(
        (name = "models", description = "Request, find, cancel and delete models"),
        (name = "fits", description = "Search for parameters that reproduce given measures"),
        (name = "batches", description = "Many models of one spec in one request"),
        (name = "operations", description = "Cancellation and deletion of many models"),
        (name = "events", description = "Follow models while they grow"),
        (name = "files", description = "Files, sections and reports of finished models"),
        (name = "access", description = "Tickets for clients that cannot send a key"),
        (name = "presets", description = "Presets and the parameters of a spec"),
        (name = "service", description = "Health, metrics, workers and this description"),
    )
)]
struct Base;

/// Returns the description of all routes. Only the router knows the routes, so it provides this
/// function as an extension.
#[derive(Clone, Copy)]
pub(super) struct Description(pub(super) fn() -> &'static Value);

/// Read this description as YAML.
///
/// The description is the same for every caller and changes only with the version of the service.
#[utoipa::path(
    get, path = "/openapi.yaml", operation_id = "get_openapi", tag = "service",
    responses((status = 200, description = "This description", content_type = "application/yaml", body = String))
)]
pub(super) async fn document(Extension(description): Extension<Description>) -> Response {
    static TEXT: OnceLock<String> = OnceLock::new();
    let text = TEXT.get_or_init(|| yaml(description.0())).as_str();
    ([(header::CONTENT_TYPE, HeaderValue::from_static("application/yaml"))], text).into_response()
}

/// A description as YAML: the content of `openapi.yaml`.
pub(super) fn yaml(description: &Value) -> String {
    let mut yaml = String::from("# Generated from the code: cargo run -- openapi > openapi.yaml\n");
    for part in ["openapi", "info", "servers", "tags", "paths", "components"] {
        let text = yaml_serde::to_string(&json!({ part: description[part] })).expect("JSON is YAML");
        yaml.push_str(&text);
    }
    yaml
}

/// The description of these routes.
pub(super) fn describe(routes: utoipa::openapi::OpenApi) -> Value {
    let mut api = Base::openapi();
    api.merge(routes);
    let mut document = serde_json::to_value(api).expect("a description has string keys only");
    document["info"] = info();
    // Relative to the URL of this document, so it is also valid below the prefix of a proxy.
    document["servers"] = json!([{ "url": ".", "description": "The service that sent this description" }]);
    schemas::complete(&mut document["components"]["schemas"]);
    operations::complete(&mut document["paths"]);
    schemas::plain_integers(&mut document);
    document["components"]["securitySchemes"] = operations::security_schemes();
    examples::add(&mut document);
    document
}

fn info() -> Value {
    json!({
        "title": "oviduct",
        "version": crate::ENGINE_VERSION,
        "license": { "name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0" },
        "description": "Grows 3D models of folded tubular organs. Request one with `POST /models`, follow its events, \
            download its files. Every error response is a problem (RFC 9457); every response has `x-request-id`, and every \
            response to a key with a rate has `ratelimit` and `ratelimit-policy`.",
    })
}
