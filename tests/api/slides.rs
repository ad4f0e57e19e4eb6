//! Sections as stained pictures and as images of tissue labels.

use super::app::App;
use super::sections::stored;
use axum::body::Body;
use axum::http::{Method, header};
use oviduct::export::sections_bin::MEDIA_TYPE;
use serde_json::json;
use std::collections::BTreeSet;
use std::io::Cursor;

const UM_PER_PIXEL: &str = "um-per-pixel";

async fn app() -> (App, String) {
    let app = App::new().await;
    let model = app.finished(7, &[("sections.bin", MEDIA_TYPE, stored(3))]).await;
    (app, format!("{model}/sections/2"))
}

/// Width, height, number of channels and pixels of a PNG file.
fn decoded(png: &[u8]) -> (u32, u32, usize, Vec<u8>) {
    let mut reader = png::Decoder::new(Cursor::new(png)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    (info.width, info.height, info.color_type.samples(), pixels)
}

#[tokio::test]
async fn a_section_is_stained_and_labelled_on_the_same_pixels() {
    let (app, path) = app().await;
    let stained = app.get(&format!("{path}?format=png&size=320")).await;
    assert_eq!((stained.status.as_u16(), stained.header(header::CONTENT_TYPE)), (200, Some("image/png")));
    assert_eq!(stained.header(header::VARY), Some("accept"));
    assert_eq!(stained.header(header::CACHE_CONTROL), Some("private, max-age=86400"));
    let labels = app.get(&format!("{path}?labels=true&size=320")).await;
    let scale = |reply: &super::app::Reply| {
        let value = reply.headers.get(UM_PER_PIXEL).unwrap();
        value.to_str().unwrap().parse::<f64>().unwrap()
    };
    // The ring is 201 µm wide and has a margin of 5 % on each side.
    assert!((scale(&stained) - 201.0 * 1.1 / 320.0).abs() < 1e-3, "{}", scale(&stained));
    assert_eq!(scale(&stained), scale(&labels));
    let (width, height, channels, _) = decoded(&stained.body);
    let (label_width, label_height, label_channels, values) = decoded(&labels.body);
    assert_eq!((width.max(height), channels), (320, 3));
    assert_eq!((label_width, label_height, label_channels), (width, height, 1));
    let found: BTreeSet<u8> = values.iter().copied().collect();
    assert!(found.is_superset(&BTreeSet::from([0, 1, 2])) && found.iter().all(|value| *value < 10), "{found:?}");
    // `Accept` selects the same picture; the default is stained.
    let accepted = app.get_with(&format!("{path}?size=320"), &[("accept", "image/png")]).await;
    assert_eq!(accepted.body, stained.body);
    assert_eq!(app.get(&format!("{path}?format=png&stain=he&labels=false&size=320")).await.body, stained.body);
    assert_ne!(app.get(&format!("{}?format=png&size=320", path.replace("/2", "/1"))).await.body, stained.body);
}

#[tokio::test]
async fn pictures_of_sections_are_kept_like_previews() {
    let (app, path) = app().await;
    let path = format!("{path}?format=png&size=64");
    let first = app.get(&path).await;
    let tag = first.header(header::ETAG).unwrap();
    assert_eq!(app.get(&path).await.body, first.body);
    let metrics = String::from_utf8(app.get("/metrics").await.body.to_vec()).unwrap();
    for line in ["oviduct_pictures_total{result=\"drawn\"} 1", "oviduct_pictures_total{result=\"kept\"} 1"] {
        assert!(metrics.contains(line), "{line}");
    }
    let again = app.get_with(&path, &[("if-none-match", tag)]).await;
    assert_eq!((again.status.as_u16(), again.body.len()), (304, 0));
    for other in ["format=png&size=65", "labels=true&size=64", "format=svg"] {
        let path = path.replace("format=png&size=64", other);
        assert_eq!(app.get_with(&path, &[("if-none-match", tag)]).await.status, 200, "{other}");
    }
    let head = app.request(Method::HEAD, &path, &[], Body::empty()).await;
    assert_eq!((head.status.as_u16(), head.body.len()), (200, 0));
    assert_eq!(head.headers.get(UM_PER_PIXEL), first.headers.get(UM_PER_PIXEL));
}

#[tokio::test]
async fn wrong_parameters_of_pictures_are_named() {
    let (app, path) = app().await;
    for (query, names) in [
        ("format=png&size=31", vec!["size"]),
        ("format=png&size=2049", vec!["size"]),
        ("format=png&size=x&stain=pas&labels=1", vec!["labels", "stain", "size"]),
        ("stain=he&labels=true", vec!["stain"]),
        ("format=svg&size=100", vec!["size"]),
        ("format=json&labels=true", vec!["labels"]),
        ("labels=true&labels=true", vec!["labels"]),
        ("format=png&view=whole", vec!["view"]),
    ] {
        let reply = app.get(&format!("{path}?{query}")).await;
        assert_eq!(reply.status, 422, "{query}");
        assert_eq!(reply.places(), names, "{query}");
    }
    let json_only = app.get_with(&format!("{path}?labels=true"), &[("accept", "application/json")]).await;
    assert_eq!((json_only.status.as_u16(), json_only.slug().as_str()), (406, "not-acceptable"));
    let missing = app.get(&format!("{}?format=png", path.replace("/2", "/3"))).await;
    assert_eq!((missing.status.as_u16(), missing.slug().as_str()), (404, "section-not-found"));
}

#[tokio::test]
async fn a_label_volume_over_the_limits_is_refused_before_it_is_queued() {
    let app = App::new().await;
    let body = json!({ "outputs": ["labels"], "spec": { "labels": { "voxel_um": 1, "slice_um": 5 } } });
    let reply = app.post("/models", &body).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (422, "cost-limit"));
    assert!(reply.json()["detail"].as_str().unwrap().contains("/labels/voxel_um"), "{reply:?}");
    let body = json!({ "outputs": ["labels"], "spec": { "labels": { "from": 0.5, "to": 0.4, "voxel_um": 0 } } });
    assert_eq!(app.post("/models", &body).await.places(), ["/spec/labels/to", "/spec/labels/voxel_um"]);
    let reply = app.post("/models/validate", &json!({ "outputs": ["labels"] })).await;
    assert!(reply.json()["cost"]["bytes"]["labels"].as_u64().unwrap() > 1_000_000, "{reply:?}");
    assert_eq!(app.get("/models").await.json()["models"], json!([]));
}

#[tokio::test]
async fn the_layers_follow_the_spec() {
    let app = App::new().await;
    let epithelium = async |um: f64| {
        let body = json!({ "seed": 7, "reuse": false, "spec": { "histology": { "epithelium_um": um } } });
        assert_eq!(app.post("/models", &body).await.status, 202);
        let job = app.claim().await;
        let id = job.job().id;
        app.finish(job, &[("sections.bin", MEDIA_TYPE, stored(3))]).await;
        let reply = app.get(&format!("/models/{id}/sections/0?labels=true&size=200")).await;
        decoded(&reply.body).3.iter().filter(|value| **value == 2).count()
    };
    let (thin, thick) = (epithelium(3.0).await, epithelium(9.0).await);
    assert!(thin > 100 && thick > 2 * thin, "{thin}, {thick}");
}
