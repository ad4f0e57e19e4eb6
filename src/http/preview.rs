//! `GET /models/{id}/preview.png`: a picture of a model, drawn on request.
//!
//! A picture is drawn on blocking threads, a few at a time; a request waits for its turn, for a bounded time, and leaves the
//! queue when its client goes. Pictures that were asked for lately are kept in memory: clients cache them, but many clients
//! show the same ones.

use super::AppState;
use super::access::Caller;
use super::conditional::ETag;
use super::extract::{ModelId, Parameters};
use super::faults::Fault;
use super::files::{find, permit};
use super::pictures::Turn;
use super::problem::{Kind, Problem};
use super::responses::{BadParameters, FileMissing, PictureAway};
use super::sections;
use crate::clock::Stopwatch;
use crate::jobs::File;
use crate::mesh::{LoftError, draft};
use crate::model::Section;
use crate::preview::{chosen, end};
use crate::render::{MEDIA_TYPE, NamedView, RenderError, mesh_png};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Longest side of a picture, pixels.
const SIZES: RangeInclusive<u32> = 32..=2048;
/// Longest side if none is asked for.
const SIZE: u32 = 1024;

/// A model never changes, but another version of the service may draw it in another way.
const A_DAY: HeaderValue = HeaderValue::from_static("private, max-age=86400");

/// Draw a picture of a finished model.
///
/// PNG with a transparent background. From 256 pixels on it has a scale bar, which also names the factor by which a long tube
/// is shortened. The same version of the service draws the same picture.
#[utoipa::path(
    get, path = "/models/{id}/preview.png", operation_id = "get_preview", tag = "files",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("view" = Option<NamedView>, Query, description = "`opened` (the default): the whole tube with a quarter cut away along it; `whole`: the tube from outside; `isthmus`, `ampulla`: one end, in true proportions"),
        ("size" = Option<u32>, Query, minimum = 32, maximum = 2048, description = "Longest side, pixels; 1024 by default"),
        ("if-none-match" = Option<String>, Header, description = "Entity tags that the client has"),
    ),
    responses(
        (status = 200, description = "The picture", headers(
            ("etag" = String, description = "Entity tag of the picture"))),
        (status = 304, description = "The client has this picture"),
        FileMissing, BadParameters, PictureAway,
    )
)]
pub(super) async fn preview(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    parameters: Parameters,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (view, size) = options(&parameters)?;
    let (_, file) = find(&state, &caller, id, "sections.bin").await?;
    let tag = ETag::strong(format_args!("{}-{}-{size}-{}", file.sha256, view.name(), env!("CARGO_PKG_VERSION")));
    if tag.matches_none(&headers) {
        return tag.not_modified(A_DAY);
    }
    let png = match state.pictures.kept(&tag) {
        Some(png) => {
            state.metrics.picture("kept");
            png
        }
        None => draw(&state, &caller, &file, view, size, &tag).await?,
    };
    if method == Method::GET {
        state.metrics.bytes_out(png.len() as u64);
    }
    let kind = HeaderValue::from_static(MEDIA_TYPE);
    let headers = [(header::CONTENT_TYPE, kind), (header::ETAG, tag.header()?), (header::CACHE_CONTROL, A_DAY)];
    Ok((headers, png).into_response())
}

fn options(parameters: &Parameters) -> Result<(NamedView, u32), Problem> {
    let mut faults = parameters.faults(&["view", "size"], &[]);
    let view = parameters.get("view").map_or(Ok(NamedView::default()), str::parse).unwrap_or_else(|error| {
        faults.push(Fault::parameter("view", error.to_string()));
        NamedView::default()
    });
    let size = parameters.get("size").map_or(Some(SIZE), |text| text.parse().ok().filter(|size| SIZES.contains(size)));
    if size.is_none() {
        let detail = format!("must be a whole number from {} to {}", SIZES.start(), SIZES.end());
        faults.push(Fault::parameter("size", detail));
    }
    Problem::check(faults)?;
    Ok((view, size.unwrap_or(SIZE)))
}

/// Draws a picture, when it is its turn, and keeps it.
async fn draw(
    state: &AppState,
    caller: &Caller,
    file: &File,
    view: NamedView,
    size: u32,
    tag: &ETag,
) -> Result<Bytes, Problem> {
    let turn = turn(state, caller).await?;
    // Another request may have drawn it while this one waited.
    if let Some(png) = state.pictures.kept(tag) {
        state.metrics.picture("kept");
        return Ok(png);
    }
    let sections = shown(state, file, view, size).await?;
    let (pictures, metrics, tag) = (Arc::clone(&state.pictures), state.metrics.clone(), tag.clone());
    let drawn = tokio::task::spawn_blocking(move || {
        // The turn is over when the threads are free, and the picture is kept, even if the client has gone.
        let _turn = turn;
        let begun = Stopwatch::start();
        let mesh = draft(&sections)?;
        drop(sections);
        let png = Bytes::from(mesh_png(&mesh, &view.of(&mesh, size))?);
        metrics.picture_drawn(begun.elapsed());
        pictures.keep(tag, png.clone());
        Ok::<_, DrawError>(png)
    });
    drawn.await.map_err(|error| failed(&error))?.map_err(|error| failed(&error))
}

/// The sections in a picture; no others are read.
async fn shown(state: &AppState, file: &File, view: NamedView, size: u32) -> Result<Vec<Section>, Problem> {
    let _download = permit(state)?;
    let entries = sections::read_index(state, file).await?;
    let end = match end(view, entries.len()) {
        Some(k) => sections::read_entries(state, file, vec![entries[k]]).await?.pop(),
        None => None,
    };
    let chosen = chosen(&entries, end.as_ref(), size).into_iter().map(|k| entries[k]).collect();
    sections::read_entries(state, file, chosen).await
}

/// Room for one more picture that is drawn.
async fn turn(state: &AppState, caller: &Caller) -> Result<Turn, Problem> {
    state.pictures.turn(caller.owner(), state.limits.picture_wait).await.ok_or_else(|| {
        state.metrics.picture("refused");
        let problem = Problem::new(Kind::TooManyPictures, "Many pictures are being drawn. Try again later.");
        problem.with_header(header::RETRY_AFTER, HeaderValue::from_static("5"))
    })
}

#[derive(Debug, thiserror::Error)]
enum DrawError {
    #[error("the sections cannot be lofted")]
    Surface(#[from] LoftError),
    #[error(transparent)]
    Render(#[from] RenderError),
}

fn failed(error: &(dyn std::error::Error + 'static)) -> Problem {
    tracing::error!(error, "a picture could not be drawn");
    Problem::new(Kind::Internal, "The picture could not be drawn.")
}
