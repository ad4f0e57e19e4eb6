//! One client's stream of events, as the body of a response.
//!
//! A stream reads published states from the [`Feed`](super::feed) at the speed of its client. It keeps little but a number:
//! a client that reads slowly gets newer states, not more of them. The stream ends with its models, with the connection, or
//! with the service.

use super::AppState;
use super::access::{Access, Caller};
use super::feed::ModelReader;
use super::fits::reader::FitReader;
use super::many::{Many, Step};
use super::models::detail::Detail;
use crate::clock::Stopwatch;
use crate::jobs::StoreError;
use axum::body::Body;
use axum::http::{HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;
use tokio_util::sync::CancellationToken;

/// Sent after some silence, so that proxies do not close the connection as idle.
const COMMENT: Bytes = Bytes::from_static(b": still here\n\n");

/// What a stream reads.
pub(super) enum Source {
    /// One model; the client has everything up to this number.
    Model(ModelReader, u64),
    /// Many models.
    Many(Box<Many>),
    /// One fit.
    Fit(Box<FitReader>),
    /// Nothing more.
    Over,
}

/// An open stream.
pub(super) struct Stream {
    source: Source,
    detail: Detail,
    /// Pieces that are still to be sent.
    pieces: VecDeque<Bytes>,
    silence: Duration,
    /// Whose stream it is: it ends some time after the key was revoked or has expired.
    caller: Caller,
    access: Arc<Access>,
    /// Since that was checked.
    checked: Stopwatch,
    shutdown: CancellationToken,
    _permit: OwnedSemaphorePermit,
}

impl Stream {
    /// A stream that sends `pieces`, and then what `source` has.
    pub(super) fn new(
        state: &AppState,
        caller: Caller,
        permit: OwnedSemaphorePermit,
        detail: Detail,
        pieces: Vec<Bytes>,
        source: Source,
    ) -> Self {
        Self {
            source,
            detail,
            pieces: pieces.into(),
            silence: state.limits.event_comment,
            caller,
            access: Arc::clone(&state.access),
            checked: Stopwatch::start(),
            shutdown: state.shutdown.clone(),
            _permit: permit,
        }
    }

    /// Whether the caller may still read it; checked as often as there would be comments.
    async fn is_allowed(&mut self) -> bool {
        if self.checked.elapsed() < self.silence {
            return true;
        }
        self.checked = Stopwatch::start();
        self.access.still_works(&self.caller).await
    }

    /// The next piece; `None` at the end of the stream.
    async fn next(&mut self) -> Option<Bytes> {
        loop {
            if let Some(piece) = self.pieces.pop_front() {
                return Some(piece);
            }
            if !self.is_allowed().await {
                return None;
            }
            let filled = self.fill().await;
            if matches!(filled, Ok(true)) {
                continue;
            }
            let Self { source, shutdown, silence, .. } = self;
            let (changed, most) = match (source, filled) {
                (Source::Over, _) => return None,
                (Source::Many(many), Err(error)) => {
                    tracing::warn!(%error, "an event stream waits: the job store could not be read");
                    (None, many.poll().min(*silence))
                }
                (Source::Model(reader, _), _) => (Some(Changed::Model(reader)), *silence),
                (Source::Fit(reader), _) => (Some(Changed::Fit(reader)), *silence),
                (Source::Many(many), _) => (Some(Changed::Many(many)), *silence),
            };
            tokio::select! {
                () = Changed::wait(changed) => {}
                () = tokio::time::sleep(most) => return Some(COMMENT),
                () = shutdown.cancelled() => return None,
            }
        }
    }

    /// Takes the next events, if there are any. Returns whether to go on without waiting.
    async fn fill(&mut self) -> Result<bool, StoreError> {
        match &mut self.source {
            Source::Over => Ok(false),
            Source::Model(reader, number) => {
                let Some(view) = reader.view().filter(|view| view.number() > *number) else { return Ok(false) };
                self.pieces.extend(view.events_after(*number, &view.version().to_string(), self.detail));
                *number = view.number();
                if view.is_last() {
                    self.source = Source::Over;
                }
                Ok(true)
            }
            Source::Fit(reader) => {
                let Some((event, last)) = reader.next().await? else { return Ok(false) };
                self.pieces.push_back(event);
                if last {
                    self.source = Source::Over;
                }
                Ok(true)
            }
            Source::Many(many) => match many.next(self.detail).await? {
                Step::Pieces(pieces) => {
                    self.pieces.extend(pieces);
                    Ok(true)
                }
                Step::Wait => Ok(false),
                Step::Over => {
                    self.source = Source::Over;
                    Ok(false)
                }
            },
        }
    }
}

/// What a waiting stream waits for.
enum Changed<'a> {
    Model(&'a mut ModelReader),
    Fit(&'a mut FitReader),
    Many(&'a mut Many),
}

impl Changed<'_> {
    async fn wait(this: Option<Self>) {
        match this {
            Some(Self::Model(reader)) => reader.changed().await,
            Some(Self::Fit(reader)) => reader.changed().await,
            Some(Self::Many(many)) => many.changed().await,
            None => std::future::pending().await,
        }
    }
}

impl IntoResponse for Stream {
    fn into_response(self) -> Response {
        let pieces = futures_util::stream::unfold(self, |mut stream| async move {
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
}
