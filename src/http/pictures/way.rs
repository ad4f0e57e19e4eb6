//! `GET /models/{id}/way`: the way through the lumen of a stored model, made on request.

use super::draw::{kept, turn};
use super::{sections, surfaces};
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::files::{IMMUTABLE, find, permit};
use crate::http::wire::blocking::blocking;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::{ModelId, Parameters};
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{CutProblems, PictureUnavailable, WayMissing};
use crate::measure::way::{NoWay, Way};
use crate::spec::ModelSpec;
use crate::way::{WayError, way as find_way};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

/// A way through the lumen of a model.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct WayAnswer {
    /// Id of the model.
    model: Uuid,
    /// Name of the file whose surface the way does not touch.
    file: String,
    /// Distance that every point of the way keeps from this surface, micrometres.
    clearance_um: f64,
    /// Length of the way, millimetres.
    length_mm: f64,
    /// Points from the isthmus end to the ampulla end, which straight lines join.
    points: Vec<WayPointAnswer>,
}

/// A point of a way.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct WayPointAnswer {
    /// Place along the tube or its centre line, millimetres. Ascends unless the way has to go back.
    s_mm: f64,
    /// Position in the files of the model, millimetres.
    position_mm: [f64; 3],
    /// Direction of the way, a unit vector.
    tangent: [f64; 3],
    /// Distance from the surface, micrometres.
    clearance_um: f64,
}

impl WayAnswer {
    fn new(model: Uuid, file: String, way: &Way) -> Self {
        let points = way.points.iter().map(|point| WayPointAnswer {
            s_mm: 1e-3 * point.place_um,
            position_mm: point.position_um.map(|x| 1e-3 * x),
            tangent: point.tangent,
            clearance_um: point.clearance_um,
        });
        let length_mm = 1e-3 * way.length_um();
        Self { model, file, clearance_um: way.clearance_um, length_mm, points: points.collect() }
    }
}

/// Find a way through the lumen of a finished model.
///
/// The way leads from the isthmus end to the ampulla end through the lumen of the stored surface
/// and touches nothing: every point of its straight lines keeps `clearance_um` from the surface.
/// It follows the wide parts of the lumen where it can. The service makes a way in one to a few
/// seconds and keeps recent ones. The same version of the service always makes the same way.
#[utoipa::path(
    get, path = "/models/{id}/way", operation_id = "get_way", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The way", body = WayAnswer, headers(
            ("etag" = String, description = "Entity tag of the way"))),
        (status = 304, description = "The client has this way"),
        WayMissing, CutProblems, PictureUnavailable,
    )
)]
pub(in crate::http) async fn way(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    Problem::check(parameters.faults(&[], &[]))?;
    let (job, recorded) = find(&state, &caller, id, "sections.bin").await?;
    let (file, format) = surfaces::file(&job)?;
    let tag = ETag::strong(format_args!("{}-way-{}", file.sha256, env!("CARGO_PKG_VERSION")));
    if tag.matches_none(&headers) {
        return tag.not_modified(IMMUTABLE);
    }
    if let Some(json) = kept(&state, &tag) {
        return answer(&tag, json);
    }
    let turn = turn(&state, &caller).await?;
    let body = surfaces::read(&state, &caller, &file, format, &turn).await?;
    let sections = {
        let _download = permit(&state, &caller)?;
        let entries = sections::read_index(&state, &recorded).await?;
        sections::read_entries(&state, &recorded, entries, turn.clone()).await?
    };
    let Some(spec) = ModelSpec::from_stored(&job.spec) else {
        tracing::error!("a stored specification cannot be read");
        return Err(Problem::new(Kind::Internal, "The specification of the model cannot be read."));
    };
    let made = blocking("Making the way", turn, move || find_way(sections, &body, &spec, job.seed)).await?;
    let way = made.map_err(|error| match error {
        WayError::NoWay(NoWay { place_um }) => {
            let detail = format!("No way through the lumen was found beyond {place_um:.1} µm along the tube.");
            Problem::new(Kind::WayNotFound, detail)
        }
        WayError::Loft(error) => {
            tracing::error!(%error, "stored sections cannot be lofted");
            Problem::new(Kind::Internal, "The sections of the model cannot be lofted.")
        }
    })?;
    let json = serde_json::to_vec(&WayAnswer::new(id.0, file.name, &way)).map_err(|error| {
        tracing::error!(%error, "a way cannot be written");
        Problem::new(Kind::Internal, "The way cannot be written.")
    })?;
    let json = Bytes::from(json);
    state.pictures.keep_picture(tag.clone(), json.clone());
    answer(&tag, json)
}

fn answer(tag: &ETag, json: Bytes) -> Result<Response, Problem> {
    let kind = HeaderValue::from_static("application/json");
    let headers = [(header::CONTENT_TYPE, kind), (header::ETAG, tag.header()?), (header::CACHE_CONTROL, IMMUTABLE)];
    Ok((headers, json).into_response())
}
