//! The service as a whole: health, readiness, presets, workers, API description, failures.

use super::app::{App, Reply, moment};
use super::faulty::Faulty;
use axum::body::Body;
use axum::http::{Method, header};
use object_store::memory::InMemory;
use object_store::throttle::{ThrottleConfig, ThrottledStore};
use oviduct::clock::Clock;
use oviduct::http::Limits;
use oviduct::jobs::WorkerKind;
use oviduct::jobs::artifacts::Artifacts;
use oviduct::status::{Condition, Status};
use serde_json::json;
use std::sync::Arc;
use std::time::Duration;

#[tokio::test]
async fn a_new_service_is_healthy_and_ready() {
    let app = App::new().await;
    for path in ["/healthz", "/readyz"] {
        let reply = app.get(path).await;
        assert_eq!((reply.status.as_u16(), &reply.json()["status"]), (200, &json!("ok")));
    }
}

#[tokio::test]
async fn a_process_that_is_not_ready_says_why() {
    let status = Status::default();
    let app = App::new().await.with_status(status.clone());
    app.expect_faults();
    for (condition, detail) in [(Condition::Draining, "It shuts down."), (Condition::OpeningDevices, "It opens 1 GPU.")]
    {
        status.set(condition, detail);
        let reply = app.get("/readyz").await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (503, "not-ready"));
        let problem = reply.json();
        assert_eq!(problem["condition"], condition.name());
        assert_eq!(problem["detail"], detail);
        assert!(reply.header(header::RETRY_AFTER).is_some());
        // The service is healthy and serves requests although it is not ready.
        assert_eq!((app.get("/healthz").await.status.as_u16(), app.get("/models").await.status.as_u16()), (200, 200));
    }
    status.clear(Condition::Draining);
    status.clear(Condition::OpeningDevices);
    assert_eq!(app.get("/readyz").await.status, 200);
}

#[tokio::test]
async fn a_process_with_stuck_workers_is_not_healthy() {
    let status = Status::default();
    let app = App::new().await.with_status(status.clone());
    app.expect_faults();
    status.stuck("w1", "worker w1 has not stopped for 300 s");
    let reply = app.get("/healthz").await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (503, "workers-stuck"));
    assert_eq!(reply.json()["workers"], json!(["worker w1 has not stopped for 300 s"]));
    status.unstuck("w1");
    assert_eq!(app.get("/healthz").await.status, 200);
}

/// Returns the first failing readiness probe, within one minute. A slow check ends after the
/// response of the probe that started it.
async fn until_not_ready(app: &App) -> Reply {
    for _ in 0..600 {
        let reply = app.get("/readyz").await;
        if reply.status != 200 {
            return reply;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    panic!("it stays ready");
}

#[tokio::test]
async fn an_artifact_store_that_takes_no_files_is_named() {
    let app = App::new().await;
    app.expect_faults();
    // A file replaces the artifact folder. Nothing can be written below a file, even by root.
    let files = app.dir.path().join("files");
    std::fs::remove_dir_all(&files).unwrap();
    std::fs::write(&files, "").unwrap();
    let reply = until_not_ready(&app).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (503, "storage-unavailable"));
    let detail = reply.json()["detail"].as_str().unwrap().to_owned();
    assert!(detail.contains("artifact store") && !detail.contains("job store"), "{detail}");
    assert!(!detail.contains(files.to_str().unwrap()), "{detail}");
}

/// A hanging write fails its check after five seconds. Until then probes report the previous
/// result.
#[tokio::test]
async fn probes_do_not_wait_for_an_artifact_store_that_hangs() {
    let throttle = ThrottleConfig { wait_put_per_call: Duration::from_secs(3600), ..ThrottleConfig::default() };
    let store = ThrottledStore::new(InMemory::new(), throttle);
    let app = App::new().await.with_artifacts(Artifacts::over(Arc::new(store)));
    app.expect_faults();
    assert_eq!(app.get("/readyz").await.status, 200);
    let reply = until_not_ready(&app).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (503, "storage-unavailable"));
}

/// A hanging read fails its check after five seconds. Until then probes report the previous result.
#[tokio::test]
async fn probes_do_not_wait_for_a_job_store_that_hangs() {
    let app = App::over(Faulty::hanging_store().await, Clock::System, Limits::default());
    app.expect_faults();
    let reply = tokio::time::timeout(Duration::from_secs(2), app.get("/readyz")).await;
    assert_eq!(reply.expect("a probe that does not wait for the check").status, 200);
    let reply = until_not_ready(&app).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (503, "store-unavailable"));
}

#[tokio::test]
async fn an_unavailable_store_is_a_problem_without_secrets() {
    let app = App::over(Faulty::store().await, Clock::System, Limits::default());
    app.expect_faults();
    assert_eq!(app.get("/healthz").await.status, 200);
    let model = format!("/models/{}", uuid::Uuid::now_v7());
    let events = format!("{model}/events");
    let file = format!("{model}/files/model.glb");
    for path in ["/readyz", "/workers", &model, &events, &file] {
        let reply = app.get(path).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (503, "store-unavailable"), "{path}");
        assert!(reply.header(header::RETRY_AFTER).is_some());
        assert!(!String::from_utf8_lossy(&reply.body).contains("secret"));
    }
    assert_eq!(app.post("/models", &json!({})).await.status, 503);
    assert_eq!(app.delete(&model).await.status, 503);
}

#[tokio::test]
async fn a_panic_is_a_problem_and_the_service_keeps_running() {
    let app = App::over(Faulty::store().await, Clock::System, Limits::default());
    app.expect_faults();
    let reply = app.get_with("/models", &[("x-request-id", "find-me")]).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (500, "internal"));
    assert_eq!(reply.json()["request_id"], "find-me");
    assert!(!String::from_utf8_lossy(&reply.body).contains("secret"));
    assert_eq!(app.get("/healthz").await.status, 200);
}

#[tokio::test]
async fn presets_are_complete_and_valid() {
    let app = App::new().await;
    let list = app.get("/presets").await.json();
    let names: Vec<_> = list["presets"].as_array().unwrap().iter().map(|p| p["name"].as_str().unwrap()).collect();
    assert_eq!(
        names,
        [
            "pig",
            "human",
            "cow",
            "pig-luteal",
            "cow-luteal",
            "mouse",
            "utero-tubal-junction",
            "infundibulum",
            "ureter",
            "oesophagus",
            "small-intestine",
            "colon",
            "paper"
        ]
    );
    for name in names {
        let whole = app.post("/models/validate", &json!({ "preset": name })).await.json()["spec"].clone();
        let preset = app.get(&format!("/presets/{name}")).await.json();
        assert!(preset["spec"]["length_mm"].is_number());
        assert!(
            preset["parameters"]
                .as_array()
                .unwrap()
                .iter()
                .all(|p| p["source"].as_str().is_some_and(|s| !s.is_empty()))
        );
        let body = json!({ "preset": name, "spec": preset["spec"] });
        assert_eq!(app.post("/models/validate", &body).await.json()["spec"], whole, "{name} changes nothing of itself");
    }
    let reply = app.get("/presets/dragon").await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (404, "preset-not-found"));
}

#[tokio::test]
async fn the_schema_is_a_schema() {
    let app = App::new().await;
    let reply = app.get("/schema").await;
    assert_eq!(reply.header(header::CONTENT_TYPE), Some("application/schema+json"));
    let validator = jsonschema::validator_for(&reply.json()).unwrap();
    for preset in oviduct::spec::presets() {
        assert!(
            validator.is_valid(&app.get(&format!("/presets/{}", preset.name)).await.json()["spec"]),
            "{}",
            preset.name
        );
    }
    assert!(!validator.is_valid(&json!({ "lenght_mm": 3 })));
}

#[tokio::test]
async fn workers_are_listed() {
    let app = App::new().await;
    assert_eq!(app.get("/workers").await.json(), json!({ "pause": null, "workers": [] }));
    app.worker(WorkerKind::Cpu).await;
    let want = json!({ "pause": null, "workers": [{
        "id": "w1", "host": "here", "backend": "cpu", "device": "test", "job": null, "jobs": [],
        "jobs_done": 3, "heartbeat_at": moment(&app.clock), "state": "active", "pause": null,
        "condition": null }] });
    assert_eq!(app.get("/workers").await.json(), want);
    // The worker lists all of its running jobs, oldest first.
    let (old, new) = (app.model(1).await, app.model(2).await);
    let running = [app.claim().await, app.claim().await];
    let worker = app.get("/workers").await.json()["workers"][0].clone();
    let ids = [&old, &new].map(|model| model.strip_prefix("/models/").unwrap());
    assert_eq!((&worker["job"], &worker["jobs"]), (&json!(ids[0]), &json!(ids)));
    for job in running {
        app.store.release(job, None).await.unwrap();
    }
    assert_eq!(app.get("/workers").await.json(), want);
}

#[tokio::test]
async fn the_description_is_served() {
    let app = App::new().await;
    let reply = app.get("/openapi.yaml").await;
    assert_eq!(reply.header(header::CONTENT_TYPE), Some("application/yaml"));
    assert!(reply.body == oviduct::http::openapi_yaml());
}

/// Responses and accepted requests match the schemas in `openapi.yaml`.
#[tokio::test]
async fn responses_are_as_described() {
    let app = App::new().await;
    let document: serde_json::Value = yaml_serde::from_slice(&app.get("/openapi.yaml").await.body).unwrap();
    let fits = |name: &str, value: &serde_json::Value| {
        let schema = json!({ "$ref": format!("#/components/schemas/{name}"), "components": document["components"] });
        let validator = jsonschema::validator_for(&schema).unwrap();
        let faults: Vec<_> = validator.iter_errors(value).map(|e| format!("{}: {e}", e.instance_path())).collect();
        assert!(faults.is_empty(), "{name}: {faults:?} in {value}");
    };
    let request = json!({ "preset": "pig", "seed": 62.0, "spec": { "length_mm": null, "collision": { "gap_um": 30 } },
        "outputs": ["glb", "obj"], "backend": "auto", "labels": { "study": "A3" }, "reuse": false });
    fits("ModelRequest", &request);
    let accepted = app.post("/models", &request).await;
    assert_eq!(accepted.status, 202);
    fits("Model", &accepted.json());
    let job = app.claim().await;
    app.beat(&job, 10, None).await;
    fits("Model", &app.get("/models").await.json()["models"][0]);
    app.finish(job, &[("model.glb", "model/gltf-binary", vec![1])]).await;
    fits("ModelList", &app.get("/models").await.json());
    fits("Validation", &app.post("/models/validate", &request).await.json());
    fits("Problem", &app.get("/nowhere").await.json());
    fits("Problem", &app.post("/models", &json!({ "seed": -1 })).await.json());
    fits("PresetList", &app.get("/presets").await.json());
    for preset in oviduct::spec::presets() {
        fits("Preset", &app.get(&format!("/presets/{}", preset.name)).await.json());
    }
    fits("JsonSchema", &app.get("/schema").await.json());
    fits("WorkerList", &app.get("/workers").await.json());
    fits("Health", &app.get("/healthz").await.json());
}

#[tokio::test]
async fn the_console_and_its_files_are_served() {
    let app = App::new().await;
    let reply = app.get("/").await;
    assert_eq!(reply.status, 200);
    assert!(reply.header(header::CONTENT_TYPE).unwrap().starts_with("text/html"));
    let policy = reply.header(header::CONTENT_SECURITY_POLICY).unwrap();
    let strict = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' blob:; \
                  connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
    assert_eq!(policy, strict);
    assert_eq!(reply.header(header::CACHE_CONTROL), Some("no-cache"));
    let page = String::from_utf8(reply.body.to_vec()).unwrap();
    let mut files = 0;
    for link in page.split(['"', '\'']).filter_map(|text| text.strip_prefix("./")) {
        let file = app.get(&format!("/{link}")).await;
        assert_eq!(file.status, 200, "{link}");
        let kind = file.header(header::CONTENT_TYPE).unwrap();
        let (_, extension) = link.rsplit_once('.').unwrap();
        let wanted = [("js", "text/javascript"), ("css", "text/css"), ("svg", "image/svg+xml")];
        assert!(wanted.contains(&(extension, kind)), "{link} is {kind}");
        let forever = file.header(header::CACHE_CONTROL).unwrap().contains("immutable");
        assert_eq!(forever, link.starts_with("assets/"), "{link}");
        let tag = file.header(header::ETAG).unwrap();
        let again = app.get_with(&format!("/{link}"), &[("if-none-match", tag)]).await;
        assert_eq!((again.status.as_u16(), again.body.len()), (304, 0), "{link}");
        files += 1;
    }
    assert!(files >= 3, "{page}");
    assert_eq!(app.get("/assets/missing.js").await.status, 404);
    assert_eq!(app.post("/", &json!({})).await.status, 405);
}

#[tokio::test]
async fn the_description_is_also_a_page() {
    let app = App::new().await;
    let reply = app.get("/docs").await;
    assert!(reply.header(header::CONTENT_TYPE).unwrap().starts_with("text/html"));
    assert!(reply.header(header::CONTENT_SECURITY_POLICY).unwrap().starts_with("default-src 'none'"));
    assert!(String::from_utf8(reply.body.to_vec()).unwrap().contains("POST /models"));
}

#[tokio::test]
async fn head_and_options_are_supported() {
    let app = App::new().await;
    let head = app.request(Method::HEAD, "/models", &[], Body::empty()).await;
    assert_eq!((head.status.as_u16(), head.body.len()), (200, 0));
    let missing = app.request(Method::HEAD, "/nowhere", &[], Body::empty()).await;
    assert_eq!((missing.status.as_u16(), missing.body.len()), (404, 0));
    let options = app.request(Method::OPTIONS, "/models", &[], Body::empty()).await;
    assert_eq!((options.status.as_u16(), options.header(header::ALLOW)), (204, Some("GET,HEAD,POST,DELETE,OPTIONS")));
    assert_eq!(app.request(Method::OPTIONS, "/nowhere", &[], Body::empty()).await.status, 404);
}
