//! Claims and submissions cost the same whatever the length of the queue. Up to 10^5 here; `benches/claim.rs` goes on
//! to 10^6.

use crate::cluster::Cluster;
use crate::queue::{Cost, cost, fill_postgres, fill_sqlite, options};
use crate::scripted::Ground;

const SHORT: u64 = 200;
const LONG: u64 = 100_000;

/// A long queue may cost a little more, for its index is deeper and its pages are not all at hand; a pass over it would
/// cost hundreds of times as much. The floor keeps a short queue's luck out.
fn check(short: Cost, long: Cost) {
    eprintln!("{SHORT} queued: {short:?}\n{LONG} queued: {long:?}");
    let bound = |short: f64| 4.0 * short.max(0.004);
    assert!(long.claim < bound(short.claim), "a claim: {short:?} {long:?}");
    assert!(long.claim_four < bound(short.claim_four), "four at a time: {short:?} {long:?}");
    assert!(long.submit < bound(short.submit), "a submission: {short:?} {long:?}");
    assert!(long.read < bound(short.read), "a look: {short:?} {long:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_long_queue_costs_no_more_than_a_short_one_on_sqlite() {
    let at = async |rows: u64| {
        let dir = tempfile::tempdir().unwrap();
        let url = Ground::Sqlite.url(dir.path()).await;
        oviduct::jobs::Database::parse(&url).unwrap().migrate().await.unwrap();
        fill_sqlite(&dir.path().join("jobs.db"), rows).await;
        let store = oviduct::jobs::open(&url, options()).await.unwrap();
        assert_eq!(store.counts().await.unwrap().queued, rows);
        let cost = cost(&*store).await;
        store.close().await;
        cost
    };
    check(at(SHORT).await, at(LONG).await);
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
        // Once without statistics of the long queue, as they are when it has just come; then with them.
        let fresh = cost(&*store).await;
        psql("ANALYZE").await.unwrap();
        store.close().await;
        let store = oviduct::jobs::open(&url, options()).await.unwrap();
        let scans = "SELECT pg_sleep(1.5); SELECT seq_scan FROM pg_stat_user_tables WHERE relname = 'jobs'";
        let before = psql(scans).await.unwrap();
        let known = if rows > SHORT { cost_again(&*store).await } else { fresh };
        store.close().await;
        assert!(rows <= SHORT || psql(scans).await.unwrap() == before, "a query read the whole table");
        (fresh, known)
    };
    let (short, long) = (at(SHORT).await, at(LONG).await);
    check(short.0, long.0);
    check(short.0, long.1);
}

/// The keys of the first samples are taken.
async fn cost_again(store: &dyn oviduct::jobs::Store) -> Cost {
    for n in 0..crate::queue::SAMPLES {
        let key = (format!("key {n}"), String::new());
        let replayed = oviduct::jobs::NewJob { idempotency: Some(key), ..crate::suite::new_job("x") };
        let id = store.submit(replayed).await.unwrap().job().id;
        store.delete(id).await.unwrap();
    }
    cost(store).await
}
