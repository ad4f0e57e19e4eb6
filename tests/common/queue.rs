//! Long queues by SQL, and what claims and submissions cost on them.

use oviduct::clock::Stopwatch;
use oviduct::generate::{Backend, Output};
use oviduct::jobs::{NewJob, Priority, Store, StoreOptions};
use std::collections::BTreeMap;
use std::time::Duration;

/// Claims and submissions that are timed on a queue.
pub const SAMPLES: usize = 40;

/// Queues `rows` jobs of seven submitters, one in ten for GPUs, in the SQLite file at `path`, which has its tables.
pub async fn fill_sqlite(path: &std::path::Path, rows: u64) {
    let pool = sqlx::SqlitePool::connect(&format!("sqlite://{}", path.display())).await.expect("the file opens");
    sqlx::query(
        "WITH RECURSIVE n (i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i + 1 < $1) \
         INSERT INTO jobs (id, status, preset, seed, digest, outputs, backend_requested, available_at, created_at, \
         spec, submitter, turn) \
         SELECT '01900000-0000-7000-8000-' || printf('%012x', i), 'queued', 'pig', i, printf('%x', i), '[\"glb\"]', \
         CASE WHEN i % 10 = 0 THEN 'gpu' ELSE 'auto' END, 0, 0, '{}', 'key ' || (i % 7), i / 7 FROM n",
    )
    .bind(rows as i64)
    .execute(&pool)
    .await
    .expect("the queue is filled");
    pool.close().await;
}

/// The same in PostgreSQL, as SQL.
pub fn fill_postgres(rows: u64) -> String {
    format!(
        "INSERT INTO jobs (id, status, preset, seed, digest, outputs, backend_requested, available_at, created_at, \
         spec, submitter, turn, engine) \
         SELECT '01900000-0000-7000-8000-' || lpad(to_hex(i), 12, '0'), 'queued', 'pig', i, to_hex(i), '[\"glb\"]', \
         CASE WHEN i % 10 = 0 THEN 'gpu' ELSE 'auto' END, 0, 0, '{{}}', 'key ' || (i % 7), i / 7, '0.1.0' \
         FROM generate_series(0, {rows} - 1) AS i; \
         -- As submissions leave it, had the jobs come one by one.\n\
         TRUNCATE queue_length; INSERT INTO queue_length (jobs) VALUES ({rows})"
    )
}

/// Room for every queue here.
pub fn options() -> StoreOptions {
    StoreOptions { queue_limit: 10_000_000, ..StoreOptions::default() }
}

/// Seconds that a sample took, a quarter of all being faster: what else the machine does is kept out.
#[derive(Clone, Copy, Debug)]
pub struct Cost {
    pub claim: f64,
    pub claim_four: f64,
    pub submit: f64,
    pub read: f64,
}

fn lower_quartile(mut seconds: Vec<f64>) -> f64 {
    seconds.sort_by(f64::total_cmp);
    seconds[seconds.len() / 4]
}

/// What a claim of one job and of four, a submission, and reading the last of the queue cost.
pub async fn cost(store: &dyn Store) -> Cost {
    let claim = async |limit: u32, samples: usize| {
        let mut seconds = Vec::new();
        for _ in 0..samples {
            let since = Stopwatch::start();
            let claimed = store.claim("w", Backend::Cpu, Duration::from_secs(600), limit).await.expect("a claim");
            seconds.push(since.seconds());
            assert_eq!(claimed.len(), limit as usize, "the queue is too short");
        }
        lower_quartile(seconds)
    };
    let (claim_one, claim_four) = (claim(1, SAMPLES).await, claim(4, SAMPLES / 4).await);
    let (mut submits, mut reads) = (Vec::new(), Vec::new());
    for n in 0..SAMPLES {
        let new = NewJob {
            preset: "pig".into(),
            seed: 1,
            spec: serde_json::json!({}),
            outputs: vec![Output::Glb],
            backend: Backend::Auto,
            labels: BTreeMap::new(),
            priority: Priority::default(),
            digest: format!("new {n}"),
            engine: oviduct::ENGINE_VERSION.into(),
            reuse: true,
            idempotency: Some((format!("key {n}"), String::new())),
            submitter: Some("key 3".into()),
        };
        let since = Stopwatch::start();
        let id = store.submit(new).await.expect("a submission").job().id;
        submits.push(since.seconds());
        let since = Stopwatch::start();
        store.get(id).await.expect("a look").expect("the job");
        reads.push(since.seconds());
    }
    Cost { claim: claim_one, claim_four, submit: lower_quartile(submits), read: lower_quartile(reads) }
}
