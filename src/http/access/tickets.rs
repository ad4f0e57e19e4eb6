//! `POST /tickets`: a ticket for one `GET` by a client that cannot send a key, such as an
//! `EventSource`, a link or an image in a browser.

use crate::http::AppState;
use crate::http::access::{Caller, unauthorized};
use crate::http::wire::faults::{body_reader, escape};
use crate::http::wire::json::JsonBody;
use crate::http::wire::problem::Problem;
use crate::http::wire::responses::{TicketProblems, TicketUnavailable};
use crate::jobs::keys::{NewTicket, TicketSecret};
use crate::spec::Fault;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::time::Duration;
use utoipa::ToSchema;

/// Lifetime of a ticket.
const LIFE: Duration = Duration::from_secs(60);
/// Maximum length of a path, bytes.
const PATH_MAX: usize = 512;

/// A request for a ticket.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "describes the body; `path_of` reads it and collects its faults")]
pub(in crate::http) struct TicketRequest {
    /// Path of the request that the ticket authorizes, without a query string, such as
    /// `/models/{id}/events`.
    #[schema(pattern = "^/[!\"$->@-~]*$", max_length = 512)]
    path: String,
}

/// A ticket.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct Ticket {
    /// Value for the parameter `ticket` of one `GET` of the path.
    ticket: String,
    /// Path of the request that the ticket authorizes.
    path: String,
    /// Time at which the ticket expires; null on a service without keys, which accepts any value.
    #[schema(value_type = Option<String>, format = DateTime)]
    expires_at: Option<Timestamp>,
}

/// Get a ticket.
///
/// A ticket authorizes one `GET` of one path within 60 seconds, as `?ticket=…`, with the rights of
/// the key that requested it. It is meant for an `EventSource` or a link, which cannot send
/// `Authorization`. Each reconnection needs a new ticket.
#[utoipa::path(
    post, path = "/tickets", operation_id = "create_ticket", tag = "access",
    request_body(content = TicketRequest, content_type = "application/json"),
    responses((status = 201, description = "The ticket", body = Ticket), TicketProblems, TicketUnavailable)
)]
pub(in crate::http) async fn create(
    State(state): State<AppState>,
    caller: Caller,
    body: JsonBody,
) -> Result<Response, Problem> {
    let path = path_of(&body)?;
    let secret = TicketSecret::generate();
    let expires_at = match &caller {
        Caller::Anyone => None,
        Caller::Key(key) if state.access.still_works(&caller).await => {
            let ticket = NewTicket { hash: secret.hash(), key: key.prefix.clone(), path: path.clone(), life: LIFE };
            Some(state.store.add_ticket(ticket).await?)
        }
        Caller::Key(_) => return Err(unauthorized("The key was revoked a moment ago.")),
    };
    let ticket = Ticket { ticket: secret.reveal().to_owned(), path, expires_at };
    let cache = [(header::CACHE_CONTROL, HeaderValue::from_static("no-store"))];
    Ok((StatusCode::CREATED, cache, Json(ticket)).into_response())
}

/// The path in a request for a ticket.
fn path_of(body: &Value) -> Result<String, Problem> {
    let mut reader = body_reader();
    let Some(members) = body.as_object() else {
        return Err(Problem::invalid([Fault::new("", "must be an object")]));
    };
    for name in members.keys().filter(|name| *name != "path") {
        reader.fault::<()>(format!("/{}", escape(name)), "is unknown; the member is path");
    }
    let path = match members.get("path") {
        None => Err("is missing"),
        Some(Value::String(path)) if path.len() > PATH_MAX => Err("must have at most 512 characters"),
        Some(Value::String(path)) if !path.starts_with('/') || !path.bytes().all(|b| b.is_ascii_graphic()) => {
            Err("must be a path: a slash and visible ASCII characters, others percent-encoded")
        }
        Some(Value::String(path)) if path.contains(['?', '#']) => Err("must not have a query or a fragment"),
        Some(Value::String(path)) => Ok(path.clone()),
        Some(_) => Err("must be a string"),
    };
    let path = path.map_or_else(|detail| reader.fault("/path", detail), Some);
    path.filter(|_| reader.count() == 0).ok_or_else(|| Problem::invalid(reader))
}
