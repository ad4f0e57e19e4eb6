//! A disk that is full at the end of an attempt: the database file may not grow, so every larger
//! write fails with `SQLITE_FULL`.

use super::*;
use crate::clock::Clock;
use crate::generate::{Progress, Stage};
use crate::jobs::sql::Engine;
use crate::jobs::{ClaimScope, Directive, Finished, JobProgress, LiveSection, NewJob, Status, Store};
use sha2::{Digest as _, Sha256};

const LEASE: Duration = Duration::from_secs(8);

async fn set_full(store: &Store, full: bool) {
    let pages = if full { 1 } else { i64::from(i32::MAX) };
    let sql = format!("PRAGMA max_page_count = {pages}");
    let Engine::Sqlite(engine) = store.engine() else { panic!("the store is not on SQLite") };
    let mut writer = acquire(&engine.writer).await.unwrap();
    sqlx::query(AssertSqlSafe(sql)).execute(&mut *writer).await.unwrap();
}

async fn open(clock: Clock) -> (Store, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    let options = StoreOptions { clock, ..StoreOptions::default() };
    (Store::open_sqlite(dir.path().join("jobs.db"), options).await.unwrap(), dir)
}

#[tokio::test]
async fn on_a_full_disk_a_finished_model_waits_and_other_changes_fail_after_five_seconds() {
    let (store, _dir) = open(Clock::System).await;
    store.submit(NewJob::sample(1)).await.unwrap();
    let claimed = store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    set_full(&store, true).await;
    let finished = Finished {
        backend: claimed.job().backend.clone(),
        files: Vec::new(),
        summary: serde_json::json!({ "large": "x".repeat(1 << 20) }),
        engine: crate::ENGINE_VERSION.into(),
    };
    let finishing = tokio::spawn({
        let store = store.clone();
        async move { store.finish(claimed, finished).await }
    });
    // Digests, which do not compress well.
    let digits: String = (0..1_u64 << 14).map(|n| hex::encode(Sha256::digest(n.to_le_bytes()))).collect();
    let large = NewJob { spec: serde_json::json!(digits).into(), ..NewJob::sample(2) };
    let since = Stopwatch::start();
    let refused = store.submit(large.clone()).await.unwrap_err();
    assert!(matches!(&refused, StoreError::Database(cause) if cause.to_string().contains("full")), "{refused}");
    assert!(since.elapsed() >= Duration::from_secs(5), "it was not retried");
    assert!(!finishing.is_finished());
    set_full(&store, false).await;
    assert_eq!(finishing.await.unwrap().unwrap(), Status::Succeeded);
    assert_eq!(store.submit(large).await.unwrap().job().status, Status::Queued);
}

#[tokio::test]
async fn leases_that_could_not_be_renewed_on_a_full_disk_do_not_expire() {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let (store, _dir) = open(clock.clone()).await;
    let id = store.submit(NewJob::sample(1)).await.unwrap().job().id;
    let claimed = store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    set_full(&store, true).await;
    let inner = vec![[0.5, 1.5]; 100_000];
    let section = LiveSection { index: 0, step: 0, z_um: 0.0, inner, outer: Vec::new() };
    let eta_seconds = None;
    let progress =
        Progress { stage: Stage::Simulate, fraction: 0.5, step: 1, steps: 2, particles: 8, sections: 1, eta_seconds };
    let beat = async || {
        let backend = &claimed.job().backend;
        store.heartbeat(&claimed, LEASE, backend, Some(&JobProgress::Model(progress)), Some(&section)).await
    };
    beat().await.unwrap_err();
    clock.advance(3 * LEASE);
    set_full(&store, false).await;
    assert!(store.claim("other", ClaimScope::Cpu, LEASE, 1).await.unwrap().is_empty());
    assert_eq!(store.get(id).await.unwrap().unwrap().attempts, 1);
    assert_eq!(beat().await.unwrap(), Directive::Continue);
    // A worker that does not come back loses its lease after all.
    clock.advance(LEASE);
    let again = store.claim("other", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    assert_eq!((again.job().id, again.attempt()), (id, 2));
}

/// Number of pages in the write-ahead log, and the salt that changes when it begins anew.
fn logged_pages(database: &std::path::Path) -> (Vec<u8>, usize) {
    const HEADER: usize = 32;
    const FRAME: usize = 24 + 4096;
    let log = std::fs::read(database.with_extension("db-wal")).unwrap();
    let salt = &log[16..24];
    let pages = log[HEADER..].chunks_exact(FRAME).take_while(|frame| &frame[8..16] == salt).count();
    (salt.to_vec(), pages)
}

#[tokio::test]
async fn a_submission_writes_at_most_twelve_pages_on_average() {
    let (store, dir) = open(Clock::System).await;
    let path = dir.path().join("jobs.db");
    let spec = crate::spec::preset("pig").unwrap().spec.clone();
    let submit = async |n: u64| {
        let digest = hex::encode(Sha256::digest(n.to_le_bytes()));
        let batch_key = Some("2000/300/10/10/rk4/40".into());
        let new = NewJob { spec: spec.clone().into(), digest, batch_key, ..NewJob::sample(n) };
        store.submit(new).await.unwrap();
    };
    let (mut pages, mut submissions) = (0, 0);
    for n in 0..600 {
        let (salt, before) = logged_pages(&path);
        submit(n).await;
        let (salt_after, after) = logged_pages(&path);
        // The first indexes are smaller than a page.
        if n >= 200 && salt == salt_after {
            (pages, submissions) = (pages + after - before, submissions + 1);
        }
    }
    assert!(submissions > 300);
    assert!(pages <= 12 * submissions, "{pages} pages of {submissions} submissions");
}
