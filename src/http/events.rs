//! `GET /models/{id}/events` and `GET /events`: streams of server-sent events.
//!
//! A stream reads published states from the [`Feed`](super::feed) at the speed of its client. It keeps nothing but a
//! number: a client that reads slowly gets newer states, not more of them. The stream ends with the model, with the
//! connection, or with the service.

use super::AppState;
use super::extract::{ModelId, no_model};
use super::feed::{AllReader, ModelReader, Next};
use super::headers::last_event_id;
use super::problem::{Kind, Problem};
use super::responses::{ModelMissing, ServerSentEvent, StreamAway};
use super::view::{Name, View};
use crate::jobs::{JobId, Status};
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::OwnedSemaphorePermit;
use tokio_util::sync::CancellationToken;

/// Sent when a stream opens, so that a client knows that it is open.
const CONNECTED: Bytes = Bytes::from_static(b": connected\n\n");
/// Sent after some silence, so that proxies do not close the connection as idle.
const COMMENT: Bytes = Bytes::from_static(b": still here\n\n");

/// What a stream reads.
enum Source {
    /// One model.
    Model(ModelReader),
    /// All models; first those that are listed.
    All(AllReader, VecDeque<JobId>),
    /// Nothing more.
    Over,
}

/// An open stream.
struct Stream {
    source: Source,
    /// The client has everything up to this number of the feed.
    number: u64,
    /// Pieces that are still to be sent.
    pieces: VecDeque<Bytes>,
    silence: Duration,
    shutdown: CancellationToken,
    _permit: OwnedSemaphorePermit,
}

impl Stream {
    /// The next piece; `None` at the end of the stream.
    async fn next(&mut self) -> Option<Bytes> {
        loop {
            if let Some(piece) = self.pieces.pop_front() {
                return Some(piece);
            }
            if self.fill() {
                continue;
            }
            if matches!(self.source, Source::Over) {
                return None;
            }
            let Self { source, shutdown, .. } = self;
            let changed = async {
                match source {
                    Source::Model(reader) => reader.changed().await,
                    Source::All(reader, _) => reader.changed().await,
                    Source::Over => std::future::pending().await,
                }
            };
            tokio::select! {
                () = changed => {}
                () = tokio::time::sleep(self.silence) => return Some(COMMENT),
                () = shutdown.cancelled() => return None,
            }
        }
    }

    /// Takes the next events, if there are any. Returns whether to go on without waiting.
    fn fill(&mut self) -> bool {
        match &mut self.source {
            Source::Over => false,
            Source::Model(reader) => {
                let Some(view) = reader.view().filter(|view| view.number() > self.number) else { return false };
                self.pieces.extend(view.events_after(self.number, &view.version().to_string()));
                self.number = view.number();
                if view.is_last() {
                    self.source = Source::Over;
                }
                true
            }
            Source::All(reader, first) => {
                if let Some(id) = first.pop_front() {
                    // A client that breaks off here begins anew: 0 is never a number of the feed.
                    let events = reader.view(id).map(|view| view.events_after(0, &reader.cursor(0)));
                    self.pieces.extend(events.unwrap_or_default());
                    return true;
                }
                match reader.after(self.number) {
                    Next::View(view) => {
                        self.pieces.extend(view.events_after(self.number, &reader.cursor(view.number())));
                        self.number = view.number();
                        true
                    }
                    Next::Nothing => false,
                    Next::Unknown => {
                        (*first, self.number) = reader.first(true);
                        true
                    }
                }
            }
        }
    }
}

/// Room for one more stream.
fn permit(state: &AppState) -> Result<OwnedSemaphorePermit, Problem> {
    state.streams.clone().try_acquire_owned().map_err(|_| {
        let limit = state.limits.streams;
        let detail =
            format!("{limit} event streams are open, which is the limit. One stream of /events reports all models.");
        Problem::new(Kind::TooManyStreams, detail).with_header(header::RETRY_AFTER, HeaderValue::from_static("5"))
    })
}

/// The answer that sends `pieces`, and then what `source` has after `number`.
fn open(state: &AppState, permit: OwnedSemaphorePermit, source: Source, number: u64, pieces: Vec<Bytes>) -> Response {
    let stream = Stream {
        source,
        number,
        pieces: pieces.into(),
        silence: state.limits.event_comment,
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
        (header::HeaderName::from_static("x-accel-buffering"), HeaderValue::from_static("no")),
    ];
    (headers, Body::from_stream(pieces)).into_response()
}

/// Follow one model: its state at once, then every change.
///
/// Event names are `status`, `progress`, `section` and `end`. The id is the model's version. The data is the whole Model,
/// in `section` events together with its latest contour. The stream closes after `end`. If the model is deleted, the data of
/// `end` is `{"id", "status": "deleted"}`.
#[utoipa::path(
    get, path = "/models/{id}/events", operation_id = "follow_model", tag = "events",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("last-event-id" = Option<String>, Header, description = "Version that the client has. A newer one is sent at once"),
    ),
    responses(
        (status = 200, description = "Events", content_type = "text/event-stream", body = ServerSentEvent),
        (status = 204, description = "The model has ended, and `Last-Event-ID` is its last version: nothing will follow. An `EventSource` does not reconnect after this answer"),
        ModelMissing, StreamAway,
    )
)]
pub(super) async fn of_model(
    State(state): State<AppState>,
    ModelId(id): ModelId,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let permit = permit(&state)?;
    // Before the model is read, so that no change in between is missed.
    let mut reader = state.feed.watch(id);
    let job = state.store.get(id).await?.ok_or_else(|| no_model(id))?;
    let known = last_event_id(&headers).and_then(|text| text.parse::<u64>().ok()) == Some(job.version);
    if job.status.is_ended() {
        if known {
            return Ok(StatusCode::NO_CONTENT.into_response());
        }
        let end = View::of(&job, state.limits.keep, &[Name::End], 1, None);
        let pieces = end.events_after(0, &job.version.to_string());
        return Ok(open(&state, permit, Source::Over, 0, pieces));
    }
    state.feed.offer(&job);
    // A place in the queue changes without a new version, so a queued model is sent in any case.
    let known = known && job.status != Status::Queued;
    let number = reader.view().filter(|_| known).map_or(0, |view| view.number());
    Ok(open(&state, permit, Source::Model(reader), number, Vec::new()))
}

/// Follow all models: at once the state of each that runs and of the newest 100 that wait, then every change.
///
/// Events are as in the stream of one model, but the stream does not close. The id is a cursor. A client that sends it back
/// as `Last-Event-ID` gets at once what has changed since; if that is no longer known, the state of the newest models, ended
/// ones included. A client that reads slowly skips states, never the last one of a model.
#[utoipa::path(
    get, path = "/events", operation_id = "follow_all", tag = "events",
    params(("last-event-id" = Option<String>, Header, description = "Cursor of the last event that the client has")),
    responses(
        (status = 200, description = "Events", content_type = "text/event-stream", body = ServerSentEvent),
        StreamAway,
    )
)]
pub(super) async fn of_all(State(state): State<AppState>, headers: HeaderMap) -> Result<Response, Problem> {
    let permit = permit(&state)?;
    let mut reader = state.feed.follow().await?;
    let last = last_event_id(&headers);
    let resumed = last.and_then(|cursor| reader.number(cursor));
    let resumed = resumed.filter(|number| !matches!(reader.after(*number), Next::Unknown));
    let (first, number) = match resumed {
        Some(number) => (VecDeque::new(), number),
        None => reader.first(last.is_some()),
    };
    Ok(open(&state, permit, Source::All(reader, first), number, vec![CONNECTED]))
}
