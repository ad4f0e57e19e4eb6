//! Histories of several clients that use several processes of the program while processes, their
//! connections and the database fail. A known checker searches an order that explains each history
//! (stateright's tester of linearizability).
//!
//! | variable | meaning |
//! |---|---|
//! | `OVIDUCT_TEST_SEED` | seed of the faults and of the operations |
//! | `OVIDUCT_TEST_SECONDS` | minimum duration of the faults, per database |
//! | `OVIDUCT_TEST_KILLS`, `…_DATABASE_KILLS`, `…_LOST_COMMITS` | minimum numbers of faults |
//! | `OVIDUCT_TEST_PROGRAM` | the program, instead of the one that was built with these tests |
#![cfg(unix)]
#![allow(
    clippy::unwrap_used,
    clippy::print_stderr,
    missing_docs,
    unreachable_pub,
    reason = "a test: what fails, fails here"
)]

mod checker;
mod clients;
#[allow(dead_code, reason = "shared with tests that need more of it")]
#[path = "../common/postgres.rs"]
mod cluster;
mod dice;
mod examples;
mod nemesis;
mod processes;
#[allow(dead_code, reason = "shared with tests that need more of it")]
#[path = "../jobs/relay.rs"]
mod relay;
mod spec;

use checker::History;
use clients::{Object, World};
use cluster::Cluster;
use dice::Dice;
use nemesis::{Nemesis, Parts, Struck};
use oviduct::clock::Stopwatch;
use processes::Process;
use relay::Way;
use std::io::Write;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

/// Keys that are in use at the same time.
const KEYS: u32 = 6;
/// Clients of a key.
const CLIENTS: u32 = 3;
/// Number of the client that reads after the faults.
const LAST_CLIENT: u32 = CLIENTS;
/// Maximum time for a model to end after the faults.
const ENDED_WITHIN: Duration = Duration::from_secs(300);

/// Maximum time for a request to be answered or cut: a read and a change, each with 5 s for a free
/// connection, 5 s for its opening and 10 s for its answer (docs/queue.md), and 5 s of retries.
const ANSWERED_WITHIN: Duration = Duration::from_secs(45);

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|text| text.parse().expect("a number"))
}

/// How long and how hard to test.
struct Plan {
    seed: u64,
    time: Duration,
    faults: Struck,
}

impl Plan {
    fn from_env(with_server: bool) -> Vec<Self> {
        let is_night = std::env::var_os("OVIDUCT_TEST_NIGHT").is_some();
        let seconds = number("OVIDUCT_TEST_SECONDS").unwrap_or(if is_night { 120 } else { 20 });
        let wanted = |name| u32::try_from(number(name).unwrap_or(0)).unwrap();
        let at_server = |name| if with_server { wanted(name) } else { 0 };
        let faults = Struck {
            kills: wanted("OVIDUCT_TEST_KILLS"),
            database_kills: at_server("OVIDUCT_TEST_DATABASE_KILLS"),
            lost_commits: at_server("OVIDUCT_TEST_LOST_COMMITS"),
            ..Struck::default()
        };
        let seeds = match number("OVIDUCT_TEST_SEED") {
            Some(seed) => seed..seed + 1,
            None => 46..if is_night { 49 } else { 47 },
        };
        seeds.map(|seed| Self { seed, time: Duration::from_secs(seconds), faults }).collect()
    }
}

/// Prints the seed and the logs of a run that fails.
struct Told {
    what: String,
    processes: Vec<Arc<Process>>,
}

impl Drop for Told {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("failed: {}", self.what);
            for process in &self.processes {
                eprintln!("log of {}:\n{}", process.name, process.tail());
            }
        }
    }
}

/// Clients use one key after the other until `over`.
async fn use_keys(
    world: Arc<World>,
    seed: u64,
    slot: u32,
    over: CancellationToken,
    used: Arc<Mutex<Vec<Arc<Object>>>>,
) {
    for round in 0.. {
        if over.is_cancelled() {
            return;
        }
        let name = format!("{seed}-{slot}-{round}");
        let object = Object { world: Arc::clone(&world), name, history: Mutex::default(), id: Mutex::default() };
        let object = Arc::new(object);
        used.lock().unwrap().push(Arc::clone(&object));
        let mut dice = Dice::new(seed, 1000 * (slot + 1) + round);
        let (cancels, deletes) = (dice.below(3) == 0, dice.below(3) == 0);
        let mut clients = JoinSet::new();
        for client in 0..CLIENTS {
            let dice = Dice::new(seed, (1 + client) << 24 | slot << 16 | round);
            clients.spawn(Arc::clone(&object).use_as(client, dice, cancels, deletes));
        }
        clients.join_all().await;
    }
}

/// Runs clients and faults, and checks the histories.
async fn run(what: &str, plan: &Plan, parts: Parts, services: usize) {
    let since = Stopwatch::start();
    let processes = parts.processes.clone();
    let what = format!("{what}, OVIDUCT_TEST_SEED={}", plan.seed);
    let _told = Told { what: what.clone(), processes: processes.clone() };
    let _supervised: Vec<_> = processes.iter().map(Process::supervise).collect();
    let world = World::new(processes[..services].iter().map(|process| process.url.clone()).collect());
    let (over, used) = (CancellationToken::new(), Arc::<Mutex<Vec<_>>>::default());
    let mut slots = JoinSet::new();
    for slot in 0..KEYS {
        slots.spawn(use_keys(Arc::clone(&world), plan.seed, slot, over.clone(), Arc::clone(&used)));
    }
    let mut nemesis = Nemesis::new(parts, Dice::new(plan.seed, 0));
    let mut minutes = 1_u64..;
    while since.elapsed() < plan.time || !nemesis.struck().reaches(&plan.faults) {
        nemesis.strike().await;
        if since.elapsed() >= Duration::from_secs(60 * minutes.start) {
            minutes.next();
            eprintln!("{what}: {:?}", nemesis.struck());
        }
        while let Some(ended) = slots.try_join_next() {
            ended.unwrap();
        }
    }
    nemesis.relent().await;
    over.cancel();
    slots.join_all().await;

    let objects = std::mem::take(&mut *used.lock().unwrap());
    let (mut models, mut longest, mut checked) = (0, Duration::ZERO, Duration::ZERO);
    for object in &objects {
        models += u32::from(object.ended(LAST_CLIENT, ENDED_WITHIN).await);
        let history: History = object.history.lock().unwrap().clone();
        let time = tokio::task::spawn_blocking(move || history.check()).await.unwrap();
        let time = time.unwrap_or_else(|fault| panic!("key {}: {fault}", object.name));
        (longest, checked) = (longest.max(time), checked + time);
    }
    let counts = *world.counts.lock().unwrap();
    let (starts, own_ends) =
        processes.iter().map(|process| process.history()).fold((0, 0), |all, one| (all.0 + one.0, all.1 + one.1));
    // Not `eprintln`, whose text a test that passes hides.
    let told = writeln!(
        std::io::stderr(),
        "{what}: {counts:?}, {:?}, {} keys with {models} models in the end, {starts} starts of processes, {own_ends} \
         ends without a database, checked in {checked:?} (longest {longest:?}), {:?} in all",
        nemesis.struck(),
        objects.len(),
        since.elapsed(),
    );
    told.unwrap();
    assert!(counts.slowest < ANSWERED_WITHIN, "{what}: a request took {:?}", counts.slowest);
}

/// The artifacts that all processes share.
fn shared(folder: &Path) -> String {
    format!("file:{}", folder.join("artifacts").display())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn histories_of_several_processes_over_postgres_are_linearizable() {
    for plan in Plan::from_env(true) {
        let folder = tempfile::tempdir().unwrap();
        let cluster = tokio::task::spawn_blocking(Cluster::start).await.unwrap();
        let (url, artifacts) = (cluster.database(), shared(folder.path()));
        let mut parts = Parts { database: Some(Arc::new(cluster)), ..Parts::default() };
        for (name, command) in [("a", "serve"), ("b", "serve"), ("c", "worker")] {
            let way = Way::open(&url).await;
            let options = ["--database", &way.url, "--artifacts", &artifacts];
            parts.processes.push(Process::new(folder.path(), name, command, &options));
            parts.ways.push(way);
        }
        run("postgres", &plan, parts, 2).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn histories_of_a_restarted_process_over_sqlite_are_linearizable() {
    for plan in Plan::from_env(false) {
        let folder = tempfile::tempdir().unwrap();
        let processes = vec![Process::new(folder.path(), "a", "serve", &[])];
        run("sqlite", &plan, Parts { processes, ..Parts::default() }, 1).await;
    }
}
