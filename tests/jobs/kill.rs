//! `kill -9` at every point of a job's life, over both databases. A child process works and dies at
//! the given point; another process takes over its jobs.

use crate::gate;
use crate::scripted::{Database, NAMES, Place, content, visible};
use crate::suite::objects;
use oviduct::jobs::fault::{Faults, POINTS, VARIABLE};
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{ListFilter, Status};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const FOLDER: &str = "OVIDUCT_TEST_FOLDER";
const DATABASE: &str = "OVIDUCT_TEST_DATABASE";
const WORKERS: &str = "OVIDUCT_TEST_WORKERS";
const LEASE: &str = "OVIDUCT_TEST_LEASE_MS";
const JOBS: u64 = 3;

/// The test that child processes run. With a folder in the environment, it works until it is killed
/// or stopped.
const CHILD: &str = "kill::a_killed_worker_loses_nothing_on_sqlite";

/// In a child process: runs all queued jobs.
async fn work(folder: &Path) {
    let url = std::env::var(DATABASE).unwrap();
    let place = Place::at(folder, &url).await;
    let number = |name| std::env::var(name).unwrap().parse::<u32>().unwrap();
    let faults = Faults::from_env().unwrap();
    let pool = place.start(|options| {
        options.workers = number(WORKERS);
        options.faults = faults;
        options.heartbeat = Duration::from_millis(250);
        options.lease = Duration::from_millis(number(LEASE).into());
        options.poll = Duration::from_millis(100);
    });
    for job in place.store.list(&ListFilter { limit: 100, ..ListFilter::default() }).await.unwrap().jobs {
        place.ended(job.id).await;
    }
    pool.shutdown(Duration::from_secs(5)).await;
    place.store.close().await;
}

/// Starts a child process over a place, with an injected fault.
pub fn start_child(folder: &Path, url: &str, fault: &str) -> Child {
    start_child_with(folder, url, fault, 2, Duration::from_secs(1))
}

/// Starts a child process with this number of workers and this lease.
pub fn start_child_with(folder: &Path, url: &str, fault: &str, workers: u32, lease: Duration) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", CHILD, "--test-threads=1"])
        .env(FOLDER, folder)
        .env(DATABASE, url)
        .env(VARIABLE, fault)
        .env(WORKERS, workers.to_string())
        .env(LEASE, lease.as_millis().to_string())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

async fn kill_at(database: Database, point: &str) {
    let dir = tempfile::tempdir().unwrap();
    let url = database.url(dir.path()).await;
    let place = Place::at(dir.path(), &url).await;
    for seed in 1..=JOBS {
        place.queue(if point == "during-renewal" { "hold" } else { "ok" }, seed).await;
    }
    place.store.close().await;
    drop(place);

    let died = start_child(dir.path(), &url, &format!("{point}:kill")).wait().unwrap();
    assert_eq!(died.code(), None, "{point}: the child was not killed");
    for path in visible(&dir.path().join("artifacts")) {
        let name = path.file_name().unwrap().to_str().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let whole = (1..=JOBS).any(|seed| {
            let names = if name == "pack" { &NAMES[..] } else { &[name] };
            bytes == names.iter().flat_map(|name| content(seed, name)).collect::<Vec<u8>>()
        });
        assert!(whole, "{point}: {} is incomplete", path.display());
    }
    // Open the gate for the jobs that ran until the renewal of their leases.
    std::fs::write(gate::file(dir.path()), "").unwrap();
    let status = start_child_with(dir.path(), &url, "", 2, Duration::from_secs(5)).wait().unwrap();
    assert!(status.success(), "{point}: {status}");

    let place = Place::at(dir.path(), &url).await;
    let jobs = place.store.list(&ListFilter { limit: 100, ..ListFilter::default() }).await.unwrap().jobs;
    assert_eq!(jobs.len() as u64, JOBS, "{point}");
    for job in &jobs {
        assert_eq!(job.status, Status::Succeeded, "{point}: {:?}", job.problem);
        place.check_files(job).await;
        let attempts = place.store.attempts(job.id).await.unwrap();
        let ends = attempts.iter().filter(|a| a.outcome == Some(AttemptEnd::Succeeded)).count();
        assert_eq!(ends, 1, "{point}");
        assert!(attempts.iter().all(|a| a.outcome.is_some()), "{point}: {attempts:?}");
    }
    // The orphan sweep removes files that the dead process uploaded without committing them.
    let far = "2200-01-01T00:00:00Z".parse().unwrap();
    place.sweep_orphans(far, Duration::ZERO).await;
    assert_eq!(place.visible().len(), objects(jobs.iter().flat_map(|job| &job.files)), "{point}");
    assert!(place.scratch().is_empty(), "{point}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_killed_worker_loses_nothing_on_sqlite() {
    if let Some(folder) = std::env::var_os(FOLDER) {
        return work(Path::new(&folder)).await;
    }
    for point in POINTS {
        kill_at(Database::Sqlite, point).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_killed_worker_loses_nothing_on_postgres() {
    for point in POINTS {
        kill_at(Database::Postgres, point).await;
    }
}
