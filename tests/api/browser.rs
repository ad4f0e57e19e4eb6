//! Features for browsers: cross-origin requests and compression.

use super::app::{App, Reply, id};
use axum::body::Body;
use axum::http::Method;
use oviduct::http::Limits;
use serde_json::json;
use std::io::Read;

const LAB: &str = "https://lab.example";

async fn open_to(origins: &[&str]) -> App {
    let cors_origins = origins.iter().map(|origin| origin.parse().unwrap()).collect();
    App::with(Limits { cors_origins, ..Limits::default() }, 100).await
}

async fn preflight(app: &App, path: &str, origin: &str) -> Reply {
    let headers = [
        ("origin", origin),
        ("access-control-request-method", "POST"),
        ("access-control-request-headers", "authorization,content-type,idempotency-key"),
    ];
    app.request(Method::OPTIONS, path, &headers, Body::empty()).await
}

/// The items of a comma-separated header, in lower case.
fn listed(reply: &Reply, name: &str) -> Vec<String> {
    let values = reply.headers.get_all(name).iter().map(|value| value.to_str().unwrap().to_lowercase());
    values.flat_map(|value| value.split(',').map(|item| item.trim().to_owned()).collect::<Vec<_>>()).collect()
}

#[tokio::test]
async fn pages_of_allowed_origins_may_call_and_others_may_not() {
    let app = open_to(&[LAB, "http://localhost:5173"]).await;
    let allowed = preflight(&app, "/models", LAB).await;
    assert!(allowed.status.is_success(), "{allowed:?}");
    assert_eq!(allowed.header("access-control-allow-origin"), Some(LAB));
    assert_eq!(allowed.header("access-control-max-age"), Some("7200"));
    assert_eq!(allowed.header("access-control-allow-credentials"), None);
    for (name, wanted) in [
        ("access-control-allow-methods", vec!["get", "head", "post", "delete"]),
        ("access-control-allow-headers", vec!["authorization", "content-type", "idempotency-key", "last-event-id"]),
    ] {
        let found = listed(&allowed, name);
        assert!(wanted.iter().all(|item| found.contains(&(*item).to_owned())), "{name}: {found:?}");
    }
    assert!(listed(&allowed, "vary").contains(&"origin".to_owned()));
    assert_eq!(preflight(&app, "/models", "https://evil.example").await.header("access-control-allow-origin"), None);

    // Pages of an allowed origin can also read problems.
    for (path, status) in [("/models", 200), ("/nowhere", 404), ("/models?limit=0", 422)] {
        let reply = app.get_with(path, &[("origin", LAB)]).await;
        assert_eq!((reply.status.as_u16(), reply.header("access-control-allow-origin")), (status, Some(LAB)), "{path}");
        let exposed = listed(&reply, "access-control-expose-headers");
        for name in ["location", "retry-after", "etag", "content-disposition", "content-range", "x-request-id"] {
            assert!(exposed.contains(&name.to_owned()), "{name} of {exposed:?}");
        }
    }
    let other = app.get_with("/models", &[("origin", "https://evil.example")]).await;
    assert_eq!(other.header("access-control-allow-origin"), None);
    // An `OPTIONS` request that is not a preflight gets the ordinary response.
    let options = app.request(Method::OPTIONS, "/models", &[("origin", LAB)], Body::empty()).await;
    assert!(options.header("allow").is_some_and(|allow| allow.contains("POST")), "{options:?}");
}

#[tokio::test]
async fn no_other_origin_is_allowed_by_default_and_any_by_a_star() {
    let closed = App::new().await;
    assert_eq!(preflight(&closed, "/models", LAB).await.header("access-control-allow-origin"), None);
    assert_eq!(closed.get_with("/models", &[("origin", LAB)]).await.header("access-control-allow-origin"), None);
    let open = open_to(&["*"]).await;
    assert_eq!(preflight(&open, "/models", LAB).await.header("access-control-allow-origin"), Some("*"));
}

/// The decompressed body.
fn plain(reply: &Reply) -> Vec<u8> {
    let mut bytes = Vec::new();
    match reply.header("content-encoding") {
        Some("zstd") => bytes = zstd::decode_all(&reply.body[..]).unwrap(),
        Some("gzip") => drop(flate2::read::GzDecoder::new(&reply.body[..]).read_to_end(&mut bytes).unwrap()),
        Some("br") => drop(brotli::Decompressor::new(&reply.body[..], 4096).read_to_end(&mut bytes).unwrap()),
        other => panic!("{other:?}"),
    }
    bytes
}

#[tokio::test]
async fn text_is_compressed_as_the_client_prefers() {
    let app = App::new().await;
    let model = app.model(1).await;
    let whole = app.get(&model).await;
    assert_eq!((whole.header("content-encoding"), whole.header("vary")), (None, Some("accept-encoding")));
    for (accepted, expected) in [
        ("gzip", "gzip"),
        ("br;q=0.9, gzip;q=0.5", "br"),
        ("gzip, deflate, br, zstd", "zstd"),
        ("zstd;q=0, gzip;q=0.1, identity;q=0", "gzip"),
    ] {
        let reply = app.get_with(&model, &[("accept-encoding", accepted)]).await;
        assert_eq!((reply.status.as_u16(), reply.header("content-encoding")), (200, Some(expected)), "{accepted}");
        assert!(reply.body.len() * 2 < whole.body.len(), "{} of {}", reply.body.len(), whole.body.len());
        assert_eq!(plain(&reply), whole.body, "{accepted}");
        assert_eq!(reply.header("vary"), Some("accept-encoding"));
        // The compressed bytes differ from the plain ones, so the tag is weak. A client that sends
        // either tag still gets 304.
        let tag = reply.header("etag").unwrap();
        assert_eq!(tag, format!("W/{}", whole.header("etag").unwrap()));
        for tag in [tag, whole.header("etag").unwrap()] {
            let same = app.get_with(&model, &[("accept-encoding", accepted), ("if-none-match", tag)]).await;
            assert_eq!((same.status.as_u16(), same.header("etag")), (304, Some(tag)), "{accepted}");
        }
    }
    for accepted in ["identity", "*;q=0", "gzip;q=0", "nonsense"] {
        let reply = app.get_with(&model, &[("accept-encoding", accepted)]).await;
        assert_eq!((reply.status.as_u16(), reply.header("content-encoding")), (200, None), "{accepted}");
    }
    let head = app.request(Method::HEAD, &model, &[("accept-encoding", "gzip")], Body::empty()).await;
    assert_eq!((head.status.as_u16(), head.header("vary"), head.body.len()), (200, Some("accept-encoding"), 0));
    assert_eq!(head.header("content-length").map(str::parse), Some(Ok(whole.body.len())));
    // The handler runs before compression, so an unacceptable encoding does not lead to 406.
    let headers = [("accept-encoding", "identity;q=0")];
    assert_eq!(app.post_with("/models", &headers, &json!({ "seed": 5 })).await.status, 202);
    let small = app.get_with("/healthz", &[("accept-encoding", "gzip")]).await;
    assert_eq!(small.header("content-encoding"), None);
}

#[tokio::test]
async fn files_are_compressed_if_they_are_text_and_ranges_never_are() {
    let app = App::new().await;
    let (glb, obj) = (b"glTF".repeat(2000), b"v 1.0 2.0 3.0\n".repeat(2000));
    let files = [("model.glb", "model/gltf-binary", glb.clone()), ("model.obj", "model/obj", obj.clone())];
    let model = app.finished(1, &files).await;
    let gzip = ("accept-encoding", "gzip");
    let plain_glb = app.get_with(&format!("{model}/files/model.glb"), &[gzip]).await;
    assert_eq!((plain_glb.header("content-encoding"), plain_glb.header("accept-ranges")), (None, Some("bytes")));
    assert_eq!(plain_glb.body, glb);
    let path = format!("{model}/files/model.obj");
    let reply = app.get_with(&path, &[gzip]).await;
    assert_eq!((reply.header("content-encoding"), plain(&reply)), (Some("gzip"), obj.clone()));
    assert!(reply.header("content-disposition").is_some());
    let weak = reply.header("etag").unwrap();
    assert!(weak.starts_with("W/\""));
    let strong = weak.strip_prefix("W/").unwrap();
    // A range refers to the uncompressed file. A weak tag in `If-Range` yields the whole file,
    // which may be compressed.
    let range = app.get_with(&path, &[gzip, ("range", "bytes=0-2047"), ("if-range", strong)]).await;
    assert_eq!((range.status.as_u16(), range.header("content-encoding")), (206, None));
    assert_eq!((&range.body[..], range.header("etag")), (&obj[..2048], Some(strong)));
    let whole = app.get_with(&path, &[gzip, ("range", "bytes=0-2047"), ("if-range", weak)]).await;
    assert_eq!((whole.status.as_u16(), plain(&whole)), (200, obj));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn events_are_never_compressed() {
    let app = App::new().await;
    let model = app.model(1).await;
    app.post(&format!("{model}/cancel"), &json!({})).await;
    let path = format!("/events?ids={}&view=full", id(&model));
    let reply = app.get_with(&path, &[("accept-encoding", "gzip, br, zstd")]).await;
    assert_eq!((reply.status.as_u16(), reply.header("content-encoding")), (200, None));
    assert!(String::from_utf8(reply.body.to_vec()).unwrap().contains("event: end\n"));
}
