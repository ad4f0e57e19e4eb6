//! `GET /fits/{id}/events`: the stream of one fit.

use super::reader::FitReader;
use super::{FitId, no_fit};
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::events::{last_seen, permit};
use crate::http::models::detail::Detail;
use crate::http::stream::{Source, Stream};
use crate::http::wire::extract::Parameters;
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{BadParameters, FitMissing, ServerSentEvent, StreamAway};
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};

/// Follow a fit: its state at once, then every change.
///
/// Event names are `status`, `progress` and `end`. The id is the fit's version. The data is the fit without its request. The stream
/// closes after `end`. If the fit is deleted, the data of `end` is `{"id", "status": "deleted"}`.
#[utoipa::path(
    get, path = "/fits/{id}/events", operation_id = "follow_fit", tag = "fits",
    params(
        ("id" = Uuid, Path, description = "Id of the fit"),
        ("last-event-id" = Option<String>, Header, description = "Version that the client has. A newer one is sent at once"),
        ("last_event_id" = Option<String>, Query, description = "The same for a new `EventSource`, which cannot send the header; the header takes precedence"),
    ),
    responses(
        (status = 200, description = "Events", content_type = "text/event-stream", body = ServerSentEvent),
        (status = 204, description = "The fit has ended, and `Last-Event-ID` is its last version: nothing will follow"),
        FitMissing, BadParameters, StreamAway,
    )
)]
pub(in crate::http) async fn events(
    State(state): State<AppState>,
    caller: Caller,
    FitId(id): FitId,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    Problem::check(parameters.faults(&["last_event_id"], &[]))?;
    let permit = permit(&state)?;
    // Before the fit is read, so that no change in between is missed.
    let changes = state.store.changes();
    let job = caller.fit(state.store.get(id).await?).ok_or_else(|| no_fit(id))?;
    let known = last_seen(&headers, &parameters).and_then(|text| text.parse::<u64>().ok()) == Some(job.version);
    if known && job.status.is_ended() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let reader = FitReader::new(&state.store, changes, &state.limits, &job, known);
    Ok(Stream::new(&state, caller, permit, Detail::Summary, Vec::new(), Source::Fit(Box::new(reader))).into_response())
}
