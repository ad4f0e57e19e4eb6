//! Compression of responses (RFC 9110, section 12.5.3): zstd, brotli or gzip, as `Accept-Encoding`
//! prefers.
//!
//! Only text is compressed: JSON, SVG, OBJ, YAML and pages. Three kinds of text are not: events,
//! because a compressor would delay them; ranges, because their offsets refer to the uncompressed
//! file; and short responses. A compressed response has other bytes than the uncompressed one, so
//! its entity tag is weak: it is valid for `If-None-Match`, but not for `If-Range`.

use axum::Router;
use axum::extract::Request;
use axum::http::header::{ACCEPT_ENCODING, CONTENT_ENCODING, CONTENT_TYPE, ETAG, IF_NONE_MATCH, VARY};
use axum::http::{Extensions, HeaderMap, HeaderValue, Method, StatusCode, Version};
use axum::middleware::Next;
use axum::response::Response;
use tower_http::CompressionLevel;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{Predicate, SizeAbove};

/// Minimum size of a compressed response, bytes. Shorter ones fit into one packet uncompressed.
const MIN_BYTES: u64 = 1024;
/// Level of every algorithm: fast, with most of the possible reduction.
const LEVEL: i32 = 3;

/// Compresses the responses of these routes.
pub(in crate::http) fn compress(routes: Router) -> Router {
    let text = |_: StatusCode, _: Version, headers: &HeaderMap, _: &Extensions| is_text(headers);
    let layer = CompressionLayer::new()
        .quality(CompressionLevel::Precise(LEVEL))
        .compress_when(SizeAbove::new(MIN_BYTES).and(text));
    routes.layer(layer).layer(axum::middleware::from_fn(adapt))
}

/// True if the body is text that may be compressed.
fn is_text(headers: &HeaderMap) -> bool {
    let Some(Ok(kind)) = headers.get(CONTENT_TYPE).map(HeaderValue::to_str) else { return false };
    let kind = kind.split(';').next().unwrap_or_default().trim();
    match kind {
        "text/event-stream" => false,
        "application/json" | "application/problem+json" | "application/yaml" | "image/svg+xml" | "model/obj" => true,
        _ => kind.starts_with("text/"),
    }
}

/// Adapts a request to the compression layer, and the response of the layer to HTTP.
async fn adapt(mut request: Request, next: Next) -> Response {
    let accepted = acceptable(request.headers()).filter(|_| request.method() != Method::HEAD);
    let tags = request.headers().get_all(IF_NONE_MATCH);
    let has_compressed =
        accepted.is_some() && tags.iter().any(|tags| tags.as_bytes().windows(2).any(|window| window == b"W/"));
    request.headers_mut().remove(ACCEPT_ENCODING);
    if let Some(Ok(accepted)) = accepted.map(HeaderValue::try_from) {
        request.headers_mut().insert(ACCEPT_ENCODING, accepted);
    }
    let mut response = next.run(request).await;
    let not_modified = response.status() == StatusCode::NOT_MODIFIED;
    let headers = response.headers_mut();
    // Caches need `Vary` even on an uncompressed response: another client may get a compressed one.
    if (not_modified || is_text(headers)) && !headers.contains_key(VARY) {
        headers.append(VARY, HeaderValue::from_static("accept-encoding"));
    }
    if headers.contains_key(CONTENT_ENCODING) || (not_modified && has_compressed) {
        weaken(headers);
    }
    response
}

/// Value of `Accept-Encoding` without entries that refuse the identity encoding.
///
/// If no other encoding matches, the client gets the uncompressed response, which RFC 9110 permits.
/// Otherwise the compression layer would respond with 406 after the handler has run.
fn acceptable(headers: &HeaderMap) -> Option<String> {
    let refuses_identity = |item: &&str| {
        let mut parts = item.split(';').map(str::trim);
        let is_identity = parts.next().is_some_and(|name| name == "*" || name.eq_ignore_ascii_case("identity"));
        let is_refusal = |part: &str| {
            let weight = part.split_once('=').filter(|(name, _)| name.trim().eq_ignore_ascii_case("q"));
            weight.is_some_and(|(_, value)| value.trim().parse() == Ok(0.0_f32))
        };
        is_identity && parts.any(is_refusal)
    };
    let values = headers.get_all(ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    let items: Vec<&str> = values.flat_map(|value| value.split(',')).filter(|item| !refuses_identity(item)).collect();
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
