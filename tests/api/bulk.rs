//! Bulk operations on models by filter and by batch; retries; lists of batches.

use super::app::{App, used};
use axum::body::Body;
use axum::http::Method;
use futures_util::future::BoxFuture;
use oviduct::http::Limits;
use oviduct::jobs::{Hook, Problem, StoreError};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;

async fn labelled(app: &App, seed: u64, study: &str) -> String {
    let body = json!({ "seed": seed, "labels": { "study": study }, "reuse": false });
    app.post("/models", &body).await.location()
}

async fn statuses(app: &App, models: &[String]) -> Vec<String> {
    let mut statuses = Vec::new();
    for model in models {
        statuses.push(app.get(model).await.json()["status"].as_str().unwrap_or("gone").to_owned());
    }
    statuses
}

fn applied(count: u64, dry_run: bool) -> Value {
    json!({ "count": count, "dry_run": dry_run })
}

async fn fail(app: &App) {
    let problem = Problem { kind: "certificate".into(), title: "A fault".into(), detail: "somewhere".into() };
    let job = app.claim().await;
    app.store.fail(job, used(), problem).await.unwrap();
}

#[tokio::test]
async fn models_are_cancelled_by_filter() {
    let app = App::new().await;
    let mut models = Vec::new();
    for seed in 0..4 {
        models.push(labelled(&app, seed, if seed < 3 { "A" } else { "B" }).await);
    }
    let job = app.claim().await;
    let path = "/models/cancel?label=study:A";
    let count = async |path: &str| app.request(Method::POST, path, &[], Body::empty()).await.json();
    assert_eq!(count(&format!("{path}&dry_run=true")).await, applied(3, true));
    assert_eq!(statuses(&app, &models).await, ["running", "queued", "queued", "queued"]);
    assert_eq!(count(&format!("{path}&status=succeeded")).await, applied(0, false));
    assert_eq!(count(path).await, applied(3, false));
    assert_eq!(statuses(&app, &models).await, ["running", "cancelled", "cancelled", "queued"]);
    assert_eq!(app.beat(&job, 10, None).await, oviduct::jobs::Directive::Cancel);
    assert_eq!(count(path).await, applied(0, false));
    assert_eq!(count("/models/cancel?all=true").await, applied(1, false));
}

#[tokio::test]
async fn models_are_deleted_by_filter() {
    let app = App::with(Limits::default(), 1000).await;
    let mut models = Vec::new();
    for seed in 0..250 {
        models.push(app.model(seed).await);
        app.clock.advance(Duration::from_secs(1));
    }
    let since = app.get(&models[30]).await.json()["created_at"].as_str().unwrap().to_owned();
    let path = format!("/models?created_after={since}");
    assert_eq!(app.delete(&format!("{path}&dry_run=true")).await.json(), applied(220, true));
    assert_eq!(app.delete(&path).await.json(), applied(220, false), "over several transactions");
    assert_eq!(statuses(&app, &models[28..32]).await, ["queued", "queued", "gone", "gone"]);
    assert_eq!(app.delete(&path).await.json(), applied(0, false));
    assert_eq!(app.delete("/models?all=true").await.json(), applied(30, false));
    assert_eq!(app.get("/models").await.json()["models"], json!([]));
}

#[tokio::test]
async fn nothing_is_changed_without_a_filter() {
    let app = App::new().await;
    let model = app.model(1).await;
    for query in ["", "?dry_run=true", "?all=false"] {
        for (method, path) in [(Method::POST, "/models/cancel"), (Method::DELETE, "/models")] {
            let refused = app.request(method, &format!("{path}{query}"), &[], Body::empty()).await;
            assert_eq!((refused.status.as_u16(), refused.places()), (422, vec!["all".to_owned()]), "{path}{query}");
        }
    }
    let wrong = app.delete("/models?batch=7&created_before=now&dry_run=1&limit=3").await;
    assert_eq!(wrong.places(), ["limit", "batch", "created_before", "dry_run"]);
    assert_eq!(statuses(&app, &[model]).await, ["queued"]);
}

#[tokio::test]
async fn a_failed_model_is_grown_again() {
    let app = App::new().await;
    let body = json!({
        "seeds": [7, 8], "spec": { "steps": 900 }, "labels": { "study": "A" }, "priority": 5, "reuse": false
    });
    let batch = app.post("/batches", &body).await.json();
    let failed = format!("/models/{}", batch["models"][0].as_str().unwrap());
    let path = format!("{failed}/retry");
    let early = app.post(&path, &json!({})).await;
    assert_eq!((early.status.as_u16(), early.slug().as_str()), (409, "not-failed"));
    fail(&app).await;
    let before = app.get(&failed).await.json();
    assert_eq!((&before["status"], &before["worker"]), (&json!("failed"), &json!("w1")));

    let headers = [("idempotency-key", "again")];
    let retry = app.post_with(&path, &headers, &json!({})).await;
    assert_eq!(retry.status, 202, "{retry:?}");
    let model = retry.json();
    for member in ["preset", "seed", "spec", "outputs", "labels", "priority", "batch", "digest"] {
        assert_eq!(model[member], before[member], "{member}");
    }
    assert_eq!(
        (&model["retry_of"], &model["status"], &model["worker"]),
        (&before["id"], &json!("queued"), &Value::Null)
    );
    assert_eq!(app.get(&failed).await.json(), before, "the failed model stays as it is");
    let reference = retry.header("location").unwrap();
    assert_eq!(reference, format!("../{}", model["id"].as_str().unwrap()));
    let replayed = app.post_with(&path, &headers, &json!({})).await;
    assert_eq!((&replayed.json()["id"], replayed.header("idempotency-replayed")), (&model["id"], Some("true")));
    let now = app.get(&format!("/batches/{}", batch["id"].as_str().unwrap())).await.json();
    assert_eq!((&now["counts"]["total"], &now["models"][2]), (&json!(3), &model["id"]));
    assert_eq!(app.post("/models/0197a3f2-7c11-7b9e-9d35-1f2e3c4b5a69/retry", &json!({})).await.status, 404);
}

#[tokio::test]
async fn a_batch_is_cancelled() {
    let app = App::new().await;
    let batch = app.post("/batches", &json!({ "count": 3, "reuse": false })).await.json();
    let other = app.model(1).await;
    let running = app.claim().await;
    let path = format!("/batches/{}", batch["id"].as_str().unwrap());
    let cancelled = app.post(&format!("{path}/cancel"), &json!({})).await;
    assert_eq!((cancelled.status.as_u16(), &cancelled.json()["counts"]["cancelled"]), (200, &json!(2)));
    assert_eq!(app.beat(&running, 10, None).await, oviduct::jobs::Directive::Cancel);
    assert_eq!(app.get(&other).await.json()["status"], "queued");
    assert_eq!(app.post("/batches/0197a3f2-7c11-7b9e-9d35-1f2e3c4b5a69/cancel", &json!({})).await.status, 404);
}

#[tokio::test]
async fn batches_are_listed() {
    let app = App::new().await;
    let mut made = Vec::new();
    for count in 1..=3 {
        made.push(app.post("/batches", &json!({ "count": count, "reuse": false })).await.json());
        app.clock.advance(Duration::from_secs(60));
    }
    let first = app.get("/batches?limit=2").await.json();
    let mut short = made[2].clone();
    short.as_object_mut().unwrap().retain(|name, _| name != "models" && name != "study");
    assert_eq!(first["batches"][0], short, "newest first, without the ids of models");
    let rest = app.get(&format!("/batches?limit=2&cursor={}", first["next"].as_str().unwrap())).await.json();
    assert_eq!((&rest["batches"][0]["id"], &rest["next"]), (&made[0]["id"], &Value::Null));
    let time = made[1]["created_at"].as_str().unwrap();
    for (name, expected) in [("created_after", &made[1..]), ("created_before", &made[..1])] {
        let found = app.get(&format!("/batches?{name}={time}")).await.json();
        assert_eq!(found["batches"].as_array().unwrap().len(), expected.len(), "{name}");
        assert_eq!(found["batches"].as_array().unwrap().last().unwrap()["id"], expected[0]["id"], "{name}");
    }
    // The list of models can be restricted to one batch.
    let of = app.get(&format!("/models?batch={}&view=summary", made[1]["id"].as_str().unwrap())).await.json();
    let ids: Vec<_> = of["models"].as_array().unwrap().iter().rev().map(|model| model["id"].clone()).collect();
    assert_eq!(json!(ids), made[1]["models"]);
    assert!(of["models"].as_array().unwrap().iter().all(|model| model["batch"] == made[1]["id"]));
    assert_eq!(app.get("/batches?limit=0&label=a:b").await.places(), ["label", "limit"]);
}

/// Accepts another model of the study while a bulk deletion runs.
struct SubmitDuringDeletion(Arc<App>);

impl Hook for SubmitDuringDeletion {
    fn before<'a>(&'a self, call: &'static str) -> BoxFuture<'a, Result<(), StoreError>> {
        Box::pin(async move {
            if call == "delete_many" {
                labelled(&self.0, 2, "A").await;
            }
            Ok(())
        })
    }
}

#[tokio::test]
async fn models_accepted_during_a_bulk_deletion_are_kept() {
    let app = Arc::new(App::new().await);
    labelled(&app, 1, "A").await;
    let store = app.store.with_hook(Arc::new(SubmitDuringDeletion(Arc::clone(&app))));
    let busy = App::over(store, app.clock.clone(), Limits::default());
    assert_eq!(busy.delete("/models?label=study:A").await.json(), applied(1, false));
    let left = app.get("/models?label=study:A").await.json();
    assert_eq!(left["models"].as_array().unwrap().len(), 1, "{left}");
}
