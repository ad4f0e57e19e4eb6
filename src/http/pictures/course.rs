//! `GET /models/{id}/course`: the centre line that a model follows, with a local frame at each
//! point.

use crate::export::course::CourseDocument;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::models::files::{IMMUTABLE, find_model, permit};
use crate::http::wire::blocking::blocking;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::ModelId;
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{DownloadUnavailable, ModelMissing};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

/// Course of a model.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct CourseAnswer {
    /// Id of the model.
    model: Uuid,
    #[serde(flatten)]
    course: CourseDocument,
}

/// Read the centre line that a model follows.
///
/// The response contains points at equal distances along the centre line, each with a local frame.
/// A point (x, y) of the section at `s_mm` is at `position_mm` + x·`u` + y·`v` in the files of the
/// model. A straight line between two points stays within 1 µm of the centre line. The course
/// follows from the spec, so it is known before the model has grown. A straight tube has two
/// points.
#[utoipa::path(
    get, path = "/models/{id}/course", operation_id = "get_course", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The course", body = CourseAnswer, headers(
            ("etag" = String, description = "Entity tag of the course"))),
        (status = 304, description = "The client has this course"),
        ModelMissing, DownloadUnavailable,
    )
)]
pub(in crate::http) async fn course(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let job = find_model(&state, &caller, id).await?;
    let tag = ETag::strong(format_args!("{}-course-{}", job.digest, env!("CARGO_PKG_VERSION")));
    if tag.matches_none(&headers) {
        return tag.not_modified(IMMUTABLE);
    }
    let permit = permit(&state, &caller)?;
    let course = blocking("Making the course", permit, move || CourseDocument::of_stored(&job.spec))
        .await?
        .ok_or_else(|| {
            tracing::error!("a stored specification has no course");
            Problem::new(Kind::Internal, "The course of the model cannot be read.")
        })?;
    let headers = [(header::ETAG, tag.header()?), (header::CACHE_CONTROL, IMMUTABLE)];
    Ok((headers, Json(CourseAnswer { model: id.0, course })).into_response())
}
