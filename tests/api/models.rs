//! Lists of models; reading, cancelling and deleting a model.

use super::app::{App, LEASE, contour, id, moment, used};
use axum::body::Body;
use axum::http::{Method, header};
use oviduct::jobs::{Directive, Problem, WorkerKind};
use serde_json::{Value, json};
use std::time::Duration;

/// Seeds on a page and the cursor of the next page.
fn page(list: &Value) -> (Vec<u64>, Option<String>) {
    let seeds = list["models"].as_array().unwrap().iter().map(|m| m["seed"].as_u64().unwrap()).collect();
    (seeds, list["next"].as_str().map(str::to_owned))
}

#[tokio::test]
async fn pages_follow_each_other_newest_first() {
    let app = App::new().await;
    for seed in 0..7 {
        app.model(seed).await;
    }
    let (all, next) = page(&app.get("/models").await.json());
    assert_eq!((all, next), (vec![6, 5, 4, 3, 2, 1, 0], None));
    let (mut seen, mut path) = (vec![], "/models?limit=3".to_owned());
    loop {
        let (seeds, next) = page(&app.get(&path).await.json());
        assert!(seeds.len() <= 3);
        seen.extend(seeds);
        // A model submitted between two pages does not shift them.
        app.model(100).await;
        match next {
            Some(cursor) => path = format!("/models?limit=3&cursor={cursor}"),
            None => break,
        }
    }
    assert_eq!(seen, [6, 5, 4, 3, 2, 1, 0]);
}

#[tokio::test]
async fn filters_select() {
    let app = App::new().await;
    for (seed, preset, study) in [(0, "pig", "A"), (1, "paper", "A"), (2, "pig", "B:1")] {
        let body = json!({ "seed": seed, "preset": preset, "labels": { "study": study, "all": "" } });
        assert_eq!(app.post("/models", &body).await.status, 202);
    }
    let job = app.claim().await;
    assert_eq!(job.job().seed, 0);
    let cases: [(&str, &[u64]); 10] = [
        ("", &[2, 1, 0]),
        ("status=queued", &[2, 1]),
        ("status=running", &[0]),
        ("status=failed", &[]),
        ("preset=paper", &[1]),
        ("preset=dragon", &[]),
        ("label=study:A", &[1, 0]),
        ("label=study:B:1", &[2]),
        ("label=all:&label=study%3AA&preset=pig", &[0]),
        ("label=study:A&status=queued", &[1]),
    ];
    for (query, want) in cases {
        assert_eq!(page(&app.get(&format!("/models?{query}")).await.json()).0, want, "{query}");
    }
}

#[tokio::test]
async fn a_model_has_a_tag_that_changes_with_it() {
    let app = App::new().await;
    app.worker(WorkerKind::Cpu).await;
    let model = app.model(7).await;
    let behind = app.model(8).await;
    let tag = |reply: &super::app::Reply| reply.header(header::ETAG).unwrap().to_owned();
    let first = app.get(&model).await;
    assert_eq!(tag(&first), format!("\"{}\"", first.json()["version"]));
    assert!(first.header(header::RETRY_AFTER).is_some());
    let waiting = app.get(&behind).await;
    let same = app.get_with(&model, &[("if-none-match", &tag(&first))]).await;
    assert_eq!((same.status.as_u16(), same.body.len(), tag(&same)), (304, 0, tag(&first)));

    let job = app.claim().await;
    let running = app.get_with(&model, &[("if-none-match", &tag(&first))]).await;
    assert_eq!((running.status.as_u16(), &running.json()["status"]), (200, &json!("running")));
    app.beat(&job, 500, Some(&contour(500))).await;
    let on = app.get_with(&model, &[("if-none-match", &tag(&running))]).await;
    assert_eq!((on.status.as_u16(), &on.json()["progress"]["step"]), (200, &json!(500)));
    assert_eq!(on.header(header::RETRY_AFTER), Some("15"), "as long as it will take");

    // The position in the queue changed although the version did not, so the tag is different.
    let moved = app.get_with(&behind, &[("if-none-match", &tag(&waiting))]).await;
    assert_eq!((moved.status.as_u16(), &moved.json()["queue"]["position"]), (200, &json!(0)));

    app.finish(job, &[]).await;
    let ended = app.get(&model).await;
    assert_eq!(ended.header(header::RETRY_AFTER), None);
    let head = app.request(Method::HEAD, &model, &[], Body::empty()).await;
    assert_eq!((head.status.as_u16(), head.body.len(), tag(&head)), (200, 0, tag(&ended)));
}

#[tokio::test]
async fn times_and_the_wait_are_reported() {
    let app = App::new().await;
    let created = moment(&app.clock);
    let model = app.model(7).await;
    assert_eq!(
        app.get(&model).await.json()["queue"],
        json!({ "position": 0, "position_is_exact": true, "reason": "no-worker", "wait_seconds": null })
    );
    app.clock.advance(Duration::from_millis(1500));
    let started = moment(&app.clock);
    let job = app.claim().await;
    let json = app.get(&model).await.json();
    assert_eq!(
        json["queue"],
        json!({ "position": null, "position_is_exact": null, "reason": null, "wait_seconds": 1.5 })
    );
    assert_eq!(
        (&json["created_at"], &json["started_at"], &json["finished_at"]),
        (&json!(created), &json!(started), &Value::Null)
    );
    app.finish(job, &[]).await;
    assert_eq!(app.get(&model).await.json()["finished_at"], started);
}

#[tokio::test]
async fn a_failed_model_says_why() {
    let app = App::new().await;
    let model = app.model(7).await;
    let job = app.claim().await;
    let problem =
        Problem { kind: "certificate".into(), title: "Not sound".into(), detail: "2 facets meet at z = 3 µm".into() };
    app.store.fail(job, used(), problem).await.unwrap();
    let json = app.get(&model).await.json();
    assert_eq!(json["status"], "failed");
    assert_eq!(
        json["problem"],
        json!({ "type": "urn:oviduct:problem:certificate", "title": "Not sound", "detail": "2 facets meet at z = 3 µm" })
    );
}

#[tokio::test]
async fn cancelling_works_in_every_state() {
    let app = App::new().await;
    let cancel = async |model: &str| app.post(&format!("{model}/cancel"), &json!({})).await;
    let queued = app.model(1).await;
    for _ in 0..2 {
        let reply = cancel(&queued).await;
        assert_eq!((reply.status.as_u16(), &reply.json()["status"]), (200, &json!("cancelled")));
    }
    let running = app.model(2).await;
    let job = app.claim().await;
    for _ in 0..2 {
        let reply = cancel(&running).await;
        assert_eq!((reply.status.as_u16(), &reply.json()["status"]), (200, &json!("running")));
    }
    assert_eq!(app.beat(&job, 1, None).await, Directive::Cancel, "the worker is notified");
    app.store.cancelled(job).await.unwrap();
    assert_eq!(cancel(&running).await.json()["status"], "cancelled");
    let done = app.finished(3, &[]).await;
    assert_eq!(cancel(&done).await.json()["status"], "succeeded");
}

#[tokio::test]
async fn deleting_works_in_every_state_and_once() {
    let app = App::new().await;
    let queued = app.model(1).await;
    assert_eq!(app.delete(&queued).await.status, 204);
    let running = app.model(2).await;
    let job = app.claim().await;
    assert_eq!(app.delete(&running).await.status, 204);
    assert_eq!(app.beat(&job, 1, None).await, Directive::Lost, "the worker is notified");
    let done = app.finished(3, &[("model.glb", "model/gltf-binary", vec![1])]).await;
    assert_eq!(app.delete(&done).await.status, 204);
    for model in [queued, running, done] {
        assert_eq!(app.delete(&model).await.slug(), "model-not-found");
        assert_eq!(app.get(&model).await.slug(), "model-not-found");
        assert_eq!(app.store.get(id(&model)).await.unwrap(), None);
    }
    assert_eq!(app.get("/models").await.json(), json!({ "models": [], "next": null }));
    assert!(app.store.claim("w2", oviduct::jobs::ClaimScope::Cpu, LEASE, 9).await.unwrap().is_empty());
}
