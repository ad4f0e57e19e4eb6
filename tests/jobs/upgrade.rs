//! Migration of tables from before priorities, with jobs in them. Also: effects of versions without
//! shared growth on current tables.

use crate::scripted::Database;
use crate::suite::{LEASE, finished, new_job};
use oviduct::jobs::{ClaimScope, Counts, JobId, NewJob, Store, StoreOptions};
use sqlx::migrate::Migrator;
use std::path::{Path, PathBuf};
use uuid::Uuid;

/// Folder with the migrations of a database.
fn folder(database: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src/jobs").join(database).join("migrations")
}

/// A folder with the first `n` migrations of a database.
fn first(n: usize, database: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let mut paths: Vec<_> = std::fs::read_dir(folder(database)).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(n < paths.len());
    for path in &paths[..n] {
        std::fs::copy(path, dir.path().join(path.file_name().unwrap())).unwrap();
    }
    dir
}

fn versions(migrator: &Migrator) -> Vec<i64> {
    migrator.iter().map(|migration| migration.version).collect()
}

/// Three queued jobs of two submitters, one running job, and three ended jobs.
const JOBS: &str = "INSERT INTO batches (id, created_at) VALUES ('01900000-0000-7000-8000-000000000000', 0); \
    INSERT INTO jobs (id, status, holder, lease_until, finished_at, preset, seed, digest, outputs, backend_requested, \
    available_at, created_at, spec, submitter, turn, engine, batch) VALUES \
    ('01900000-0000-7000-8000-000000000001', 'failed', NULL, NULL, 1, 'pig', 1, 'd1', '[]', 'auto', 0, 0, '{}', '', 0, \
    '0.1.0', '01900000-0000-7000-8000-000000000000'), \
    ('01900000-0000-7000-8000-000000000002', 'cancelled', NULL, NULL, 1, 'pig', 1, 'd2', '[]', 'auto', 0, 0, '{}', '', \
    0, '0.1.0', NULL), \
    ('01900000-0000-7000-8000-000000000003', 'cancelled', NULL, NULL, 1, 'pig', 1, 'd3', '[]', 'auto', 0, 0, '{}', '', \
    0, '0.1.0', NULL), \
    ('01900000-0000-7000-8000-000000000004', 'running', 'old', 4000000000000000, NULL, 'pig', 1, 'd4', '[]', 'auto', 0, \
    0, '{}', 'a', 3, '0.1.0', NULL), \
    ('01900000-0000-7000-8000-000000000005', 'queued', NULL, NULL, NULL, 'pig', 1, 'd5', '[]', 'auto', 0, 0, '{}', 'a', \
    5, '0.1.0', NULL), \
    ('01900000-0000-7000-8000-000000000006', 'queued', NULL, NULL, NULL, 'pig', 1, 'd6', '[]', 'auto', 0, 0, '{}', 'a', \
    6, '0.1.0', NULL), \
    ('01900000-0000-7000-8000-000000000007', 'queued', NULL, NULL, NULL, 'pig', 1, 'd7', '[]', 'auto', 0, 0, '{}', 'b', \
    5, '0.1.0', NULL); \
    INSERT INTO labels (name, value, job_id) VALUES ('animal', 'a', '01900000-0000-7000-8000-000000000001'); \
    INSERT INTO attempts (job_id, attempt, worker, started_at) VALUES \
    ('01900000-0000-7000-8000-000000000001', 1, 'old', 0); \
    INSERT INTO files (job_id, ordinal, name, media_type, bytes, sha256, key) VALUES \
    ('01900000-0000-7000-8000-000000000001', 0, 'model.glb', 'model/gltf-binary', 1, '', 'a/b')";

async fn goes_on(store: &Store) {
    let counts = Counts { queued: 3, running: 1, failed: 1, cancelled: 2, ..Counts::default() };
    assert_eq!(store.counts().await.unwrap(), counts);
    let failed = JobId(Uuid::from_u128(0x0190_0000_0000_7000_8000_0000_0000_0001));
    let job = store.get(failed).await.unwrap().unwrap();
    assert_eq!((job.spec.text(), job.labels["animal"].as_str(), job.files[0].key.as_str()), ("{}", "a", "a/b"));
    assert_eq!(store.attempts(failed).await.unwrap()[0].worker, "old");
    let queued = store.queued_by_backend().await.unwrap().map(|(backend, jobs)| (backend.name(), jobs));
    assert_eq!(queued, [("auto", 3), ("gpu", 0), ("cpu", 0), ("cpu-single", 0)]);
    // The migrated jobs have no batch key, so a GPU runs them one by one.
    let alone = store.claim("gpu", ClaimScope::Gpu, LEASE, 16).await.unwrap().pop().unwrap();
    assert_eq!(alone.job().digest, "d5");
    store.release(alone, None).await.unwrap();
    let submit = async |digest: &str, priority: i64| {
        let priority = priority.try_into().unwrap();
        let new = NewJob { priority, owner: Some("b".into()), ..new_job(digest) };
        store.submit(new).await.unwrap().job().clone()
    };
    assert_eq!(submit("urgent", 1).await.queue_position, Some(0));
    assert_eq!(submit("low", -1).await.queue_position, Some(4));
    // The new job gets the turn after its submitter's last job. The other job of that turn is
    // older.
    assert_eq!(submit("plain", 0).await.queue_position, Some(4));
    let mut order = Vec::new();
    while let Some(claimed) = store.claim("new", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop() {
        order.push(claimed.job().digest.clone());
        assert_eq!(claimed.job().priority.get(), i64::from(order.len() == 1) - i64::from(order.len() == 6));
        let done = finished(&claimed);
        store.finish(claimed, done).await.unwrap();
    }
    assert_eq!(order, ["urgent", "d5", "d7", "d6", "plain", "low"]);
    let batch = oviduct::jobs::BatchId(Uuid::from_u128(0x0190_0000_0000_7000_8000_0000_0000_0000));
    assert_eq!(store.batch(batch).await.unwrap().unwrap().priority.get(), 0);
    store.delete_batch(batch).await.unwrap().unwrap();
    let counts = Counts { running: 1, succeeded: 6, cancelled: 2, ..Counts::default() };
    assert_eq!(store.counts().await.unwrap(), counts);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_of_an_older_version_continue_on_sqlite() {
    let dir = tempfile::tempdir().unwrap();
    let url = Database::Sqlite.url(dir.path()).await;
    let before = sqlx::SqlitePool::connect(&format!("{url}?mode=rwc")).await.unwrap();
    Migrator::new(first(3, "sqlite").path()).await.unwrap().run(&before).await.unwrap();
    sqlx::raw_sql(JOBS).execute(&before).await.unwrap();
    before.close().await;
    // `jobs::open` would end running attempts on SQLite, which PostgreSQL does not. This test makes
    // the same assertions on both.
    let store = Store::open_sqlite(dir.path().join("jobs.db"), StoreOptions::default()).await.unwrap();
    goes_on(&store).await;

    let tables = sqlx::SqlitePool::connect(&url).await.unwrap();
    let all = Migrator::new(folder("sqlite")).await.unwrap();
    let applied = sqlx::query_scalar::<_, i64>("SELECT version FROM _sqlx_migrations ORDER BY version");
    assert_eq!(applied.fetch_all(&tables).await.unwrap(), versions(&all));
    // The migrator compares the hashes of the applied migrations.
    all.run(&tables).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_of_an_older_version_continue_on_postgres() {
    let url = Database::Postgres.url("".as_ref()).await;
    let before = sqlx::PgPool::connect(&url).await.unwrap();
    Migrator::new(first(1, "postgres").path()).await.unwrap().run(&before).await.unwrap();
    sqlx::raw_sql(JOBS).execute(&before).await.unwrap();
    before.close().await;
    goes_on(&oviduct::jobs::open(&url, StoreOptions::default()).await.unwrap()).await;

    let tables = sqlx::PgPool::connect(&url).await.unwrap();
    let all = Migrator::new(folder("postgres")).await.unwrap();
    let applied = sqlx::query_scalar::<_, i64>("SELECT version FROM _sqlx_migrations ORDER BY version");
    assert_eq!(applied.fetch_all(&tables).await.unwrap(), versions(&all));
    all.run(&tables).await.unwrap();
}

/// Ends the first of three equal jobs as a version without shared growth does. Returns the ids of
/// the two stranded jobs.
async fn strand(store: &Store, execute: impl AsyncFnOnce(&'static str)) -> [JobId; 2] {
    let mut ids = Vec::new();
    for _ in 0..3 {
        ids.push(store.submit(new_job("d")).await.unwrap().job().id);
    }
    assert_eq!(store.queue_stranded().await.unwrap(), []);
    execute("UPDATE jobs SET status = 'cancelled', finished_at = 1 WHERE NOT shares").await;
    assert!(store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().is_empty());
    [ids[1], ids[2]]
}

async fn grows(store: &Store, [second, third]: [JobId; 2]) {
    assert_eq!(store.queue_stranded().await.unwrap(), [second]);
    let claimed = store.claim("w", ClaimScope::Cpu, LEASE, 9).await.unwrap().pop().unwrap();
    assert_eq!(claimed.job().id, second);
    let done = finished(&claimed);
    store.finish(claimed, done).await.unwrap();
    assert_eq!(store.get(third).await.unwrap().unwrap().reused_from, Some(second));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_that_an_older_version_left_waiting_are_queued_on_sqlite() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open_sqlite(dir.path().join("jobs.db"), StoreOptions::default()).await.unwrap();
    let pool = sqlx::SqlitePool::connect(&Database::Sqlite.url(dir.path()).await).await.unwrap();
    let left = strand(&store, async |sql| {
        sqlx::raw_sql(sql).execute(&pool).await.unwrap();
    })
    .await;
    grows(&store, left).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_that_an_older_version_left_waiting_are_queued_on_postgres() {
    let url = Database::Postgres.url("".as_ref()).await;
    let store = oviduct::jobs::open(&url, StoreOptions::default()).await.unwrap();
    let pool = sqlx::PgPool::connect(&url).await.unwrap();
    let left = strand(&store, async |sql| {
        sqlx::raw_sql(sql).execute(&pool).await.unwrap();
    })
    .await;
    grows(&store, left).await;
}
