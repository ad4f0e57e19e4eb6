//! The cost of claims, heartbeats, submissions, reads and counts does not depend on the length of
//! the queue. This test goes up to 10^5 jobs; `benches/claim.rs` continues to 10^6.

use crate::cluster::Cluster;
use crate::queue::{costs, fill_postgres, fill_sqlite, options};
use crate::scripted::Database;
use oviduct::jobs::{Counts, Store};

const SHORT: u64 = 200;
const LONG: u64 = 100_000;

/// Maximum number of rounds. Other load of the machine can slow down all operations of a round.
const ROUNDS: u32 = 5;

/// Compares the costs on a long and on a short queue.
///
/// A long queue may cost a little more, because its index is deeper and fewer of its pages are
/// cached. A scan of the whole queue would cost hundreds of times as much. The lower bound on the
/// short queue's time limits the effect of very short times. Each round measures both queues in
/// succession; the best round of each operation counts.
async fn check(short: &Store, long: &Store) {
    let mut best: Vec<(&str, f64, String)> = Vec::new();
    for _ in 0..ROUNDS {
        let (short, long) = (costs(short).await, costs(long).await);
        eprintln!("{SHORT} queued: {short:?}\n{LONG} queued: {long:?}");
        let pairs = short.0.iter().zip(&long.0);
        let now = pairs.map(|(short, long)| (short.0, long.1 / short.1.max(0.004), format!("{short:?}, {long:?}")));
        best = match best.is_empty() {
            true => now.collect(),
            false => best.into_iter().zip(now).map(|(best, now)| if now.1 < best.1 { now } else { best }).collect(),
        };
        if best.iter().all(|(_, ratio, _)| *ratio < 4.0) {
            return;
        }
    }
    panic!("{best:#?}");
}

async fn are_counted(store: &Store, rows: u64) {
    let queued = store.queued_by_backend().await.unwrap().map(|(backend, jobs)| (backend.name(), jobs));
    assert_eq!(queued, [("auto", rows - rows / 10), ("gpu", rows / 10), ("cpu", 0), ("cpu-single", 0)]);
    let counts = store.counts().await.unwrap();
    assert_eq!(counts, Counts { queued: rows, failed: rows, ..Counts::default() });
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_long_queue_costs_no_more_than_a_short_one_on_sqlite() {
    let queue = async |rows: u64| {
        let dir = tempfile::tempdir().unwrap();
        let url = Database::Sqlite.url(dir.path()).await;
        oviduct::jobs::Database::parse(&url).unwrap().migrate().await.unwrap();
        fill_sqlite(&dir.path().join("jobs.db"), rows).await;
        let store = oviduct::jobs::open(&url, options()).await.unwrap();
        are_counted(&store, rows).await;
        (dir, store)
    };
    let ((_short, short), (_long, long)) = (queue(SHORT).await, queue(LONG).await);
    check(&short, &long).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_long_queue_costs_no_more_than_a_short_one_on_postgres() {
    let psql = |url: &str, sql: &str| {
        let (url, sql) = (url.to_owned(), sql.to_owned());
        tokio::task::spawn_blocking(move || Cluster::shared().psql(&url, &sql))
    };
    let queue = async |rows: u64| {
        let url = Database::Postgres.url("".as_ref()).await;
        let store = oviduct::jobs::open(&url, options()).await.unwrap();
        psql(&url, &fill_postgres(rows)).await.unwrap();
        are_counted(&store, rows).await;
        (url, store)
    };
    let (_, short) = queue(SHORT).await;
    // First without planner statistics of the long queue, as right after it was filled; then with
    // them.
    let (url, long) = queue(LONG).await;
    check(&short, &long).await;
    psql(&url, "ANALYZE").await.unwrap();
    long.close().await;
    let long = oviduct::jobs::open(&url, options()).await.unwrap();
    let scans = "SELECT pg_sleep(1.5); SELECT seq_scan FROM pg_stat_user_tables WHERE relname = 'jobs'";
    let before = psql(&url, scans).await.unwrap();
    check(&short, &long).await;
    long.close().await;
    assert_eq!(psql(&url, scans).await.unwrap(), before, "a query read the whole table");
}
