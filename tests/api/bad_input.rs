//! Invalid requests: the response is a problem that names the place, and the service keeps running.

use super::app::{App, Reply};
use axum::body::{Body, Bytes};
use axum::http::{Method, header};
use serde_json::{Value, json};
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

async fn raw(app: &App, body: impl Into<Body>) -> Reply {
    app.request(Method::POST, "/models", &[("content-type", "application/json")], body.into()).await
}

/// The problem with its request id replaced by a placeholder, for snapshots.
fn steady(reply: &Reply) -> Value {
    let mut problem = reply.json();
    problem["request_id"] = "…".into();
    problem
}

#[tokio::test]
async fn every_fault_of_a_request_comes_at_once() {
    let app = App::new().await;
    let body = json!({
        "preset": "pig", "seed": -1, "outputs": ["glb", "fbx", "glb"], "backend": "tpu", "labels": { "n": 1 },
        "spec": { "length_mm": "long", "steps": -5, "collision": { "gap_um": 1e9, "gap_mm": 1 } }, "sede": 7
    });
    let reply = app.post("/models", &body).await;
    assert_eq!(reply.status, 422);
    insta::assert_json_snapshot!(steady(&reply));
    assert_eq!(app.post("/models/validate", &body).await.places(), reply.places());
}

#[tokio::test]
async fn single_faults_name_their_place() {
    let app = App::new().await;
    let many: Value = (0..17).map(|i| (format!("k{i}"), json!("v"))).collect::<serde_json::Map<_, _>>().into();
    let cases = [
        (json!({ "presett": "pig" }), "/presett"),
        (json!({ "preset": "dragon" }), "/preset"),
        (json!({ "preset": 3 }), "/preset"),
        (json!({ "seed": 9_007_199_254_740_992_u64 }), "/seed"),
        (json!({ "seed": 1.5 }), "/seed"),
        (json!({ "seed": null }), "/seed"),
        (json!({ "seed": "7" }), "/seed"),
        (json!({ "spec": 3 }), "/spec"),
        (json!({ "spec": { "colision": {} } }), "/spec/colision"),
        (json!({ "spec": { "particles": { "total": 1e9 } } }), "/spec/particles/total"),
        (json!({ "spec": { "particles": { "total": -5 } } }), "/spec/particles/total"),
        (json!({ "outputs": "glb" }), "/outputs"),
        (json!({ "outputs": ["glb", "glb"] }), "/outputs/1"),
        (json!({ "outputs": ["exe"] }), "/outputs/0"),
        (json!({ "backend": "cuda" }), "/backend"),
        (json!({ "labels": many }), "/labels"),
        (json!({ "labels": { "": "x" } }), "/labels/"),
        (json!({ "labels": { "a": "x".repeat(257) } }), "/labels/a"),
        (json!({ "labels": { "a/b~c": 1 } }), "/labels/a~1b~0c"),
        (json!({ "priority": 101 }), "/priority"),
        (json!({ "priority": -101 }), "/priority"),
        (json!({ "priority": 0.5 }), "/priority"),
        (json!({ "priority": "high" }), "/priority"),
        (json!({ "priority": null }), "/priority"),
        (json!({ "reuse": 1 }), "/reuse"),
        (json!([]), ""),
        (json!("pig"), ""),
        (json!(null), ""),
    ];
    for (body, place) in cases {
        let reply = app.post("/models", &body).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (422, "invalid-request"), "{body}");
        assert!(reply.places().iter().any(|p| p == place), "{body}: {:?}", reply.places());
    }
    assert_eq!(app.get("/models").await.json()["models"], json!([]), "nothing was queued");
}

#[tokio::test]
async fn a_schedule_out_of_order_is_named() {
    let app = App::new().await;
    let reply = app
        .post("/models", &json!({ "spec": { "friction": { "keys": [[0, 0.1], [0.7, 0.1], [0.3, 0.1], [1, 0.1]] } } }))
        .await;
    assert_eq!(reply.status, 422);
    assert!(reply.places()[0].starts_with("/spec/friction"), "{:?}", reply.places());
}

#[tokio::test]
async fn what_is_not_json_is_refused_with_line_and_column() {
    let app = App::new().await;
    let broken = raw(&app, "{\n  \"seed\": 7,\n  \"preset\" \"pig\"\n}").await;
    insta::assert_json_snapshot!(steady(&broken));
    let bombs: Vec<Vec<u8>> = vec![
        b"".to_vec(),
        b"seed=7".to_vec(),
        b"{\"seed\": NaN}".to_vec(),
        b"{\"seed\": 1e999}".to_vec(),
        b"{\"seed\": 07}".to_vec(),
        b"{\"seed\": 7, \"seed\": 8}".to_vec(),
        b"{\"spec\": {\"steps\": 1, \"steps\": 2}}".to_vec(),
        b"{\"preset\": \"\xff\xfe\"}".to_vec(),
        b"{\"preset\": \"\\ud800\"}".to_vec(),
        b"\xef\xbb\xbf{}".to_vec(),
        b"{}{}".to_vec(),
        b"[".repeat(200_000),
        b"{\"a\":".repeat(100_000),
    ];
    for bomb in bombs {
        let reply = raw(&app, bomb.clone()).await;
        let shown = String::from_utf8_lossy(&bomb[..bomb.len().min(40)]).into_owned();
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (400, "invalid-json"), "{shown}");
        assert!(reply.json()["line"].as_u64().unwrap() >= 1, "{shown}");
        assert!(reply.json()["column"].is_u64(), "{shown}");
    }
    assert_eq!(raw(&app, "{}").await.status, 202, "the service goes on");
}

#[tokio::test]
async fn other_media_types_are_refused() {
    let app = App::new().await;
    for kind in [
        None,
        Some("text/plain"),
        Some("application/x-www-form-urlencoded"),
        Some("application/json; charset=latin-1"),
        Some("nonsense"),
    ] {
        let headers: Vec<_> = kind.into_iter().map(|kind| ("content-type", kind)).collect();
        let reply = app.request(Method::POST, "/models", &headers, Body::from("{}")).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (415, "unsupported-media-type"), "{kind:?}");
    }
}

#[tokio::test]
async fn a_body_that_is_too_large_is_refused_with_and_without_its_length() {
    let app = App::new().await;
    let large = vec![b' '; 50 << 20];
    let reply = raw(&app, large).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (413, "payload-too-large"));
    assert_eq!(reply.json()["limit"], 1 << 20);
    let endless = futures_util::stream::repeat_with(|| Ok::<_, Infallible>(Bytes::from_static(&[b' '; 4096])));
    let reply = raw(&app, Body::from_stream(endless)).await;
    assert_eq!(reply.status, 413);
    let fits = [vec![b' '; (1 << 20) - 2], b"{}".to_vec()].concat();
    assert_eq!(raw(&app, fits).await.status, 202);
}

/// If the service did not read the whole body, the connection would be reset while the client
/// sends, and the client would lose the response.
#[tokio::test]
async fn a_body_that_is_too_large_is_read_to_its_end() {
    let app = App::new().await;
    let sent = Arc::new(AtomicUsize::new(0));
    let counted = sent.clone();
    let parts = (0..1024).map(move |n| {
        counted.store(n + 1, Ordering::Relaxed);
        Ok::<_, Infallible>(Bytes::from_static(&[b' '; 4096]))
    });
    let reply = raw(&app, Body::from_stream(futures_util::stream::iter(parts))).await;
    assert_eq!((reply.status.as_u16(), sent.load(Ordering::Relaxed)), (413, 1024));
    // A client that sends `Expect: 100-continue` gets the refusal before it sends the body.
    let headers = [("content-type", "application/json"), ("expect", "100-continue")];
    assert_eq!(app.request(Method::POST, "/models", &headers, Body::from(vec![b' '; 4 << 20])).await.status, 413);
}

#[tokio::test]
async fn a_body_that_breaks_off_or_never_ends_is_refused() {
    let limits = oviduct::http::Limits { body_time: std::time::Duration::from_millis(50), ..Default::default() };
    let app = App::with(limits, 10).await;
    let broken = futures_util::stream::iter([Ok(Bytes::from_static(b"{")), Err(std::io::Error::other("gone"))]);
    assert_eq!(raw(&app, Body::from_stream(broken)).await.slug(), "bad-request");
    let stuck = futures_util::stream::pending::<Result<Bytes, Infallible>>();
    let reply = raw(&app, Body::from_stream(stuck)).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (408, "request-timeout"));
}

#[tokio::test]
async fn unknown_addresses_are_problems() {
    let app = App::new().await;
    insta::assert_json_snapshot!(steady(&app.get("/nowhere").await));
    for path in ["/models/", "/model", "/batch", "/doc", "/ticket", "/models/x/y/z", "/presets/pig/x", "/%ff"] {
        assert_eq!(app.get(path).await.slug(), "not-found", "{path}");
    }
}

#[tokio::test]
async fn an_invalid_id_is_no_model() {
    let app = App::new().await;
    let unknown = uuid::Uuid::now_v7().to_string();
    for id in [
        "x",
        "..",
        "%2e%2e%2f",
        "%00",
        "0",
        "{}",
        &unknown,
        &unknown.replace('-', ""),
        &format!("{{{unknown}}}").replace(['{', '}'], "%7B"),
        "%ff%fe",
    ] {
        for rest in ["", "/events", "/report", "/files/model.glb", "/sections/0"] {
            let reply = app.get(&format!("/models/{id}{rest}")).await;
            assert_eq!(reply.status, 404, "{id}{rest}");
        }
        assert_eq!(app.delete(&format!("/models/{id}")).await.status, 404, "{id}");
        assert_eq!(app.post(&format!("/models/{id}/cancel"), &json!({})).await.status, 404, "{id}");
    }
    assert_eq!(app.get(&format!("/models/{unknown}")).await.slug(), "model-not-found");
}

#[tokio::test]
async fn wrong_methods_are_refused_with_those_allowed() {
    let app = App::new().await;
    let model = format!("/models/{}", uuid::Uuid::nil());
    let cases = [
        ("/models", Method::PUT, "GET,HEAD,POST,DELETE"),
        ("/models/validate", Method::PUT, "POST"),
        (&model, Method::PUT, "GET,HEAD,DELETE"),
        (&model, Method::PATCH, "GET,HEAD,DELETE"),
        ("/healthz", Method::POST, "GET,HEAD"),
        ("/healthz", Method::TRACE, "GET,HEAD"),
        ("/", Method::POST, "GET,HEAD"),
    ];
    for (path, method, allow) in cases {
        let reply = app.request(method.clone(), path, &[], Body::empty()).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (405, "method-not-allowed"), "{method} {path}");
        let mut got: Vec<_> = reply.header(header::ALLOW).unwrap().split(',').collect();
        let mut want: Vec<_> = allow.split(',').collect();
        got.sort_unstable();
        want.sort_unstable();
        assert_eq!(got, want, "{method} {path}");
    }
    let custom = app.request(Method::from_bytes(b"BREW").unwrap(), "/models", &[], Body::empty()).await;
    assert_eq!(custom.status, 405);
}

#[tokio::test]
async fn bad_query_parameters_are_named() {
    let app = App::new().await;
    let cases = [
        ("status=done", "status"),
        ("status=", "status"),
        ("limit=0", "limit"),
        ("limit=101", "limit"),
        ("limit=x", "limit"),
        ("limit=5&limit=6", "limit"),
        ("label=nocolon", "label"),
        ("cursor=abc", "cursor"),
        ("colour=red", "colour"),
    ];
    for (query, name) in cases {
        let reply = app.get(&format!("/models?{query}")).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (422, "invalid-request"), "{query}");
        assert_eq!(reply.places(), [name], "{query}");
    }
    let all = app.get("/models?status=x&limit=x&label=x&cursor=x&y=x").await;
    assert_eq!(all.places().len(), 5, "all at once");
}

#[tokio::test]
async fn bad_idempotency_keys_are_refused() {
    let app = App::new().await;
    for key in ["", "two words", &"k".repeat(256)] {
        let reply = app.post_with("/models", &[("idempotency-key", key)], &json!({})).await;
        assert_eq!((reply.status.as_u16(), reply.places()), (422, vec!["idempotency-key".to_owned()]), "{key}");
    }
    assert_eq!(app.post_with("/models", &[("idempotency-key", &"k".repeat(255))], &json!({})).await.status, 202);
}
