//! Streams of some models: by id, label and batch; their first states, ends and cursors.

use super::app::{App, contour, id};
use super::events::{Event, Stream};
use oviduct::http::Limits;
use serde_json::{Value, json};
use std::time::Duration;

async fn app() -> App {
    App::with(Limits { event_interval: Duration::ZERO, ..Limits::default() }, 1000).await
}

async fn labelled(app: &App, seed: u64, labels: Value) -> String {
    let body = json!({ "seed": seed, "labels": labels, "reuse": false });
    app.post("/models", &body).await.location()
}

async fn cancel(app: &App, model: &str) {
    assert_eq!(app.post(&format!("{model}/cancel"), &json!({})).await.status, 200);
}

/// Name, status and model of an event.
fn brief(event: &Event) -> (String, String, String) {
    let text = |member: &str| event.data[member].as_str().unwrap().to_owned();
    (event.name.clone(), text("status"), format!("/models/{}", text("id")))
}

fn is(event: &Event, name: &str, status: &str, model: &str) {
    assert_eq!(brief(event), (name.to_owned(), status.to_owned(), model.to_owned()));
}

/// The rest of a stream that closes, and the last id that a browser would send after it.
async fn rest(mut stream: Stream) -> (Vec<Event>, String) {
    let mut events = Vec::new();
    while let Some(event) = stream.next().await {
        events.push(event);
    }
    let last = stream.last_id().unwrap();
    (events, last)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_of_ids_tells_their_states_and_ends_with_them() {
    let app = app().await;
    let [first, ended, other] = [app.model(1).await, app.model(2).await, app.model(3).await];
    cancel(&app, &ended).await;
    let none = "0197a3f2-7c11-7b9e-9d35-1f2e3c4b5a69";
    let path = format!("/events?ids={},{},{none}", id(&first), id(&ended));
    let mut stream = Stream::open(&app, &path, None).await;
    is(&stream.next().await.unwrap(), "status", "queued", &first);
    is(&stream.next().await.unwrap(), "end", "cancelled", &ended);
    let missing = stream.next().await.unwrap();
    assert_eq!((missing.name.as_str(), missing.data), ("end", json!({ "id": none, "status": "deleted" })));

    let job = app.claim().await;
    is(&stream.next().await.unwrap(), "status", "running", &first);
    // What happens to others is not told.
    let _other = app.claim().await;
    app.beat(&job, 820, Some(&contour(820))).await;
    assert_eq!(stream.until("section").await.data["section"]["index"], 82);
    app.finish(job, &[]).await;
    let (end, last) = rest(stream).await;
    assert_eq!(end.len(), 1, "{end:?}");
    is(&end[0], "end", "succeeded", &first);
    assert_eq!(app.get(&other).await.json()["status"], "running");

    // A browser stops after 204. The parameter stands in for the header, which takes precedence.
    for (path, header) in [
        (path.clone(), Some(last.as_str())),
        (path.clone(), Some(end[0].id.as_str())),
        (format!("{path}&last_event_id={last}"), None),
        (format!("{path}&last_event_id=nonsense"), Some(last.as_str())),
    ] {
        let headers: Vec<_> = header.iter().map(|last| ("last-event-id", *last)).collect();
        let again = app.get_with(&path, &headers).await;
        assert_eq!((again.status.as_u16(), again.body.len()), (204, 0), "{path}");
    }
    // Another process knows as much.
    let second = App::over(app.store.clone(), app.clock.clone(), Limits::default());
    assert_eq!(second.get_with(&path, &[("last-event-id", &last)]).await.status, 204);
    // A cursor of other models, or of none, does not count.
    for unknown in ["nonsense", last.split('-').next().unwrap(), &last.replace('-', "-0")] {
        let (events, last) = rest(Stream::open(&app, &path, Some(unknown)).await).await;
        assert_eq!(events.len(), 3, "{unknown}");
        assert_eq!(app.get_with(&path, &[("last-event-id", &last)]).await.status, 204);
    }
    // A client does not know that a model was deleted later, even if it is not the newest.
    app.delete(&first).await;
    let (events, _) = rest(Stream::open(&app, &path, Some(&last)).await).await;
    let mut deleted: Vec<_> =
        events.iter().filter(|event| event.data["status"] == "deleted").map(|e| brief(e).2).collect();
    deleted.sort_unstable();
    let mut expected = [first, format!("/models/{none}")];
    expected.sort_unstable();
    assert_eq!(deleted, expected);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_of_labels_goes_on() {
    let app = app().await;
    let _other = labelled(&app, 1, json!({ "study": "B" })).await;
    let done = labelled(&app, 2, json!({ "study": "A", "day": "1" })).await;
    cancel(&app, &done).await;
    let open = labelled(&app, 3, json!({ "study": "A", "day": "1" })).await;
    let path = "/events?label=study:A&label=day:1";
    let mut stream = Stream::open(&app, path, None).await;
    is(&stream.next().await.unwrap(), "status", "queued", &open);
    let _half = labelled(&app, 4, json!({ "study": "A" })).await;
    let new = labelled(&app, 5, json!({ "study": "A", "day": "1", "n": "5" })).await;
    is(&stream.next().await.unwrap(), "status", "queued", &new);
    app.delete(&new).await;
    is(&stream.next().await.unwrap(), "end", "deleted", &new);
    cancel(&app, &open).await;
    let end = stream.next().await.unwrap();
    is(&end, "end", "cancelled", &open);
    assert!(stream.silent(Duration::from_millis(150)).await, "it does not close");
    drop(stream);

    let later = labelled(&app, 6, json!({ "study": "A", "day": "1" })).await;
    let mut back = Stream::open(&app, path, Some(&end.id)).await;
    is(&back.next().await.unwrap(), "status", "queued", &later);
    assert!(back.silent(Duration::from_millis(150)).await, "and nothing that was known");
    drop(back);
    // An unknown cursor gives ended models too.
    let mut anew = Stream::open(&app, path, Some("nonsense")).await;
    let told = [anew.next().await.unwrap(), anew.next().await.unwrap(), anew.next().await.unwrap()];
    assert_eq!(told.each_ref().map(|event| brief(event).2), [later, done.clone(), open]);
    app.delete(&done).await;
    is(&anew.next().await.unwrap(), "end", "deleted", &done);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_of_a_batch_begins_with_all_its_models_and_ends_with_the_last() {
    let app = app().await;
    let batch = app.post("/batches", &json!({ "count": 230 })).await.json();
    let _other = app.model(1).await;
    let models: Vec<&str> = batch["models"].as_array().unwrap().iter().map(|id| id.as_str().unwrap()).collect();
    let path = format!("/events?batch={}", batch["id"].as_str().unwrap());
    let mut stream = Stream::open(&app, &path, None).await;
    let mut told = Vec::new();
    for _ in &models {
        told.push(stream.next().await.unwrap().data["id"].as_str().unwrap().to_owned());
    }
    told.sort_unstable();
    assert_eq!(told, models, "each once, over several pages");
    assert!(stream.silent(Duration::from_millis(150)).await, "and none again");
    for model in &models[1..] {
        cancel(&app, &format!("/models/{model}")).await;
    }
    app.delete(&format!("/models/{}", models[0])).await;
    let (events, last) = rest(stream).await;
    let ends: Vec<_> = events.iter().filter(|event| event.name == "end").collect();
    assert_eq!(ends.len(), models.len());
    assert_eq!(app.get_with(&path, &[("last-event-id", &last)]).await.status, 204);
}

#[tokio::test]
async fn bad_parameters_of_streams_are_named() {
    let app = app().await;
    let wrong = app.get("/events?ids=1&batch=2&label=x&view=y&colour=red").await;
    assert_eq!(
        (wrong.status.as_u16(), wrong.places()),
        (422, ["colour", "view", "ids", "batch", "label"].map(str::to_owned).to_vec())
    );
}
