//! A seeded schedule of 500 faults over four workers: each job ends once, with the right bytes.

use crate::scripted::{Database, OBJECTS, Place};
use oviduct::clock::{Clock, Stopwatch};
use oviduct::jobs::fault::Faults;
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{ListFilter, Status, StoreOptions};
use std::time::Duration;

const FAULTS: u32 = 500;
/// Number of jobs that are submitted together.
const WAVE: u64 = 60;
/// Factor by which the clock of leases and retries runs faster than real time.
const SPEED: u32 = 20;
/// Environment variable with the seed, to reproduce a run.
const SEED: &str = "OVIDUCT_TEST_SEED";

async fn survives(database: Database) {
    let seed = std::env::var(SEED).map_or(0x5eed, |text| text.parse().expect("a number"));
    let told = PrintSeedOnPanic(seed);
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let options = StoreOptions { clock: clock.clone(), max_attempts: 10_000, ..StoreOptions::default() };
    let place = Place::on(database, options).await;
    let faults = Faults::random(seed, 12, FAULTS, Duration::from_millis(1500));
    // Leases last 1 s and are renewed every 150 ms, both in real time. A stall outlasts the lease.
    let pool = place.start(|options| {
        options.workers = 4;
        options.threads = 1;
        options.heartbeat = Duration::from_millis(150);
        options.progress = Duration::from_millis(50);
        options.lease = Duration::from_secs(1) * SPEED;
        options.poll = Duration::from_millis(50);
        options.faults = faults.clone();
    });
    let time = tokio::spawn(async move {
        let mut since = Stopwatch::start();
        loop {
            tokio::time::sleep(Duration::from_millis(10)).await;
            // The measured time, which is longer than the sleep on a slow machine.
            let now = Stopwatch::start();
            clock.advance(since.elapsed() * SPEED);
            since = now;
        }
    });
    let mut queued = 0;
    while faults.left() > 0 {
        for _ in 0..WAVE {
            queued += 1;
            place.queue("ok", 1000 + queued).await;
        }
        loop {
            tokio::time::sleep(Duration::from_millis(50)).await;
            let counts = place.store.counts().await.unwrap();
            if counts.queued + counts.running == 0 {
                break;
            }
        }
    }
    pool.shutdown(Duration::from_secs(5)).await;
    time.abort();

    let mut filter = ListFilter { limit: 500, ..ListFilter::default() };
    let (mut jobs, mut attempts, mut vanished) = (0, 0, 0);
    loop {
        let page = place.store.list(&filter).await.unwrap();
        for job in &page.jobs {
            assert_eq!(job.status, Status::Succeeded, "{:?}", job.problem);
            place.check_files(job).await;
            let history = place.store.attempts(job.id).await.unwrap();
            let ends = history.iter().filter(|a| a.outcome == Some(AttemptEnd::Succeeded)).count();
            let last = history.last().unwrap().outcome;
            assert_eq!((ends, last), (1, Some(AttemptEnd::Succeeded)), "{history:?}");
            jobs += 1;
            attempts += history.len();
            vanished += history.iter().filter(|a| a.outcome == Some(AttemptEnd::Vanished)).count();
        }
        filter.before = page.next;
        if page.next.is_none() {
            break;
        }
    }
    assert_eq!(jobs, queued, "jobs were lost");
    let far = "2200-01-01T00:00:00Z".parse().unwrap();
    place.sweep_orphans(far, Duration::ZERO).await;
    assert_eq!(place.visible().len() as u64, jobs * OBJECTS as u64);
    assert!(place.scratch().is_empty());
    eprintln!("{database:?}: {FAULTS} faults, {jobs} jobs, {attempts} attempts, {vanished} of them by lost leases");
    assert!(vanished > 0, "no lease was lost: the test shows too little");
    place.store.close().await;
    drop(told);
}

struct PrintSeedOnPanic(u64);

impl Drop for PrintSeedOnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("to reproduce these faults: {SEED}={}", self.0);
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn random_faults_lose_nothing_on_sqlite() {
    survives(Database::Sqlite).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn random_faults_lose_nothing_on_postgres() {
    survives(Database::Postgres).await;
}
