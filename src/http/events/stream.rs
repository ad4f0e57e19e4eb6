//! An event stream as the body of a response.
//!
//! A stream takes events from its [`Reader`] at the speed of its client, so a slow client costs no
//! memory. It ends with its jobs, with the connection, with the key of the caller, or with the
//! service.

use super::reader::{Reader, StreamStep};
use crate::clock::Stopwatch;
use crate::http::AppState;
use crate::http::access::{Access, Caller};
use crate::http::models::model::Detail;
use crate::http::wire::shares::Share;
use axum::body::Body;
use axum::http::{HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Sent after a silence, so that proxies do not close the connection as idle.
const COMMENT: Bytes = Bytes::from_static(b": still here\n\n");

/// An open stream.
pub(super) struct EventStream {
    /// `None` once nothing follows `pieces`.
    reader: Option<Reader>,
    detail: Detail,
    /// Pieces that are still to be sent.
    pieces: VecDeque<Bytes>,
    silence: Duration,
    caller: Caller,
    access: Arc<Access>,
    /// Time since the key of the caller was checked.
    checked: Stopwatch,
    shutdown: CancellationToken,
    _permit: Share,
}

impl EventStream {
    /// A response that sends `pieces`, and then the events of `reader`.
    pub(super) fn respond(
        state: &AppState,
        caller: Caller,
        permit: Share,
        detail: Detail,
        pieces: Vec<Bytes>,
        reader: Option<Reader>,
    ) -> Response {
        let stream = Self {
            reader,
            detail,
            pieces: pieces.into(),
            silence: state.limits.event_comment,
            caller,
            access: Arc::clone(&state.access),
            checked: Stopwatch::start(),
            shutdown: state.shutdown.clone(),
            _permit: permit,
        };
        let pieces = futures_util::stream::unfold(stream, |mut stream| async move {
            let piece = stream.next().await?;
            Some((Ok::<_, Infallible>(piece), stream))
        });
        let headers = [
            (header::CONTENT_TYPE, HeaderValue::from_static("text/event-stream")),
            (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
            (HeaderName::from_static("x-accel-buffering"), HeaderValue::from_static("no")),
        ];
        (headers, Body::from_stream(pieces)).into_response()
    }

    /// The next piece; `None` at the end of the stream.
    async fn next(&mut self) -> Option<Bytes> {
        loop {
            if let Some(piece) = self.pieces.pop_front() {
                return Some(piece);
            }
            let reader = self.reader.as_mut()?;
            if self.checked.elapsed() >= self.silence {
                self.checked = Stopwatch::start();
                if !self.access.still_works(&self.caller).await {
                    return None;
                }
            }
            let wait = match reader.next(self.detail).await {
                Ok(StreamStep::Events(events)) => {
                    self.pieces.extend(events);
                    continue;
                }
                Ok(StreamStep::Last(events)) => {
                    self.pieces.extend(events);
                    self.reader = None;
                    continue;
                }
                Ok(StreamStep::Wait) => self.silence,
                Err(error) => {
                    tracing::warn!(%error, "could not read the job store; an event stream waits for the next attempt");
                    reader.poll().min(self.silence)
                }
            };
            tokio::select! {
                () = reader.changed() => {}
                () = tokio::time::sleep(wait) => return Some(COMMENT),
                () = self.shutdown.cancelled() => return None,
            }
        }
    }
}
