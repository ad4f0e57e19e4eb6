//! Reasons why queued jobs wait, and the refusal of submissions while files cannot be stored.

use super::app::{App, used};
use super::events::Stream;
use axum::body::Body;
use axum::http::{Method, header};
use oviduct::http::Limits;
use oviduct::jobs::{ClaimScope, Status as JobStatus, WorkerCondition, WorkerInfo, WorkerKind};
use oviduct::status::{Condition, Status};
use serde_json::{Value, json};
use std::time::Duration;

/// Records the heartbeat of a worker.
async fn beat(app: &App, id: &str, kind: WorkerKind, condition: Option<WorkerCondition>) {
    let worker = WorkerInfo {
        id: id.into(),
        host: "here".into(),
        kind,
        device: "test".into(),
        jobs: Vec::new(),
        jobs_done: 0,
        heartbeat_at: app.clock.now(),
        pause: None,
        condition,
    };
    app.store.worker_seen(&worker).await.unwrap();
}

/// Waits until the model has this reason. Numbers of workers are up to a second old.
async fn until_reason(app: &App, model: &str, reason: &Value) -> Value {
    for _ in 0..600 {
        let found = app.get(model).await.json();
        if found["queue"]["reason"] == *reason {
            return found;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("{model} never waits for the reason {reason}");
}

/// A fit that the service accepts.
fn fit() -> Value {
    json!({ "targets": [{ "region": "ampulla", "quantity": "folds_on_ring", "value": 30 }], "evaluations": 50 })
}

#[tokio::test]
async fn submissions_are_refused_while_files_cannot_be_stored() {
    let status = Status::default();
    let app = App::new().await.with_status(status.clone());
    app.expect_faults();
    let failed = app.model(1).await;
    let claimed = app.claim().await;
    let problem = oviduct::jobs::Problem {
        kind: "certificate".into(),
        title: "The surface intersects itself".into(),
        detail: "Twice.".into(),
    };
    app.store.fail(claimed, used(), problem).await.unwrap();
    let retry = format!("{failed}/retry");
    let batch = json!({ "seeds": [1, 2] });
    let requests = [("/models", json!({ "seed": 5 })), (&*retry, Value::Null), ("/batches", batch), ("/fits", fit())];
    let send = async |n: usize, key: &str| {
        let (path, body) = &requests[n];
        // A key with another body is a conflict.
        let key = format!("{key}-{n}");
        let headers = [("idempotency-key", &*key)];
        match body {
            Value::Null => app.request(Method::POST, path, &headers, Body::empty()).await,
            body => app.post_with(path, &headers, body).await,
        }
    };
    let model = send(0, "before").await.location();
    for (n, (path, _)) in requests.iter().enumerate() {
        assert_eq!(send(n, "before").await.status, 202, "{path}");
    }
    let queued = app.store.counts().await.unwrap().queued;

    status.set(Condition::Storage, "Files are refused.");
    for (n, (path, _)) in requests.iter().enumerate() {
        let reply = send(n, "now").await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (503, "not-ready"), "{path}");
        let problem = reply.json();
        assert_eq!((&problem["condition"], &problem["detail"]), (&json!("storage"), &json!("Files are refused.")));
        assert!(reply.header(header::RETRY_AFTER).is_some(), "{path}");
        // A repeated request writes nothing.
        let replayed = send(n, "before").await;
        assert_eq!((replayed.status.as_u16(), replayed.header("idempotency-replayed")), (202, Some("true")), "{path}");
    }
    assert_eq!(app.store.counts().await.unwrap().queued, queued, "a refused submission left a record");
    // The problem of an invalid request is permanent, so the service reports it instead.
    assert_eq!(app.post("/models", &json!({ "seed": -1 })).await.status, 422);
    for (path, body) in [("/models/validate", json!({ "seed": 5 })), ("/fits/validate", fit())] {
        assert_eq!(app.post(path, &body).await.status, 200, "{path} writes nothing");
    }
    assert_eq!(app.post(&format!("{model}/cancel"), &json!({})).await.status, 200);
    assert_eq!(app.delete(&model).await.status, 204);

    status.clear(Condition::Storage);
    for n in 0..requests.len() {
        assert_eq!(send(n, "now").await.status, 202);
    }
}

#[tokio::test]
async fn a_queued_model_says_why_it_waits() {
    let app = App::new().await;
    let auto = app.model(1).await;
    let reply = app.get(&auto).await;
    let expected = json!({ "position": 0, "position_is_exact": true, "reason": "no-worker", "wait_seconds": null });
    assert_eq!(reply.json()["queue"], expected);
    let tag = reply.header(header::ETAG).unwrap().to_owned();
    assert_eq!(app.get_with(&auto, &[("if-none-match", &tag)]).await.status, 304);

    // A GPU worker runs jobs of `auto` but not of `cpu`.
    beat(&app, "g", WorkerKind::Gpu, None).await;
    until_reason(&app, &auto, &Value::Null).await;
    let reply = app.get_with(&auto, &[("if-none-match", &tag)]).await;
    assert_eq!(reply.status, 200, "the reason has changed without a new version");
    let cpu = app.post("/models", &json!({ "seed": 2, "backend": "cpu" })).await.location();
    until_reason(&app, &cpu, &json!("no-worker")).await;
    let fit = app.post("/fits", &fit()).await;
    assert_eq!(fit.json()["queue"]["reason"], "no-worker");

    beat(&app, "c", WorkerKind::Cpu, Some(WorkerCondition::Storage)).await;
    until_reason(&app, &cpu, &json!("storage")).await;
    until_reason(&app, &auto, &Value::Null).await;
    let workers = app.get("/workers").await.json()["workers"].clone();
    assert_eq!([&workers[0]["condition"], &workers[1]["condition"]], [&json!("storage"), &Value::Null]);
    beat(&app, "g", WorkerKind::Gpu, Some(WorkerCondition::Storage)).await;
    until_reason(&app, &auto, &json!("storage")).await;
    let listed = app.get("/models").await.json();
    assert_eq!(listed["models"][0]["queue"]["reason"], "storage");

    // Workers that are paused do not start models even if they could store files.
    assert_eq!(app.post("/workers/pause", &json!({})).await.status, 200);
    until_reason(&app, &cpu, &json!("paused")).await;
    assert_eq!(app.post("/workers/resume", &json!({})).await.status, 200);
    assert_eq!(app.post("/workers/c/drain", &json!({})).await.status, 200);
    until_reason(&app, &cpu, &json!("paused")).await;
    until_reason(&app, &auto, &json!("storage")).await;

    // A running model waits for nothing.
    let running = app.store.claim("g", ClaimScope::Gpu, super::app::LEASE, 1).await.unwrap().pop().unwrap();
    assert_eq!(running.job().status, JobStatus::Running);
    let queue = app.get(&auto).await.json()["queue"].clone();
    assert_eq!([&queue["reason"], &queue["position"], &queue["position_is_exact"]], [&Value::Null; 3]);
}

#[tokio::test]
async fn a_model_that_waits_for_an_equal_one_says_so() {
    let app = App::new().await;
    beat(&app, "c", WorkerKind::Cpu, None).await;
    let ask = async || app.post("/models", &json!({ "seed": 3 })).await.json();
    let (first, second) = (ask().await, ask().await);
    assert_eq!((&first["queue"]["reason"], &second["queue"]["reason"]), (&Value::Null, &json!("equal-model")));
    let path = format!("/models/{}", second["id"].as_str().unwrap());
    assert_eq!(app.get(&path).await.json()["queue"]["reason"], "equal-model");
    let first = app.claim().await;
    app.store.cancel(first.job().id).await.unwrap();
    app.store.cancelled(first).await.unwrap();
    assert_eq!(app.get(&path).await.json()["queue"]["reason"], Value::Null, "it is queued itself");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn event_streams_tell_the_reason() {
    let limits = Limits { event_poll: Duration::from_millis(50), ..Limits::default() };
    let app = App::with(limits, 100).await;
    beat(&app, "c", WorkerKind::Cpu, None).await;
    let model = app.model(1).await;
    for path in [format!("{model}/events"), "/events".to_owned()] {
        beat(&app, "c", WorkerKind::Cpu, None).await;
        until_reason(&app, &model, &Value::Null).await;
        let mut stream = Stream::open(&app, &path, None).await;
        let event = stream.next().await.unwrap();
        assert_eq!((&*event.name, &event.data["queue"]["reason"]), ("status", &Value::Null), "{path}");
        // The record of the model does not change, so no change is reported.
        beat(&app, "c", WorkerKind::Cpu, Some(WorkerCondition::Storage)).await;
        let event = stream.next().await.unwrap();
        assert_eq!((&*event.name, &event.data["queue"]["reason"]), ("status", &json!("storage")), "{path}");
    }
}

#[tokio::test]
async fn a_position_that_is_not_counted_to_the_end_is_marked() {
    let app = App::with(Limits::default(), 10_000).await;
    let seeds: Vec<u32> = (0..1000).collect();
    assert_eq!(app.post("/batches", &json!({ "seeds": seeds })).await.status, 202);
    let last = app.model(1000).await;
    let queue = app.get(&last).await.json()["queue"].clone();
    assert_eq!((&queue["position"], &queue["position_is_exact"]), (&json!(1000), &json!(false)));
    app.claim().await;
    let queue = app.get(&last).await.json()["queue"].clone();
    assert_eq!((&queue["position"], &queue["position_is_exact"]), (&json!(999), &json!(true)));
}
