//! Against small servers that misbehave in one way each.

use super::*;
use axum::Router;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use axum::routing::{get, post};
use serde_json::json;
use std::sync::{Arc, Mutex};

async fn serve(router: Router) -> Client {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let url = format!("http://{}/", listener.local_addr().expect("an address"));
    tokio::spawn(async move { axum::serve(listener, router).await });
    Client::new(&url).expect("an address")
}

fn stream(text: &'static str) -> axum::response::Response {
    ([("content-type", "text/event-stream")], Body::from(text)).into_response()
}

/// Answers in turn: a stream that breaks off, an error, a stream to the end; remembers the `Last-Event-ID` of each.
async fn events(State(seen): State<Arc<Mutex<Vec<String>>>>, headers: HeaderMap) -> axum::response::Response {
    let last = headers.get("last-event-id").map_or("-", |v| v.to_str().expect("ASCII")).to_owned();
    let mut seen = seen.lock().expect("not poisoned");
    seen.push(last);
    match seen.len() {
        1 => stream(
            "event: status\nid: 3\ndata: {\"id\":\"x\",\"status\":\"queued\",\"queue\":{\"position\":2}}\n\n\
             event: section\nid: 4\ndata: {\"inner\":[]}\n\nevent: progress\nid: 5\ndata: {\"id\":",
        ),
        2 => StatusCode::BAD_GATEWAY.into_response(),
        _ => stream("event: end\nid: 9\ndata: {\"id\":\"x\",\"status\":\"succeeded\"}\n\n"),
    }
}

#[tokio::test]
async fn following_goes_on_where_it_was_interrupted() {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let client = serve(Router::new().route("/models/x/events", get(events)).with_state(seen.clone())).await;
    let mut heard = Vec::new();
    client
        .follow("x", |followed| {
            heard.push(match followed {
                Followed::Model(model) => model.status.clone(),
                Followed::Away => "away".to_owned(),
            });
        })
        .await
        .expect("ends");
    assert_eq!(heard, ["queued", "away", "away"]);
    assert_eq!(*seen.lock().expect("not poisoned"), ["-", "4", "4"]);
}

#[tokio::test]
async fn following_what_is_not_there_fails_at_once() {
    let deleted = || async { stream("event: end\ndata: {\"status\":\"deleted\"}\n\n") };
    let client = serve(Router::new().route("/models/y/events", get(deleted))).await;
    for id in ["x", "y"] {
        let failure = client.follow(id, |_| panic!("nothing to hear")).await.expect_err("fails");
        assert_eq!(failure.report().0, 1);
    }
}

#[tokio::test]
async fn faults_of_a_request_are_named() {
    let refuse = || async {
        let problem = json!({ "title": "Invalid", "errors": [
            { "pointer": "/spec/steps", "detail": "must be an integer" }, { "pointer": "/seed", "detail": "negative" }
        ]});
        (StatusCode::UNPROCESSABLE_ENTITY, axum::Json(problem))
    };
    let full = || async { (StatusCode::TOO_MANY_REQUESTS, axum::Json(json!({ "title": "The queue is full" }))) };
    let client = serve(Router::new().route("/models", post(refuse)).route("/models/x", get(full))).await;
    let failure = client.submit(&json!({}), "k").await.expect_err("refused");
    let lines = vec!["error: /spec/steps: must be an integer".to_owned(), "error: /seed: negative".to_owned()];
    assert_eq!(failure.report(), (2, lines));
    let (code, lines) = client.model("x").await.expect_err("refused").report();
    assert_eq!((code, lines[0].contains("429") && lines[0].contains("The queue is full")), (1, true), "{lines:?}");
}

#[tokio::test]
async fn files_are_proven_and_saved_whole_or_not_at_all() {
    let client = serve(Router::new().route("/f", get(|| async { "abc" }))).await;
    let right = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    let file = |name: &str, bytes, sha256: &str| {
        json!({ "id": "x", "status": "succeeded",
                "files": [{ "name": name, "bytes": bytes, "sha256": sha256, "href": "/f" }] })
    };
    let dir = tempfile::tempdir().expect("a folder");
    for (name, bytes, sha256, good) in [
        ("a.glb", 3, right, true),
        ("b.glb", 4, right, false),
        ("c.glb", 3, &right.replace('b', "c"), false),
        ("../d.glb", 3, right, false),
        (".hidden", 3, right, false),
    ] {
        let model: Model = serde_json::from_value(file(name, bytes, sha256)).expect("a model");
        assert_eq!(client.download(&model, dir.path()).await.is_ok(), good, "{name}");
    }
    let left: Vec<_> = std::fs::read_dir(dir.path()).expect("there").map(|e| e.expect("read").file_name()).collect();
    assert_eq!(left, ["a.glb"]);
}

#[test]
fn addresses() {
    assert_eq!(Client::new("http://h:1/").expect("good").address("/models"), "http://h:1/models");
    for wrong in ["h:1", "ftp://h", "", "http://"] {
        assert!(matches!(Client::new(wrong), Err(Failure::Usage(_))), "{wrong}");
    }
}
