//! Origins whose pages may call the service (CORS protocol of the Fetch standard). The default is
//! none.

use super::headers::{
    IDEMPOTENCY_KEY, IDEMPOTENCY_REPLAYED, LAST_EVENT_ID, PREFER, PREFERENCE_APPLIED, REQUEST_ID, UM_PER_PIXEL,
};
use super::problem::{RATE_LIMIT, RATE_LIMIT_POLICY};
use crate::trace::TRACEPARENT;
use axum::Router;
use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue, Method, Uri, header};
use axum::middleware::Next;
use axum::response::IntoResponse;
use std::str::FromStr;
use std::time::Duration;
use tower::ServiceExt;
use tower_http::cors::{AllowOrigin, CorsLayer};

/// Time for which a browser caches the response to a preflight: the maximum of Chromium.
const PREFLIGHT_CACHE: Duration = Duration::from_secs(7200);

/// An origin whose pages may call the service, such as `https://lab.example:8443`, or `*` for any.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin(HeaderValue);

impl Origin {
    /// True for `*`.
    #[must_use]
    pub fn is_any(&self) -> bool {
        self.0 == "*"
    }

    /// True if pages with this `Origin` header may call the service.
    #[must_use]
    pub fn allows(&self, origin: &HeaderValue) -> bool {
        self.is_any() || self.0 == *origin
    }
}

/// A text that is not an origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("must be an origin such as https://lab.example:8443 (scheme, host and port, without a path), or *")]
pub struct NoOrigin;

impl FromStr for Origin {
    type Err = NoOrigin;

    /// Reads an origin and normalizes it as browsers do: lower case, without the default port.
    fn from_str(text: &str) -> Result<Self, NoOrigin> {
        if text == "*" {
            return Ok(Self(HeaderValue::from_static("*")));
        }
        let uri: Uri = text.to_ascii_lowercase().parse().map_err(|_| NoOrigin)?;
        let (Some(scheme), Some(authority)) = (uri.scheme_str(), uri.authority()) else { return Err(NoOrigin) };
        let whole = format!("{scheme}://{authority}");
        if !matches!(scheme, "http" | "https") || authority.as_str().contains('@') || !text.eq_ignore_ascii_case(&whole)
        {
            return Err(NoOrigin);
        }
        let own = match (scheme, authority.port_u16()) {
            ("http", Some(80)) | ("https", Some(443)) => format!("{scheme}://{}", authority.host()),
            _ => whole,
        };
        HeaderValue::try_from(own).map(Self).map_err(|_| NoOrigin)
    }
}

/// Lets pages of these origins call the routes. Responses allow no credentials, because API keys
/// travel in a header, not in a cookie. Preflights are answered before any check of the request.
pub(in crate::http) fn allow(routes: Router, origins: &[Origin]) -> Router {
    if origins.is_empty() {
        return routes;
    }
    let allowed = match origins.iter().any(Origin::is_any) {
        true => AllowOrigin::any(),
        false => AllowOrigin::list(origins.iter().map(|origin| origin.0.clone())),
    };
    let layer = CorsLayer::new()
        .allow_origin(allowed)
        .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::DELETE])
        .allow_headers(REQUEST_HEADERS)
        .expose_headers(RESPONSE_HEADERS)
        .max_age(PREFLIGHT_CACHE);
    // The layer treats every OPTIONS request as a preflight. Others ask for the methods of a
    // resource, so they bypass the layer.
    let plain = routes.clone();
    let route = axum::middleware::from_fn(move |request: Request, next: Next| {
        let plain = plain.clone();
        async move {
            let preflight = request.headers().contains_key(header::ACCESS_CONTROL_REQUEST_METHOD);
            match request.method() == Method::OPTIONS && !preflight {
                true => plain.oneshot(request).await.into_response(),
                false => next.run(request).await,
            }
        }
    });
    Router::new().fallback_service(routes).layer(layer).layer(route)
}

/// Headers that a page may send, in addition to those that the Fetch standard always allows.
const REQUEST_HEADERS: [HeaderName; 10] = [
    IDEMPOTENCY_KEY,
    PREFER,
    LAST_EVENT_ID,
    REQUEST_ID,
    HeaderName::from_static(TRACEPARENT),
    header::AUTHORIZATION,
    header::CONTENT_TYPE,
    header::IF_NONE_MATCH,
    header::IF_RANGE,
    header::RANGE,
];

/// Response headers that a page may read, in addition to those that the Fetch standard always
/// allows.
const RESPONSE_HEADERS: [HeaderName; 13] = [
    IDEMPOTENCY_REPLAYED,
    PREFERENCE_APPLIED,
    REQUEST_ID,
    UM_PER_PIXEL,
    RATE_LIMIT,
    RATE_LIMIT_POLICY,
    header::ACCEPT_RANGES,
    header::CONTENT_DISPOSITION,
    header::CONTENT_RANGE,
    header::ETAG,
    header::LOCATION,
    header::RETRY_AFTER,
    header::WWW_AUTHENTICATE,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_read_as_browsers_write_them() {
        let read = |text: &str| text.parse::<Origin>().map(|origin| origin.0);
        assert_eq!(read("https://Lab.Example"), Ok(HeaderValue::from_static("https://lab.example")));
        assert_eq!(read("https://lab.example:443"), read("https://lab.example"));
        assert_eq!(read("http://[::1]:5173"), Ok(HeaderValue::from_static("http://[::1]:5173")));
        assert_eq!(read("*"), Ok(HeaderValue::from_static("*")));
        for wrong in [
            "",
            "lab.example",
            "https://lab.example/",
            "https://lab.example/app",
            "ftp://lab.example",
            "null",
            "https://me@lab.example",
            "https://*.example?",
            "https://",
            "*, https://lab.example",
        ] {
            assert_eq!(read(wrong), Err(NoOrigin), "{wrong}");
        }
    }
}
