//! RFC 9110 on all paths: `HEAD` equals `GET` without the body, and 405 lists the allowed methods.
//! Selected paths: conditional requests and ranges.

use super::app::App;
use super::{cut, report, sections};
use axum::body::Body;
use axum::http::{HeaderMap, Method, Request, header};
use oviduct::export::sections_bin::MEDIA_TYPE;
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// A service with a finished model, a batch, a fit and an operation; all described paths with their
/// methods.
async fn app() -> (App, Vec<(String, BTreeSet<String>)>) {
    let app = App::new().await;
    let gltf = ("model.gltf", "model/gltf+json", vec![7; 1000]);
    let obj = ("model.obj", "model/obj", cut::stored());
    let files = [
        gltf,
        obj,
        ("report.json", "application/json", report::stored()),
        ("sections.bin", MEDIA_TYPE, sections::stored(3)),
    ];
    let model = app.finished(7, &files).await;
    let batch = app.post("/batches", &json!({ "count": 1 })).await.location();
    let target = json!({ "region": "whole", "quantity": "fill", "value": 0.7 });
    let fit = app.post("/fits", &json!({ "targets": [target] })).await.location();
    let operation = format!("/operations/{}", app.operation(None).await);
    let document: Value = yaml_serde::from_slice(&app.get("/openapi.yaml").await.body).unwrap();
    let mut addresses = Vec::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        let path = path
            .replace("/models/{id}", &model)
            .replace("/batches/{id}", &batch)
            .replace("/fits/{id}", &fit)
            .replace("/operations/{id}", &operation)
            .replace("/workers/{id}", "/workers/w1");
        let path =
            path.replace("{name}", if path.contains("presets") { "pig" } else { "model.gltf" }).replace("{k}", "1");
        assert!(!path.contains('{'), "{path}");
        let path = if path.ends_with("/cut") { path + "?z_um=1500" } else { path };
        let methods: BTreeSet<String> = item.as_object().unwrap().keys().map(|m| m.to_ascii_uppercase()).collect();
        addresses.push((path, methods));
    }
    addresses.push(("/".into(), BTreeSet::from(["GET".to_owned()])));
    assert!(addresses.len() > 15);
    (app, addresses)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn head_is_get_without_its_body() {
    let (app, addresses) = app().await;
    let mut seen = 0;
    for (path, methods) in addresses {
        if !methods.contains("GET") {
            assert_eq!(app.request(Method::HEAD, &path, &[], Body::empty()).await.status, 405, "{path}");
            continue;
        }
        let head = app.request(Method::HEAD, &path, &[], Body::empty()).await;
        // Event streams do not end, so the test does not read the body.
        let get = app.start(Request::get(&path).body(Body::empty()).unwrap()).await;
        assert_eq!((head.status, head.body.len()), (get.status(), 0), "{path}");
        // The sections do not belong to the surface.
        assert_eq!(head.status, if path.ends_with("/way") { 404 } else { 200 }, "{path}");
        for name in [header::CONTENT_TYPE, header::ETAG, header::CACHE_CONTROL, header::VARY, header::ACCEPT_RANGES] {
            assert_eq!(head.headers.get(&name), get.headers().get(&name), "{name} of {path}");
        }
        let length = |headers: &HeaderMap| headers.get(header::CONTENT_LENGTH).cloned();
        // The length of the metrics differs between requests.
        if let (Some(head), Some(get)) = (length(&head.headers), length(get.headers()))
            && path != "/metrics"
        {
            assert_eq!(head, get, "{path}");
        }
        seen += 1;
    }
    assert!(seen > 12, "{seen}");
    for (path, status) in [("/models/x", 404), ("/models?limit=0", 422), ("/presets/dragon", 404)] {
        let head = app.request(Method::HEAD, path, &[], Body::empty()).await;
        assert_eq!((head.status.as_u16(), head.body.len()), (status, 0), "{path}");
        assert_eq!(head.header(header::CONTENT_TYPE), Some("application/problem+json"), "{path}");
    }
}

#[tokio::test]
async fn a_method_that_is_not_allowed_is_refused_with_those_that_are() {
    let (app, addresses) = app().await;
    for (path, mut methods) in addresses {
        if methods.contains("GET") {
            methods.insert("HEAD".into());
        }
        for method in
            ["GET", "POST", "PUT", "PATCH", "DELETE", "PROPFIND"].into_iter().filter(|m| !methods.contains(*m))
        {
            let method = Method::from_bytes(method.as_bytes()).unwrap();
            let reply = app.request(method.clone(), &path, &[], Body::empty()).await;
            assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (405, "method-not-allowed"), "{method} {path}");
            let allowed: BTreeSet<String> =
                reply.header(header::ALLOW).unwrap().split(',').map(|m| m.trim().to_owned()).collect();
            assert_eq!(allowed, methods, "{method} {path}");
        }
    }
}

#[tokio::test]
async fn a_range_is_sent_only_of_the_same_file() {
    let (app, addresses) = app().await;
    let path = addresses.iter().map(|(path, _)| path).find(|path| path.ends_with("/model.gltf")).unwrap();
    let tag = app.get(path).await.header(header::ETAG).unwrap().to_owned();
    let weak = format!("W/{tag}");
    for (if_range, status) in
        [(tag.as_str(), 206), (&weak, 200), ("Wed, 21 Oct 2015 07:28:00 GMT", 200), ("\"other\"", 200), ("*", 200)]
    {
        let reply = app.get_with(path, &[("range", "bytes=5-9"), ("if-range", if_range)]).await;
        assert_eq!(
            (reply.status.as_u16(), reply.body.len()),
            (status, if status == 206 { 5 } else { 1000 }),
            "{if_range}"
        );
    }
    // Without `Range`, `If-Range` has no effect.
    assert_eq!(app.get_with(path, &[("if-range", "\"other\"")]).await.status, 200);
    // An unsatisfiable range is ignored if `If-Range` names another file.
    assert_eq!(app.get_with(path, &[("range", "bytes=5000-"), ("if-range", &weak)]).await.status, 200);
    for (range, status, bytes) in [
        ("bytes=-2000", 206, 1000),
        ("bytes=-18446744073709551616", 206, 1000),
        ("bytes=0-18446744073709551616", 206, 1000),
        ("bytes=0-0,-1", 200, 1000),
        ("bytes=0-0, 5000-", 200, 1000),
        ("bytes=", 200, 1000),
        ("bytes=-", 200, 1000),
        ("bytes=0x1-2", 200, 1000),
        ("BYTES=1-2", 206, 2),
    ] {
        let reply = app.get_with(path, &[("range", range)]).await;
        assert_eq!((reply.status.as_u16(), reply.body.len()), (status, bytes), "{range}");
    }
}

#[tokio::test]
async fn the_accepted_representation_is_sent() {
    let (app, addresses) = app().await;
    let path = addresses.iter().map(|(path, _)| path).find(|path| path.ends_with("/sections/1")).unwrap();
    let (plain, drawn) = (Some("application/json"), Some("image/svg+xml"));
    for (accept, kind) in [
        ("*/*", plain),
        ("application/*", plain),
        ("APPLICATION/JSON", plain),
        ("application/json;q=0, */*", drawn),
        ("application/json;q=0.1, image/*;q=0.2", drawn),
        ("application/json; charset=utf-8", plain),
        ("image/svg+xml;Q=0.9, application/json;Q=0.1", drawn),
        ("", plain),
    ] {
        let reply = app.get_with(path, &[("accept", accept)]).await;
        assert_eq!((reply.status.as_u16(), reply.header(header::CONTENT_TYPE)), (200, kind), "{accept}");
        assert_eq!(reply.header(header::VARY), Some("accept"));
    }
    for accept in
        ["application/json;q=0", "*/*;q=0", "text/html", "application/json;q=0, image/svg+xml;q=0, image/png;q=0, */*"]
    {
        assert_eq!(app.get_with(path, &[("accept", accept)]).await.slug(), "not-acceptable", "{accept}");
    }
}

#[tokio::test]
async fn a_transfer_coding_that_the_service_does_not_know_is_not_implemented() {
    let (app, _) = app().await;
    app.expect_faults();
    let post = async |coding: &str| {
        let headers = [("content-type", "application/json"), ("transfer-encoding", coding)];
        app.request(Method::POST, "/models/validate", &headers, Body::from("{}")).await
    };
    for coding in ["gzip, chunked", "gzip", "identity", "Chunked ,br"] {
        let reply = post(coding).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (501, "transfer-coding-unsupported"), "{coding}");
    }
    for coding in ["chunked", "Chunked", "chunked,"] {
        assert_eq!(post(coding).await.status, 200, "{coding}");
    }
}
