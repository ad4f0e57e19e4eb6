//! Operator requests: pauses, drains, and metrics of the queue and the workers.

use super::app::{App, moment};
use super::faulty::Faulty;
use axum::body::Body;
use axum::http::Method;
use oviduct::clock::Clock;
use oviduct::http::Limits;
use oviduct::jobs::{ClaimScope, WorkerKind};
use serde_json::{Value, json};
use std::time::Duration;

async fn call(app: &App, path: &str) -> Value {
    let reply = app.request(Method::POST, path, &[], Body::empty()).await;
    assert_eq!(reply.status, 200, "{reply:?}");
    reply.json()
}

async fn has_line(app: &App, line: &str) {
    let text = String::from_utf8(app.get("/metrics").await.body.to_vec()).unwrap();
    assert!(text.lines().any(|found| found == line), "{line} in\n{text}");
}

#[tokio::test]
async fn all_workers_are_paused_and_resumed() {
    let app = App::new().await;
    app.worker(WorkerKind::Cpu).await;
    let model = app.model(1).await;
    has_line(&app, "oviduct_claiming_paused 0").await;
    let pause = json!({ "since": moment(&app.clock), "by": null });
    let paused = call(&app, "/workers/pause").await;
    assert_eq!((&paused["pause"], &paused["workers"][0]["state"]), (&pause, &json!("active")));
    has_line(&app, "oviduct_claiming_paused 1").await;
    assert!(app.store.claim("w1", ClaimScope::Cpu, super::app::LEASE, 1).await.unwrap().is_empty());
    // A pause of the workers does not stop the API from accepting models.
    app.model(2).await;
    assert_eq!(app.get("/readyz").await.status, 200);
    // Repeating a request changes nothing.
    app.clock.advance(Duration::from_secs(1));
    assert_eq!(call(&app, "/workers/pause").await["pause"], pause);
    assert_eq!(call(&app, "/workers/resume").await, app.get("/workers").await.json());
    assert_eq!(app.get("/workers").await.json()["pause"], Value::Null);
    assert_eq!(app.claim().await.job().id, super::app::id(&model));
}

#[tokio::test]
async fn a_worker_is_paused_drained_and_resumed_by_its_name() {
    let app = App::new().await;
    app.worker(WorkerKind::Cpu).await;
    app.model(1).await;
    let job = app.claim().await;
    assert_eq!(call(&app, "/workers/w1/pause").await["state"], "paused");
    assert_eq!(call(&app, "/workers/w1/resume").await["state"], "active");
    let drained = call(&app, "/workers/w1/drain").await;
    assert_eq!((&drained["id"], &drained["state"]), (&json!("w1"), &json!("draining")));
    assert_eq!(drained["pause"], json!({ "since": moment(&app.clock), "by": null }));
    assert_eq!(drained, app.get("/workers").await.json()["workers"][0]);
    has_line(&app, "oviduct_workers{backend=\"cpu\",state=\"draining\"} 1").await;
    app.finish(job, &[]).await;
    assert_eq!(app.get("/workers").await.json()["workers"][0]["state"], "drained");
    has_line(&app, "oviduct_workers{backend=\"cpu\",state=\"drained\"} 1").await;
    has_line(&app, "oviduct_workers{backend=\"cpu\",state=\"active\"} 0").await;
    // The path may percent-encode the name of the worker.
    assert_eq!(call(&app, "/workers/%771/resume").await["state"], "active");
    for name in ["w2", "%00", "a%20b", "..%2F..", "*"] {
        for verb in ["pause", "resume", "drain"] {
            let reply = app.request(Method::POST, &format!("/workers/{name}/{verb}"), &[], Body::empty()).await;
            assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (404, "worker-not-found"), "{name} {verb}");
        }
    }
    assert_eq!(app.get("/workers").await.json()["pause"], Value::Null, "no name is that of all workers");
    // A worker is unknown once its heartbeats have been missing for long.
    app.clock.advance(Duration::from_secs(600));
    let reply = app.request(Method::POST, "/workers/w1/drain", &[], Body::empty()).await;
    assert_eq!(reply.slug(), "worker-not-found");
}

#[tokio::test]
async fn metrics_tell_the_age_of_the_queue_the_use_of_connections_and_the_times_of_routes() {
    let app = App::new().await;
    app.worker(WorkerKind::Gpu).await;
    app.model(1).await;
    app.clock.advance(Duration::from_secs(15));
    app.model(2).await;
    for line in [
        "oviduct_oldest_queued_seconds{backend=\"auto\"} 15.0",
        "oviduct_oldest_queued_seconds{backend=\"gpu\"} 0.0",
        "oviduct_workers{backend=\"gpu\",state=\"active\"} 1",
        "oviduct_job_store_up 1",
        "oviduct_database_connections_max{pool=\"writer\"} 1",
        "oviduct_event_streams_max 4096",
        "oviduct_downloads 0",
        "oviduct_http_request_duration_seconds_count{method=\"POST\",route=\"/models\",status=\"2xx\"} 2",
        "oviduct_http_request_duration_seconds_bucket{le=\"+Inf\",method=\"POST\",route=\"/models\",status=\"2xx\"} 2",
    ] {
        has_line(&app, line).await;
    }
    // The GPU worker has missed ten heartbeat intervals, so it does not count as live.
    app.clock.advance(Duration::from_secs(6));
    has_line(&app, "oviduct_workers{backend=\"gpu\",state=\"active\"} 0").await;
    // A response that the client asked to be held is excluded from the latencies.
    let held = app.post_with("/models", &[("prefer", "wait=1")], &json!({ "seed": 3 })).await;
    assert_eq!(held.header("preference-applied"), Some("wait=1"));
    has_line(&app, "oviduct_http_request_duration_seconds_count{method=\"POST\",route=\"/models\",status=\"2xx\"} 2")
        .await;
    has_line(&app, "oviduct_http_requests_total{method=\"POST\",route=\"/models\",status=\"202\"} 3").await;
}

#[tokio::test]
async fn metrics_tell_that_the_job_store_is_away() {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let app = App::over(Faulty::store().await, clock, Limits::default());
    has_line(&app, "oviduct_job_store_up 0").await;
}
