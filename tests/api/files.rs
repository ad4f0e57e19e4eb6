//! Downloads of files and the report: bytes, ranges, entity tags.

use super::app::App;
use axum::body::Body;
use axum::http::{Method, Request, header};
use oviduct::http::Limits;
use proptest::prelude::*;
use sha2::{Digest, Sha256};
use std::time::Duration;

/// Bytes without short repetitions, so that a shifted range is detected.
fn content(len: usize) -> Vec<u8> {
    (0..len).map(|i| (i * 31 % 251) as u8).collect()
}

async fn app(len: usize) -> (App, String) {
    let app = App::new().await;
    let report = br#"{"certificate":{"passed":true}}"#.to_vec();
    let files = [("model.glb", "model/gltf-binary", content(len)), ("report.json", "application/json", report)];
    let model = app.finished(7, &files).await;
    (app, model)
}

#[tokio::test]
async fn a_file_comes_whole_with_its_tag() {
    let (app, model) = app(100_000).await;
    let path = format!("{model}/files/model.glb");
    let reply = app.get(&path).await;
    assert_eq!(reply.status, 200);
    assert!(reply.body == content(100_000));
    let tag = format!("\"{}\"", hex::encode(Sha256::digest(content(100_000))));
    assert_eq!(reply.header(header::ETAG).unwrap(), tag);
    assert_eq!(reply.header(header::CONTENT_TYPE), Some("model/gltf-binary"));
    assert_eq!(reply.header(header::CONTENT_LENGTH), Some("100000"));
    assert_eq!(reply.header(header::ACCEPT_RANGES), Some("bytes"));
    assert_eq!(reply.header(header::CONTENT_DISPOSITION), Some("attachment; filename=\"pig-7-model.glb\""));
    assert!(reply.header(header::CACHE_CONTROL).unwrap().contains("immutable"));
    assert_eq!(reply.header(header::X_CONTENT_TYPE_OPTIONS), Some("nosniff"));

    for same in [tag.as_str(), &format!("W/{tag}"), "*", &format!("\"x\", {tag}")] {
        let reply = app.get_with(&path, &[("if-none-match", same), ("range", "bytes=0-1")]).await;
        assert_eq!((reply.status.as_u16(), reply.body.len()), (304, 0));
        assert_eq!(reply.header(header::ETAG).unwrap(), tag);
    }
    assert_eq!(app.get_with(&path, &[("if-none-match", "\"x\"")]).await.status, 200);

    let head = app.request(Method::HEAD, &path, &[("range", "bytes=0-1")], Body::empty()).await;
    assert_eq!((head.status.as_u16(), head.body.len(), head.header(header::CONTENT_LENGTH)), (200, 0, Some("100000")));
    assert_eq!(head.header(header::ETAG).unwrap(), tag);
}

#[tokio::test]
async fn ranges_are_slices_of_the_file() {
    let (app, model) = app(1000).await;
    let path = format!("{model}/files/model.glb");
    let tag = app.get(&path).await.header(header::ETAG).unwrap().to_owned();
    let cases = [
        ("bytes=0-0", 0..1),
        ("bytes=10-19", 10..20),
        ("bytes=990-", 990..1000),
        ("bytes=-5", 995..1000),
        ("bytes=-5000", 0..1000),
        ("bytes=5-99999", 5..1000),
    ];
    for (range, want) in cases {
        for more in [vec![], vec![("if-range", tag.as_str())]] {
            let headers = [vec![("range", range)], more].concat();
            let reply = app.get_with(&path, &headers).await;
            assert_eq!(reply.status, 206, "{range}");
            assert_eq!(
                reply.header(header::CONTENT_RANGE).unwrap(),
                format!("bytes {}-{}/1000", want.start, want.end - 1)
            );
            assert_eq!(reply.header(header::CONTENT_LENGTH).unwrap(), want.len().to_string());
            assert_eq!(reply.header(header::ETAG).unwrap(), tag);
            assert!(reply.body == content(1000)[want.clone()], "{range}");
        }
    }
    for range in ["bytes=1000-", "bytes=5000-6000", "bytes=-0"] {
        let reply = app.get_with(&path, &[("range", range)]).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (416, "range-not-satisfiable"), "{range}");
        assert_eq!(reply.header(header::CONTENT_RANGE), Some("bytes */1000"));
    }
    for whole in [
        vec![("range", "bytes=0-1,5-6")],
        vec![("range", "lines=1-2")],
        vec![("range", "bytes=9-1")],
        vec![("range", "bytes=0-1"), ("if-range", "\"other\"")],
    ] {
        let reply = app.get_with(&path, &whole).await;
        assert_eq!((reply.status.as_u16(), reply.body.len()), (200, 1000), "{whole:?}");
    }
}

#[test]
fn any_range_is_a_slice_or_a_refusal() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let (app, path) = runtime.block_on(async {
        let (app, model) = app(5000).await;
        (app, format!("{model}/files/model.glb"))
    });
    proptest!(ProptestConfig::with_cases(64), |(first in 0usize..6000, last in 0usize..6000, form in 0..3)| {
        let (range, want) = match form {
            0 if last >= first => (format!("bytes={first}-{last}"), first..(last + 1).min(5000)),
            0 => (format!("bytes={last}-{first}"), last..(first + 1).min(5000)),
            1 => (format!("bytes={first}-"), first..5000),
            _ => (format!("bytes=-{first}"), 5000 - first.min(5000)..5000),
        };
        let reply = runtime.block_on(app.get_with(&path, &[("range", &range)]));
        if want.start < want.end {
            prop_assert_eq!(reply.status, 206);
            prop_assert!(reply.body == content(5000)[want]);
        } else {
            prop_assert_eq!(reply.status, 416);
        }
    });
    runtime.block_on(async { drop(app) });
}

#[tokio::test]
async fn an_empty_file_is_a_file() {
    let app = App::new().await;
    let model = app.finished(1, &[("model.obj", "model/obj", vec![])]).await;
    let path = format!("{model}/files/model.obj");
    assert_eq!(app.get(&path).await.status, 200);
    assert_eq!(app.get_with(&path, &[("range", "bytes=0-")]).await.status, 416);
}

#[tokio::test]
async fn a_name_is_never_a_path() {
    let (app, model) = app(10).await;
    std::fs::write(app.dir.path().join("files/secret"), "secret").unwrap();
    for name in [
        "secret",
        "..%2f..%2f..%2fsecret",
        "%2e%2e%2fsecret",
        "..",
        ".",
        "model.glb%00",
        "MODEL.GLB",
        "model.glb%2f",
        "1%2fmodel.glb",
        "%2fetc%2fpasswd",
        "model.obj",
        " model.glb",
    ] {
        let name = name.replace(' ', "%20");
        let reply = app.get(&format!("{model}/files/{name}")).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (404, "file-not-found"), "{name}");
    }
}

#[tokio::test]
async fn files_come_at_the_end_and_go_with_the_model() {
    let (app, model) = app(10).await;
    let open = app.model(8).await;
    for rest in ["/files/model.glb", "/report", "/sections/0"] {
        let reply = app.get(&format!("{open}{rest}")).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (404, "file-not-found"));
        assert!(reply.json()["detail"].as_str().unwrap().contains("has not ended"));
    }
    assert_eq!(app.delete(&model).await.status, 204);
    assert_eq!(app.get(&format!("{model}/files/model.glb")).await.slug(), "model-not-found");
    let models = app.dir.path().join("files/models");
    let left = || std::fs::read_dir(&models).map_or(0, Iterator::count);
    // The service removes files after it has sent the response.
    for _ in 0..6000 {
        if left() == 0 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(left(), 0, "no file is left behind");
}

#[tokio::test]
async fn a_missing_file_is_a_problem() {
    let (app, model) = app(10).await;
    let job = app.store.get(super::app::id(&model)).await.unwrap().unwrap();
    app.artifacts.delete(&[job.files[0].key.clone()]).await.unwrap();
    assert_eq!(app.get(&format!("{model}/files/{}", job.files[0].name)).await.slug(), "file-not-found");
}

#[tokio::test]
async fn the_report_contains_its_file_and_the_backend() {
    let (app, model) = app(10).await;
    let reply = app.get(&format!("{model}/report")).await;
    assert_eq!((reply.status.as_u16(), reply.header(header::CONTENT_TYPE)), (200, Some("application/json")));
    assert_eq!(reply.json()["certificate"]["passed"], true);
    let told = app.get(&model).await.json();
    for name in ["backend", "digest", "preset", "seed"] {
        assert!(!told[name].is_null());
        assert_eq!(reply.json()[name], told[name], "{name}");
    }
    let file = app.get(&format!("{model}/files/report.json")).await.json();
    assert_eq!(file.get("backend"), None, "the file does not depend on the machine");
    assert_eq!(reply.header(header::CONTENT_DISPOSITION), None);
    let tag = reply.header(header::ETAG).unwrap();
    assert_eq!(app.get_with(&format!("{model}/report"), &[("if-none-match", tag)]).await.status, 304);
}

/// Each download uses a file descriptor of the process while the client reads.
#[tokio::test]
async fn concurrent_downloads_are_limited() {
    let app = App::with(Limits { downloads: 1, ..Limits::default() }, 10).await;
    let model = app.finished(7, &[("model.glb", "model/gltf-binary", content(1 << 20))]).await;
    let path = format!("{model}/files/model.glb");
    app.expect_faults();
    let running = app.start(Request::get(&path).body(Body::empty()).unwrap()).await;
    let refused = app.get(&path).await;
    assert_eq!((refused.status.as_u16(), refused.slug().as_str()), (503, "too-many-downloads"));
    assert!(refused.header(header::RETRY_AFTER).is_some());
    // `HEAD` needs no file descriptor, so the limit does not apply.
    assert_eq!(app.request(Method::HEAD, &path, &[], Body::empty()).await.status, 200);
    drop(running);
    assert!(app.get(&path).await.body == content(1 << 20), "there is room again");
    assert!(app.get(&path).await.body == content(1 << 20), "and after a whole download");
}
