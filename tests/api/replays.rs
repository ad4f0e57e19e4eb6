//! Replays of idempotency keys: an accepted request keeps its response, whatever has changed since.

use super::app::{App, id};
use axum::http::header;
use oviduct::clock::Clock;
use oviduct::http::Limits;
use oviduct::jobs::{Store, StoreOptions, WorkerKind};
use serde_json::json;
use std::time::Duration;

const KEY: [(&str, &str); 1] = [("idempotency-key", "k")];

#[tokio::test]
async fn a_replay_succeeds_after_the_gpu_worker_has_gone() {
    let app = App::new().await;
    let model = json!({ "backend": "gpu" });
    let batch = json!({ "backend": "gpu", "count": 2 });
    app.worker(WorkerKind::Gpu).await;
    let taken = [app.post_with("/models", &KEY, &model).await, app.post_with("/batches", &KEY, &batch).await];
    app.clock.advance(Duration::from_secs(360));
    assert_eq!(app.post("/models", &model).await.slug(), "gpu-unavailable");
    let again = [app.post_with("/models", &KEY, &model).await, app.post_with("/batches", &KEY, &batch).await];
    for (taken, again) in taken.into_iter().zip(again) {
        assert_eq!((again.status.as_u16(), again.header("idempotency-replayed")), (202, Some("true")));
        assert_eq!((again.json(), again.header(header::LOCATION)), (taken.json(), taken.header(header::LOCATION)));
    }
    // A different body under the same key is a new request and is refused.
    let other = app.post_with("/models", &KEY, &json!({ "backend": "gpu", "seed": 1 })).await;
    assert_eq!(other.slug(), "gpu-unavailable");
    let other = app.post_with("/models", &KEY, &json!({ "seed": 1 })).await;
    assert_eq!(other.slug(), "idempotency-key-reused");
}

#[tokio::test]
async fn a_replay_succeeds_after_a_limit_was_lowered() {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let options = StoreOptions { clock: clock.clone(), queue_limit: 9, ..StoreOptions::default() };
    let store = Store::open_in_memory(options).await.unwrap();
    let before = App::over(store.clone(), clock.clone(), Limits::default());
    let (model, batch) = (json!({ "seed": 1 }), json!({ "count": 3 }));
    let taken = [before.post_with("/models", &KEY, &model).await, before.post_with("/batches", &KEY, &batch).await];
    let cost = oviduct::generate::CostLimits { max_vertices: 1000, ..Default::default() };
    let after = App::over(store, clock, Limits { cost, batch: 2, ..Limits::default() });
    assert_eq!(after.post("/models", &model).await.slug(), "cost-limit");
    assert_eq!(after.post("/batches", &batch).await.places(), ["/count"]);
    let again = [after.post_with("/models", &KEY, &model).await, after.post_with("/batches", &KEY, &batch).await];
    for (taken, again) in taken.into_iter().zip(again) {
        assert_eq!((again.status.as_u16(), again.header("idempotency-replayed")), (202, Some("true")));
        assert_eq!(again.json(), taken.json());
    }
}

/// A model that has ended needs no waiting, so the response is not 202.
#[tokio::test]
async fn a_replay_of_an_ended_model_is_not_reported_as_accepted() {
    let app = App::new().await;
    let body = json!({ "seed": 1 });
    let first = app.post_with("/models", &KEY, &body).await;
    app.store.cancel(id(&first.location())).await.unwrap();
    let again = app.post_with("/models", &KEY, &body).await;
    assert_eq!((again.status.as_u16(), again.header("idempotency-replayed")), (200, Some("true")));
    assert_eq!(again.header(header::RETRY_AFTER), None);
    assert_eq!(again.header(header::LOCATION), first.header(header::LOCATION));
    assert_eq!(again.json()["status"], "cancelled");
}
