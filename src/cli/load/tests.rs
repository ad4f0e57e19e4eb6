//! Loads against small servers, each with one fault.

use super::*;
use axum::extract::{Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use serde_json::json;
use std::collections::HashMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;
use tokio::sync::RwLock;
use tokio::task::JoinHandle;

/// A load with these options, started by the same parser as on the command line.
async fn load(url: &str, options: &str) -> Result<Report, Failure> {
    #[derive(Debug, clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: LoadArgs,
    }
    let line = ["load", "--url", url, "--seed", "1", "--warm-up", "0"].into_iter().chain(options.split_whitespace());
    let Line { args } = clap::Parser::try_parse_from(line).expect("valid options");
    through_service(&args, 1, &mut Signals::listen()).await
}

/// A service of models that succeed at once.
#[derive(Clone, Default)]
struct Quick {
    accepted: Arc<Mutex<Vec<String>>>,
    /// Every answer waits while this is locked for writing.
    gate: Arc<RwLock<()>>,
    /// Answers every second request for a model with this.
    refusal: Option<StatusCode>,
    /// Requests for models so far.
    requests: Arc<AtomicU64>,
    /// Time that a request for a model takes.
    slow: Duration,
    /// Forgets the models that it has accepted.
    forgets: bool,
}

async fn create(State(quick): State<Quick>) -> Response {
    drop(quick.gate.read().await);
    tokio::time::sleep(quick.slow).await;
    if let (Some(status), 1) = (quick.refusal, quick.requests.fetch_add(1, Ordering::Relaxed) % 2) {
        return (status, Json(json!({ "title": "Not now" }))).into_response();
    }
    let id = uuid::Uuid::now_v7().to_string();
    quick.accepted.lock().unwrap().push(id.clone());
    let answer = (StatusCode::ACCEPTED, Json(json!({ "id": id, "status": "queued" })));
    // So that the server can be stopped with its listener.
    ([("connection", "close")], answer).into_response()
}

async fn list(State(quick): State<Quick>, Query(query): Query<HashMap<String, String>>) -> Json<serde_json::Value> {
    let ended = !quick.forgets && query.get("status").is_none_or(|status| status == "succeeded");
    let model = |id: &String| {
        json!({ "id": id, "status": "succeeded", "created_at": "2026-11-21T09:00:00Z",
                "started_at": "2026-11-21T09:00:01Z", "finished_at": "2026-11-21T09:00:02Z" })
    };
    let models: Vec<_> = quick.accepted.lock().unwrap().iter().filter(|_| ended).map(model).collect();
    Json(json!({ "models": models, "next": null }))
}

/// Serves on this address, or on a free port; returns the URL.
async fn serve(quick: Quick, address: &str) -> (String, JoinHandle<()>) {
    let listener = TcpListener::bind(address).await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let router = Router::new().route("/models", get(list).post(create)).with_state(quick);
    (url, tokio::spawn(async move { axum::serve(listener, router).await.unwrap() }))
}

const FREE: &str = "127.0.0.1:0";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stall_of_the_service_shows_in_the_percentiles_of_an_open_loop() {
    let quick = Quick::default();
    let (url, _server) = serve(quick.clone(), FREE).await;
    let stall = tokio::spawn(async move {
        tokio::time::sleep(Duration::from_millis(700)).await;
        let _closed = quick.gate.write().await;
        tokio::time::sleep(Duration::from_millis(300)).await;
    });
    let report = load(&url, "--rate 200/s --arrivals uniform --duration 2s --mix submit=1").await.unwrap();
    stall.await.unwrap();
    let calls = &report.calls[&Call::Submit];
    // The stall changed neither the number of calls nor their times: 60 of 400 were due while it
    // lasted.
    assert_eq!((calls.due, calls.answered, calls.dropped), (400, 400, 0));
    assert!((0.27..1.0).contains(&Times::of(&calls.latency).p99), "{:?}", Times::of(&calls.latency));
    assert!(
        Times::of(&calls.latency).p90 > 0.05 && Times::of(&calls.latency).p50 < 0.2,
        "{:?}",
        Times::of(&calls.latency)
    );
    let models = report.models.as_ref().unwrap();
    assert_eq!((models.models, models.succeeded, models.missing, report.failed()), (400, 400, 0, false));
    assert!((models.queue_wait.p50 - 1.0).abs() < 0.01 && (models.end_to_end.p50 - 2.0).abs() < 0.01, "{models:?}");
    assert!(report.timeline.len() == 2 && report.timeline.iter().map(|second| second.calls).sum::<u64>() == 400);
}

/// Answers the connections in turn: with status 500, by closing, with nonsense instead of HTTP,
/// with nonsense instead of JSON, with a body that breaks off.
async fn serve_faults() -> String {
    const FAULTS: [&str; 5] = [
        "HTTP/1.1 500 Internal Server Error\r\ncontent-length: 0\r\nconnection: close\r\n\r\n",
        "",
        "hello\r\n\r\n",
        "HTTP/1.1 202 Accepted\r\ncontent-length: 8\r\nconnection: close\r\n\r\nnot JSON",
        "HTTP/1.1 202 Accepted\r\ncontent-length: 999\r\nconnection: close\r\n\r\n{\"id\":",
    ];
    let listener = TcpListener::bind(FREE).await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    tokio::spawn(async move {
        for fault in FAULTS.into_iter().cycle() {
            let (mut stream, _) = listener.accept().await.unwrap();
            tokio::spawn(async move {
                // The whole request fits into one segment of the loopback interface.
                let _ = stream.read(&mut [0; 4096]).await;
                let _ = stream.write_all(fault.as_bytes()).await;
                let _ = stream.shutdown().await;
            });
        }
    });
    url
}

#[tokio::test]
async fn every_fault_of_the_service_is_counted_and_none_ends_the_run() {
    let url = serve_faults().await;
    let report = load(&url, "--rate 100 --arrivals uniform --duration 1s --mix submit=1").await.unwrap();
    let calls = &report.calls[&Call::Submit];
    assert_eq!((calls.due, calls.answered, calls.errors.total, report.failed()), (100, 0, 100, true));
    assert_eq!(report.errors.counts(), "status 500 20, connection 60, other 20");
    // Errors are not answers.
    assert_eq!(Times::of(&calls.latency).max, 0.0);
    assert!(report.models.is_none(), "{:?}", report.models);
    let text = text::lines(&report).join("\n");
    assert!(text.contains("submit: of 100 calls 100 met an error") && text.contains("could not be read"), "{text}");

    let report = load(&url, "--models 10 --concurrency 5").await.unwrap();
    assert_eq!((report.calls[&Call::Submit].errors.total, report.failed()), (10, true));
    let report = load(&url, "--mix get=1,list=3 --concurrency 2 --duration 1s").await.unwrap();
    let (get, list) = (&report.calls[&Call::Get], &report.calls[&Call::List]);
    assert!(get.due > 0 && get.skipped == get.due && list.errors.total == list.due, "{report:?}");
}

#[tokio::test]
async fn a_restart_of_the_service_is_ridden_out() {
    let quick = Quick::default();
    let (url, server) = serve(quick.clone(), FREE).await;
    let address = url.trim_start_matches("http://").to_owned();
    let restart = tokio::spawn(async move {
        tokio::time::sleep(Duration::from_millis(500)).await;
        server.abort();
        let _ = server.await;
        tokio::time::sleep(Duration::from_millis(500)).await;
        serve(quick, &address).await
    });
    let report = load(&url, "--rate 50 --arrivals uniform --duration 2s --mix submit=1").await.unwrap();
    let _server = restart.await.unwrap();
    let calls = &report.calls[&Call::Submit];
    // About a quarter of the calls were due while there was no service.
    assert_eq!((calls.due, calls.answered + calls.errors.total), (100, 100));
    assert!((10..=40).contains(&calls.errors.total), "{calls:?}");
    let models = report.models.as_ref().unwrap();
    assert_eq!((models.succeeded, models.missing, report.failed()), (calls.answered, 0, true));
}

#[tokio::test]
async fn a_request_that_is_refused_for_every_model_is_wrong_usage() {
    let refuse = || async {
        let problem = json!({ "title": "Invalid", "errors": [{ "pointer": "/spec/steps", "detail": "too many" }] });
        (StatusCode::UNPROCESSABLE_ENTITY, Json(problem))
    };
    let listener = TcpListener::bind(FREE).await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let router = Router::new().route("/models", axum::routing::post(refuse));
    tokio::spawn(async move { axum::serve(listener, router).await.unwrap() });
    for options in ["--rate 10 --duration 60s --mix submit=1", "--models 5"] {
        let Err(failure) = load(&url, options).await else { panic!("{options}") };
        assert_eq!(failure.report(), (2, vec!["error: /spec/steps: too many".to_owned()]));
    }
}

#[tokio::test]
async fn a_full_queue_is_counted_apart() {
    let quick = Quick { refusal: Some(StatusCode::TOO_MANY_REQUESTS), ..Quick::default() };
    let (url, _server) = serve(quick, FREE).await;
    let report = load(&url, "--rate 100 --arrivals uniform --duration 1s --mix submit=1").await.unwrap();
    let calls = &report.calls[&Call::Submit];
    assert_eq!((calls.due, calls.answered, calls.refused, calls.unfinished), (100, 50, 50, 0));
    assert_eq!((report.errors.total, report.failed()), (0, false));
    // Nothing was answered as it should be: a failure too.
    let (url, _server) = serve(Quick { forgets: true, ..Quick::default() }, FREE).await;
    let report = load(&url, "--rate 50 --duration 1s --mix download=1").await.unwrap();
    let calls = &report.calls[&Call::Download];
    assert!(calls.due > 0 && calls.skipped == calls.due && report.failed(), "{calls:?}");
}

#[tokio::test]
async fn calls_over_the_limit_in_flight_are_dropped_and_counted() {
    let quick = Quick { slow: Duration::from_millis(2500), ..Quick::default() };
    let (url, _server) = serve(quick, FREE).await;
    let options = "--rate 50 --arrivals uniform --duration 1s --mix submit=1 --max-in-flight 5";
    let report = load(&url, options).await.unwrap();
    let calls = &report.calls[&Call::Submit];
    assert_eq!((calls.due, calls.answered, calls.dropped, report.failed()), (50, 5, 45, true));
    let options = "--rate 50 --arrivals uniform --duration 1s --mix submit=1 --timeout 300ms";
    let report = load(&url, options).await.unwrap();
    let calls = &report.calls[&Call::Submit];
    assert_eq!((calls.answered, report.errors.counts()), (0, "timeout 50".to_owned()));
    assert!(Times::of(&calls.latency).p50 > 0.29, "a timeout is a latency too: {:?}", calls.latency);
}

#[tokio::test]
async fn a_model_that_the_service_no_longer_knows_is_missing() {
    let (url, _server) = serve(Quick { forgets: true, ..Quick::default() }, FREE).await;
    let report = load(&url, "--rate 20 --arrivals uniform --duration 1s --mix submit=1").await.unwrap();
    let models = report.models.as_ref().unwrap();
    assert_eq!((models.models, models.missing, report.failed()), (0, 20, true));
}

#[test]
fn options_that_cannot_be_met_are_refused() {
    let settings = |options: &str| {
        #[derive(Debug, clap::Parser)]
        struct Line {
            #[command(flatten)]
            args: LoadArgs,
        }
        let line = ["load"].into_iter().chain(options.split_whitespace());
        let Line { args } = clap::Parser::try_parse_from(line).expect("valid options");
        Settings::of(&args, args.model.of.seed.unwrap_or(1)).map_err(|failure| failure.report())
    };
    let Err((2, lines)) = settings("--models 2 --seed 9007199254740991") else { panic!("there is one seed") };
    assert!(lines[0].contains("--models 2") && lines[0].contains("only 1 seeds"), "{lines:?}");
    let Err((2, lines)) = settings("--rate 1 --max-in-flight 4000000000") else { panic!("too many descriptors") };
    assert!(lines[0].contains("ulimit -n"), "{lines:?}");
    let by_time = settings("--rate 5").unwrap();
    assert_eq!((by_time.length, by_time.warm_up, by_time.mix), (Some(LENGTH), WARM_UP, Some(Mix::default())));
    let by_number = settings("").unwrap();
    assert_eq!((by_number.length, by_number.seeds.left(), by_number.mix), (None, MODELS, None));
    assert_eq!(settings("--duration 9s --models 7").unwrap().seeds.left(), 7);
}
