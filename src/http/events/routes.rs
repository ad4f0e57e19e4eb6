//! `GET /models/{id}/events`, `GET /fits/{id}/events` and `GET /events`.

use super::reader::Reader;
use super::snapshot::{Changes, Snapshot};
use super::stream::EventStream;
use super::subscription::Subscription;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::fits::{FitId, no_fit};
use crate::http::models::model::{Detail, LinkBase};
use crate::http::models::select;
use crate::http::openapi::schemas::ServerSentEvent;
use crate::http::wire::extract::{ModelId, Parameters, no_model};
use crate::http::wire::headers::last_event_id;
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{BadParameters, FitMissing, ModelMissing, StreamUnavailable};
use crate::http::wire::shares::Share;
use crate::jobs::{Job, JobId, Status};
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;

/// Sent when a stream of many models opens, so that a client knows that it is open.
const CONNECTED: Bytes = Bytes::from_static(b": connected\n\n");

/// Descriptions of the header and of the parameter with the last event that a client has.
const LAST_EVENT_HEADER: &str = "Version that the client has. The service sends a newer version immediately";
const LAST_EVENT_PARAMETER: &str = "Value of `Last-Event-ID` for a new `EventSource`, which cannot send the header. \
    The header takes precedence";

/// The right to open one more stream.
fn permit(state: &AppState, caller: &Caller) -> Result<Share, Problem> {
    state.streams.take(caller.owner(), 1).map_err(|exhausted| {
        let detail = format!(
            "{} event streams are open {}, which is the limit. One stream of /events reports all models.",
            exhausted.limit(),
            exhausted.callers()
        );
        Problem::new(Kind::TooManyStreams, detail).with_header(header::RETRY_AFTER, 5)
    })
}

/// The id of the last event that the client has: from the header, which a browser sends when it
/// reconnects, or else from the parameter.
fn last_seen<'a>(headers: &'a HeaderMap, parameters: &'a Parameters) -> Option<&'a str> {
    let parameter = || parameters.get("last_event_id").map(str::trim).filter(|id| !id.is_empty());
    last_event_id(headers).or_else(parameter)
}

/// Follow one model: its current state, then every change.
///
/// Events are named `status`, `progress`, `section` and `end`. The id of an event is the version of
/// the model. The data is the whole Model without its spec, which never changes; `view=full` adds
/// the spec. In `section` events, the data also has the latest section. The stream closes after
/// `end`. If the model is deleted, the data of `end` is `{"id", "status": "deleted"}`.
#[utoipa::path(
    get, path = "/models/{id}/events", operation_id = "follow_model", tag = "events",
    params(
        ("id" = Uuid, Path, description = "Id of the model"),
        ("view" = Option<Detail>, Query, description = "`full` adds the spec to each event; `summary` by default"),
        ("last-event-id" = Option<String>, Header, description = LAST_EVENT_HEADER),
        ("last_event_id" = Option<String>, Query, description = LAST_EVENT_PARAMETER),
    ),
    responses(
        (status = 200, description = "Events", content_type = "text/event-stream", body = ServerSentEvent),
        (status = 204, description = "The model has ended, and `Last-Event-ID` is its last version, so no event will \
            follow. An `EventSource` does not reconnect after this response"),
        ModelMissing, BadParameters, StreamUnavailable,
    )
)]
pub(in crate::http) async fn of_model(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let mut faults = parameters.faults(&["view", "last_event_id"], &[]);
    let detail = Detail::read(&parameters, Detail::Summary, &mut faults);
    Problem::check(faults)?;
    let seen = last_seen(&headers, &parameters);
    of_job(&state, caller, id, seen, detail, |caller, job| caller.model(job).ok_or_else(|| no_model(id))).await
}

/// Follow a fit: its current state, then every change.
///
/// Events are named `status`, `progress` and `end`. The id of an event is the version of the fit.
/// The data is the fit without its request. The stream closes after `end`. If the fit is deleted,
/// the data of `end` is `{"id", "status": "deleted"}`.
#[utoipa::path(
    get, path = "/fits/{id}/events", operation_id = "follow_fit", tag = "fits",
    params(
        ("id" = Uuid, Path, description = "Id of the fit"),
        ("last-event-id" = Option<String>, Header, description = LAST_EVENT_HEADER),
        ("last_event_id" = Option<String>, Query, description = LAST_EVENT_PARAMETER),
    ),
    responses(
        (status = 200, description = "Events", content_type = "text/event-stream", body = ServerSentEvent),
        (status = 204, description = "The fit has ended, and `Last-Event-ID` is its last version, so no event will \
            follow"),
        FitMissing, BadParameters, StreamUnavailable,
    )
)]
pub(in crate::http) async fn of_fit(
    State(state): State<AppState>,
    caller: Caller,
    FitId(id): FitId,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    Problem::check(parameters.faults(&["last_event_id"], &[]))?;
    let seen = last_seen(&headers, &parameters);
    of_job(&state, caller, id, seen, Detail::Summary, |caller, job| caller.fit(job).ok_or_else(|| no_fit(id))).await
}

/// The stream of one job, if `find` finds that the caller may follow it.
async fn of_job(
    state: &AppState,
    caller: Caller,
    id: JobId,
    last_seen: Option<&str>,
    detail: Detail,
    find: impl FnOnce(&Caller, Option<Job>) -> Result<Job, Problem>,
) -> Result<Response, Problem> {
    let permit = permit(state, &caller)?;
    // The job is read after this call, so that no change in between is missed.
    let mut reader = Reader::of_job(&state.feed, id);
    let job = find(&caller, state.store.get(id).await?)?;
    let has_this_version = last_seen.and_then(|text| text.parse::<u64>().ok()) == Some(job.version);
    if !job.status.is_ended() {
        state.feed.offer(&job).await;
        // The position in the queue changes without a new version, so a queued job is always sent.
        if has_this_version && job.status != Status::Queued {
            reader.skip(job.version);
        }
        return Ok(EventStream::respond(state, caller, permit, detail, Vec::new(), Some(reader)));
    }
    if has_this_version {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let context = state.job_context([&job]).await;
    let end = Snapshot::new(&job, &context, 1, Changes::default(), None).for_its_stream(&job, &context);
    let events = end.events_after(0, &job.version.to_string(), detail, LinkBase::Model);
    Ok(EventStream::respond(state, caller, permit, detail, events, None))
}

/// Follow models: first the running and the newest 100 queued models, then every change.
///
/// Events have the form of the events of a single model, but their id is a cursor. A client that
/// reconnects with the last cursor as `Last-Event-ID` and the same parameters receives the changes
/// since then. If the service does not have these changes, it sends the state of the newest models,
/// including ended ones. A client that reads slowly may miss intermediate states of a model, but
/// never the last one.
///
/// The parameters `ids`, `label` and `batch` select models; a model must match all of them. With
/// `ids` or `batch`, the stream starts with the state of each of these models, including ended
/// ones. For an id without a model, it sends `end` with `deleted`. When all of these models have
/// ended, the stream closes, and a client that reconnects gets 204. Other streams do not close.
#[utoipa::path(
    get, path = "/events", operation_id = "follow_all", tag = "events",
    params(
        ("ids" = Option<String>, Query, pattern = "^[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}(,[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}){0,99}$", description = "Only these models: up to 100 ids, separated by commas"),
        ("label" = Option<Vec<String>>, Query, max_items = 16, pattern = "^[^:\\u0000]+:[^\\u0000]*$",
            description = "Only models with this label, `key:value`. May be repeated; models must have all labels"),
        ("batch" = Option<String>, Query, format = Uuid, description = "Only models of this batch"),
        ("view" = Option<Detail>, Query, description = "`full` adds the spec to each event; `summary` by default"),
        ("last-event-id" = Option<String>, Header, description = "Cursor of the last event that the client has"),
        ("last_event_id" = Option<String>, Query, description = LAST_EVENT_PARAMETER),
    ),
    responses(
        (status = 200, description = "Events", content_type = "text/event-stream", body = ServerSentEvent),
        (status = 204, description = "The models in `ids` or `batch` have ended, and the client has all their events"),
        BadParameters, StreamUnavailable,
    )
)]
pub(in crate::http) async fn of_all(
    State(state): State<AppState>,
    caller: Caller,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let mut faults = parameters.faults(&["ids", "label", "batch", "view", "last_event_id"], &["label"]);
    let detail = Detail::read(&parameters, Detail::Summary, &mut faults);
    let filter = select::read(&parameters, &caller, &mut faults);
    Problem::check(faults)?;
    let permit = permit(&state, &caller)?;
    let last_seen = last_seen(&headers, &parameters);
    let Some(reader) = Reader::of_models(&state.feed, Subscription::new(filter), last_seen).await? else {
        return Ok(StatusCode::NO_CONTENT.into_response());
    };
    Ok(EventStream::respond(&state, caller, permit, detail, vec![CONNECTED], Some(reader)))
}
