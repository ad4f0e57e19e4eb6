//! Bulk operations on models by filter and by batch; retries; lists of batches.

use super::app::{App, used};
use axum::body::Body;
use axum::http::Method;
use futures_util::future::BoxFuture;
use oviduct::http::Limits;
use oviduct::jobs::keys::Scope;
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
            if call == "step_operation" {
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

/// An app with 1,500 queued models of one owner, its key, and the key of another owner.
async fn crowded() -> (App, String, String) {
    let app = App::with(Limits::default(), 5000).await;
    let key = app.key("lab", &[Scope::Read, Scope::Submit]).await;
    let other = app.key("other", &[Scope::Read, Scope::Submit]).await;
    for seeds in [0..1000, 1000..1500] {
        let body = json!({ "seeds": seeds.collect::<Vec<u32>>(), "labels": { "study": "A" } });
        assert_eq!(app.post_with("/batches", &[("authorization", &key)], &body).await.status, 202);
    }
    (app, key, other)
}

#[tokio::test]
async fn many_models_are_deleted_by_an_operation_with_progress() {
    let (app, key, _) = crowded().await;
    let lab = [("authorization", key.as_str())];
    let send = async |method: Method, path: &str| app.request(method, path, &lab, Body::empty()).await;
    let path = "/models?label=study:A&status=queued";
    let counted = send(Method::DELETE, &format!("{path}&dry_run=true")).await;
    assert_eq!((counted.status.as_u16(), counted.json()), (200, applied(1500, true)));
    let accepted = send(Method::DELETE, path).await;
    assert_eq!((accepted.status.as_u16(), accepted.header("retry-after")), (202, Some("1")));
    let (address, operation) = (accepted.location(), accepted.json());
    assert_eq!(address, format!("/operations/{}", operation["id"].as_str().unwrap()));
    assert_eq!((&operation["status"], &operation["action"]), (&json!("queued"), &json!("delete")));
    assert_eq!(operation["conditions"], json!({ "label": ["study:A"], "status": ["queued"] }));
    assert_eq!(operation["progress"], json!({ "changed": 0, "total": 1500, "fraction": 0.0 }));
    let tag = accepted.header("etag").unwrap().to_owned();
    let same = app.get_with(&address, &[lab[0], ("if-none-match", &tag)]).await;
    assert_eq!(same.status, 304);
    let later = app.post_with("/models", &lab, &json!({ "seed": 9000, "labels": { "study": "A" } })).await.location();

    let executor = app.execute_operations();
    let mut seen = Vec::new();
    let ended = loop {
        let operation = app.get_with(&address, &lab).await;
        let body = operation.json();
        seen.push(body["progress"]["changed"].as_u64().unwrap());
        if operation.header("retry-after").is_none() {
            break body;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    executor.abort();
    assert!(seen.is_sorted(), "{seen:?}");
    assert_eq!((&ended["status"], &ended["progress"]["fraction"]), (&json!("succeeded"), &json!(1.0)));
    assert_eq!((ended["progress"]["changed"].as_u64(), ended["finished_at"].is_string()), (Some(1500), true));
    let left = app.get_with("/models", &lab).await.json();
    assert_eq!(left["models"].as_array().unwrap().len(), 1, "{left}");
    assert_eq!(app.get_with(&later, &lab).await.json()["status"], "queued");
    let list = app.get_with("/operations?limit=1", &lab).await.json();
    assert_eq!((&list["operations"][0]["id"], &list["next"]), (&operation["id"], &Value::Null));
    let again = send(Method::POST, &format!("{address}/cancel")).await;
    assert_eq!(again.json(), ended, "an ended operation does not change");
}

#[tokio::test]
async fn an_operation_is_cancelled_and_belongs_to_its_owner() {
    let (app, key, other) = crowded().await;
    let (lab, other) = ([("authorization", key.as_str())], [("authorization", other.as_str())]);
    let post = async |path: &str, key| app.request(Method::POST, path, key, Body::empty()).await;
    let accepted = post("/models/cancel?all=true", &lab).await;
    assert_eq!(accepted.status, 202);
    let reference = accepted.header("location").unwrap();
    let id = accepted.json()["id"].as_str().unwrap().to_owned();
    assert_eq!(reference, format!("../operations/{id}"));
    let address = format!("/operations/{id}");
    for (method, path) in [(Method::GET, address.clone()), (Method::POST, format!("{address}/cancel"))] {
        let hidden = app.request(method, &path, &other, Body::empty()).await;
        assert_eq!((hidden.status.as_u16(), hidden.slug().as_str()), (404, "operation-not-found"));
    }
    assert_eq!(app.get_with("/operations", &other).await.json()["operations"], json!([]));
    let step = app.store.step_operation(None).await.unwrap().unwrap();
    assert_eq!(step.operation.changed, 100);
    let cancelled = post(&format!("{address}/cancel"), &lab).await.json();
    assert_eq!((&cancelled["status"], &cancelled["progress"]["changed"]), (&json!("cancelled"), &json!(100)));
    assert_eq!(app.store.step_operation(None).await.unwrap(), None);
    let counts = app.store.counts().await.unwrap();
    assert_eq!((counts.queued, counts.cancelled), (1400, 100));
    assert_eq!(app.get_with("/operations/nonsense", &lab).await.slug(), "operation-not-found");
    assert_eq!(app.get_with("/operations?limit=0&status=queued", &lab).await.places(), ["status", "limit"]);
}
