//! `oviduct load`: sends requests for many models to a service, or grows them in this process, and reports throughput,
//! latencies and errors. An error is counted, and the load goes on.

use super::args::LoadArgs;
use super::client::{Client, ErrorKind};
use super::exit::{Ended, Failure};
use super::{interrupt, model, submit, term};
use crate::clock::Stopwatch;
use crate::generate::{Backend, CancelToken, Output, Request, generate};
use crate::spec::ModelSpec;
use anyhow::Context;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::task::JoinSet;

/// A model that ended. Times are in seconds.
pub(super) struct One {
    /// From the first request to the answer that accepted it.
    accepted: f64,
    /// From the first request to its end.
    pub(super) ended: f64,
    pub(super) succeeded: bool,
    bytes: u64,
    /// Answers 429 before it was accepted.
    refused: u64,
}

/// A model without a known end.
#[derive(Debug)]
pub(super) struct Lost {
    kind: ErrorKind,
    pub(super) message: String,
}

impl From<Failure> for Lost {
    fn from(failure: Failure) -> Self {
        Self { kind: ErrorKind::of(&failure), message: failure.report().1.join("; ") }
    }
}

/// The result of a load. Times are in seconds.
#[derive(Debug, Serialize)]
struct Report {
    /// `service` or `direct`.
    mode: &'static str,
    /// Models that were requested: `succeeded`, `failed` and `errors` together.
    models: u64,
    succeeded: u64,
    /// Models that ended, but did not succeed.
    failed: u64,
    /// Answers 429; each request was repeated.
    refused: u64,
    errors: Errors,
    concurrency: u32,
    seconds: f64,
    /// Models that ended per second.
    models_per_second: f64,
    bytes: u64,
    accepted: Times,
    ended: Times,
}

/// Models without a known end, by the error that a request for them met.
#[derive(Debug, Default, PartialEq, Serialize)]
struct Errors {
    total: u64,
    /// Answers with an error status, by status.
    status: BTreeMap<u16, u64>,
    /// Connections that failed or were lost.
    connection: u64,
    /// Requests without an answer in time.
    timeout: u64,
    other: u64,
    /// The first message of each kind.
    examples: Vec<String>,
}

impl Errors {
    fn of<'a>(lost: impl Iterator<Item = &'a Lost>) -> Self {
        let (mut errors, mut first) = (Self::default(), BTreeMap::new());
        for Lost { kind, message } in lost {
            errors.total += 1;
            match kind {
                ErrorKind::Status(status) => *errors.status.entry(*status).or_default() += 1,
                ErrorKind::Connection => errors.connection += 1,
                ErrorKind::Timeout => errors.timeout += 1,
                ErrorKind::Other => errors.other += 1,
            }
            first.entry(*kind).or_insert(message);
        }
        errors.examples = first.into_values().cloned().collect();
        errors
    }
}

/// Distribution of a time.
#[derive(Debug, Default, Serialize)]
struct Times {
    p50: f64,
    p90: f64,
    p99: f64,
    max: f64,
}

impl Times {
    fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let last = times.len().saturating_sub(1);
            times.get((share * last as f64).round() as usize).copied().unwrap_or_default()
        };
        Self { p50: at(0.5), p90: at(0.9), p99: at(0.99), max: at(1.0) }
    }
}

pub(super) async fn run(args: LoadArgs) -> Ended {
    let json = args.json;
    let report = tokio::select! {
        report = load(args) => report?,
        () = interrupt::asked_to_stop() => return Err(Failure::Interrupted),
    };
    if json {
        term::print_json(&report)?;
    } else {
        for line in lines(&report) {
            term::print(&line)?;
        }
    }
    if report.succeeded == report.models { Ok(()) } else { Err(Failure::Negative) }
}

async fn load(args: LoadArgs) -> Result<Report, Failure> {
    let seeds = Seeds::new(args.model.seed.unwrap_or_else(|| uuid::Uuid::new_v4().as_u64_pair().1 >> 16), args.models);
    let watch = Stopwatch::start();
    let all = if args.direct {
        let (preset, spec) = model::resolve(&args.model)?;
        let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let model = Model {
            preset: preset.name.clone(),
            spec: Arc::new(spec),
            backend: args.model.backend,
            outputs: args.model.outputs.clone(),
        };
        direct(&model, seeds, args.concurrency, threads).await?
    } else {
        let body = submit::request(&args.model)?;
        through(&Client::new(&args.url)?, &body, seeds, args.concurrency).await?
    };
    let mode = if args.direct { "direct" } else { "service" };
    Ok(Report::of(mode, &all, args.concurrency, watch.seconds()))
}

impl Report {
    fn of(mode: &'static str, all: &[Result<One, Lost>], concurrency: u32, seconds: f64) -> Self {
        let ended: Vec<&One> = all.iter().filter_map(|one| one.as_ref().ok()).collect();
        let succeeded = ended.iter().filter(|one| one.succeeded).count() as u64;
        Self {
            mode,
            models: all.len() as u64,
            succeeded,
            failed: ended.len() as u64 - succeeded,
            refused: ended.iter().map(|one| one.refused).sum(),
            errors: Errors::of(all.iter().filter_map(|one| one.as_ref().err())),
            concurrency,
            seconds,
            models_per_second: ended.len() as f64 / seconds,
            bytes: ended.iter().map(|one| one.bytes).sum(),
            accepted: Times::of(ended.iter().map(|one| one.accepted).collect()),
            ended: Times::of(ended.iter().map(|one| one.ended).collect()),
        }
    }
}

/// Consecutive seeds, each taken once. Clones share them.
#[derive(Clone, Debug)]
pub(super) struct Seeds {
    next: Arc<AtomicU64>,
    end: u64,
}

impl Seeds {
    pub(super) fn new(first: u64, count: u64) -> Self {
        Self { next: Arc::new(AtomicU64::new(first)), end: first + count }
    }

    fn take(&self) -> Option<u64> {
        Some(self.next.fetch_add(1, Ordering::Relaxed)).filter(|seed| *seed < self.end)
    }
}

/// Requests the models of these seeds from a service, `concurrency` at a time.
///
/// # Errors
/// [`Failure::Usage`] if the request is invalid; [`Failure::Failed`] if a task panics.
pub(super) async fn through(
    client: &Client,
    body: &Value,
    seeds: Seeds,
    concurrency: u32,
) -> Result<Vec<Result<One, Lost>>, Failure> {
    let mut tasks = JoinSet::new();
    for _ in 0..concurrency {
        let (client, body, seeds) = (client.clone(), body.clone(), seeds.clone());
        tasks.spawn(async move {
            let mut done = Vec::new();
            while let Some(seed) = seeds.take() {
                match request(&client, &body, seed).await {
                    // An invalid request would be refused for every seed.
                    Err(faults @ Failure::Usage(_)) => return Err(faults),
                    other => done.push(other.map_err(Lost::from)),
                }
            }
            Ok(done)
        });
    }
    all_of(tasks).await
}

/// The models that [`direct`] grows.
#[derive(Clone, Debug)]
pub(super) struct Model {
    pub(super) preset: String,
    pub(super) spec: Arc<ModelSpec>,
    pub(super) backend: Backend,
    pub(super) outputs: Vec<Output>,
}

/// Grows the models of these seeds in this process, `concurrency` at a time, each on `threads` threads.
///
/// # Errors
/// If threads cannot be started, or a task panics.
pub(super) async fn direct(
    model: &Model,
    seeds: Seeds,
    concurrency: u32,
    threads: usize,
) -> Result<Vec<Result<One, Lost>>, Failure> {
    let mut tasks = JoinSet::new();
    for _ in 0..concurrency {
        let (model, seeds) = (model.clone(), seeds.clone());
        tasks.spawn_blocking(move || {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let pool = pool.context("the threads could not be started")?;
            let one = |seed| pool.install(|| grow(&model, seed)).map_err(Lost::from);
            Ok(std::iter::from_fn(|| seeds.take()).map(one).collect())
        });
    }
    all_of(tasks).await
}

async fn all_of<T: 'static>(mut tasks: JoinSet<Result<Vec<T>, Failure>>) -> Result<Vec<T>, Failure> {
    let mut all = Vec::new();
    while let Some(done) = tasks.join_next().await {
        all.extend(done.context("a task panicked")??);
    }
    Ok(all)
}

/// Requests one model from the service and waits for its end.
async fn request(client: &Client, body: &Value, seed: u64) -> Result<One, Failure> {
    let mut body = body.clone();
    body["seed"] = json!(seed);
    body["reuse"] = json!(false);
    let watch = Stopwatch::start();
    let key = uuid::Uuid::now_v7().to_string();
    let (accepted, refused) = client.submit_patiently(&body, &key).await?;
    let accepted_after = watch.seconds();
    let ended = client.wait_for(&submit::read(&accepted)?.id).await?;
    let model = submit::read(&ended)?;
    Ok(One {
        accepted: accepted_after,
        ended: watch.seconds(),
        succeeded: model.status == "succeeded",
        bytes: model.files.iter().map(|file| file.bytes).sum(),
        refused,
    })
}

/// Grows one model in this process.
fn grow(model: &Model, seed: u64) -> Result<One, Failure> {
    let dir = std::env::temp_dir().join(format!("oviduct-load-{}", uuid::Uuid::now_v7()));
    std::fs::create_dir(&dir).with_context(|| dir.display().to_string())?;
    let request = Request {
        preset: model.preset.clone(),
        spec: ModelSpec::clone(&model.spec),
        seed,
        backend: model.backend,
        outputs: model.outputs.clone(),
        dir: dir.clone(),
        memory_limit_bytes: None,
    };
    let watch = Stopwatch::start();
    let outcome = generate(&request, &(), &CancelToken::default());
    let ended = watch.seconds();
    std::fs::remove_dir_all(&dir).with_context(|| dir.display().to_string())?;
    let bytes = outcome.as_ref().map_or(0, |outcome| outcome.files.iter().map(|file| file.bytes).sum());
    Ok(One { accepted: 0.0, ended, succeeded: outcome.is_ok(), bytes, refused: 0 })
}

fn lines(report: &Report) -> Vec<String> {
    let times = |times: &Times| {
        format!("p50 {:.3} s, p90 {:.3} s, p99 {:.3} s, max {:.3} s", times.p50, times.p90, times.p99, times.max)
    };
    let errors = &report.errors;
    let mut lines = vec![
        format!(
            "{} models in {:.2} s, {} at a time: {:.3} per second; {} succeeded, {} failed, {} lost to errors; {} answers \
             were 429",
            report.models,
            report.seconds,
            report.concurrency,
            report.models_per_second,
            report.succeeded,
            report.failed,
            errors.total,
            report.refused
        ),
        format!("accepted after {}", times(&report.accepted)),
        format!("ended after    {}", times(&report.ended)),
    ];
    if errors.total > 0 {
        let statuses = errors.status.iter().map(|(status, count)| (format!("status {status}"), *count));
        let others = [("connection", errors.connection), ("timeout", errors.timeout), ("other", errors.other)];
        let counts: Vec<String> = statuses
            .chain(others.map(|(kind, count)| (kind.to_owned(), count)))
            .filter(|(_, count)| *count > 0)
            .map(|(kind, count)| format!("{kind} {count}"))
            .collect();
        lines.push(format!("errors: {}", counts.join(", ")));
        lines.extend(errors.examples.iter().map(|example| format!("  {example}")));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_percentiles_of_the_sorted_list() {
        let times = Times::of((0..=100).rev().map(f64::from).collect());
        assert_eq!((times.p50, times.p90, times.p99, times.max), (50.0, 90.0, 99.0, 100.0));
        assert_eq!(Times::of(Vec::new()).max, 0.0);
    }

    #[test]
    fn a_report_counts_every_model_once_and_errors_by_kind() {
        let one = |succeeded| Ok(One { accepted: 0.1, ended: 2.0, succeeded, bytes: 5, refused: 1 });
        let lost = |kind, message: &str| Err(Lost { kind, message: message.to_owned() });
        let all = [
            one(true),
            lost(ErrorKind::Status(503), "first 503"),
            lost(ErrorKind::Timeout, "late"),
            one(false),
            lost(ErrorKind::Status(503), "second 503"),
            lost(ErrorKind::Status(500), "500"),
            lost(ErrorKind::Connection, "refused"),
            lost(ErrorKind::Other, "odd"),
            one(true),
        ];
        let report = Report::of("service", &all, 3, 1.5);
        assert_eq!((report.models, report.succeeded, report.failed, report.errors.total), (9, 2, 1, 6));
        assert_eq!((report.bytes, report.refused, report.models_per_second), (15, 3, 2.0));
        let errors = serde_json::to_value(&report.errors).expect("JSON");
        let examples = ["500", "first 503", "refused", "late", "odd"];
        let expected = json!({ "total": 6, "status": { "500": 1, "503": 2 }, "connection": 1, "timeout": 1, "other": 1,
                               "examples": examples });
        assert_eq!(errors, expected);
        let text = lines(&report).join("\n");
        assert!(text.contains("errors: status 500 1, status 503 2, connection 1, timeout 1, other 1"), "{text}");
        let none = Report::of("service", &[one(true)], 1, 1.0);
        assert_eq!((none.errors, lines(&Report::of("direct", &[], 1, 1.0)).len()), (Errors::default(), 3));
    }
}
