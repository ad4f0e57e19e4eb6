//! The stream of all models when reports of changes get lost.

use super::app::{App, contour, id};
use super::events::Stream;
use super::wire::Wire;
use oviduct::http::Limits;
use oviduct::jobs::{Change, ClaimScope};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::sync::broadcast;

/// A service to which only the sender reports changes.
async fn deaf(poll: Duration) -> (App, broadcast::Sender<Change>) {
    let changes = broadcast::Sender::new(4);
    let limits = Limits { event_poll: poll, event_interval: Duration::from_millis(10), ..Limits::default() };
    (Wire::app(limits, Some(changes.clone())).await.0, changes)
}

fn uuid(model: &str) -> Value {
    json!(id(model).to_string())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn changes_that_were_not_reported_are_found() {
    let (app, _changes) = deaf(Duration::from_millis(20)).await;
    let [gone, grown] = [app.model(1).await, app.model(2).await];
    let mut stream = Stream::open(&app, "/events", None).await;
    for _ in 0..2 {
        assert_eq!(stream.next().await.unwrap().data["status"], "queued");
    }
    app.delete(&gone).await;
    assert_eq!(stream.until("end").await.data, json!({ "id": uuid(&gone), "status": "deleted" }));
    let job = app.claim().await;
    while stream.until("status").await.data["status"] != "running" {}
    app.beat(&job, 10, Some(&contour(10))).await;
    assert_eq!(stream.until("section").await.data["section"]["index"], 1);
    app.finish(job, &[]).await;
    let end = stream.until("end").await.data;
    assert_eq!((&end["id"], &end["status"]), (&uuid(&grown), &json!("succeeded")));

    // A model that was never reported, and one that ended before it was found.
    let late = app.model(3).await;
    assert_eq!(stream.until("status").await.data["id"], uuid(&late));
    app.delete(&late).await;
    assert_eq!(stream.until("end").await.data["status"], "deleted");
    let quick = app.finished(4, &[]).await;
    let end = loop {
        let event = stream.next().await.unwrap();
        if event.data["status"] == "succeeded" {
            break event;
        }
    };
    assert_eq!((end.name.as_str(), &end.data["id"]), ("end", &uuid(&quick)));
    assert!(stream.silent(Duration::from_millis(600)).await, "nothing is sent twice");
}

/// A client that reconnects has the running models, and must get their end.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn models_that_a_reconnected_client_has_are_watched_too() {
    let (app, changes) = deaf(Duration::from_millis(20)).await;
    let model = app.model(1).await;
    let other = app.model(2).await;
    let mut stream = Stream::open(&app, "/events", None).await;
    stream.next().await.unwrap();
    stream.next().await.unwrap();
    app.store.cancel(id(&other)).await.unwrap();
    changes.send(Change { id: id(&other), version: Some(2) }).unwrap();
    let cursor = stream.until("end").await.id;
    drop(stream);
    let mut back = Stream::open(&app, "/events", Some(&cursor)).await;
    assert!(back.silent(Duration::from_millis(200)).await, "it has everything");
    app.store.cancel(id(&model)).await.unwrap();
    let end = back.until("end").await;
    assert_eq!((&end.data["id"], &end.data["status"]), (&uuid(&model), &json!("cancelled")));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_overrun_of_the_feed_loses_no_end() {
    // Nothing is found by polling here.
    let (app, changes) = deaf(Duration::from_secs(600)).await;
    let mut running = Vec::new();
    for seed in 0..150 {
        app.model(seed).await;
        running.push(app.claim().await);
    }
    let mut open: BTreeSet<String> = running.iter().map(|job| job.job().id.to_string()).collect();
    let mut stream = Stream::open(&app, "/events", None).await;
    let mut told = BTreeSet::new();
    while told.len() < open.len() {
        let event = stream.next().await.unwrap();
        assert_eq!((event.name.as_str(), &event.data["status"]), ("status", &json!("running")));
        told.insert(event.data["id"].as_str().unwrap().to_owned());
    }
    assert_eq!(told, open, "all running models, however many");
    let some = Change { id: running[0].job().id, version: Some(9) };
    for job in running {
        app.store.cancel(job.job().id).await.unwrap();
        app.store.cancelled(job).await.unwrap();
    }
    // More than the channel holds.
    for _ in 0..50 {
        changes.send(some).unwrap();
    }
    while !open.is_empty() {
        let end = stream.until("end").await;
        assert_eq!(end.data["status"], "cancelled");
        open.remove(end.data["id"].as_str().unwrap());
    }
    assert!(app.store.claim("w1", ClaimScope::Cpu, Duration::from_secs(1), 1).await.unwrap().is_empty());
}
