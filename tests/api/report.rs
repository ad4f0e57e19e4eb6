//! The HTML page of a model's report.

use super::app::App;
use super::sections;
use axum::http::header;
use oviduct::export::sections_bin::MEDIA_TYPE;
use serde_json::json;

/// A `report.json` of an older version, without morphometry.
pub(super) fn stored() -> Vec<u8> {
    let spec = oviduct::spec::ModelSpec::resolve(oviduct::spec::preset("pig").unwrap(), &json!({})).unwrap();
    let report = json!({
        "digest": "d1gest", "preset": "pig", "seed": 7, "engine": "0.1.0", "spec": spec.to_json(),
        "summary": { "sections": 3 }, "certificate": { "passed": true, "closed": true },
    });
    serde_json::to_vec(&report).unwrap()
}

#[tokio::test]
async fn the_report_page_loads_no_resources_and_is_cached() {
    let app = App::new().await;
    let files = [("report.json", "application/json", stored()), ("sections.bin", MEDIA_TYPE, sections::stored(3))];
    let path = format!("{}/report.html", app.finished(7, &files).await);
    let page = app.get(&path).await;
    assert_eq!((page.status.as_u16(), page.header(header::CONTENT_TYPE)), (200, Some("text/html; charset=utf-8")));
    assert!(page.header(header::CONTENT_SECURITY_POLICY).unwrap().starts_with("default-src 'none'"));
    let html = String::from_utf8(page.body.to_vec()).unwrap();
    assert!(html.contains("Pig oviduct, seed 7") && html.contains("d1gest"));
    let tag = page.header(header::ETAG).unwrap();
    assert_eq!(app.get_with(&path, &[("if-none-match", tag)]).await.status, 304);
    assert_eq!(app.get(&path).await.body, page.body);
}

#[tokio::test]
async fn a_model_without_a_report_has_no_report_page() {
    let app = App::new().await;
    let path = app.finished(7, &[("sections.bin", MEDIA_TYPE, sections::stored(3))]).await;
    let missing = app.get(&format!("{path}/report.html")).await;
    assert_eq!(missing.status, 404);
    assert_eq!(app.get("/models/0197a000-0000-7000-8000-000000000000/report.html").await.status, 404);
}

#[tokio::test]
async fn a_manifest_says_what_the_files_are_and_where_they_come_from() {
    let app = App::new().await;
    let files = [
        ("model.glb", "model/gltf-binary", b"glb".to_vec()),
        ("lumen.stl", "model/stl", b"stl".to_vec()),
        ("report.json", "application/json", stored()),
        ("sections.bin", MEDIA_TYPE, sections::stored(3)),
    ];
    let path = app.finished(7, &files).await;
    let reply = app.get(&format!("{path}/manifest.json")).await;
    assert_eq!((reply.status.as_u16(), reply.header(header::CONTENT_TYPE)), (200, Some("application/json")));
    let model = app.get(&path).await.json();
    let manifest = reply.json();
    for member in ["preset", "seed", "digest", "spec"] {
        assert_eq!(manifest[member], model[member], "{member}");
    }
    assert_eq!(manifest["licence"]["software"], "MIT OR Apache-2.0");
    assert!(manifest["cite"].as_str().unwrap().contains("Burkitt"));
    let listed = manifest["files"].as_array().unwrap();
    for (file, of_model) in listed.iter().zip(model["files"].as_array().unwrap()) {
        for member in ["name", "media_type", "bytes", "sha256"] {
            assert_eq!(file[member], of_model[member], "{member}");
        }
    }
    let kinds: Vec<_> = listed.iter().map(|file| (&file["body"], &file["unit"])).collect();
    let (none, tissue, lumen) = (json!(null), json!("tissue"), json!("lumen"));
    let expected = [(&tissue, &json!("m")), (&lumen, &json!("mm")), (&none, &none), (&none, &none)];
    assert_eq!(kinds, expected);
    assert_eq!(listed[1]["patches"], json!(["wall", "inlet", "outlet"]));
    let tag = reply.header(header::ETAG).unwrap();
    assert_eq!(app.get_with(&format!("{path}/manifest.json"), &[("if-none-match", tag)]).await.status, 304);
}

#[tokio::test]
async fn what_is_not_finished_has_no_manifest() {
    let app = App::new().await;
    let queued = app.post("/models", &json!({ "seed": 7 })).await.json();
    let reply = app.get(&format!("/models/{}/manifest.json", queued["id"].as_str().unwrap())).await;
    assert_eq!(reply.status, 404);
}
