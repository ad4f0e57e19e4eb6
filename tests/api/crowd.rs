//! Many readers of the same changes: each change is read and serialised once, and a slow reader
//! keeps no events in memory.

use super::app::{App, contour, id};
use super::events::Stream;
use super::wire::Wire;
use axum::body::{Body, BodyDataStream, Bytes};
use axum::http::Request;
use futures_util::StreamExt;
use oviduct::http::Limits;
use serde_json::json;
use std::collections::BTreeSet;
use std::time::Duration;

const READERS: usize = 60;

fn limits() -> Limits {
    // Nothing is found by polling here, and nothing is held back.
    Limits { event_poll: Duration::from_secs(600), event_interval: Duration::ZERO, ..Limits::default() }
}

async fn open(app: &App, path: &str) -> BodyDataStream {
    app.start(Request::get(path).body(Body::empty()).unwrap()).await.into_body().into_data_stream()
}

/// The next piece that holds this text.
async fn piece(stream: &mut BodyDataStream, text: &str) -> Bytes {
    loop {
        let piece = tokio::time::timeout(Duration::from_secs(60), stream.next()).await.expect("it comes soon");
        let piece = piece.expect("the stream goes on").unwrap();
        if std::str::from_utf8(&piece).unwrap().contains(text) {
            return piece;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn all_readers_share_the_bytes_of_a_change() {
    let (app, wire) = Wire::app(limits(), None).await;
    let model = app.model(7).await;
    let mut streams = Vec::new();
    for n in 0..READERS {
        let path = if n % 2 == 0 { "/events".to_owned() } else { format!("{model}/events") };
        let mut stream = open(&app, &path).await;
        piece(&mut stream, "\"status\":\"queued\"").await;
        streams.push(stream);
    }
    let reads = wire.reads();
    let job = app.claim().await;
    let mut places = BTreeSet::new();
    for stream in &mut streams {
        places.insert(piece(stream, "\"status\":\"running\"").await.as_ptr() as usize);
    }
    assert_eq!(places.len(), 1, "one copy for {READERS} readers");
    app.beat(&job, 820, Some(&contour(820))).await;
    let mut places = BTreeSet::new();
    for stream in &mut streams {
        places.insert(piece(stream, "\"section\":{\"index\":82").await.as_ptr() as usize);
    }
    assert_eq!(places.len(), 1, "of contours too");
    assert!(wire.reads() - reads <= 4, "{} reads for {READERS} readers", wire.reads() - reads);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_that_lags_skips_to_the_newest_state() {
    let (app, _wire) = Wire::app(limits(), None).await;
    let model = app.model(7).await;
    let job = app.claim().await;
    app.beat(&job, 1, None).await;
    let mut slow =
        [Stream::open(&app, "/events", None).await, Stream::open(&app, &format!("{model}/events"), None).await];
    for stream in &mut slow {
        assert_eq!(stream.next().await.unwrap().data["status"], "running");
    }
    // This one reads all along, so that each change is published.
    let mut fast = Stream::open(&app, &format!("{model}/events"), None).await;
    for step in 2..=200 {
        app.beat(&job, step, None).await;
        while fast.next().await.unwrap().data["progress"]["step"] != step {}
    }
    for stream in &mut slow {
        let next = stream.next().await.unwrap();
        assert_eq!((next.name.as_str(), &next.data["progress"]["step"]), ("progress", &json!(200)));
        assert!(stream.silent(Duration::from_millis(100)).await, "and nothing besides");
    }
    app.finish(job, &[]).await;
    for stream in &mut slow {
        let end = stream.next().await.unwrap();
        assert_eq!((end.name.as_str(), &end.data["id"]), ("end", &json!(id(&model).to_string())));
    }
}
