//! `bench queue`: what the job store does in a second.
//!
//! Jobs are submitted by one caller and by many at a time. Then a worker claims them and ends them
//! without computing anything. The store is new: SQLite in a temporary directory, or the empty
//! PostgreSQL database of `--database`. `scripts/bench-queue` runs this next to graphile-worker.

use super::machine;
use super::report::Report;
use anyhow::Context;
use oviduct::clock::Stopwatch;
use oviduct::generate::{Backend, Output};
use oviduct::jobs::{ClaimScope, Database, Finished, JobKind, NewJob, Priority, Store, StoreOptions};
use oviduct::spec::{ModelSpec, SEED_MAX, batch_key, preset};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::task::JoinSet;

/// Numbers of concurrent callers that submit.
const CALLERS: [u64; 2] = [1, 64];
/// Number of jobs that a claim takes, and that end at a time.
const JOBS: u32 = 8;
/// A lease that does not expire during the benchmark.
const LEASE: Duration = Duration::from_secs(600);

pub(super) async fn run(quick: bool, database: Option<String>) -> anyhow::Result<Report> {
    let time = Duration::from_secs(if quick { 1 } else { 5 });
    let folder = tempfile::tempdir()?;
    let (kind, database) = match database {
        Some(url) => ("PostgreSQL", Database::parse(&url).map_err(anyhow::Error::msg).context("--database")?),
        None => ("SQLite", Database::Sqlite(folder.path().join("jobs.db"))),
    };
    let options = StoreOptions { queue_limit: u64::MAX >> 1, ..StoreOptions::default() };
    let store = database.open(options).await.context("the job store could not be opened")?;
    let (mut lines, mut submissions) = (vec![machine::line(), format!("{kind}, per second:")], Value::Null);
    let mut queued = 0;
    for callers in CALLERS {
        let (count, seconds) = submit(&store, callers, time, queued).await?;
        queued += count;
        let rate = count as f64 / seconds;
        lines.push(format!("  submissions, {callers} at a time: {rate:.0}"));
        submissions[callers.to_string()] = json!(rate);
    }
    let (count, seconds) = work(&store, time).await?;
    let ends = count as f64 / seconds;
    lines.push(format!("  claims and ends, {JOBS} at a time: {ends:.0}"));
    store.close().await;
    let json = json!({ "store": kind, "submissions_per_second": submissions, "ends_per_second": ends });
    Ok(Report { lines, json, files: Vec::new() })
}

/// Submits jobs for `time`, with seeds from `first`. Returns their number and the seconds.
async fn submit(store: &Store, callers: u64, time: Duration, first: u64) -> anyhow::Result<(u64, f64)> {
    let preset = preset("pig").context("the preset is missing")?;
    let spec = Arc::new(ModelSpec::resolve(preset, &json!({})).map_err(|faults| anyhow::anyhow!("{faults:?}"))?);
    let (next, watch) = (Arc::new(AtomicU64::new(first)), Stopwatch::start());
    let mut tasks = JoinSet::new();
    for _ in 0..callers {
        let (store, spec, next) = (store.clone(), Arc::clone(&spec), Arc::clone(&next));
        tasks.spawn(async move {
            while watch.elapsed() < time {
                store.submit(new_job(&spec, next.fetch_add(1, Ordering::Relaxed))).await?;
            }
            Ok::<_, oviduct::jobs::StoreError>(())
        });
    }
    while let Some(ended) = tasks.join_next().await {
        ended.context("a caller panicked")??;
    }
    Ok((next.load(Ordering::Relaxed) - first, watch.seconds()))
}

fn new_job(spec: &ModelSpec, seed: u64) -> NewJob {
    let seed = seed & SEED_MAX;
    NewJob {
        kind: JobKind::Model,
        preset: "pig".into(),
        seed,
        spec: spec.json(),
        outputs: vec![Output::Glb].into(),
        backend: Backend::Auto,
        labels: BTreeMap::new(),
        priority: Priority::default(),
        digest: spec.digest(seed),
        engine: oviduct::ENGINE_VERSION.into(),
        reuse: true,
        missing: Vec::new(),
        batch_key: Some(batch_key(spec)),
        short: false,
        idempotency: None,
        owner: None,
        quota: Default::default(),
        weight: 1,
        trace: None,
        retry_of: None,
    }
}

/// Claims and ends queued jobs for `time`. Returns their number and the seconds. As the worker of a
/// GPU, one worker claims the next [`JOBS`] jobs at once, while it ends those before.
async fn work(store: &Store, time: Duration) -> anyhow::Result<(u64, f64)> {
    let (mut ended, watch) = (0, Stopwatch::start());
    let claim = || store.claim("bench", ClaimScope::Cpu, LEASE, JOBS);
    let mut claimed = claim().await?;
    while watch.elapsed() < time && !claimed.is_empty() {
        ended += claimed.len() as u64;
        let mut ends = JoinSet::new();
        for job in claimed {
            let finished = Finished {
                backend: job.job().backend.clone(),
                files: Vec::new(),
                summary: json!({}),
                engine: oviduct::ENGINE_VERSION.into(),
            };
            let store = store.clone();
            ends.spawn(async move { store.finish(job, finished).await });
        }
        let (ends, next) = tokio::join!(ends.join_all(), claim());
        ends.into_iter().collect::<Result<Vec<_>, _>>()?;
        claimed = next?;
    }
    Ok((ended, watch.seconds()))
}
