//! Two services over one PostgreSQL: an event stream of one service shows the progress of a job
//! that a worker of the other runs.

use crate::bounds::best_of_five;
use crate::scripted::{Database, Place, generate, scripted};
use axum::body::Body;
use axum::http::{Request, StatusCode};
use http_body_util::BodyExt;
use oviduct::clock::Stopwatch;
use oviduct::generate::{CancelToken, Outcome, Progress, Sink, Stage};
use oviduct::http::{AppState, Limits, router};
use oviduct::worker::{GenerationInput, WorkError};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

/// Steps of the job, and the time between them: longer than the interval of progress events.
const STEPS: u32 = 8;
const STEP: Duration = Duration::from_millis(400);

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_stream_shows_what_another_process_does_within_half_a_second() {
    let dir = tempfile::tempdir().unwrap();
    let url = Database::Postgres.url(dir.path()).await;
    let (service, worker) = (Place::at(dir.path(), &url).await, Place::at(dir.path(), &url).await);
    let since = Stopwatch::start();
    let done: Arc<Mutex<BTreeMap<u32, f64>>> = Arc::default();
    let reported = Arc::clone(&done);
    let stepping =
        move |input: GenerationInput<'_>, sink: &dyn Sink, cancel: &CancelToken| -> Result<Outcome, WorkError> {
            for step in 1..=STEPS {
                reported.lock().unwrap().insert(step, since.seconds());
                let fraction = f64::from(step) / 100.0;
                let (stage, eta_seconds) = (Stage::Simulate, None);
                sink.progress(&Progress { stage, fraction, step, steps: 2000, particles: 8, sections: 1, eta_seconds });
                std::thread::sleep(STEP);
            }
            generate(input, sink, cancel)
        };
    // Polls and heartbeats are far apart and progress is written immediately, so only notifications
    // can be in time.
    let pool = worker.start_with(worker.store.clone(), Arc::new(stepping), |options| {
        options.heartbeat = Duration::from_secs(60);
        options.lease = Duration::from_secs(240);
        options.poll = Duration::from_secs(60);
    });
    tokio::time::sleep(Duration::from_millis(300)).await;

    let shutdown = CancellationToken::new();
    let (store, artifacts) = (service.store.clone(), service.artifacts.clone());
    let state = AppState::new(store, artifacts, Limits::default(), shutdown.clone());
    let router = router(state);
    best_of_five(async |seed| {
        done.lock().unwrap().clear();
        let id = service.store.submit(scripted("ok", seed)).await.unwrap().job().id;
        let request = Request::get(format!("/models/{id}/events")).header("host", "here").body(Body::empty()).unwrap();
        let response = router.clone().oneshot(request).await.unwrap();
        assert_eq!(response.status(), StatusCode::OK);
        let read = arrivals(response.into_body(), since);
        let arrived = tokio::time::timeout(Duration::from_secs(600), read).await.expect("the stream did not end");
        let done = done.lock().unwrap().clone();
        let mut delays: Vec<f64> = (1..=STEPS).filter_map(|step| Some(arrived.get(&step)? - done[&step])).collect();
        delays.sort_by(f64::total_cmp);
        eprintln!("delays of progress from one process to the stream of another: {delays:.3?} s");
        // A single late one is due to the load of the machine.
        if delays.len() < STEPS as usize - 1 {
            Err(format!("steps are missing: {arrived:?}"))
        } else if delays[delays.len() - 2] >= 0.5 {
            Err(format!("{delays:?}"))
        } else {
            Ok(())
        }
    })
    .await;
    shutdown.cancel();
    pool.shutdown(Duration::from_secs(5)).await;
}

/// Reads the stream of a model that succeeds to its end: when each step was first reported.
async fn arrivals(mut body: Body, since: Stopwatch) -> BTreeMap<u32, f64> {
    let (mut text, mut read, mut arrived) = (String::new(), 0, BTreeMap::new());
    while let Some(frame) = body.frame().await {
        let Ok(data) = frame.unwrap().into_data() else { continue };
        text.push_str(std::str::from_utf8(&data).unwrap());
        while let Some(length) = text[read..].find("\n\n") {
            let event = &text[read..read + length];
            read += length + 2;
            let Some(data) = event.lines().find_map(|line| line.strip_prefix("data: ")) else { continue };
            let model: serde_json::Value = serde_json::from_str(data).unwrap();
            if let Some(step) = model["progress"]["step"].as_u64().filter(|_| model["status"] == "running") {
                arrived.entry(step as u32).or_insert_with(|| since.seconds());
            }
        }
    }
    assert!(text.contains("event: end") && text.contains("\"succeeded\""), "{text}");
    arrived
}
