//! `GET /models/{id}/events` and `GET /events`: streams of server-sent events.

use super::AppState;
use super::access::Caller;
use super::interest::Interest;
use super::many::Many;
use super::models::detail::Detail;
use super::models::select;
use super::stream::{Source, Stream};
use super::view::{Name, View};
use super::wire::extract::{ModelId, Parameters, no_model};
use super::wire::faults::Faults;
use super::wire::headers::last_event_id;
use super::wire::problem::{Kind, Problem};
use super::wire::responses::{BadParameters, ModelMissing, ServerSentEvent, StreamAway};
use crate::jobs::Status;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use std::sync::Arc;
use tokio::sync::OwnedSemaphorePermit;

/// Sent when a stream of many models opens, so that a client knows that it is open.
const CONNECTED: Bytes = Bytes::from_static(b": connected\n\n");

/// Room for one more stream.
pub(super) fn permit(state: &AppState) -> Result<OwnedSemaphorePermit, Problem> {
    state.streams.clone().try_acquire_owned().map_err(|_| {
        let limit = state.limits.streams;
        let detail =
            format!("{limit} event streams are open, which is the limit. One stream of /events reports all models.");
        Problem::new(Kind::TooManyStreams, detail).with_header(header::RETRY_AFTER, HeaderValue::from_static("5"))
    })
}

/// The id of the last event that the client has: the header, which a browser sends when it reconnects, or else the parameter.
pub(super) fn last_seen<'a>(headers: &'a HeaderMap, parameters: &'a Parameters) -> Option<&'a str> {
    let parameter = || parameters.get("last_event_id").map(str::trim).filter(|id| !id.is_empty());
    last_event_id(headers).or_else(parameter)
}

/// How much of each model the events hold.
fn detail(parameters: &Parameters, faults: &mut Faults) -> Detail {
    Detail::read(parameters, Detail::Summary, faults)
}

/// Follow one model: its state at once, then every change.
///
/// Event names are `status`, `progress`, `section` and `end`. The id is the model's version. The data is the whole Model
/// but for its spec, which never changes and comes with `view=full`; in `section` events together with its latest contour. The stream closes after `end`. If the model is deleted, the data of
/// `end` is `{"id", "status": "deleted"}`.
#[utoipa::path(
    get, path = "/models/{id}/events", operation_id = "follow_model", tag = "events",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("view" = Option<Detail>, Query, description = "`full` adds the spec to each event; `summary` by default"),
        ("last-event-id" = Option<String>, Header, description = "Version that the client has. A newer one is sent at once"),
        ("last_event_id" = Option<String>, Query, description = "The same for a new `EventSource`, which cannot send the header; the header takes precedence"),
    ),
    responses(
        (status = 200, description = "Events", content_type = "text/event-stream", body = ServerSentEvent),
        (status = 204, description = "The model has ended, and `Last-Event-ID` is its last version: nothing will follow. An `EventSource` does not reconnect after this answer"),
        ModelMissing, BadParameters, StreamAway,
    )
)]
pub(super) async fn of_model(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let mut faults = parameters.faults(&["view", "last_event_id"], &[]);
    let detail = detail(&parameters, &mut faults);
    Problem::check(faults)?;
    let permit = permit(&state)?;
    // Before the model is read, so that no change in between is missed.
    let mut reader = state.feed.watch(id);
    let job = caller.model(state.store.get(id).await?).ok_or_else(|| no_model(id))?;
    let known = last_seen(&headers, &parameters).and_then(|text| text.parse::<u64>().ok()) == Some(job.version);
    if job.status.is_ended() {
        if known {
            return Ok(StatusCode::NO_CONTENT.into_response());
        }
        let keep = state.limits.keep;
        let end = Arc::new(View::of(&job, keep, &[Name::End], 1, None)).of_one(&job, keep);
        let pieces = end.events_after(0, &job.version.to_string(), detail);
        return Ok(Stream::new(&state, caller, permit, detail, pieces, Source::Over).into_response());
    }
    state.feed.offer(&job);
    // A place in the queue changes without a new version, so a queued model is sent in any case.
    let known = known && job.status != Status::Queued;
    // What was published since the job was read is still to be sent.
    let seen = reader.view().filter(|view| known && view.version() <= job.version);
    let number = seen.map_or(0, |view| view.number());
    Ok(Stream::new(&state, caller, permit, detail, Vec::new(), Source::Model(reader, number)).into_response())
}

/// Follow models: at once the state of each that runs and of the newest 100 that wait, then every change.
///
/// Events are as in the stream of one model. The id is a cursor. A client that sends it back as `Last-Event-ID`, with the
/// same parameters, gets at once what has changed since; if that is no longer known, the state of the newest models, ended
/// ones included. A client that reads slowly skips states, never the last one of a model.
///
/// `ids`, `label` and `batch` narrow the stream; a model must match all of them. With `ids` or `batch`, the state of each of
/// these models comes at once, whether it has ended or not (for an id without a model, an `end` with `deleted`); when all
/// have ended, the stream closes, and a client that reconnects gets 204. Other streams do not close.
#[utoipa::path(
    get, path = "/events", operation_id = "follow_all", tag = "events",
    params(
        ("ids" = Option<String>, Query, pattern = "^[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}(,[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}){0,99}$", description = "Only these models: up to 100 ids, separated by commas"),
        ("label" = Option<Vec<String>>, Query, max_items = 16, pattern = "^[^:\\u0000]+:[^\\u0000]*$", description = "Only models with this label, `key:value`. May be given up to 16 times: models with all of them"),
        ("batch" = Option<String>, Query, format = Uuid, description = "Only models of this batch"),
        ("view" = Option<Detail>, Query, description = "`full` adds the spec to each event; `summary` by default"),
        ("last-event-id" = Option<String>, Header, description = "Cursor of the last event that the client has"),
        ("last_event_id" = Option<String>, Query, description = "The same for a new `EventSource`, which cannot send the header; the header takes precedence"),
    ),
    responses(
        (status = 200, description = "Events", content_type = "text/event-stream", body = ServerSentEvent),
        (status = 204, description = "The models in `ids` or `batch` have ended, and the client has all their events"),
        BadParameters, StreamAway,
    )
)]
pub(super) async fn of_all(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let mut faults = parameters.faults(&["ids", "label", "batch", "view", "last_event_id"], &["label"]);
    let detail = detail(&parameters, &mut faults);
    let filter = select::read(&parameters, &caller, &mut faults);
    Problem::check(faults)?;
    let permit = permit(&state)?;
    let last = last_seen(&headers, &parameters);
    let many = Many::new(state.feed.follow().await?, Interest::new(filter), last).await?;
    if many.is_over() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    Ok(Stream::new(&state, caller, permit, detail, vec![CONNECTED], Source::Many(Box::new(many))).into_response())
}
