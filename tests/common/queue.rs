//! Long queues, created by SQL, and timings of claims, submissions and reads on them.

use oviduct::clock::Stopwatch;
use oviduct::generate::{Backend, Output, Progress, Stage};
use oviduct::jobs::{ClaimScope, ClaimedJob, JobId, JobKind, JobProgress, NewJob, Priority, Store, StoreOptions};
use std::collections::BTreeMap;
use std::time::Duration;

/// Number of claims and submissions that are timed on a queue.
pub const SAMPLES: usize = 40;

/// Fills the tables of the SQLite file at `path` with `rows` queued jobs and as many ended ones.
/// The jobs have seven submitters, three priorities and three batch keys; one job in ten is for
/// GPUs.
pub async fn fill_sqlite(path: &std::path::Path, rows: u64) {
    let pool = sqlx::SqlitePool::connect(&format!("sqlite://{}", path.display())).await.expect("the file opens");
    sqlx::query(
        "WITH RECURSIVE n (i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i + 1 < 2 * $1) \
         INSERT INTO jobs (id, status, preset, seed, digest, outputs, backend_requested, available_at, created_at, \
         finished_at, spec, submitter, rank, turn, batch_key) \
         SELECT '01900000-0000-7000-8000-' || printf('%012x', i), CASE WHEN i < $1 THEN 'queued' ELSE 'failed' END, \
         'pig', i, printf('%x', i), '[\"glb\"]', CASE WHEN i % 10 = 0 THEN 'gpu' ELSE 'auto' END, 0, 0, \
         CASE WHEN i < $1 THEN NULL ELSE i END, CAST('{}' AS BLOB), 'key ' || (i % 7), i / 7 % 3 - 1, i / 21, \
         'size ' || (i % 3) FROM n",
    )
    .bind(rows as i64)
    .execute(&pool)
    .await
    .expect("the queue is filled");
    pool.close().await;
}

/// SQL that fills the tables of a PostgreSQL database in the same way.
pub fn fill_postgres(rows: u64) -> String {
    format!(
        // `replica` disables the triggers, so the script inserts the counts that they would have
        // produced.
        "SET session_replication_role = replica; \
         INSERT INTO jobs (id, status, preset, seed, digest, outputs, backend_requested, available_at, created_at, \
         finished_at, spec, submitter, rank, turn, engine, batch_key) \
         SELECT '01900000-0000-7000-8000-' || lpad(to_hex(i), 12, '0'), \
         CASE WHEN i < {rows} THEN 'queued' ELSE 'failed' END, 'pig', i, to_hex(i), '[\"glb\"]', \
         CASE WHEN i % 10 = 0 THEN 'gpu' ELSE 'auto' END, 0, 0, CASE WHEN i < {rows} THEN NULL ELSE i END, '{{}}', \
         'key ' || (i % 7), i / 7 % 3 - 1, i / 21, '0.1.0', 'size ' || (i % 3) FROM generate_series(0, 2 * {rows} - 1) AS i; \
         INSERT INTO queue_length (backend, jobs) VALUES ('gpu', ({rows} + 9) / 10), ('auto', {rows} - ({rows} + 9) / 10); \
         INSERT INTO ended_jobs (status, jobs) VALUES ('failed', {rows}); \
         SET session_replication_role = DEFAULT"
    )
}

/// Store options with a queue limit above the length of every queue in these measurements.
pub fn options() -> StoreOptions {
    StoreOptions { queue_limit: 10_000_000, ..StoreOptions::default() }
}

/// Seconds per operation: the lower quartile of many samples, which excludes most of the machine's
/// other load.
#[derive(Clone, Debug)]
pub struct Costs(pub Vec<(&'static str, f64)>);

fn lower_quartile(mut seconds: Vec<f64>) -> f64 {
    seconds.sort_by(f64::total_cmp);
    seconds[seconds.len() / 4]
}

fn new_job(n: usize) -> NewJob {
    NewJob {
        kind: JobKind::Model,
        preset: "pig".into(),
        seed: 1,
        spec: serde_json::json!({}).into(),
        outputs: vec![Output::Glb].into(),
        backend: Backend::Auto,
        labels: BTreeMap::new(),
        priority: Priority::default(),
        digest: format!("new {n}"),
        engine: oviduct::ENGINE_VERSION.into(),
        reuse: true,
        missing: Vec::new(),
        batch_key: Some("size 1".into()),
        short: false,
        idempotency: Some((format!("key {n}"), String::new())),
        owner: Some("key 3".into()),
        quota: Default::default(),
        weight: 1,
        trace: None,
        retry_of: None,
    }
}

/// Times operations on the queue:
///
/// - a claim of one job,
/// - a claim of four jobs,
/// - a claim of four jobs by a GPU worker,
/// - a heartbeat,
/// - a submission,
/// - a read of the last job of its priority, with its queue position,
/// - a read of the counts.
///
/// Removes the jobs that it submits and releases the jobs that it claims.
pub async fn costs(store: &Store) -> Costs {
    const LEASE: Duration = Duration::from_secs(600);
    let claim = async |scope, limit: u32, samples: usize| {
        let (mut seconds, mut held) = (Vec::new(), Vec::new());
        for _ in 0..samples {
            let since = Stopwatch::start();
            let claimed = store.claim("w", scope, LEASE, limit).await.expect("a claim");
            seconds.push(since.seconds());
            assert_eq!(claimed.len(), limit as usize, "the queue is too short");
            held.extend(claimed);
        }
        (lower_quartile(seconds), held)
    };
    let (one, held) = claim(ClaimScope::Cpu, 1, SAMPLES).await;
    let (four, mut more) = claim(ClaimScope::Cpu, 4, SAMPLES / 4).await;
    let (gpu, batches) = claim(ClaimScope::Gpu, 4, SAMPLES / 4).await;
    more.extend(batches);
    let mut beats = Vec::new();
    for claimed in &held {
        beats.push(beat(store, claimed).await);
    }
    let (mut submits, mut looks, mut counts) = (Vec::new(), Vec::new(), Vec::new());
    let mut ids: Vec<JobId> = Vec::new();
    for n in 0..SAMPLES {
        let new = new_job(n);
        let since = Stopwatch::start();
        let id = store.submit(new).await.expect("a submission").job().id;
        submits.push(since.seconds());
        let since = Stopwatch::start();
        store.get(id).await.expect("a look").expect("the job");
        looks.push(since.seconds());
        let since = Stopwatch::start();
        store.counts().await.expect("counts");
        store.queued_by_backend().await.expect("counts");
        store.queue_ages().await.expect("ages");
        counts.push(since.seconds());
        ids.push(id);
    }
    for id in ids {
        store.delete(id).await.expect("it is removed");
    }
    for claimed in held.into_iter().chain(more) {
        store.release(claimed, None).await.expect("it is released");
    }
    let names = ["claim", "claim of 4", "GPU claim of 4", "heartbeat", "submit", "look", "counts"];
    let seconds =
        [one, four, gpu, lower_quartile(beats), lower_quartile(submits), lower_quartile(looks), lower_quartile(counts)];
    Costs(names.into_iter().zip(seconds).collect())
}

/// Duration of a heartbeat with progress, in seconds.
async fn beat(store: &Store, claimed: &ClaimedJob) -> f64 {
    let (stage, eta_seconds) = (Stage::Simulate, None);
    let progress = Progress { stage, fraction: 0.5, step: 1, steps: 2, particles: 8, sections: 1, eta_seconds };
    let since = Stopwatch::start();
    let backend = &claimed.job().backend;
    store
        .heartbeat(claimed, Duration::from_secs(600), backend, Some(&JobProgress::Model(progress)), None)
        .await
        .expect("a heartbeat");
    since.seconds()
}
