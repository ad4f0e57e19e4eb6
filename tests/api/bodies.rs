//! The budget of request bodies: what has arrived of their text, and the values parsed from it.

use super::app::{App, Reply};
use axum::body::{Body, Bytes};
use axum::http::{Method, header};
use futures_util::{StreamExt, stream};
use oviduct::http::{Limits, WithoutKeys};
use oviduct::jobs::keys::{KeyLimits, Scope};
use serde_json::{Value, json};
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::oneshot;

async fn send(app: &App, path: &str, key: &str, body: impl Into<Body>) -> Reply {
    let headers = [("content-type", "application/json"), ("authorization", key)];
    app.request(Method::POST, path, &headers[..if key.is_empty() { 1 } else { 2 }], body.into()).await
}

fn slug(reply: &Reply) -> (u16, String) {
    (reply.status.as_u16(), reply.slug())
}

/// Eight MiB of small objects would take 800 MB as values.
#[tokio::test]
async fn a_body_of_too_many_values_is_refused_where_they_become_too_many() {
    let app = App::new().await;
    for item in ["{}", "0", "{\"\":0}", "[[0]]"] {
        let body = format!("[\n{item}{}]", format!(",\n{item}").repeat((8 << 20) / (item.len() + 2) - 2));
        let reply = send(&app, "/fits/validate", "", body).await;
        let problem = reply.json();
        assert_eq!(slug(&reply), (413, "payload-too-large".to_owned()), "{item}: {problem}");
        assert_eq!(problem["limit"], 50_000);
        // The list is a value, too.
        let values = item.matches(['{', '[', '0']).count() as u64;
        let line = problem["line"].as_u64().unwrap();
        assert!((49_999 / values + 1..=49_999 / values + 3).contains(&line), "{item}: {problem}");
        assert!(problem["column"].is_u64() && problem["detail"].as_str().unwrap().contains("50000 values"));
    }
    // As many as fifty per model of the largest batch are read.
    let many = json!({ "seeds": (0..49_990).collect::<Vec<_>>() });
    assert_eq!(app.post("/batches/validate", &many).await.places(), ["/seeds"]);
    let larger = App::with(Limits { batch: 2000, ..Limits::default() }, 10).await;
    let many = json!({ "seeds": (0..99_990).collect::<Vec<_>>() });
    assert_eq!(larger.post("/batches/validate", &many).await.places(), ["/seeds"]);
}

/// A body that has arrived up to its last byte, which comes when the sender is used.
fn unfinished(start: Vec<u8>) -> (Body, oneshot::Receiver<()>, oneshot::Sender<()>) {
    let ((arrived, has_arrived), (finish, finished)) = (oneshot::channel(), oneshot::channel::<()>());
    // The service asks for the end once it has taken the start.
    let end = async move {
        let _ = arrived.send(());
        let _ = finished.await;
        Bytes::from_static(b"}")
    };
    let body = stream::iter([Bytes::from(start)]).chain(stream::once(end));
    (Body::from_stream(body.map(Ok::<_, Infallible>)), has_arrived, finish)
}

#[tokio::test]
async fn unfinished_bodies_of_one_owner_leave_memory_for_others() {
    let limits = Limits { body_memory: 1 << 20, ..Limits::default() };
    let app = App::with(limits, 10).await.with_access(WithoutKeys::Anyone, KeyLimits::default());
    app.expect_faults();
    let [greedy, modest] = [app.key("greedy", &[Scope::Read]).await, app.key("modest", &[Scope::Read]).await];
    let padded = |length: usize| [b"{".to_vec(), vec![b' '; length]].concat();
    let (body, has_arrived, finish) = unfinished(padded(300 << 10));
    let first = send(&app, "/models/validate", &greedy, body);
    let others = async {
        has_arrived.await.unwrap();
        let (body, _, finish_second) = unfinished(padded(300 << 10));
        finish_second.send(()).unwrap();
        let refused = send(&app, "/models/validate", &greedy, body).await;
        assert_eq!(slug(&refused), (503, "too-many-bodies".to_owned()));
        assert!(refused.header(header::RETRY_AFTER).is_some());
        assert!(refused.json()["detail"].as_str().unwrap().contains("your owner"), "{}", refused.json());
        let other = send(&app, "/models/validate", &modest, padded(300 << 10)).await;
        assert_eq!(slug(&other), (400, "invalid-json".to_owned()), "the body of another owner is read");
        assert_eq!(send(&app, "/models/validate", &greedy, "{}").await.status, 200, "a small body of the same owner");
        finish.send(()).unwrap();
    };
    let (first, ()) = tokio::join!(first, others);
    assert_eq!(first.status, 200, "{first:?}");
    let again = [padded(300 << 10), b"}".to_vec()].concat();
    assert_eq!(send(&app, "/models/validate", &greedy, again).await.status, 200, "its memory is free again");
}

/// The values take memory of the budget, too: here 300 KiB of text become 40 MB. A retry would not
/// help, so the response is not 503.
#[tokio::test]
async fn values_take_memory_of_the_budget() {
    let app = App::with(Limits { body_memory: 16 << 20, ..Limits::default() }, 10).await;
    let deep = |count: usize| {
        let nested = format!("{}0{}", "{\"a\":".repeat(100), "}".repeat(100));
        format!("[{}]", vec![nested; count].join(","))
    };
    let reply = send(&app, "/models/validate", "", deep(490)).await;
    assert_eq!(slug(&reply), (413, "payload-too-large".to_owned()));
    assert!(reply.json()["detail"].as_str().unwrap().contains("16 MiB") && reply.json()["column"].is_u64());
    assert_eq!(slug(&send(&app, "/models/validate", "", deep(100)).await), (422, "invalid-request".to_owned()));
    assert_eq!(slug(&send(&app, "/models/validate", "", deep(100)).await), (422, "invalid-request".to_owned()));
}

/// A held response may last a minute. Its request takes no memory in the meantime.
#[tokio::test]
async fn a_held_response_takes_no_memory_for_its_body() {
    let limits = Limits { body_memory: 500 << 10, ..Limits::default() };
    let app = App::with(limits, 10).await;
    let body = format!("{{\"seed\":1{}}}", " ".repeat(300 << 10));
    let headers = [("content-type", "application/json"), ("prefer", "wait=60")];
    let held = app.request(Method::POST, "/models", &headers, Body::from(body.clone()));
    let others = async {
        while app.get("/models").await.json()["models"] == json!([]) {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        while !String::from_utf8_lossy(&app.get("/metrics").await.body).contains("oviduct_held_answers 1") {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert_eq!(send(&app, "/models/validate", "", body.clone()).await.status, 200);
        app.shutdown.cancel();
    };
    let (held, ()) = tokio::join!(held, others);
    assert_eq!(held.status, 202);
}

#[tokio::test]
async fn a_limit_above_eight_mebibytes_holds() {
    let app = App::with(Limits { body_bytes: 16 << 20, ..Limits::default() }, 10).await;
    let body = format!("{}{{}}", " ".repeat(10 << 20));
    assert_eq!(send(&app, "/models/validate", "", body).await.status, 200);
    let reply = send(&app, "/models/validate", "", " ".repeat((16 << 20) + 1)).await;
    assert_eq!(slug(&reply), (413, "payload-too-large".to_owned()));
}

/// The models of a batch take up to 100 MB while it is checked and queued.
#[tokio::test]
async fn batches_wait_for_a_turn_for_a_limited_time() {
    let body = json!({ "seeds": [1, 2] });
    let full = Limits { batches: 0, picture_wait: Duration::from_millis(20), ..Limits::default() };
    let app = App::with(full, 10).await;
    app.expect_faults();
    for path in ["/batches", "/batches/validate"] {
        let refused = app.post(path, &body).await;
        assert_eq!(slug(&refused), (503, "too-many-bodies".to_owned()));
        assert!(refused.header(header::RETRY_AFTER).is_some());
    }
    assert_eq!(app.post("/models/validate", &json!({})).await.status, 200);
    let one = App::with(Limits { batches: 1, picture_wait: Duration::from_secs(60), ..Limits::default() }, 10).await;
    let batches: [Value; 4] = [1, 2, 3, 4].map(|seed| json!({ "seeds": [seed] }));
    let replies = futures_util::future::join_all(batches.iter().map(|body| one.post("/batches", body))).await;
    assert!(replies.iter().all(|reply| reply.status == 202));
}
