//! A disk that is full at the end of an attempt: the database file may not grow, so every larger
//! write fails with `SQLITE_FULL`.

use super::*;
use crate::clock::Clock;
use crate::generate::{Progress, Stage};
use crate::jobs::sql::Engine;
use crate::jobs::{ClaimScope, Directive, Finished, JobProgress, LiveSection, NewJob, Status, Store};

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
    let large = NewJob { spec: serde_json::json!("x".repeat(1 << 20)).into(), ..NewJob::sample(2) };
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
