//! Claims, heartbeats, submissions, looks and counts cost the same whatever the length of the queue. Up to 10^5 here;
//! `benches/claim.rs` goes on to 10^6.

use crate::cluster::Cluster;
use crate::queue::{Costs, costs, fill_postgres, fill_sqlite, options};
use crate::scripted::Ground;
use oviduct::jobs::{Counts, Store};

const SHORT: u64 = 200;
const LONG: u64 = 100_000;

/// A long queue may cost a little more, for its index is deeper and its pages are not all at hand; a pass over it would
/// cost hundreds of times as much. The floor keeps a short queue's luck out.
fn check(short: &Costs, long: &Costs) {
    eprintln!("{SHORT} queued: {short:?}\n{LONG} queued: {long:?}");
    for ((what, short), (_, long)) in short.0.iter().zip(&long.0) {
        assert!(*long < 4.0 * short.max(0.004), "{what}: {short} s, and on a long queue {long} s");
    }
}

async fn are_counted(store: &dyn Store, rows: u64) {
    let counts = store.counts().await.unwrap();
    assert_eq!(counts, Counts { queued: rows, failed: rows, ..Counts::default() });
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_long_queue_costs_no_more_than_a_short_one_on_sqlite() {
    let at = async |rows: u64| {
        let dir = tempfile::tempdir().unwrap();
        let url = Ground::Sqlite.url(dir.path()).await;
        oviduct::jobs::Database::parse(&url).unwrap().migrate().await.unwrap();
        fill_sqlite(&dir.path().join("jobs.db"), rows).await;
        let store = oviduct::jobs::open(&url, options()).await.unwrap();
        are_counted(&*store, rows).await;
        let costs = costs(&*store).await;
        store.close().await;
        costs
    };
    check(&at(SHORT).await, &at(LONG).await);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_long_queue_costs_no_more_than_a_short_one_on_postgres() {
    let at = async |rows: u64| {
        let url = Ground::Postgres.url("".as_ref()).await;
        let store = oviduct::jobs::open(&url, options()).await.unwrap();
        let psql = |sql: &str| {
            let (url, sql) = (url.clone(), sql.to_owned());
            tokio::task::spawn_blocking(move || Cluster::shared().psql(&url, &sql))
        };
        psql(&fill_postgres(rows)).await.unwrap();
        are_counted(&*store, rows).await;
        // Once without statistics of the long queue, as they are when it has just come; then with them.
        let fresh = costs(&*store).await;
        psql("ANALYZE").await.unwrap();
        store.close().await;
        let store = oviduct::jobs::open(&url, options()).await.unwrap();
        let scans = "SELECT pg_sleep(1.5); SELECT seq_scan FROM pg_stat_user_tables WHERE relname = 'jobs'";
        let before = psql(scans).await.unwrap();
        let known = if rows > SHORT { costs(&*store).await } else { fresh.clone() };
        store.close().await;
        assert!(rows <= SHORT || psql(scans).await.unwrap() == before, "a query read the whole table");
        (fresh, known)
    };
    let (short, long) = (at(SHORT).await, at(LONG).await);
    check(&short.0, &long.0);
    check(&short.0, &long.1);
}
