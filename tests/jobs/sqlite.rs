//! The suite over SQLite, in memory and in a file, and tests of the file itself.

use crate::suite::{Factory, LEASE, new_job};
use futures_util::FutureExt;
use oviduct::clock::Clock;
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{ClaimScope, Job, Status, Store, StoreOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

const MEMORY: Factory = |options| {
    async move {
        let store = Store::open_in_memory(options).await.unwrap();
        (store, Box::new(()) as Box<dyn Send + Sync>)
    }
    .boxed()
};

const FILE: Factory = |options| {
    async move {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open_sqlite(dir.path().join("jobs.db"), options).await.unwrap();
        (store, Box::new(dir) as Box<dyn Send + Sync>)
    }
    .boxed()
};

mod memory {
    crate::suite::over!(super::MEMORY);
}

mod file {
    crate::suite::over!(super::FILE);
}

#[tokio::test]
async fn a_restart_keeps_jobs_and_takes_over_their_leases_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("deep/down/jobs.db");
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let options = StoreOptions { clock: clock.clone(), max_attempts: 2, ..StoreOptions::default() };
    let open = || Store::open_sqlite(&path, options.clone());
    // A dropped store releases its file only after its last connection has closed.
    let open_again = || async {
        for _ in 0..6000 {
            match open().await {
                Err(error) if error.to_string().contains("in use by another process") => {
                    tokio::time::sleep(std::time::Duration::from_millis(10)).await;
                }
                other => return other,
            }
        }
        open().await
    };

    let store = open().await.unwrap();
    let other = open().await.unwrap_err();
    assert!(other.to_string().contains("in use by another process"), "{other}");
    let running = store.submit(new_job("1")).await.unwrap().job().id;
    let queued = store.submit(new_job("2")).await.unwrap().job().clone();
    let claimed = store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    drop(store);

    // The lease has not expired, so only the recovery at start can have ended the attempt.
    let store = open_again().await.unwrap();
    let kept = store.get(queued.id).await.unwrap().unwrap();
    assert_eq!(kept, Job { queue_position: Some(0), ..queued });
    assert_eq!(store.recover().await.unwrap(), [running]);
    assert_eq!(store.recover().await.unwrap(), []);
    let answer = store.heartbeat(&claimed, LEASE, &claimed.job().backend, None, None).await.unwrap();
    assert_eq!(answer, oviduct::jobs::Directive::Lost);
    let again = store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    assert_eq!((again.job().id, again.attempt()), (running, 2));
    drop(store);

    let store = open_again().await.unwrap();
    assert_eq!(store.recover().await.unwrap(), [running]);
    let job = store.get(running).await.unwrap().unwrap();
    assert_eq!(job.status, Status::Failed);
    assert_eq!(job.problem.unwrap().kind, "attempts-exhausted");
    let ends: Vec<_> = store.attempts(running).await.unwrap().iter().map(|a| a.outcome).collect();
    assert_eq!(ends, [Some(AttemptEnd::Vanished); 2]);
}

#[tokio::test]
async fn a_removed_lock_file_does_not_let_another_process_in() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("jobs.db");
    let open = || Store::open_sqlite(&path, StoreOptions::default());
    let store = open().await.unwrap();
    std::fs::remove_file(dir.path().join("jobs.db.lock")).unwrap();
    let other = open().await.unwrap_err();
    assert!(other.to_string().contains("in use by another process"), "{other}");
    store.close().await;
    open().await.unwrap().close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn readers_do_not_wait_for_a_writer() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("jobs.db");
    let store = Store::open_sqlite(&path, StoreOptions::default()).await.unwrap();
    let id = store.submit(new_job("1")).await.unwrap().job().id;
    // Another connection holds the write lock.
    let blocker = sqlx::SqlitePool::connect(&format!("sqlite://{}", path.display())).await.unwrap();
    let held = blocker.begin_with("BEGIN IMMEDIATE").await.unwrap();
    let writing = tokio::spawn({
        let store = store.clone();
        async move { store.cancel(id).await }
    });
    for _ in 0..20 {
        let read = tokio::time::timeout(Duration::from_secs(30), store.get(id)).await.expect("reading waited");
        assert_eq!(read.unwrap().unwrap().status, Status::Queued);
    }
    assert!(!writing.is_finished());
    held.rollback().await.unwrap();
    assert_eq!(writing.await.unwrap().unwrap().unwrap().status, Status::Cancelled);
}

#[tokio::test]
async fn a_call_whose_caller_is_dropped_runs_to_its_end_and_notifies() {
    let store = Store::open_in_memory(StoreOptions::default()).await.unwrap();
    let mut changes = store.changes();
    // The future is polled once and dropped, as when a client disconnects.
    assert!(store.submit(new_job("1")).now_or_never().is_none());
    let change = tokio::time::timeout(Duration::from_secs(60), changes.recv()).await.unwrap().unwrap();
    assert_eq!(store.get(change.id).await.unwrap().unwrap().status, Status::Queued);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_read_whose_caller_is_dropped_does_not_cost_the_connection() {
    let store = Store::open_in_memory(StoreOptions::default()).await.unwrap();
    let id = store.submit(new_job("1")).await.unwrap().job().id;
    for _ in 0..100 {
        // The future is polled once and dropped, as when a job ends while its worker reads it. An
        // in-memory store has only this connection.
        let _ = store.get(id).now_or_never();
        assert!(store.get(id).await.unwrap().is_some());
    }
}

/// Runs `oviduct serve` over the data in `dir`, where it must refuse to start.
fn refused_start(dir: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_oviduct"))
        .args(["serve", "--addr", "127.0.0.1:0", "--gpu", "off", "--data", "."])
        .current_dir(dir)
        .output()
        .unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_damaged_file_is_refused_at_start_with_its_name_and_the_remedy() {
    const PAGE: u64 = 4096;
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("oviduct.db");
    let store = Store::open_sqlite(&path, StoreOptions::default()).await.unwrap();
    for n in 0..60 {
        store.submit(new_job(&n.to_string())).await.unwrap();
    }
    store.close().await;
    let store = Store::open_sqlite(&path, StoreOptions::default()).await.unwrap();
    assert_eq!(store.counts().await.unwrap().queued, 60, "a whole file is opened");
    store.close().await;
    drop(store);

    let mut file = std::fs::File::options().write(true).open(&path).unwrap();
    let pages = file.metadata().unwrap().len() / PAGE;
    assert!(pages > 20, "{pages} pages");
    for page in (6..pages).step_by(7) {
        file.seek(SeekFrom::Start(page * PAGE)).unwrap();
        file.write_all(&[0xa5; PAGE as usize]).unwrap();
    }
    let no_database = tempfile::tempdir().unwrap();
    std::fs::write(no_database.path().join("oviduct.db"), "x".repeat(10_000)).unwrap();
    for dir in [dir.path(), no_database.path()] {
        let output = refused_start(dir);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        for part in ["oviduct.db is damaged", "docs/operations.md", "Backup and restore"] {
            assert!(said.contains(part), "{part} in {said}");
        }
    }
}
