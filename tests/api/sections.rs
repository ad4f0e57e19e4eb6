//! Cross sections as JSON and as drawings.

use super::app::App;
use axum::http::header;
use oviduct::export::Metadata;
use oviduct::export::sections_bin::{MEDIA_TYPE, write_sections};
use oviduct::model::{Ring, Section};
use serde_json::json;

fn section(k: u16) -> Section {
    let ring = |radius: f32, first: u32| Ring {
        ids: vec![first, first + 2, first + 1],
        points: vec![[radius, 0.0], [-radius, radius], [-radius, -radius + f32::from(k)]],
    };
    Section {
        step: f64::from(k) * 10.0,
        z_um: f64::from(k) * 300.5,
        added: k == 1,
        inner: ring(50.25, 0),
        outer: ring(100.5, 10),
    }
}

pub(super) fn stored(count: u16) -> Vec<u8> {
    let sections: Vec<_> = (0..count).map(section).collect();
    let metadata = Metadata {
        preset: "pig".into(),
        seed: 7,
        digest: "0".repeat(64),
        engine: "0.1.0".into(),
        length_mm: 60.0,
        sections: usize::from(count),
    };
    let mut bytes = Vec::new();
    write_sections(&sections, &metadata, &mut bytes).unwrap();
    bytes
}

async fn app() -> (App, String) {
    let app = App::new().await;
    let model = app.finished(7, &[("sections.bin", MEDIA_TYPE, stored(3))]).await;
    (app, model)
}

#[tokio::test]
async fn a_section_is_json_by_default() {
    let (app, model) = app().await;
    for k in 0..3 {
        let reply = app.get(&format!("{model}/sections/{k}")).await;
        assert_eq!((reply.status.as_u16(), reply.header(header::CONTENT_TYPE)), (200, Some("application/json")));
        let want = section(k);
        let ring = |ring: &Ring| json!({ "ids": ring.ids, "points": ring.points });
        let id = model.strip_prefix("/models/").unwrap();
        assert_eq!(
            reply.json(),
            json!({ "model": id, "index": k, "count": 3, "units": "um", "step": want.step, "z_um": want.z_um,
                "added": want.added, "inner": ring(&want.inner), "outer": ring(&want.outer) })
        );
    }
}

#[tokio::test]
async fn a_section_is_drawn_on_request() {
    let (app, model) = app().await;
    let path = format!("{model}/sections/1");
    let by_query = app.get(&format!("{path}?format=svg")).await;
    let by_header = app.get_with(&path, &[("accept", "image/svg+xml,*/*;q=0.5")]).await;
    assert_eq!(by_query.header(header::CONTENT_TYPE), Some("image/svg+xml"));
    assert!(std::str::from_utf8(&by_query.body).unwrap().contains("<svg"));
    assert_eq!(by_query.body, by_header.body);
    assert_eq!(by_header.header(header::VARY), Some("accept"));
    let by_json = app.get_with(&format!("{path}?format=json"), &[("accept", "image/svg+xml")]).await;
    assert_eq!(by_json.json()["index"], 1);
    let refused = app.get_with(&path, &[("accept", "text/html")]).await;
    assert_eq!((refused.status.as_u16(), refused.slug().as_str()), (406, "not-acceptable"));
    for (query, name) in [("format=gif", "format"), ("fromat=svg", "fromat")] {
        assert_eq!(app.get(&format!("{path}?{query}")).await.places(), [name]);
    }
}

#[tokio::test]
async fn a_section_never_changes() {
    let (app, model) = app().await;
    let path = format!("{model}/sections/1");
    let reply = app.get(&path).await;
    let tag = reply.header(header::ETAG).unwrap();
    assert!(reply.header(header::CACHE_CONTROL).unwrap().contains("immutable"));
    assert_eq!(app.get_with(&path, &[("if-none-match", tag)]).await.status, 304);
    assert_eq!(app.get_with(&format!("{path}?format=svg"), &[("if-none-match", tag)]).await.status, 200);
    assert_eq!(app.get_with(&format!("{model}/sections/2"), &[("if-none-match", tag)]).await.status, 200);
}

#[tokio::test]
async fn a_missing_section_is_a_problem() {
    let (app, model) = app().await;
    for k in ["3", "99999999999999999999999", "-1", "1.0", "one", "%00"] {
        let reply = app.get(&format!("{model}/sections/{k}")).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (404, "section-not-found"), "{k}");
    }
}

#[tokio::test]
async fn a_damaged_file_is_an_internal_problem_and_the_service_keeps_running() {
    let app = App::new().await;
    app.expect_faults();
    let mut bytes = stored(3);
    let middle = bytes.len() / 3;
    bytes[middle] ^= 0xff;
    for (seed, bytes) in [(1, vec![]), (2, vec![0; 10]), (3, vec![0; 500]), (4, bytes[..bytes.len() - 1].to_vec())] {
        let model = app.finished(seed, &[("sections.bin", MEDIA_TYPE, bytes)]).await;
        assert_eq!(app.get(&format!("{model}/sections/0")).await.slug(), "internal", "{seed}");
    }
    assert_eq!(app.get("/healthz").await.status, 200);
}
