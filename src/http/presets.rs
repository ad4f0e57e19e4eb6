//! `GET /presets`, `GET /presets/{name}`, `GET /schema`: presets, and the JSON Schema of a spec.

use super::openapi::schemas::JsonSchema;
use super::wire::extract::PathTexts;
use super::wire::problem::{Kind, Problem};
use super::wire::responses::PresetMissing;
use crate::spec::{PresetDetails, PresetSummary, preset, presets, schema};
use axum::Json;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

/// The presets.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct PresetList {
    /// The presets, the default first.
    presets: Vec<PresetSummary<'static>>,
}

/// List the presets.
///
/// The default preset comes first.
#[utoipa::path(
    get, path = "/presets", operation_id = "list_presets", tag = "presets",
    responses((status = 200, description = "The presets", body = PresetList))
)]
pub(super) async fn list() -> Json<PresetList> {
    Json(PresetList { presets: presets().iter().map(crate::spec::Preset::summary).collect() })
}

/// Read a preset: its values, each with unit and source.
///
/// The `spec` of a request is merged into these values.
#[utoipa::path(
    get, path = "/presets/{name}", operation_id = "get_preset", tag = "presets",
    params(("name" = String, Path, description = "Name of the preset")),
    responses((status = 200, description = "The preset", body = PresetDetails<'static>), PresetMissing)
)]
pub(super) async fn get(path: PathTexts) -> Result<Json<PresetDetails<'static>>, Problem> {
    let found = preset(path.get("name")).ok_or_else(|| {
        let names: Vec<_> = presets().iter().map(|p| p.name.as_str()).collect();
        Problem::new(Kind::PresetNotFound, format!("The presets are {}.", names.join(", ")))
    })?;
    Ok(Json(found.details()))
}

/// Read the JSON Schema of a spec: titles, units, bounds, defaults.
///
/// The schema describes the `spec` of a request. Its defaults are the values of the default preset.
#[utoipa::path(
    get, path = "/schema", operation_id = "get_schema", tag = "presets",
    responses((status = 200, description = "JSON Schema, draft 2020-12", content_type = "application/schema+json", body = JsonSchema))
)]
pub(super) async fn spec_schema() -> Response {
    let kind = (header::CONTENT_TYPE, HeaderValue::from_static("application/schema+json"));
    ([kind], schema().to_string()).into_response()
}
