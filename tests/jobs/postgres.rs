//! The suite over PostgreSQL, and tests of several processes over one server. Two job stores on one
//! database share only the server, so they behave like two processes.

use crate::bounds::{best_of_five, within};
use crate::cluster::Cluster;
use crate::kill::start_child_with;
use crate::relay::{Line, Way};
use crate::scripted::{Database, NAMES, OBJECTS, Place, content, scripted};
use crate::suite::{Factory, finished, new_job, objects};
use futures_util::FutureExt;
use futures_util::future::join_all;
use oviduct::clock::{Clock, Stopwatch};
use oviduct::jobs::artifacts;
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{
    ClaimScope, Directive, File, Finished, Job, JobId, NewJob, Status, Store, StoreError, StoreOptions, Submitted,
};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A lease that does not expire during a test.
const LEASE: Duration = Duration::from_secs(600);
/// Maximum wait for an expected event.
const DEADLINE: Duration = Duration::from_secs(600);

const SERVER: Factory = |options| {
    async move {
        let url = Database::Postgres.url("".as_ref()).await;
        let store = Store::open_postgres(&url, options).await.unwrap();
        (store, Box::new(()) as Box<dyn Send + Sync>)
    }
    .boxed()
};

mod suite {
    crate::suite::over!(super::SERVER);
}

async fn open(url: &str) -> Store {
    Store::open_postgres(url, StoreOptions::default()).await.unwrap()
}

/// Two job stores on one new database.
async fn two() -> (Store, Store) {
    let url = Database::Postgres.url("".as_ref()).await;
    // Both stores run the migrations concurrently.
    tokio::join!(open(&url), open(&url))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_change_in_one_process_is_notified_in_the_other() {
    let (one, other) = two().await;
    let mut changes = other.changes();
    let job = one.submit(new_job("1")).await.unwrap().job().clone();
    let told = tokio::time::timeout(DEADLINE, changes.recv()).await.unwrap().unwrap();
    assert_eq!((told.id, told.version), (job.id, Some(1)));
    one.delete(job.id).await.unwrap();
    let told = tokio::time::timeout(DEADLINE, changes.recv()).await.unwrap().unwrap();
    assert_eq!((told.id, told.version), (job.id, None));
    assert_eq!(other.get(job.id).await.unwrap(), None);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cancel_in_one_process_stops_a_job_in_the_other_within_a_second() {
    let dir = tempfile::tempdir().unwrap();
    let url = Database::Postgres.url(dir.path()).await;
    let (service, worker) = (Place::at(dir.path(), &url).await, Place::at(dir.path(), &url).await);
    // The intervals of heartbeats and polling are far above the bound, so only a notification can
    // be in time.
    let pool = worker.start(|options| {
        options.heartbeat = Duration::from_secs(60);
        options.lease = Duration::from_secs(240);
        options.poll = Duration::from_secs(3600);
    });
    tokio::time::sleep(Duration::from_millis(300)).await;
    best_of_five(async |seed| {
        // The worker learns of the job by a notification; its polling interval is one hour.
        let id = service.queue("wait", seed).await;
        service.until(id, |job| job.progress.is_some()).await;
        let since = Stopwatch::start();
        service.store.cancel(id).await.unwrap();
        assert_eq!(service.ended(id).await.status, Status::Cancelled);
        within(1.0, since)
    })
    .await;
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn concurrent_processes_create_one_job_per_idempotency_key() {
    let (one, other) = two().await;
    for round in 0..10 {
        let keyed = move || NewJob { idempotency: Some((format!("k{round}"), "body".into())), ..new_job("d") };
        let racers = (0..16).map(|n| {
            let store = if n % 2 == 0 { one.clone() } else { other.clone() };
            tokio::spawn(async move { store.submit(keyed()).await.unwrap() })
        });
        let submitted: Vec<Submitted> = join_all(racers).await.into_iter().map(Result::unwrap).collect();
        let queued = submitted.iter().filter(|s| matches!(s, Submitted::Queued(_))).count();
        let ids: BTreeSet<JobId> = submitted.iter().map(|s| s.job().id).collect();
        assert_eq!((queued, ids.len()), (1, 1), "round {round}");
    }
    assert_eq!(one.counts().await.unwrap().queued, 10);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn files_that_are_being_reused_are_not_removed() {
    let (one, other) = two().await;
    let mut reused = 0;
    for round in 0..40 {
        let digest = format!("d{round}");
        one.submit(new_job(&digest)).await.unwrap();
        let claimed = one.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
        let done = finished(&claimed);
        let id = claimed.job().id;
        let made = done.files.clone();
        one.finish(claimed, done).await.unwrap();
        let (gone, again) = tokio::join!(one.delete(id), other.submit(new_job(&digest)));
        let (gone, again) = (gone.unwrap().unwrap(), again.unwrap());
        match &again {
            Submitted::Reused(job) => {
                reused += 1;
                assert_eq!((&job.files, gone.len()), (&made, 0), "round {round}: files in use were removed");
            }
            Submitted::Queued(job) => {
                assert_eq!(gone.len(), objects(&made), "round {round}");
                one.cancel(job.id).await.unwrap();
            }
            Submitted::Replayed(_) => panic!("no key was given"),
        }
    }
    eprintln!("{reused} of 40 races were won by the reuse");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn claimers_of_several_processes_end_each_job_once() {
    let (one, other) = two().await;
    for n in 0..120 {
        one.submit(new_job(&n.to_string())).await.unwrap();
    }
    let ended = Arc::new(Mutex::new(Vec::new()));
    let claimers = (0..6).map(|n| {
        let store = if n % 2 == 0 { one.clone() } else { other.clone() };
        let ended = Arc::clone(&ended);
        tokio::spawn(async move {
            // Another claim may have locked the last rows, so an empty claim does not mean an empty
            // queue.
            while store.counts().await.unwrap().queued > 0 {
                for claimed in store.claim(&format!("w{n}"), ClaimScope::Cpu, LEASE, 1 + n % 4).await.unwrap() {
                    let done = finished(&claimed);
                    let id = claimed.job().id;
                    store.finish(claimed, done).await.unwrap();
                    let job = store.get(id).await.unwrap().unwrap();
                    ended.lock().unwrap().push(job);
                }
            }
        })
    });
    join_all(claimers).await;
    let ended = ended.lock().unwrap();
    let ids: BTreeSet<JobId> = ended.iter().map(|job| job.id).collect();
    assert_eq!((ended.len(), ids.len()), (120, 120));
    assert!(ended.iter().all(|job| job.attempts == 1));
}

/// The counts are sums over rows that every transaction adds. The store merges these rows from time
/// to time.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn counts_of_several_processes_are_right_and_stay_few_rows() {
    let url = Database::Postgres.url("".as_ref()).await;
    let (one, other) = tokio::join!(open(&url), open(&url));
    let clients = (0..4).map(|client| {
        let store = if client % 2 == 0 { one.clone() } else { other.clone() };
        tokio::spawn(async move {
            for n in 0..150 {
                let new = NewJob { reuse: false, ..new_job("d") };
                let id = store.submit(new).await.unwrap().job().id;
                match n % 4 {
                    0 => drop(store.cancel(id).await.unwrap()),
                    1 => drop(store.delete(id).await.unwrap()),
                    2 => {
                        for claimed in store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap() {
                            let done = finished(&claimed);
                            match store.finish(claimed, done).await {
                                // Another client deleted the job in the meantime.
                                Ok(_) | Err(StoreError::Fenced) => {}
                                Err(error) => panic!("{error}"),
                            }
                        }
                    }
                    _ => {}
                }
                let counts = store.counts().await.unwrap();
                assert!(counts.total() <= 600, "{counts:?}");
            }
        })
    });
    for client in join_all(clients).await {
        client.unwrap();
    }
    let psql = async |sql: &'static str| {
        let url = url.clone();
        tokio::task::spawn_blocking(move || Cluster::shared().psql(&url, sql)).await.unwrap()
    };
    let counts = one.counts().await.unwrap();
    let counted = psql("SELECT status, COUNT(*) FROM jobs GROUP BY status ORDER BY status").await;
    let told = format!("cancelled|{}\nqueued|{}\nsucceeded|{}\n", counts.cancelled, counts.queued, counts.succeeded);
    assert_eq!((counted, counts.running, counts.total()), (told, 0, 448));
    let rows = "SELECT (SELECT COUNT(*) FROM queue_length) + (SELECT COUNT(*) FROM ended_jobs)";
    let rows: u64 = psql(rows).await.trim().parse().unwrap();
    assert!(rows <= 600, "of some 1800 changes {rows} rows are left");
}

fn signal(process: u32, name: &str) {
    let status = Command::new("kill").args([format!("-{name}"), process.to_string()]).status().unwrap();
    assert!(status.success());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stopped_worker_cannot_change_what_another_has_taken() {
    let dir = tempfile::tempdir().unwrap();
    let url = Database::Postgres.url(dir.path()).await;
    let place = Place::at(dir.path(), &url).await;
    let id = place.queue("hold", 7).await;
    let mut child = start_child_with(dir.path(), &url, "", 1, Duration::from_secs(5));
    place.until(id, |job| job.progress.is_some()).await;
    signal(child.id(), "STOP");
    place.open_gate();
    // The lease expires; this process claims the job and completes it.
    let pool = place.start(|options| {
        options.poll = Duration::from_millis(50);
        options.lease = Duration::from_secs(5);
    });
    let ended = place.ended(id).await;
    assert_eq!((ended.status, ended.attempts), (Status::Succeeded, 2));
    pool.shutdown(Duration::from_secs(5)).await;
    signal(child.id(), "CONT");
    // The child continues, learns that it lost the lease, and exits because no jobs are left.
    let status = tokio::task::spawn_blocking(move || child.wait()).await.unwrap().unwrap();
    assert!(status.success(), "{status}");
    assert_eq!(place.store.get(id).await.unwrap().unwrap(), ended, "the record was changed");
    place.check_files(&ended).await;
    let outcomes: Vec<_> = place.store.attempts(id).await.unwrap().iter().map(|a| a.outcome).collect();
    assert_eq!(outcomes, [Some(AttemptEnd::Vanished), Some(AttemptEnd::Succeeded)]);
    // If the child was stopped during an upload, the upload may have completed later. No record
    // names that file.
    let far = "2200-01-01T00:00:00Z".parse().unwrap();
    place.sweep_orphans(far, Duration::ZERO).await;
    assert_eq!(place.visible().len(), OBJECTS, "it left files");
}

/// Reads jobs repeatedly until all have ended; each state must be consistent with the previous one.
/// Returns the numbers of successful and of failed reads.
async fn watch(store: Store, ids: Arc<Mutex<Vec<JobId>>>) -> (usize, usize) {
    let (mut seen, mut away) = (0, 0);
    let mut last: BTreeMap<JobId, Job> = BTreeMap::new();
    loop {
        let known = ids.lock().unwrap().clone();
        let mut open = known.is_empty();
        for id in known {
            match store.get(id).await {
                Ok(job) => {
                    let job = job.expect("an accepted job is missing");
                    assert!(!matches!(job.status, Status::Failed | Status::Cancelled), "{:?}", job.problem);
                    if let Some(before) = last.get(&id) {
                        assert!(job.version >= before.version && job.attempts >= before.attempts);
                        assert!(!before.status.is_ended() || job == *before, "an ended job changed");
                    }
                    open |= !job.status.is_ended();
                    last.insert(id, job);
                    seen += 1;
                }
                Err(StoreError::Database(_)) => {
                    away += 1;
                    open = true;
                }
                Err(error) => panic!("{error}"),
            }
        }
        if !open && last.len() == JOBS as usize {
            return (seen, away);
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

const JOBS: u64 = 40;

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_server_that_crashes_under_load_loses_nothing() {
    let cluster = Arc::new(tokio::task::spawn_blocking(Cluster::start).await.unwrap());
    let url = cluster.database();
    let dir = tempfile::tempdir().unwrap();
    // Leases are short, so a slow machine may lose additional ones.
    let options = StoreOptions { max_attempts: 100, ..StoreOptions::default() };
    let place = Place::with(dir.path(), &url, options).await;
    let client = open(&url).await;
    let pool = place.start(|options| {
        options.workers = 4;
        options.threads = 1;
        options.heartbeat = Duration::from_millis(500);
        options.lease = Duration::from_secs(2);
        options.poll = Duration::from_millis(200);
    });
    let ids = Arc::new(Mutex::new(Vec::new()));
    let watcher = tokio::spawn(watch(client.clone(), Arc::clone(&ids)));
    let submitting = tokio::spawn({
        let ids = Arc::clone(&ids);
        async move {
            for seed in 1..=JOBS {
                let script = if seed % 4 == 0 { "slow" } else { "ok" };
                let keyed =
                    || NewJob { idempotency: Some((seed.to_string(), String::new())), ..scripted(script, 100 + seed) };
                // Retries with the same idempotency key until there is a response, as clients do.
                let submitted = loop {
                    match client.submit(keyed()).await {
                        Ok(submitted) => break submitted,
                        Err(StoreError::Database(_)) => tokio::time::sleep(Duration::from_millis(100)).await,
                        Err(error) => panic!("{error}"),
                    }
                };
                ids.lock().unwrap().push(submitted.job().id);
                tokio::time::sleep(Duration::from_millis(60)).await;
            }
        }
    });
    for pause in [300, 1500] {
        tokio::time::sleep(Duration::from_millis(800)).await;
        let cluster = Arc::clone(&cluster);
        let crash = move || {
            cluster.crash();
            std::thread::sleep(Duration::from_millis(pause));
            cluster.restart();
        };
        tokio::task::spawn_blocking(crash).await.unwrap();
    }
    submitting.await.unwrap();
    let watched = tokio::time::timeout(DEADLINE, watcher).await.expect("jobs did not end");
    let (seen, away) = watched.unwrap();
    // The process receives notifications from other processes again.
    let mut changes = place.store.changes();
    let other = open(&url).await;
    let last = other.submit(scripted("ok", 999)).await.unwrap().job().id;
    let heard = async { while changes.recv().await.unwrap().id != last {} };
    tokio::time::timeout(DEADLINE, heard).await.expect("the listener did not come back");
    place.ended(last).await;
    pool.shutdown(Duration::from_secs(10)).await;
    let counts = other.counts().await.unwrap();
    assert_eq!((counts.succeeded, counts.total()), (JOBS + 1, JOBS + 1));
    let mut attempts = 0;
    let ids = ids.lock().unwrap().clone();
    for id in &ids {
        let job = other.get(*id).await.unwrap().unwrap();
        place.check_files(&job).await;
        let history = other.attempts(*id).await.unwrap();
        assert_eq!(history.iter().filter(|a| a.outcome == Some(AttemptEnd::Succeeded)).count(), 1);
        attempts += history.len();
    }
    eprintln!("{JOBS} jobs over two crashes: {attempts} attempts, {seen} looks, {away} of them while it was away");
}

/// The database is unavailable for three leases while four models grow and clients submit jobs. A
/// manual clock times the leases. The outage lasts long enough in real time for claims to fail.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn an_outage_longer_than_three_leases_costs_no_attempt() {
    const LEASE: Duration = Duration::from_secs(8);
    let cluster = tokio::task::spawn_blocking(Cluster::start).await.unwrap();
    let cluster = Arc::new(cluster);
    let url = {
        let cluster = Arc::clone(&cluster);
        tokio::task::spawn_blocking(move || cluster.database()).await.unwrap()
    };
    let dir = tempfile::tempdir().unwrap();
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let options = || StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
    let (place, other) =
        (Place::with(dir.path(), &url, options()).await, Place::with(dir.path(), &url, options()).await);
    // These workers hold the leases. After the outage, their heartbeats come later than the polls
    // of the idle workers.
    let holders = place.start(|options| {
        options.workers = 4;
        options.threads = 1;
        options.heartbeat = Duration::from_secs(2);
        options.lease = LEASE;
    });
    let mut ids = Vec::new();
    for seed in 0..4 {
        let id = place.queue("hold", seed).await;
        place.until(id, |job| job.progress.is_some()).await;
        ids.push(id);
    }
    let idle = other.start(|options| {
        options.workers = 2;
        options.threads = 1;
        options.poll = Duration::from_millis(20);
        options.lease = LEASE;
    });
    let warm_up = other.queue("ok", 99).await;
    other.ended(warm_up).await;
    clock.advance(LEASE / 2);
    let submitting = tokio::spawn({
        let store = other.store.clone();
        async move {
            let mut ids = Vec::new();
            for seed in 100..140 {
                let keyed = || NewJob { idempotency: Some((seed.to_string(), String::new())), ..scripted("ok", seed) };
                loop {
                    match store.submit(keyed()).await {
                        Ok(submitted) => break ids.push(submitted.job().id),
                        Err(StoreError::Database(_)) => tokio::time::sleep(Duration::from_millis(100)).await,
                        Err(error) => panic!("{error}"),
                    }
                }
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            ids
        }
    });
    let control = async |control: fn(&Cluster)| {
        let cluster = Arc::clone(&cluster);
        tokio::task::spawn_blocking(move || control(&cluster)).await.unwrap();
    };
    control(Cluster::crash).await;
    // Both processes notice the outage.
    let claim = async |store: &Store| store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap_err();
    tokio::join!(claim(&place.store), claim(&other.store));
    clock.advance(3 * LEASE);
    control(Cluster::restart).await;
    ids.extend(submitting.await.unwrap());
    place.open_gate();
    for id in ids {
        let job = place.ended(id).await;
        assert_eq!((job.status, job.attempts), (Status::Succeeded, 1), "{:?}", place.store.attempts(id).await);
    }
    tokio::join!(holders.shutdown(Duration::from_secs(5)), idle.shutdown(Duration::from_secs(5)));
}

/// A transaction is committed, but its connection breaks before the response. The store neither
/// repeats the transaction nor loses its result.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_commit_whose_response_is_lost_takes_effect_once() {
    let way = Way::open(&Database::Postgres.url("".as_ref()).await).await;
    let store = open(&way.url).await;
    let (after, before) = (Line::CutAfterCommit, Line::CutBeforeCommit);
    for (how, seed) in [(after, "1"), (before, "2"), (after, "3"), (before, "4")] {
        let lose_the_next_answer =
            || assert_eq!(way.line.send_replace(how), Line::Open, "the last answer was not lost");
        lose_the_next_answer();
        let id = store.submit(new_job(seed)).await.unwrap().job().id;
        lose_the_next_answer();
        let claimed = store.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().expect("the claim was lost");
        assert_eq!((claimed.job().id, claimed.attempt()), (id, 1));
        lose_the_next_answer();
        let done = finished(&claimed);
        store.finish(claimed, done).await.unwrap();
        let ends: Vec<_> = store.attempts(id).await.unwrap().into_iter().map(|attempt| attempt.outcome).collect();
        assert_eq!(ends, [Some(AttemptEnd::Succeeded)]);
    }
    assert_eq!(*way.line.borrow(), Line::Open);
    let counts = store.counts().await.unwrap();
    assert_eq!((counts.succeeded, counts.total()), (4, 4));
}

/// A process that starts after an outage does not know about it. It therefore expires no lease
/// during its first lease period.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_process_that_has_just_started_expires_no_lease() {
    const LEASE: Duration = Duration::from_secs(8);
    let url = Database::Postgres.url("".as_ref()).await;
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let options = || StoreOptions { clock: clock.clone(), ..StoreOptions::default() };
    let holder = Store::open_postgres(&url, options()).await.unwrap();
    let id = holder.submit(new_job("1")).await.unwrap().job().id;
    let claimed = holder.claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    clock.advance(3 * LEASE);
    let started = Store::open_postgres(&url, options()).await.unwrap();
    assert!(started.claim("new", ClaimScope::Cpu, LEASE, 1).await.unwrap().is_empty());
    let backend = &claimed.job().backend;
    assert_eq!(holder.heartbeat(&claimed, LEASE, backend, None, None).await.unwrap(), Directive::Continue);
    clock.advance(LEASE);
    let taken = started.claim("new", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    assert_eq!((taken.job().id, taken.attempt()), (id, 2));
}

/// An asynchronous replica that became the primary lost the claim of a job. The next claim gets the
/// same number of the attempt, so both workers write the same keys.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_whose_claim_was_lost_keeps_the_files_of_the_next_one() {
    let dir = tempfile::tempdir().unwrap();
    let url = Database::Postgres.url(dir.path()).await;
    let place = Place::at(dir.path(), &url).await;
    let id = place.queue("hold", 1).await;
    let pool = place.start(|options| {
        // The worker learns of the loss when it ends its attempt.
        options.progress = Duration::from_secs(60);
        options.heartbeat = Duration::from_secs(60);
        options.lease = Duration::from_secs(240);
    });
    place.until(id, |job| job.status == Status::Running).await;
    let forget = "DELETE FROM attempts; UPDATE jobs SET status = 'queued', attempts = 0, holder = NULL, \
                  lease_until = NULL, progress = NULL, section = NULL";
    tokio::task::spawn_blocking(move || Cluster::shared().psql(&url, forget)).await.unwrap();

    let claimed = place.store.claim("other", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    assert_eq!((claimed.job().id, claimed.attempt()), (id, 1));
    let files = NAMES.map(|name| {
        let bytes = content(1, name);
        let (size, sha256) = (bytes.len() as u64, hex::encode(Sha256::digest(&bytes)));
        let (media_type, key) = ("model/gltf-binary".into(), artifacts::key(id, 1, name));
        (File { name: name.into(), media_type, bytes: size, sha256, key, start: None }, bytes)
    });
    for (file, bytes) in &files {
        place.artifacts.put_bytes(&file.key, bytes.clone().into()).await.unwrap();
    }
    let done = Finished { files: files.map(|(file, _)| file).to_vec(), ..finished(&claimed) };
    let id = claimed.job().id;
    place.store.finish(claimed, done).await.unwrap();
    let job = place.store.get(id).await.unwrap().unwrap();
    place.open_gate();
    pool.shutdown(Duration::from_secs(60)).await;
    place.check_files(&job).await;
    place.store.close().await;
}
