//! Drawing on request. A few pictures are drawn at a time, on blocking threads; other requests wait
//! for a bounded time. Recent pictures are kept in memory, because many clients show the same ones.

use crate::clock::Stopwatch;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::wire::blocking::compute;
use crate::http::wire::conditional::ETag;
use crate::http::wire::extract::Parameters;
use crate::http::wire::faults::{Faults, RequestFault};
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::shares::Turn;
use crate::mesh::LoftError;
use crate::panics::panic_message;
use crate::render::{MEDIA_TYPE, RenderError};
use crate::report::ReportError;
use axum::http::{HeaderValue, Method, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Longer side of a picture, in pixels.
const SIZES: RangeInclusive<u32> = 32..=2048;
/// Default of the longer side, in pixels.
const DEFAULT_SIZE: u32 = 1024;

/// `Cache-Control` of pictures. A model never changes, but another version of the service may draw
/// it differently.
pub(super) const A_DAY: HeaderValue = HeaderValue::from_static("private, max-age=86400");

/// Failure to draw a picture or page.
#[derive(Debug, thiserror::Error)]
pub(super) enum DrawError {
    #[error("the sections cannot be lofted")]
    Surface(#[from] LoftError),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error("the report cannot be shown as a page")]
    Page(#[source] ReportError),
}

/// Reads the parameter `size`.
pub(super) fn read_size(parameters: &Parameters, faults: &mut Faults) -> u32 {
    let Some(text) = parameters.get("size") else { return DEFAULT_SIZE };
    text.parse().ok().filter(|size| SIZES.contains(size)).unwrap_or_else(|| {
        let detail = format!("must be a whole number from {} to {}", SIZES.start(), SIZES.end());
        faults.push(RequestFault::parameter("size", detail));
        DEFAULT_SIZE
    })
}

/// The picture with this tag, if it is kept. Otherwise waits for a turn, reads the input of the
/// picture and draws it.
///
/// `read` gets the turn, for its work on blocking threads.
pub(super) async fn picture<T: Send + 'static, F: Future<Output = Result<T, Problem>>>(
    state: &AppState,
    caller: &Caller,
    tag: &ETag,
    read: impl FnOnce(Turn) -> F,
    draw: impl FnOnce(T) -> Result<Vec<u8>, DrawError> + Send + 'static,
) -> Result<Bytes, Problem> {
    if let Some(png) = kept(state, tag) {
        return Ok(png);
    }
    let turn = turn(state, caller).await?;
    // Another request may have drawn it while this one waited.
    if let Some(png) = kept(state, tag) {
        return Ok(png);
    }
    let input = read(turn.clone()).await?;
    let (pictures, metrics, tag) = (Arc::clone(&state.pictures), state.metrics.clone(), tag.clone());
    let drawn = compute(move || {
        // Even if the client disconnects, the turn lasts as long as the thread works, and the
        // picture is kept.
        let _turn = turn;
        let begun = Stopwatch::start();
        let png = Bytes::from(draw(input)?);
        metrics.picture_drawn(begun.elapsed());
        pictures.keep_picture(tag, png.clone());
        Ok::<_, DrawError>(png)
    });
    match drawn.await {
        Ok(drawn) => drawn.map_err(|error| failed(&error.to_string())),
        Err(panic) => Err(failed(panic_message(&*panic))),
    }
}

/// The response with a picture.
pub(super) fn answer(state: &AppState, method: &Method, tag: &ETag, png: Bytes) -> Result<Response, Problem> {
    if method == Method::GET {
        state.metrics.bytes_out(png.len() as u64);
    }
    let kind = HeaderValue::from_static(MEDIA_TYPE);
    let headers = [(header::CONTENT_TYPE, kind), (header::ETAG, tag.header()?), (header::CACHE_CONTROL, A_DAY)];
    Ok((headers, png).into_response())
}

/// A kept picture or way.
pub(super) fn kept(state: &AppState, tag: &ETag) -> Option<Bytes> {
    let png = state.pictures.picture(tag)?;
    state.metrics.picture("kept");
    Some(png)
}

/// Waits for a turn to draw.
pub(in crate::http) async fn turn(state: &AppState, caller: &Caller) -> Result<Turn, Problem> {
    state.pictures.turns.turn(caller.owner(), state.limits.picture_wait).await.ok_or_else(|| {
        state.metrics.picture("refused");
        let problem = Problem::new(Kind::TooManyPictures, "Many pictures are being drawn. Try again later.");
        problem.with_header(header::RETRY_AFTER, 5)
    })
}

fn failed(error: &str) -> Problem {
    tracing::error!(error, "a picture could not be drawn");
    Problem::new(Kind::Internal, "The picture could not be drawn.")
}
