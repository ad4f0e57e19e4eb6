//! Batches, counts of models, and the expiry of models.

use super::app::App;
use axum::http::header;
use oviduct::http::Limits;
use serde_json::{Value, json};
use std::time::Duration;

fn counts(queued: u64, running: u64, succeeded: u64, failed: u64, cancelled: u64) -> Value {
    json!({ "total": queued + running + succeeded + failed + cancelled, "queued": queued, "running": running,
        "succeeded": succeeded, "failed": failed, "cancelled": cancelled })
}

#[tokio::test]
async fn a_batch_is_many_models_in_one_request() {
    let app = App::new().await;
    let body = json!({ "seeds": [5, 6, 7], "spec": { "steps": 900 }, "outputs": ["obj"], "labels": { "study": "A3" } });
    let reply = app.post("/batches", &body).await;
    assert_eq!(reply.status, 202, "{reply:?}");
    assert!(reply.header(header::RETRY_AFTER).is_some());
    let address = reply.location();
    let batch = reply.json();
    assert_eq!(address, format!("/batches/{}", batch["id"].as_str().unwrap()));
    assert_eq!(batch["counts"], counts(3, 0, 0, 0, 0));
    for (id, seed) in batch["models"].as_array().unwrap().iter().zip([5, 6, 7]) {
        let model = app.get(&format!("/models/{}", id.as_str().unwrap())).await.json();
        assert_eq!((&model["seed"], &model["spec"]["steps"]), (&json!(seed), &json!(900)));
        assert_eq!((&model["outputs"], &model["labels"]["study"]), (&json!(["obj"]), &json!("A3")));
    }
    let job = app.claim().await;
    let files = [("model.obj", "model/obj", b"o".to_vec())];
    app.finish(job, &files).await;
    let _running = app.claim().await;
    let now = app.get(&address).await;
    assert_eq!((now.status.as_u16(), &now.json()["counts"]), (200, &counts(1, 1, 1, 0, 0)));
    // The finished model is reused; the other is queued.
    let again = app.post("/batches", &json!({ "seeds": [5, 8], "spec": { "steps": 900 }, "outputs": ["obj"] })).await;
    assert_eq!(again.json()["counts"], counts(1, 0, 1, 0, 0));

    assert_eq!(app.delete(&address).await.status, 204);
    for path in [&address, &format!("/models/{}", batch["models"][0].as_str().unwrap())] {
        assert_eq!(app.get(path).await.status, 404);
    }
    assert_eq!(app.delete(&address).await.slug(), "batch-not-found");
    assert_eq!(app.get("/batches/nonsense").await.slug(), "batch-not-found");
}

#[tokio::test]
async fn seeds_are_drawn_for_a_count_and_differ() {
    let app = App::new().await;
    let batch = app.post("/batches", &json!({ "count": 20 })).await.json();
    let mut seeds = Vec::new();
    for id in batch["models"].as_array().unwrap() {
        seeds.push(app.get(&format!("/models/{}", id.as_str().unwrap())).await.json()["seed"].as_u64().unwrap());
    }
    seeds.sort_unstable();
    seeds.dedup();
    assert_eq!(seeds.len(), 20);
}

#[tokio::test]
async fn a_batch_is_all_or_nothing() {
    let app = App::with(Limits { batch: 5, ..Limits::default() }, 4).await;
    app.model(1).await;
    let reply = app.post("/batches", &json!({ "count": 4 })).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (429, "queue-full"));
    assert!(reply.header(header::RETRY_AFTER).is_some());
    assert_eq!(app.get("/models").await.json()["models"].as_array().unwrap().len(), 1);
    assert_eq!(app.post("/batches", &json!({ "count": 3 })).await.status, 202);
    for (body, place) in [
        (json!({ "count": 6 }), "/count"),
        (json!({ "seeds": [1, 2, 3, 4, 5, 6] }), "/seeds"),
        (json!({ "seeds": [1, 1] }), "/seeds/1"),
        (json!({}), ""),
        (json!({ "count": 1, "seed": 4 }), "/seed"),
        (json!({ "count": 1, "spec": { "steps": -1 } }), "/spec/steps"),
        (json!({ "count": 1, "priority": 1000 }), "/priority"),
    ] {
        let reply = app.post("/batches", &body).await;
        assert_eq!((reply.status.as_u16(), reply.places()), (422, vec![place.to_owned()]), "{body}");
    }
}

#[tokio::test]
async fn an_idempotency_key_gives_the_same_batch() {
    let app = App::new().await;
    let body = json!({ "count": 2 });
    let first = app.post_with("/batches", &[("idempotency-key", "k")], &body).await;
    let second = app.post_with("/batches", &[("idempotency-key", "k")], &body).await;
    assert_eq!(first.json(), second.json());
    assert_eq!((first.header("idempotency-replayed"), second.header("idempotency-replayed")), (None, Some("true")));
    let other = app.post_with("/batches", &[("idempotency-key", "k")], &json!({ "count": 3 })).await;
    assert_eq!(other.slug(), "idempotency-key-reused");
    let urgent = app.post_with("/batches", &[("idempotency-key", "k")], &json!({ "count": 2, "priority": 1 })).await;
    assert_eq!(urgent.slug(), "idempotency-key-reused", "the priority is part of the request");
}

#[tokio::test]
async fn models_show_when_they_will_be_removed() {
    let app = App::with(Limits { keep: Some(Duration::from_secs(3600)), ..Limits::default() }, 100).await;
    let model = app.model(1).await;
    assert_eq!(app.get(&model).await.json()["expires_at"], Value::Null);
    app.post(&format!("{model}/cancel"), &json!({})).await;
    assert_eq!(app.get(&model).await.json()["expires_at"], "2026-01-02T04:04:05Z");
}

#[tokio::test]
async fn the_counts_can_be_read() {
    let app = App::new().await;
    app.model(1).await;
    app.model(2).await;
    let _running = app.claim().await;
    assert_eq!(app.get("/models/nonsense").await.status, 404);
    let reply = app.get("/metrics").await;
    assert_eq!(reply.status, 200);
    assert!(reply.header(header::CONTENT_TYPE).unwrap().starts_with("application/openmetrics-text"));
    let text = String::from_utf8(reply.body.to_vec()).unwrap();
    for line in [
        "oviduct_jobs{status=\"queued\"} 1",
        "oviduct_jobs{status=\"running\"} 1",
        "oviduct_event_streams 0",
        "oviduct_http_requests_total{method=\"POST\",route=\"/models\",status=\"202\"} 2",
        "oviduct_http_requests_total{method=\"GET\",route=\"/models/{id}\",status=\"404\"} 1",
    ] {
        assert!(text.lines().any(|l| l == line), "{line} in\n{text}");
    }
}
