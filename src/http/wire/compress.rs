//! Compression of answers (RFC 9110, section 12.5.3): zstd, brotli or gzip, as `Accept-Encoding` prefers.
//!
//! Only text is compressed: JSON, SVG, OBJ, YAML, pages. Events are not, because a compressor would hold them back; neither
//! are ranges, whose offsets are those of the plain file, nor short answers. The entity tag of a compressed answer is weak,
//! because its bytes are not those of the plain one: it still serves `If-None-Match`, and never `If-Range`.

use axum::Router;
use axum::extract::Request;
use axum::http::header::{ACCEPT_ENCODING, CONTENT_ENCODING, CONTENT_TYPE, ETAG, IF_NONE_MATCH, VARY};
use axum::http::{Extensions, HeaderMap, HeaderValue, Method, StatusCode, Version};
use axum::middleware::Next;
use axum::response::Response;
use tower_http::CompressionLevel;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{Predicate, SizeAbove};

/// Answers below this size, in bytes, fit a packet anyway.
const LEAST: u64 = 1024;
/// Of each algorithm: a fast one that gives most of the gain.
const LEVEL: i32 = 3;

/// Compresses the answers of these routes.
pub(in crate::http) fn compress(routes: Router) -> Router {
    let text = |_: StatusCode, _: Version, headers: &HeaderMap, _: &Extensions| is_text(headers);
    let layer = CompressionLayer::new()
        .quality(CompressionLevel::Precise(LEVEL))
        .compress_when(SizeAbove::new(LEAST).and(text));
    routes.layer(layer).layer(axum::middleware::from_fn(adapt))
}

/// Whether the body is text of a kind that is worth compressing.
fn is_text(headers: &HeaderMap) -> bool {
    let Some(Ok(kind)) = headers.get(CONTENT_TYPE).map(HeaderValue::to_str) else { return false };
    let kind = kind.split(';').next().unwrap_or_default().trim();
    match kind {
        "text/event-stream" => false,
        "application/json" | "application/problem+json" | "application/yaml" | "image/svg+xml" | "model/obj" => true,
        _ => kind.starts_with("text/"),
    }
}

/// Adapts a request and its answer to the layer.
async fn adapt(mut request: Request, next: Next) -> Response {
    let weak =
        request.headers().get_all(IF_NONE_MATCH).iter().any(|tags| tags.as_bytes().windows(2).any(|w| w == b"W/"));
    let head = request.method() == Method::HEAD;
    let accepted = acceptable(request.headers()).filter(|_| !head);
    let weak = weak && accepted.is_some();
    request.headers_mut().remove(ACCEPT_ENCODING);
    if let Some(Ok(accepted)) = accepted.map(HeaderValue::try_from) {
        request.headers_mut().insert(ACCEPT_ENCODING, accepted);
    }
    let mut response = next.run(request).await;
    let not_modified = response.status() == StatusCode::NOT_MODIFIED;
    let headers = response.headers_mut();
    // Also where this answer is not compressed: one to another client may be.
    if (not_modified || is_text(headers)) && !headers.contains_key(VARY) {
        headers.append(VARY, HeaderValue::from_static("accept-encoding"));
    }
    if headers.contains_key(CONTENT_ENCODING) || (not_modified && weak) {
        weaken(headers);
    }
    response
}

/// What the client accepts, without its refusals of the plain form. It gets that if nothing else fits, which RFC 9110 allows;
/// the layer would answer 406 when the request has had its effect.
fn acceptable(headers: &HeaderMap) -> Option<String> {
    let refuses_plain = |item: &&str| {
        let mut parts = item.split(';').map(str::trim);
        let plain = parts.next().is_some_and(|name| name == "*" || name.eq_ignore_ascii_case("identity"));
        let refused = |part: &str| {
            let weight = part.split_once('=').filter(|(name, _)| name.trim().eq_ignore_ascii_case("q"));
            weight.is_some_and(|(_, value)| value.trim().parse() == Ok(0.0_f32))
        };
        plain && parts.any(refused)
    };
    let values = headers.get_all(ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    let items: Vec<&str> = values.flat_map(|value| value.split(',')).filter(|item| !refuses_plain(item)).collect();
    (!items.is_empty()).then(|| items.join(","))
}

/// Makes the entity tag weak.
fn weaken(headers: &mut HeaderMap) {
    let Some(tag) = headers.get(ETAG).filter(|tag| !tag.as_bytes().starts_with(b"W/")) else { return };
    if let Ok(weak) = HeaderValue::from_bytes(&[b"W/", tag.as_bytes()].concat()) {
        headers.insert(ETAG, weak);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_of_the_plain_form_is_passed_over() {
        let read = |value: &'static str| {
            acceptable(&HeaderMap::from_iter([(ACCEPT_ENCODING, HeaderValue::from_static(value))]))
        };
        assert_eq!(read("gzip, identity;q=0"), Some("gzip".into()));
        assert_eq!(read("br;q=0.5,*; q=0.000"), Some("br;q=0.5".into()));
        assert_eq!(read("gzip;q=0, *"), Some("gzip;q=0, *".into()));
        assert_eq!(read("*;q=0"), None);
        assert_eq!(acceptable(&HeaderMap::new()), None);
    }
}
