//! The client against small servers, each with one fault.

use super::*;
use axum::Router;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use axum::routing::{get, post};
use serde_json::json;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use tokio::time::timeout;

async fn serve(router: Router) -> Client {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let url = format!("http://{}/", listener.local_addr().expect("an address"));
    tokio::spawn(async move { axum::serve(listener, router).await });
    let retries = Retries { most: 4, wait: Duration::from_millis(1) };
    Client { retries, ..Client::new(&url, None).expect("a URL") }
}

fn stream(text: &'static str) -> axum::response::Response {
    ([("content-type", "text/event-stream")], Body::from(text)).into_response()
}

/// Answers in turn: a stream that is cut off, an error, a whole stream; records the `Last-Event-ID`
/// of each request.
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
async fn following_resumes_after_an_interruption() {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let client = serve(Router::new().route("/models/x/events", get(events)).with_state(seen.clone())).await;
    let mut heard = Vec::new();
    client
        .follow("x", |followed| {
            heard.push(match followed {
                Followed::Model(model) => model.status.clone(),
                Followed::Disconnected => "away".to_owned(),
            });
        })
        .await
        .expect("ends");
    assert_eq!(heard, ["queued", "away", "away"]);
    assert_eq!(*seen.lock().expect("not poisoned"), ["-", "4", "4"]);
}

#[tokio::test]
async fn following_a_missing_or_deleted_model_fails_at_once() {
    let deleted = || async { stream("event: end\ndata: {\"status\":\"deleted\"}\n\n") };
    let client = serve(Router::new().route("/models/y/events", get(deleted))).await;
    for id in ["x", "y"] {
        let failure = client.follow(id, |_| panic!("there is no event")).await.expect_err("fails");
        assert_eq!(failure.report().0, 1);
    }
}

/// Counts the requests, and answers each with `answer`.
fn counted<R: IntoResponse + Send + 'static>(answer: fn() -> R) -> (Router, Arc<AtomicU32>) {
    let requests = Arc::new(AtomicU32::new(0));
    let count = Arc::clone(&requests);
    let handler = move || {
        count.fetch_add(1, Ordering::Relaxed);
        async move { answer() }
    };
    (Router::new().route("/models/x/events", get(handler)), requests)
}

#[tokio::test]
async fn following_gives_up_when_no_answer_holds_anything_new() {
    let snapshot = || stream("event: status\nid: 3\ndata: {\"id\":\"x\",\"status\":\"queued\"}\n\n");
    let cases = [
        // The same snapshot on every connection is new only once.
        (counted(|| stream("")), 5, "closed before the model ended"),
        (counted(snapshot), 5, "closed before the model ended"),
        (counted(|| StatusCode::BAD_GATEWAY.into_response()), 5, "502"),
    ];
    for ((router, requests), most, reason) in cases {
        let client = serve(router).await;
        let followed = timeout(Duration::from_secs(30), client.follow("x", |_| {})).await.expect("it gives up");
        let (code, lines) = followed.expect_err("it fails").report();
        assert_eq!(code, 1);
        assert!(lines[0].contains("no new event of model x") && lines[0].contains(reason), "{lines:?}");
        let requests = requests.load(Ordering::Relaxed);
        assert_eq!(requests, most, "{reason}");
    }
}

#[tokio::test]
async fn no_content_means_that_the_model_has_ended() {
    let (router, requests) = counted(|| StatusCode::NO_CONTENT);
    let client = serve(router).await;
    client.follow("x", |_| panic!("there is no event")).await.expect("it has ended");
    assert_eq!(requests.load(Ordering::Relaxed), 1);
}

#[tokio::test]
async fn errors_have_kinds() {
    let refuse = || async { StatusCode::SERVICE_UNAVAILABLE };
    let odd = || async { "not JSON" };
    let client = serve(Router::new().route("/models/a", get(refuse)).route("/models/b", get(odd))).await;
    let kind = async |id| ErrorKind::of(&client.model(id).await.expect_err("fails"));
    assert_eq!(kind("a").await, ErrorKind::Status(503));
    assert_eq!(kind("b").await, ErrorKind::Other);
    assert_eq!(kind("c").await, ErrorKind::Status(404));
    // Nobody listens on a port that was just closed.
    let port = std::net::TcpListener::bind("127.0.0.1:0").expect("a port").local_addr().expect("bound").port();
    let nobody = Client::new(&format!("http://127.0.0.1:{port}"), None).expect("a URL");
    assert_eq!(ErrorKind::of(&nobody.model("x").await.expect_err("fails")), ErrorKind::Connection);
    assert_eq!(ErrorKind::of(&Failure::from(ServiceError::Silent)), ErrorKind::Timeout);
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
async fn files_are_saved_only_if_they_match_their_hash() {
    let manifest = || async { axum::Json(json!({ "preset": "pig", "seed": 7, "digest": "d", "files": [] })) };
    let router = Router::new().route("/f", get(|| async { "abc" })).route("/models/x/manifest.json", get(manifest));
    let client = serve(router).await;
    let right = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    let file = |name: &str, bytes, sha256: &str| {
        json!({ "id": "x", "status": "succeeded",
                "files": [{ "name": name, "bytes": bytes, "sha256": sha256, "href": client.address("/f") }] })
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
        assert_eq!(client.download(&model, dir.path(), false).await.is_ok(), good, "{name}");
    }
    let mut left: Vec<_> =
        std::fs::read_dir(dir.path()).expect("there").map(|e| e.expect("read").file_name()).collect();
    left.sort();
    assert_eq!(left, ["a.glb", "manifest.json"]);
}

#[tokio::test]
async fn the_key_is_sent_with_every_request() {
    let id = |headers: HeaderMap| async move {
        let sent = headers.get("authorization").map_or("-", |v| v.to_str().expect("ASCII")).to_owned();
        axum::Json(json!({ "id": sent, "status": "queued" }))
    };
    let client = serve(Router::new().route("/models", post(id)).route("/models/x", get(id))).await;
    assert_eq!(client.model("x").await.expect("answered")["id"], "-");
    let key = "s3cret".parse().expect("any text");
    let client = Client::new(&client.base, Some(&key)).expect("valid");
    assert_eq!(client.model("x").await.expect("answered")["id"], "Bearer s3cret");
    assert_eq!(client.submit(&json!({}), "k").await.expect("answered")["id"], "Bearer s3cret");
    assert!(!format!("{client:?}").contains("s3cret"), "{client:?}");
}

#[test]
fn addresses() {
    assert_eq!(Client::new("http://h:1/", None).expect("good").address("/models"), "http://h:1/models");
    for wrong in ["h:1", "ftp://h", "", "http://"] {
        assert!(matches!(Client::new(wrong, None), Err(Failure::Usage(_))), "{wrong}");
    }
}
