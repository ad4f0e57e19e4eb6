//! What a claim, a submission and a look at a job cost on queues of 10^2 to 10^6 jobs, on both stores.
//!
//! `cargo bench --bench claim [-- LONGEST]`. PostgreSQL is started from Debian's package, as in the tests.
#![allow(missing_docs, unreachable_pub, clippy::print_stdout, reason = "a bench prints its results")]

#[path = "../tests/common/postgres.rs"]
#[allow(dead_code, reason = "shared with tests that need more of it")]
mod cluster;
#[path = "../tests/common/queue.rs"]
mod queue;

use cluster::Cluster;
use oviduct::jobs::{Database, open};
use queue::{Cost, cost, fill_postgres, fill_sqlite, options};

fn print(store: &str, rows: u64, cost: Cost) {
    let [claim, four, submit, read] = [cost.claim, cost.claim_four, cost.submit, cost.read].map(|s| s * 1e3);
    println!("| {store} | {rows} | {claim:.2} | {four:.2} | {submit:.2} | {read:.2} |");
}

async fn run(longest: u64) {
    println!("| store | queued | claim, ms | claim of 4, ms | submit, ms | look, ms |\n|---|---|---|---|---|---|");
    let sizes: Vec<u64> = (2..=6).map(|n| 10u64.pow(n)).filter(|rows| *rows <= longest).collect();
    for &rows in &sizes {
        let dir = tempfile::tempdir().expect("a folder");
        let path = dir.path().join("jobs.db");
        let database = Database::Sqlite(path.clone());
        database.migrate().await.expect("tables");
        // The jobs that the samples take come on top.
        fill_sqlite(&path, rows + 100).await;
        let store = database.open(options()).await.expect("a store");
        print("SQLite", rows, cost(&*store).await);
        store.close().await;
    }
    let cluster = Cluster::shared();
    for &rows in &sizes {
        let url = cluster.database();
        let store = open(&url, options()).await.expect("a store");
        cluster.psql(&url, &fill_postgres(rows + 100));
        print("PostgreSQL", rows, cost(&*store).await);
        store.close().await;
    }
}

fn main() {
    let longest = std::env::args().skip(1).find_map(|arg| arg.parse().ok()).unwrap_or(1_000_000);
    tokio::runtime::Runtime::new().expect("a runtime").block_on(run(longest));
}
