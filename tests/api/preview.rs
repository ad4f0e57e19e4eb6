//! Preview pictures of models.

use super::app::App;
use super::sections::stored;
use axum::body::Body;
use axum::http::{Method, header};
use oviduct::export::sections_bin::MEDIA_TYPE;
use oviduct::http::Limits;
use std::time::Duration;
use tiny_skia::Pixmap;

async fn model(app: &App) -> String {
    app.finished(7, &[("sections.bin", MEDIA_TYPE, stored(3))]).await
}

async fn metrics(app: &App) -> String {
    String::from_utf8(app.get("/metrics").await.body.to_vec()).unwrap()
}

#[tokio::test]
async fn a_picture_has_the_size_and_view_that_are_asked_for() {
    let app = App::new().await;
    let path = format!("{}/preview.png", model(&app).await);
    let mut seen = Vec::new();
    for (query, size) in [
        ("", (1024, 683)),
        ("?view=opened&size=96", (96, 64)),
        ("?view=whole&size=96", (96, 64)),
        ("?view=isthmus&size=96", (96, 96)),
        ("?view=ampulla&size=96", (96, 96)),
    ] {
        let reply = app.get(&format!("{path}{query}")).await;
        assert_eq!((reply.status.as_u16(), reply.header(header::CONTENT_TYPE)), (200, Some("image/png")), "{query}");
        let picture = Pixmap::decode_png(&reply.body).unwrap();
        assert_eq!((picture.width(), picture.height()), size, "{query}");
        let alpha = |p: &tiny_skia::PremultipliedColorU8| p.alpha();
        assert!(picture.pixels().iter().any(|p| alpha(p) == 255) && picture.pixels().iter().any(|p| alpha(p) == 0));
        assert!(!seen.contains(&reply.body), "{query}");
        seen.push(reply.body);
    }
    assert_eq!(app.get(&format!("{path}?size=1024&view=opened")).await.body, seen[0], "these are the defaults");
}

#[tokio::test]
async fn a_picture_is_kept_by_the_service_and_by_clients() {
    let app = App::new().await;
    let path = format!("{}/preview.png?size=64", model(&app).await);
    let first = app.get(&path).await;
    let tag = first.header(header::ETAG).unwrap();
    assert!(tag.starts_with('"') && first.header(header::CACHE_CONTROL).unwrap() == "private, max-age=86400");
    assert_eq!(app.get(&path).await.body, first.body);
    let metrics = metrics(&app).await;
    for line in [
        "oviduct_pictures_total{result=\"drawn\"} 1",
        "oviduct_pictures_total{result=\"kept\"} 1",
        "oviduct_picture_seconds_count 1",
    ] {
        assert!(metrics.contains(line), "{line}");
    }
    let again = app.get_with(&path, &[("if-none-match", tag)]).await;
    assert_eq!((again.status.as_u16(), again.body.len(), again.header(header::ETAG)), (304, 0, Some(tag)));
    for other in ["view=whole&size=64", "size=65"] {
        let path = path.replace("size=64", other);
        assert_eq!(app.get_with(&path, &[("if-none-match", tag)]).await.status, 200, "{other}");
    }
    let head = app.request(Method::HEAD, &path, &[], Body::empty()).await;
    assert_eq!((head.status.as_u16(), head.body.len(), head.header(header::ETAG)), (200, 0, Some(tag)));
    assert_eq!(head.header(header::CONTENT_LENGTH).unwrap(), first.body.len().to_string());
    // Another service draws the same picture.
    let other = App::new().await;
    let path = format!("{}/preview.png?size=64", model(&other).await);
    assert_eq!(other.get(&path).await.body, first.body);
}

#[tokio::test]
async fn each_wrong_parameter_is_named() {
    let app = App::new().await;
    let path = format!("{}/preview.png", model(&app).await);
    let reply = app.get(&format!("{path}?view=inside&size=31&colour=red")).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (422, "invalid-request"));
    assert_eq!(reply.places(), ["colour", "view", "size"]);
    for wrong in ["size=2049", "size=", "size=64.0", "size=-64", "view=", "view=Whole", "size=64&size=64"] {
        assert_eq!(app.get(&format!("{path}?{wrong}")).await.places().len(), 1, "{wrong}");
    }
}

#[tokio::test]
async fn only_models_that_have_succeeded_have_pictures() {
    let app = App::new().await;
    let open = app.model(8).await;
    let reply = app.get(&format!("{open}/preview.png")).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (404, "file-not-found"));
    assert!(reply.json()["detail"].as_str().unwrap().contains("has not ended"));
    let unknown = app.get("/models/00000000-0000-7000-8000-000000000000/preview.png").await;
    assert_eq!(unknown.slug(), "model-not-found");
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_wait_for_a_drawing_permit_for_a_limited_time() {
    let wait = Duration::from_secs(60);
    let app = App::with(Limits { pictures: 1, picture_wait: wait, ..Limits::default() }, 10).await;
    let path = format!("{}/preview.png", model(&app).await);
    let paths = [32, 33, 34, 35].map(|size| format!("{path}?size={size}"));
    let replies = futures_util::future::join_all(paths.iter().map(|path| app.get(path))).await;
    assert!(replies.iter().all(|reply| reply.status == 200));

    let wait = Duration::from_millis(20);
    let full = App::with(Limits { pictures: 0, picture_wait: wait, ..Limits::default() }, 10).await;
    full.expect_faults();
    let path = format!("{}/preview.png", model(&full).await);
    let refused = full.get(&path).await;
    assert_eq!((refused.status.as_u16(), refused.slug().as_str()), (503, "too-many-pictures"));
    assert!(refused.header(header::RETRY_AFTER).is_some());
    assert!(metrics(&full).await.contains("oviduct_pictures_total{result=\"refused\"} 1"));
}

#[tokio::test]
async fn damaged_sections_are_an_internal_problem() {
    let app = App::new().await;
    app.expect_faults();
    let mut damaged = stored(3);
    let middle = damaged.len() / 3;
    damaged[middle] ^= 0xff;
    for (seed, bytes) in [(1, stored(1)), (2, damaged), (3, Vec::new())] {
        let model = app.finished(seed, &[("sections.bin", MEDIA_TYPE, bytes)]).await;
        assert_eq!(app.get(&format!("{model}/preview.png?size=32")).await.slug(), "internal", "{seed}");
    }
    // The failed drawings released their permits.
    assert_eq!(app.get(&format!("{}/preview.png?size=32", model(&app).await)).await.status, 200);
}
