//! Streams of events: order, whole states, resuming, thinning, ends.

use super::app::{App, contour, id};
use axum::body::{Body, BodyDataStream};
use axum::http::Request;
use futures_util::StreamExt;
use futures_util::future::BoxFuture;
use oviduct::clock::Clock;
use oviduct::http::Limits;
use oviduct::jobs::{Hook, Store, StoreError, StoreOptions};
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Longest wait for something that must happen.
const SOON: Duration = Duration::from_secs(60);

/// An event as a client reads it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Event {
    pub(super) name: String,
    pub(super) id: String,
    pub(super) data: Value,
}

/// A connection to a stream.
pub(super) struct Stream {
    body: BodyDataStream,
    text: String,
    comments: Vec<String>,
    last_id: Option<String>,
}

impl Stream {
    pub(super) async fn open(app: &App, path: &str, last: Option<&str>) -> Self {
        let mut request = Request::get(path).header("accept", "text/event-stream");
        if let Some(last) = last {
            request = request.header("last-event-id", last);
        }
        let response = app.start(request.body(Body::empty()).unwrap()).await;
        assert_eq!(response.status(), 200);
        let headers = response.headers();
        assert!(headers["content-type"].to_str().unwrap().starts_with("text/event-stream"));
        assert_eq!(
            (&headers["cache-control"], &headers["x-accel-buffering"]),
            (&"no-cache".parse().unwrap(), &"no".parse().unwrap())
        );
        Self { body: response.into_body().into_data_stream(), text: String::new(), comments: vec![], last_id: None }
    }

    /// The next event; `None` if the stream has closed.
    pub(super) async fn next(&mut self) -> Option<Event> {
        tokio::time::timeout(SOON, self.read()).await.expect("an event comes soon")
    }

    async fn read(&mut self) -> Option<Event> {
        loop {
            while let Some(end) = self.text.find("\n\n") {
                let block: String = self.text.drain(..end + 2).collect();
                let field = |name: &str| block.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
                // Also of a block without an event.
                self.last_id = field("id").map(str::to_owned).or(self.last_id.take());
                match field("event") {
                    Some(name) => {
                        return Some(Event {
                            name: name.into(),
                            id: field("id").unwrap().into(),
                            data: serde_json::from_str(field("data").unwrap()).unwrap(),
                        });
                    }
                    None => self.comments.push(block),
                }
            }
            let chunk = self.body.next().await?.unwrap();
            self.text.push_str(std::str::from_utf8(&chunk).unwrap());
        }
    }

    /// The id that a browser would send when it reconnects.
    pub(super) fn last_id(&self) -> Option<String> {
        self.last_id.clone()
    }

    /// The next event of this name.
    pub(super) async fn until(&mut self, name: &str) -> Event {
        loop {
            let event = self.next().await.unwrap_or_else(|| panic!("the stream closed before {name}"));
            if event.name == name {
                return event;
            }
        }
    }

    pub(super) async fn silent(&mut self, time: Duration) -> bool {
        tokio::time::timeout(time, self.read()).await.is_err()
    }
}

async fn app() -> App {
    App::with(Limits { event_interval: Duration::from_millis(100), ..Limits::default() }, 100).await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_model_is_followed_from_the_queue_to_its_end() {
    let app = app().await;
    let model = app.model(7).await;
    let path = format!("{model}/events");
    let mut stream = Stream::open(&app, &path, None).await;
    let first = stream.next().await.unwrap();
    let summary = format!("{model}?view=summary");
    assert_eq!((first.name.as_str(), &first.data), ("status", &app.get(&summary).await.json()), "at once");
    assert_eq!(first.id, first.data["version"].to_string());

    let job = app.claim().await;
    let running = stream.next().await.unwrap();
    assert_eq!((running.name.as_str(), &running.data["status"]), ("status", &json!("running")));

    app.beat(&job, 820, Some(&contour(820))).await;
    let progress = stream.until("progress").await;
    assert_eq!(progress.data["progress"]["step"], 820);
    assert!(progress.data.get("section").is_none());
    let section = stream.until("section").await;
    assert_eq!((&section.data["section"]["index"], &section.data["status"]), (&json!(82), &json!("running")));
    assert_eq!(section.data["section"]["outer"][0], json!([250.5, 0.0]));

    app.finish(job, &[("model.glb", "model/gltf-binary", b"glTF".to_vec())]).await;
    let end = stream.until("end").await;
    assert_eq!((&end.data["status"], &end.data["files"][0]["name"]), (&json!("succeeded"), &json!("model.glb")));
    // References are relative to the address of the stream, and to that of the model.
    let mut same = app.get(&summary).await.json();
    let href = end.data["files"][0]["href"].clone();
    assert_eq!(href.as_str(), Some(&*format!("../{}", same["files"][0]["href"].as_str().unwrap())));
    same["files"][0]["href"] = href;
    assert_eq!(end.data, same);
    assert_eq!(stream.next().await, None, "the stream closes after the end");

    // A stream of an ended model ends at once.
    for last in [None, Some("1"), Some("nonsense")] {
        let mut late = Stream::open(&app, &path, last).await;
        assert_eq!(late.next().await.unwrap(), end);
        assert_eq!(late.next().await, None);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_spec_is_sent_only_on_request() {
    let app = app().await;
    let model = app.model(7).await;
    let whole = app.get(&model).await.json();
    assert!(whole["spec"].is_object());
    let mut short = whole.clone();
    short.as_object_mut().unwrap().remove("spec");
    for (path, list) in [(model.clone(), false), ("/models".into(), true)] {
        for (query, expected) in [("", &whole), ("?view=full", &whole), ("?view=summary", &short)] {
            let answer = app.get(&format!("{path}{query}")).await.json();
            assert_eq!(if list { &answer["models"][0] } else { &answer }, expected, "{path}{query}");
        }
    }
    for path in ["/events".to_owned(), format!("{model}/events")] {
        for (query, expected) in [("", &short), ("?view=summary", &short), ("?view=full", &whole)] {
            let mut stream = Stream::open(&app, &format!("{path}{query}"), None).await;
            assert_eq!(&stream.next().await.unwrap().data, expected, "{path}{query}");
        }
        let wrong = app.get(&format!("{path}?view=all&colour=red")).await;
        assert_eq!((wrong.status.as_u16(), wrong.places()), (422, vec!["colour".to_owned(), "view".to_owned()]));
    }
}

/// Otherwise an `EventSource` reconnects every few seconds forever.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_has_the_end_of_a_model_gets_no_content() {
    let app = app().await;
    let model = app.model(7).await;
    let path = format!("{model}/events");
    let mut stream = Stream::open(&app, &path, None).await;
    app.post(&format!("{model}/cancel"), &json!({})).await;
    let end = stream.until("end").await;
    let again = app.get_with(&path, &[("last-event-id", &end.id)]).await;
    assert_eq!((again.status.as_u16(), again.body.len()), (204, 0));
    // Only with the last version: a model that has not ended may still change.
    let open = app.model(8).await;
    let version = app.get(&open).await.json()["version"].to_string();
    let mut stream = Stream::open(&app, &format!("{open}/events"), Some(&version)).await;
    assert_eq!(stream.next().await.unwrap().data["status"], "queued");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_reconnects_gets_only_what_is_newer() {
    let app = app().await;
    let model = app.model(7).await;
    let path = format!("{model}/events");
    let job = app.claim().await;
    let mut stream = Stream::open(&app, &path, None).await;
    let seen = stream.next().await.unwrap();
    drop(stream);

    app.beat(&job, 500, Some(&contour(500))).await;
    let mut back = Stream::open(&app, &path, Some(&seen.id)).await;
    let newer = back.next().await.unwrap();
    assert_eq!((newer.name.as_str(), &newer.data["progress"]["step"]), ("status", &json!(500)));
    let section = back.next().await.unwrap();
    assert_eq!(section.name, "section", "a reloaded page can draw at once");
    drop(back);

    let mut up_to_date = Stream::open(&app, &path, Some(&section.id)).await;
    assert!(up_to_date.silent(Duration::from_millis(150)).await);
    app.beat(&job, 600, None).await;
    assert_eq!(up_to_date.next().await.unwrap().data["progress"]["step"], 600);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn progress_is_thinned_and_the_last_state_always_comes() {
    let app = App::new().await;
    let model = app.model(7).await;
    let job = app.claim().await;
    let mut stream = Stream::open(&app, &format!("{model}/events"), None).await;
    stream.next().await.unwrap();
    let beats = async {
        for step in 1..=100 {
            app.beat(&job, step * 10, Some(&contour(step * 10))).await;
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    let watch = oviduct::clock::Stopwatch::start();
    let reading = async {
        let mut counts = [0, 0];
        loop {
            let event = stream.next().await.unwrap();
            counts[usize::from(event.name == "section")] += 1;
            if event.data["progress"]["step"] == 1000 {
                return counts;
            }
        }
    };
    let ((), [progress, sections]) = tokio::join!(beats, reading);
    let most = (watch.seconds() * 4.0).ceil() as u32 + 1;
    assert!((2..=most).contains(&progress), "{progress} progress events in {} s", watch.seconds());
    assert!(sections <= most, "{sections} section events");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_deleted_model_ends_its_streams() {
    let app = app().await;
    for claimed in [false, true] {
        let model = app.model(7).await;
        let job = if claimed { Some(app.claim().await) } else { None };
        let mut stream = Stream::open(&app, &format!("{model}/events"), None).await;
        stream.next().await.unwrap();
        assert_eq!(app.delete(&model).await.status, 204);
        let end = stream.until("end").await;
        assert_eq!(end.data, json!({ "id": id(&model).to_string(), "status": "deleted" }));
        assert_eq!(stream.next().await, None);
        assert_eq!(app.get(&format!("{model}/events")).await.status, 404);
        drop(job);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cancelled_model_ends_its_streams() {
    let app = app().await;
    let model = app.model(7).await;
    let mut stream = Stream::open(&app, &format!("{model}/events"), None).await;
    app.post(&format!("{model}/cancel"), &json!({})).await;
    assert_eq!(stream.until("end").await.data["status"], "cancelled");
    assert_eq!(stream.next().await, None);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn moving_up_in_the_queue_is_reported() {
    let app = App::with(Limits { event_poll: Duration::from_millis(50), ..Limits::default() }, 10).await;
    let (_first, second) = (app.model(1).await, app.model(2).await);
    let mut stream = Stream::open(&app, &format!("{second}/events"), None).await;
    assert_eq!(stream.next().await.unwrap().data["queue"]["position"], 1);
    let _job = app.claim().await;
    assert_eq!(stream.next().await.unwrap().data["queue"]["position"], 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn all_models_are_followed_on_one_connection() {
    let app = app().await;
    let before = app.model(1).await;
    let done = app.model(2).await;
    app.post(&format!("{done}/cancel"), &json!({})).await;
    let mut stream = Stream::open(&app, "/events", None).await;
    let first = stream.next().await.unwrap();
    assert_eq!(
        (first.name.as_str(), &first.data),
        ("status", &app.get(&format!("{before}?view=summary")).await.json()),
        "at once"
    );

    let later = app.model(3).await;
    // The end of the cancelled model may still come.
    let new = stream.until("status").await;
    assert_eq!((new.name.as_str(), &new.data["id"]), ("status", &json!(id(&later).to_string())));

    let job = app.claim().await;
    assert_eq!(stream.until("status").await.data["status"], "running");
    app.beat(&job, 10, Some(&contour(10))).await;
    assert_eq!(stream.until("section").await.data["section"]["index"], 1);
    app.finish(job, &[]).await;
    assert_eq!(stream.until("end").await.data["status"], "succeeded");

    app.delete(&later).await;
    let end = stream.until("end").await;
    assert_eq!(end.data, json!({ "id": id(&later).to_string(), "status": "deleted" }));
    let cursor = end.id;
    drop(stream);

    // A client that reconnects gets each model that has changed since, once, in its present state.
    let missed = app.model(4).await;
    let _job = app.claim().await;
    let mut back = Stream::open(&app, "/events", Some(&cursor)).await;
    let event = back.next().await.unwrap();
    assert_eq!((&event.data["id"], &event.data["status"]), (&json!(id(&missed).to_string()), &json!("running")));
    assert!(back.silent(Duration::from_millis(150)).await, "and nothing that was known");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_unknown_cursor_gives_the_state_of_all_models() {
    let app = app().await;
    let open = app.model(1).await;
    let ended = app.model(2).await;
    app.post(&format!("{ended}/cancel"), &json!({})).await;
    for cursor in ["0", "1234-5", "nonsense"] {
        let mut stream = Stream::open(&app, "/events", Some(cursor)).await;
        let told = [stream.next().await.unwrap(), stream.next().await.unwrap()];
        let told: Vec<_> = told.iter().map(|e| (e.name.as_str(), e.data["id"].as_str().unwrap().to_owned())).collect();
        assert_eq!(told, [("status", id(&open).to_string()), ("end", id(&ended).to_string())], "{cursor}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_silent_stream_sends_comments() {
    let app = App::with(Limits { event_comment: Duration::from_millis(50), ..Limits::default() }, 10).await;
    let mut stream = Stream::open(&app, "/events", None).await;
    let comments = async {
        while stream.comments.len() < 3 {
            assert!(stream.silent(Duration::from_millis(50)).await, "an event came");
        }
    };
    tokio::time::timeout(SOON, comments).await.expect("comments come soon");
    assert!(stream.comments.iter().all(|c| c.starts_with(':') || c.starts_with("id: ")));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn streams_end_with_the_connection_and_with_the_service() {
    let app = app().await;
    let model = app.model(1).await;
    let mut streams = Vec::new();
    for path in [format!("{model}/events"), "/events".to_owned()] {
        let mut stream = Stream::open(&app, &path, None).await;
        stream.next().await.unwrap();
        streams.push(stream);
    }
    assert_eq!(app.open_streams(), 2);
    drop(streams.pop());
    for _ in 0..6000 {
        if app.open_streams() == 1 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(app.open_streams(), 1);
    app.shutdown.cancel();
    assert_eq!(streams[0].next().await, None);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn there_is_a_limit_to_open_streams() {
    let app = App::with(Limits { streams: 1, ..Limits::default() }, 10).await;
    app.expect_faults();
    let stream = Stream::open(&app, "/events", None).await;
    let refused = app.get("/events").await;
    assert_eq!((refused.status.as_u16(), refused.slug().as_str()), (503, "too-many-streams"));
    assert!(refused.header("retry-after").is_some());
    drop(stream);
}

/// Panics in the first call of `get` after it is armed.
struct PanicsOnce(std::sync::atomic::AtomicBool);

impl Hook for PanicsOnce {
    fn before<'a>(&'a self, call: &'static str) -> BoxFuture<'a, Result<(), StoreError>> {
        let is_due = call == "get" && self.0.swap(false, Ordering::SeqCst);
        assert!(!is_due, "on purpose");
        Box::pin(async { Ok(()) })
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn streams_continue_after_a_panic_of_the_publication() {
    let hook = Arc::new(PanicsOnce(std::sync::atomic::AtomicBool::new(false)));
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let store = Store::open_in_memory(StoreOptions { clock: clock.clone(), ..StoreOptions::default() }).await.unwrap();
    let limits = Limits { event_poll: Duration::from_millis(50), ..Limits::default() };
    let app = App::over(store.with_hook(Arc::<PanicsOnce>::clone(&hook)), clock, limits);
    let model = app.model(7).await;
    let mut stream = Stream::open(&app, &format!("{model}/events"), None).await;
    assert_eq!(stream.next().await.unwrap().data["status"], "queued");
    hook.0.store(true, Ordering::SeqCst);
    while hook.0.load(Ordering::SeqCst) {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    app.store.cancel(id(&model)).await.unwrap();
    assert_eq!(stream.next().await.unwrap().data["status"], "cancelled");
    let text = String::from_utf8(app.get("/metrics").await.body.to_vec()).unwrap();
    assert!(text.lines().any(|line| line == "oviduct_task_panics_total{task=\"events\"} 1"), "{text}");
}
