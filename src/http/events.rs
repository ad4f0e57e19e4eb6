//! `GET /models/{id}/events` and `GET /events`: streams of server-sent events.
//!
//! Each stream is a task that reads the present state of what changed and writes it to a short channel. A client that
//! reads slowly holds up its own task only, and then gets newer states, not more of them. The task ends with the
//! model, with the connection, or with the service.

mod all;

use super::AppState;
use super::extract::{ModelId, no_model};
use super::headers::last_event_id;
use super::openapi::{ModelMissing, ServerSentEvent, StreamAway};
use super::problem::{Kind, Problem};
use super::sse::{self, Track};
use crate::clock::Stopwatch;
use crate::jobs::{Job, ListFilter, Status, StoreError};
use all::Begin;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;

/// Events that wait for a slow client.
const BACKLOG: usize = 4;
/// Models on a page of those that a stream of all begins with.
const FIRST: u32 = 100;

/// The client has gone, or the service is closing.
struct Closed;

/// Where a stream's events go.
struct Out {
    state: AppState,
    events: mpsc::Sender<Result<Event, Infallible>>,
    age: Stopwatch,
    _permit: OwnedSemaphorePermit,
}

impl Out {
    async fn send(&self, event: Event) -> Result<(), Closed> {
        tokio::select! {
            sent = self.events.send(Ok(event)) => sent.map_err(|_| Closed),
            () = self.state.shutdown.cancelled() => Err(Closed),
        }
    }

    /// Waits until `change`, at most `time`.
    async fn pause(&self, change: impl Future<Output = ()>, time: Duration) -> Result<(), Closed> {
        tokio::select! {
            () = change => Ok(()),
            () = tokio::time::sleep(time) => Ok(()),
            () = self.events.closed() => Err(Closed),
            () = self.state.shutdown.cancelled() => Err(Closed),
        }
    }

    fn track(&self) -> Track {
        Track::new(self.state.limits.event_interval)
    }
}

/// Opens a stream that `work` fills.
fn open<W, F>(state: AppState, work: W) -> Result<Response, Problem>
where
    W: FnOnce(Out) -> F,
    F: Future<Output = Result<(), Closed>> + Send + 'static,
{
    let permit = state.streams.clone().try_acquire_owned().map_err(|_| {
        let detail = format!("{} streams are open; one of /events tells of all models.", state.limits.streams);
        Problem::new(Kind::TooManyStreams, detail).with_header(header::RETRY_AFTER, HeaderValue::from_static("5"))
    })?;
    let comment = KeepAlive::new().interval(state.limits.event_comment).text("still here");
    let (events, receiver) = mpsc::channel(BACKLOG);
    let filling = work(Out { state, events, age: Stopwatch::start(), _permit: permit });
    tokio::spawn(tracing::Instrument::in_current_span(async move {
        if filling.await.is_err() {
            tracing::debug!("a stream was closed before its end");
        }
    }));
    let headers = [
        (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
        (header::HeaderName::from_static("x-accel-buffering"), HeaderValue::from_static("no")),
    ];
    Ok((headers, Sse::new(ReceiverStream::new(receiver)).keep_alive(comment)).into_response())
}

/// Follow one model: its state at once, then every change.
///
/// Event names are `status`, `progress`, `section` and `end`;
/// the id is the model's version; the data is the whole Model, in `section` events with its last contour. After
/// `end` the stream closes. A deleted model ends its stream with `end`, whose data is `{"id", "status": "deleted"}`.
#[utoipa::path(
    get, path = "/models/{id}/events", operation_id = "follow_model", tag = "events",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("last-event-id" = Option<String>, Header, description = "Version that the client knows; newer is sent at once"),
    ),
    responses(
        (status = 200, description = "Events", content_type = "text/event-stream", body = ServerSentEvent),
        ModelMissing, StreamAway,
    )
)]
pub(super) async fn of_model(
    State(state): State<AppState>,
    ModelId(id): ModelId,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    // Before the model is read, so that no change in between is missed.
    let watch = state.feed.watch();
    let number = state.feed.head();
    let job = state.store.get(id).await?.ok_or_else(|| no_model(id))?;
    let known = last_event_id(&headers).and_then(|text| text.parse::<u64>().ok());
    open(state, move |out| follow(out, job, known, watch, number))
}

async fn follow(
    out: Out,
    mut job: Job,
    known: Option<u64>,
    mut watch: watch::Receiver<u64>,
    mut number: u64,
) -> Result<(), Closed> {
    let id = job.id;
    // A place in the queue changes without a new version, so a queued model is told in any case.
    let known = known == Some(job.version) && job.status != Status::Queued;
    let interval = out.state.limits.event_interval;
    let mut track = if known { Track::knowing(interval, &job) } else { out.track() };
    loop {
        let (names, again) = track.next(&job, out.age.elapsed());
        for name in names {
            out.send(sse::event(name, &job, &job.version.to_string(), out.state.limits.keep)).await?;
        }
        if job.status.is_ended() {
            return Ok(());
        }
        let changed = out.state.feed.changed(id, &mut watch, number);
        out.pause(changed, again.unwrap_or(out.state.limits.event_poll)).await?;
        number = out.state.feed.head();
        match out.state.store.get(id).await {
            Ok(Some(now)) => job = now,
            Ok(None) => return out.send(sse::deleted(id, &(job.version + 1).to_string())).await,
            Err(error) => store_failed(&out, &error).await?,
        }
    }
}

/// A stream outlives a store that is away for a while.
async fn store_failed(out: &Out, error: &StoreError) -> Result<(), Closed> {
    tracing::warn!(%error, "a stream could not read the job store");
    out.pause(std::future::pending(), out.state.limits.event_poll).await
}

/// Follow all models: at once the state of each that runs and of the newest 100 that wait, then every change.
///
/// Events are as in the stream of one model, but the stream does not close. The id is a cursor; sent back as
/// `Last-Event-ID` it brings at once what changed since, and where that is no longer known, the state of the newest
/// models.
#[utoipa::path(
    get, path = "/events", operation_id = "follow_all", tag = "events",
    params(("last-event-id" = Option<String>, Header, description = "Cursor of the last event that the client has")),
    responses(
        (status = 200, description = "Events", content_type = "text/event-stream", body = ServerSentEvent),
        StreamAway,
    )
)]
pub(super) async fn of_all(State(state): State<AppState>, headers: HeaderMap) -> Result<Response, Problem> {
    let watch = state.feed.watch();
    let head = state.feed.head();
    let resumed = last_event_id(&headers);
    let missed = resumed
        .and_then(|cursor| state.feed.number(cursor))
        .and_then(|number| Some((number, state.feed.since(number)?)));
    let present = newest(&state).await?;
    let begin = match missed {
        Some((number, changes)) => Begin::Resumed(number, changes.into_iter().map(|(_, id)| id).collect()),
        None => Begin::Anew { with_ended: resumed.is_some() },
    };
    open(state, move |out| all::follow(out, present, begin, head, watch))
}

/// The models that a stream of all begins with, oldest first: all that run, the newest that wait, and the newest of
/// any state, the ended ones among them.
async fn newest(state: &AppState) -> Result<Vec<Job>, StoreError> {
    let mut jobs = BTreeMap::new();
    for status in [Some(Status::Running), Some(Status::Queued), None] {
        let mut filter = ListFilter { status, limit: FIRST, ..ListFilter::default() };
        loop {
            let page = state.store.list(&filter).await?;
            jobs.extend(page.jobs.into_iter().map(|job| (job.id, job)));
            filter.before = page.next.filter(|_| status == Some(Status::Running));
            if filter.before.is_none() {
                break;
            }
        }
    }
    Ok(jobs.into_values().collect())
}
