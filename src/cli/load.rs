//! `oviduct load`: puts load on a service, or on the generator alone, and says how fast models come.

use super::args::LoadArgs;
use super::client::Client;
use super::exit::{Ended, Failure};
use super::{interrupt, model, submit, term};
use crate::clock::Stopwatch;
use crate::generate::{Backend, CancelToken, Output, Request, generate};
use crate::spec::ModelSpec;
use anyhow::Context;
use serde::Serialize;
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::task::JoinSet;

/// What became of one model.
pub(super) struct One {
    /// From the first request to the answer that it was accepted.
    accepted: f64,
    /// From the first request to its end.
    pub(super) ended: f64,
    pub(super) succeeded: bool,
    bytes: u64,
    /// Answers 429 on the way.
    refused: u64,
}

/// What is said in the end. Times are seconds.
#[derive(Debug, Serialize)]
struct Report {
    /// `service` or `direct`.
    mode: &'static str,
    models: u64,
    succeeded: u64,
    failed: u64,
    /// Answers 429; each was tried again.
    refused: u64,
    concurrency: u32,
    seconds: f64,
    models_per_second: f64,
    bytes: u64,
    accepted: Times,
    ended: Times,
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
    if report.failed == 0 { Ok(()) } else { Err(Failure::Negative) }
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
    let seconds = watch.seconds();
    let succeeded = all.iter().filter(|one| one.succeeded).count() as u64;
    Ok(Report {
        mode: if args.direct { "direct" } else { "service" },
        models: all.len() as u64,
        succeeded,
        failed: all.len() as u64 - succeeded,
        refused: all.iter().map(|one| one.refused).sum(),
        concurrency: args.concurrency,
        seconds,
        models_per_second: all.len() as f64 / seconds,
        bytes: all.iter().map(|one| one.bytes).sum(),
        accepted: Times::of(all.iter().map(|one| one.accepted).collect()),
        ended: Times::of(all.iter().map(|one| one.ended).collect()),
    })
}

/// Seeds that follow each other, each given out once.
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

/// Models of these seeds through a service, so many at a time.
pub(super) async fn through(
    client: &Client,
    body: &Value,
    seeds: Seeds,
    concurrency: u32,
) -> Result<Vec<One>, Failure> {
    let mut tasks = JoinSet::new();
    for _ in 0..concurrency {
        let (client, body, seeds) = (client.clone(), body.clone(), seeds.clone());
        tasks.spawn(async move {
            let mut done = Vec::new();
            while let Some(seed) = seeds.take() {
                done.push(request(&client, &body, seed).await?);
            }
            Ok(done)
        });
    }
    all_of(tasks).await
}

/// What the generator alone is to grow.
#[derive(Clone, Debug)]
pub(super) struct Model {
    pub(super) preset: String,
    pub(super) spec: Arc<ModelSpec>,
    pub(super) backend: Backend,
    pub(super) outputs: Vec<Output>,
}

/// Models of these seeds by the generator alone, so many at a time, each on `threads` threads.
pub(super) async fn direct(model: &Model, seeds: Seeds, concurrency: u32, threads: usize) -> Result<Vec<One>, Failure> {
    let mut tasks = JoinSet::new();
    for _ in 0..concurrency {
        let (model, seeds) = (model.clone(), seeds.clone());
        tasks.spawn_blocking(move || {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let pool = pool.context("no threads could be made")?;
            std::iter::from_fn(|| seeds.take()).map(|seed| pool.install(|| grow(&model, seed))).collect()
        });
    }
    all_of(tasks).await
}

async fn all_of(mut tasks: JoinSet<Result<Vec<One>, Failure>>) -> Result<Vec<One>, Failure> {
    let mut all = Vec::new();
    while let Some(done) = tasks.join_next().await {
        all.extend(done.context("a task of the load panicked")??);
    }
    Ok(all)
}

/// One model through the service, from the request to its end.
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

/// One model by the generator alone.
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
    vec![
        format!(
            "{} models in {:.2} s, {} at a time: {:.3} a second; {} succeeded, {} failed, {} answers were 429",
            report.models,
            report.seconds,
            report.concurrency,
            report.models_per_second,
            report.succeeded,
            report.failed,
            report.refused
        ),
        format!("accepted after {}", times(&report.accepted)),
        format!("ended after    {}", times(&report.ended)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_sorted_list() {
        let times = Times::of((0..=100).rev().map(f64::from).collect());
        assert_eq!((times.p50, times.p90, times.p99, times.max), (50.0, 90.0, 99.0, 100.0));
        assert_eq!(Times::of(Vec::new()).max, 0.0);
    }
}
