//! `GET /` and the files of the web console, built from `web/` and embedded in the program.
//!
//! The policy of the page forbids loading anything from other origins. Names of its files change
//! with their content, so clients may cache them forever; the page itself is revalidated each time.

use super::AppState;
use super::wire::conditional::ETag;
use super::wire::problem::{Kind, Problem};
use axum::Router;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use rust_embed::{Embed, EmbeddedFile};

/// Output of `npm run build`.
#[derive(Embed)]
#[folder = "web/dist/"]
struct Files;

const PAGE: &str = "index.html";
/// Folder of the files whose names change with their content.
const HASHED: &str = "assets/";

/// WebAssembly decodes the levels of detail. Pictures and downloads that need a key are blobs.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' blob:; \
     connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

/// Routes of the page at `/` and of its files.
pub(super) fn routes() -> Router<AppState> {
    Files::iter().fold(Router::new(), |routes, name| {
        let path = if name == PAGE { "/".to_owned() } else { format!("/{name}") };
        routes.route(&path, get(async move |headers: HeaderMap| send(&name, &headers)))
    })
}

fn send(name: &str, headers: &HeaderMap) -> Result<Response, Problem> {
    let EmbeddedFile { data, metadata } =
        Files::get(name).ok_or_else(|| Problem::new(Kind::Internal, "The console has lost a file."))?;
    let tag = ETag::strong(hex::encode(metadata.sha256_hash()));
    let forever = "public, max-age=31536000, immutable";
    let cache = HeaderValue::from_static(if name.starts_with(HASHED) { forever } else { "no-cache" });
    if tag.matches_none(headers) {
        return tag.not_modified(cache);
    }
    let kind =
        HeaderValue::from_str(metadata.mimetype()).unwrap_or(HeaderValue::from_static("application/octet-stream"));
    let fields = [
        (header::CONTENT_TYPE, kind),
        (header::ETAG, tag.header()?),
        (header::CACHE_CONTROL, cache),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    ];
    Ok((fields, data).into_response())
}
