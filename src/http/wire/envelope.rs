//! The layer around all routes: checks `Host` and `Transfer-Encoding`, assigns the request id,
//! opens the tracing span, and writes the body of every error response.
//!
//! Invariant: every error response has a problem as its body, including those of axum.

use super::cors::{self, Origin};
use super::headers::REQUEST_ID;
use super::host;
use super::problem::{Kind, MEDIA_TYPE, Problem};
use super::transfer;
use crate::clock::Stopwatch;
use crate::trace;
use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tower_http::catch_panic::CatchPanicLayer;
use tracing::Instrument;
use uuid::Uuid;

/// Maximum length of a request id from a client, bytes.
const REQUEST_ID_MAX: usize = 128;

fn request_id(headers: &HeaderMap) -> String {
    headers
        .get(REQUEST_ID)
        .and_then(|v| v.to_str().ok())
        .filter(|s| !s.is_empty() && s.len() <= REQUEST_ID_MAX && s.bytes().all(|b| b.is_ascii_graphic()))
        .map_or_else(|| Uuid::now_v7().to_string(), str::to_owned)
}

/// Puts the envelope around a router. Pages of other `origins` may read its responses.
///
/// The envelope is not a layer of `router` itself, because a router adds `Allow` to its responses
/// after its own layers.
pub(in crate::http) fn enclose(router: Router, origins: &[Origin]) -> Router {
    let inner = cors::allow(router.layer(CatchPanicLayer::custom(panicked)), origins);
    Router::new().fallback_service(inner).layer(axum::middleware::from_fn(envelope))
}

async fn envelope(request: Request, next: Next) -> Response {
    let id = request_id(request.headers());
    let method = request.method().clone();
    let path = request.uri().path().to_owned();
    let span = tracing::info_span!("request", %method, %path, request_id = %id, model = tracing::field::Empty, key = tracing::field::Empty);
    trace::adopt(&span, request.headers().get(trace::TRACEPARENT).and_then(|value| value.to_str().ok()));
    let watch = Stopwatch::start();
    let checked = host::check(request.version(), request.headers()).and_then(|()| transfer::check(request.headers()));
    let response = match checked {
        Ok(()) => next.run(request).instrument(span.clone()).await,
        Err(refusal) => refusal.into_response(),
    };
    let mut response = span.in_scope(|| {
        let response = complete(response, &method, &path, &id);
        let (status, seconds) = (response.status().as_u16(), watch.seconds());
        if response.status().is_server_error() {
            tracing::error!(status, seconds, "answered");
        } else {
            tracing::debug!(status, seconds, "answered");
        }
        response
    });
    let headers = response.headers_mut();
    if let Ok(value) = HeaderValue::from_str(&id) {
        headers.insert(REQUEST_ID, value);
    }
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}

/// Writes the problem of an error response, and responds to `OPTIONS`.
fn complete(mut response: Response, method: &Method, path: &str, id: &str) -> Response {
    let status = response.status();
    if status == StatusCode::METHOD_NOT_ALLOWED && method == Method::OPTIONS {
        return options(&response);
    }
    if !status.is_client_error() && !status.is_server_error() {
        return response;
    }
    let problem =
        response.extensions_mut().remove::<Problem>().unwrap_or_else(|| framework_problem(status, method, path));
    let body = serde_json::to_vec(&problem.body(path, id)).unwrap_or_default();
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, MEDIA_TYPE);
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.remove(header::CONTENT_LENGTH);
    *response.status_mut() = problem.kind().status();
    *response.body_mut() = if method == Method::HEAD { Body::empty() } else { Body::from(body) };
    response
}

/// The problem for an error response of axum.
fn framework_problem(status: StatusCode, method: &Method, path: &str) -> Problem {
    let kind = Kind::for_status(status);
    let detail = match kind {
        Kind::NotFound => format!("There is no resource at {path}; /openapi.yaml lists all."),
        Kind::MethodNotAllowed => format!("{path} does not support {method}; the Allow header lists what it supports."),
        _ => format!("{} {method} {path}", status.canonical_reason().unwrap_or("Error")),
    };
    Problem::new(kind, detail)
}

/// The response to `OPTIONS`: the methods that the refused response lists, and `OPTIONS`.
fn options(refused: &Response) -> Response {
    let mut allow = refused.headers().get(header::ALLOW).map_or_else(Vec::new, |v| v.as_bytes().to_vec());
    allow.extend_from_slice(if allow.is_empty() { b"OPTIONS" } else { b",OPTIONS" });
    let mut response = StatusCode::NO_CONTENT.into_response();
    if let Ok(value) = HeaderValue::from_bytes(&allow) {
        response.headers_mut().insert(header::ALLOW, value);
    }
    response
}

/// The response to a panic in a handler.
#[expect(clippy::needless_pass_by_value, reason = "the signature that tower-http calls")]
fn panicked(panic: Box<dyn std::any::Any + Send + 'static>) -> Response {
    let message = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("no message");
    tracing::error!(panic = message, "a handler panicked");
    Problem::new(Kind::Internal, "The service failed. Its log has this request id.").into_response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::routing::get;
    use http_body_util::BodyExt;
    use tower::ServiceExt;

    async fn boom() -> &'static str {
        panic!("on purpose")
    }

    fn app() -> Router {
        enclose(Router::new().route("/boom", get(boom)), &[])
    }

    #[tokio::test]
    async fn a_panic_is_a_problem_with_the_request_id() {
        let request =
            Request::get("/boom").header(header::HOST, "here").header(REQUEST_ID, "mine").body(Body::empty()).unwrap();
        let response = app().oneshot(request).await.unwrap();
        assert_eq!(response.status(), 500);
        assert_eq!(response.headers()[REQUEST_ID], "mine");
        let body = response.into_body().collect().await.unwrap().to_bytes();
        let body: serde_json::Value = serde_json::from_slice(&body).unwrap();
        assert_eq!(body["type"], "urn:oviduct:problem:internal");
        assert_eq!(body["request_id"], "mine");
        assert!(!body.to_string().contains("on purpose"), "the message stays in the log");
    }

    #[tokio::test]
    async fn an_invalid_request_id_is_replaced() {
        for bad in ["", "two words", &"x".repeat(129)] {
            let request = Request::get("/nowhere")
                .header(header::HOST, "here")
                .header(REQUEST_ID, bad)
                .body(Body::empty())
                .unwrap();
            let response = app().oneshot(request).await.unwrap();
            assert_eq!(response.status(), 404);
            let id = response.headers()[REQUEST_ID].to_str().unwrap();
            assert!(Uuid::try_parse(id).is_ok(), "{bad:?} became {id}");
        }
    }

    #[tokio::test]
    async fn a_request_without_a_host_is_a_problem() {
        let response = app().oneshot(Request::get("/boom").body(Body::empty()).unwrap()).await.unwrap();
        assert_eq!((response.status().as_u16(), &response.headers()[header::CONTENT_TYPE]), (400, &MEDIA_TYPE));
        assert!(response.headers().contains_key(REQUEST_ID));
    }

    #[tokio::test]
    async fn options_names_the_methods() {
        let request = Request::options("/boom").header(header::HOST, "here").body(Body::empty()).unwrap();
        let response = app().oneshot(request).await.unwrap();
        assert_eq!(response.status(), 204);
        assert_eq!(response.headers()[header::ALLOW], "GET,HEAD,OPTIONS");
    }
}
