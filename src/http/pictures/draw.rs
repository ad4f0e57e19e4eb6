//! Drawing on request: a few pictures at a time on blocking threads, others wait for a bounded time, and those that were asked
//! for lately are kept in memory, since many clients show the same ones.

use super::queue::Turn;
use crate::clock::Stopwatch;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::wire::conditional::ETag;
use crate::http::wire::problem::{Kind, Problem};
use crate::mesh::LoftError;
use crate::render::{MEDIA_TYPE, RenderError};
use crate::report::ReportError;
use axum::http::{HeaderValue, Method, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Longest side of a picture, pixels.
pub(super) const SIZES: RangeInclusive<u32> = 32..=2048;
/// Longest side if none is asked for.
pub(super) const SIZE: u32 = 1024;

/// A model never changes, but another version of the service may draw it in another way.
pub(super) const A_DAY: HeaderValue = HeaderValue::from_static("private, max-age=86400");

/// Why a picture was not drawn.
#[derive(Debug, thiserror::Error)]
pub(in crate::http) enum DrawError {
    #[error("the sections cannot be lofted")]
    Surface(#[from] LoftError),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error("the report cannot be shown as a page")]
    Page(#[source] ReportError),
}

/// The size that a parameter asks for; `Err` with a sentence if it is none.
pub(in crate::http) fn size(text: Option<&str>) -> Result<u32, String> {
    text.map_or(Some(SIZE), |text| text.parse().ok().filter(|size| SIZES.contains(size)))
        .ok_or_else(|| format!("must be a whole number from {} to {}", SIZES.start(), SIZES.end()))
}

/// The picture with this tag: one that is kept, or one that is drawn, when it is its turn, from what `read` gives.
pub(in crate::http) async fn picture<T: Send + 'static>(
    state: &AppState,
    caller: &Caller,
    tag: &ETag,
    read: impl Future<Output = Result<T, Problem>>,
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
    let shown = read.await?;
    let (pictures, metrics, tag) = (Arc::clone(&state.pictures), state.metrics.clone(), tag.clone());
    let drawn = tokio::task::spawn_blocking(move || {
        // The turn is over when the threads are free, and the picture is kept, even if the client has gone.
        let _turn = turn;
        let begun = Stopwatch::start();
        let png = Bytes::from(draw(shown)?);
        metrics.picture_drawn(begun.elapsed());
        pictures.keep(tag, png.clone());
        Ok::<_, DrawError>(png)
    });
    drawn.await.map_err(|error| failed(&error))?.map_err(|error| failed(&error))
}

/// The answer with a picture.
pub(in crate::http) fn answer(state: &AppState, method: &Method, tag: &ETag, png: Bytes) -> Result<Response, Problem> {
    if method == Method::GET {
        state.metrics.bytes_out(png.len() as u64);
    }
    let kind = HeaderValue::from_static(MEDIA_TYPE);
    let headers = [(header::CONTENT_TYPE, kind), (header::ETAG, tag.header()?), (header::CACHE_CONTROL, A_DAY)];
    Ok((headers, png).into_response())
}

fn kept(state: &AppState, tag: &ETag) -> Option<Bytes> {
    let png = state.pictures.kept(tag)?;
    state.metrics.picture("kept");
    Some(png)
}

/// Room for one more picture that is drawn.
pub(in crate::http) async fn turn(state: &AppState, caller: &Caller) -> Result<Turn, Problem> {
    state.pictures.turn(caller.owner(), state.limits.picture_wait).await.ok_or_else(|| {
        state.metrics.picture("refused");
        let problem = Problem::new(Kind::TooManyPictures, "Many pictures are being drawn. Try again later.");
        problem.with_header(header::RETRY_AFTER, HeaderValue::from_static("5"))
    })
}

fn failed(error: &(dyn std::error::Error + 'static)) -> Problem {
    tracing::error!(error, "a picture could not be drawn");
    Problem::new(Kind::Internal, "The picture could not be drawn.")
}
