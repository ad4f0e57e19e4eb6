//! Cost of queue operations with 10^2 to 10^6 queued jobs and as many ended ones, on both
//! databases: claims, a heartbeat, a submission, a read of a job and the counts.
//!
//! Usage: `cargo bench --bench claim [-- LONGEST [ROUNDS]]`. PostgreSQL is started from Debian's
//! package, as in the tests. Each cell contains the median of the rounds, with their minimum and
//! maximum in parentheses.
#![allow(missing_docs, unreachable_pub, clippy::print_stdout, reason = "a bench prints its results")]

#[path = "../tests/common/postgres.rs"]
#[allow(dead_code, reason = "shared with tests that need more of it")]
mod cluster;
#[path = "../tests/common/queue.rs"]
mod queue;

use cluster::Cluster;
use oviduct::jobs::{Database, Store, open};
use queue::{Costs, costs, fill_postgres, fill_sqlite, options};

/// Measures a job store in several rounds and prints a row of the table.
async fn measure(name: &str, rows: u64, rounds: usize, store: &Store) {
    let mut all: Vec<Costs> = Vec::new();
    for _ in 0..rounds {
        all.push(costs(store).await);
    }
    let mut line = format!("| {name} | {rows} |");
    for what in 0..all[0].0.len() {
        let mut millis: Vec<f64> = all.iter().map(|costs| costs.0[what].1 * 1e3).collect();
        millis.sort_by(f64::total_cmp);
        line += &format!(" {:.2} ({:.2}–{:.2}) |", millis[rounds / 2], millis[0], millis[rounds - 1]);
    }
    println!("{line}");
}

async fn run(longest: u64, rounds: usize) {
    println!(
        "| store | queued | claim, ms | claim of 4, ms | GPU claim of 4, ms | heartbeat, ms | submit, ms | look, ms | counts, ms |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let sizes: Vec<u64> = (1..=3).map(|n| 100u64.pow(n)).filter(|rows| *rows <= longest).collect();
    // The measurements claim some jobs, so queue these in addition.
    let taken = 100 * rounds as u64;
    for &rows in &sizes {
        let dir = tempfile::tempdir().expect("a folder");
        let path = dir.path().join("jobs.db");
        let database = Database::Sqlite(path.clone());
        database.migrate().await.expect("tables");
        fill_sqlite(&path, rows + taken).await;
        let store = database.open(options()).await.expect("a store");
        measure("SQLite", rows, rounds, &store).await;
        store.close().await;
    }
    let cluster = Cluster::shared();
    for &rows in &sizes {
        let url = cluster.database();
        let store = open(&url, options()).await.expect("a store");
        cluster.psql(&url, &fill_postgres(rows + taken));
        cluster.psql(&url, "ANALYZE");
        measure("PostgreSQL", rows, rounds, &store).await;
        store.close().await;
    }
}

fn main() {
    let mut numbers = std::env::args().skip(1).filter_map(|arg| arg.parse::<u64>().ok());
    let (longest, rounds) = (numbers.next().unwrap_or(1_000_000), numbers.next().unwrap_or(5));
    tokio::runtime::Runtime::new().expect("a runtime").block_on(run(longest, rounds.max(1) as usize));
}
