//! The worker pool: success, every kind of failure, cancellation, lost leases, shutdown, restart.

use crate::bounds::{best_of_five, within};
use crate::scripted::{Database, OBJECTS, Place, scripted};
use crate::suite::LEASE;
use crate::watched::Heartbeats;
use futures_util::FutureExt;
use futures_util::future::{BoxFuture, join_all};
use oviduct::clock::{Clock, Stopwatch};
use oviduct::generate::{Backend, Stage, UsedBackend};
use oviduct::jobs::fault::{Faults, POINTS};
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{ClaimScope, Hook, JobProgress, NewJob, Status, StoreError, StoreOptions, Submitted};
use oviduct::metrics::Metrics;
use std::sync::{Arc, Mutex};
use std::time::Duration;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_succeeds_with_its_files() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|options| options.heartbeat = Duration::from_millis(100));
    let id = place.queue("hold", 7).await;
    let running = place.until(id, |job| job.section.is_some()).await;
    assert_eq!(
        (running.status, running.progress.and_then(JobProgress::model).unwrap().stage),
        (Status::Running, Stage::Simulate)
    );
    assert_eq!(
        (running.backend.used, running.backend.device.as_deref()),
        (Some(UsedBackend::Cpu), Some("cpu, 2 threads"))
    );
    let section = running.section.unwrap();
    assert_eq!((section.index, section.inner.len(), section.outer.len()), (0, 512, 100));
    let worker = place.store.workers().await.unwrap().pop().unwrap();
    assert_eq!((worker.jobs.as_slice(), worker.jobs_done), ([id].as_slice(), 0));
    place.open_gate();

    let job = place.ended(id).await;
    assert_eq!((job.status, job.attempts, &job.problem), (Status::Succeeded, 1, &None));
    assert_eq!(job.backend.device.as_deref(), Some("scripted, 2 threads"));
    assert_eq!(job.summary.as_ref().unwrap()["vertices"], 8);
    place.check_files(&job).await;
    let single = NewJob { backend: Backend::CpuSingle, ..scripted("ok", 8) };
    let single = place.store.submit(single).await.unwrap().job().id;
    let job = place.ended(single).await;
    let listed = async || place.store.workers().await.unwrap().pop().unwrap();
    while listed().await.jobs_done < 2 {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(listed().await.jobs, []);
    assert_eq!(job.backend.device.as_deref(), Some("scripted, 1 threads"));
    assert_eq!(job.backend.used, Some(UsedBackend::CpuSingle));
    pool.shutdown(Duration::from_secs(5)).await;
    assert_eq!(place.visible().len(), 2 * OBJECTS);
    assert!(place.scratch().is_empty());
    assert_eq!(place.store.workers().await.unwrap(), [], "a worker that has stopped is not listed");
}

/// Panics in the first calls with these names.
struct Panics(Mutex<Vec<&'static str>>);

impl Hook for Panics {
    fn before<'a>(&'a self, call: &'static str) -> BoxFuture<'a, Result<(), StoreError>> {
        let mut left = self.0.lock().unwrap();
        let is_first = left.iter().position(|name| *name == call).map(|index| left.remove(index)).is_some();
        drop(left);
        assert!(!is_first, "on purpose, in {call}");
        Box::pin(async { Ok(()) })
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn workers_continue_after_a_panic_outside_of_attempts() {
    let place = Place::fresh(|_| {}).await;
    let panics = Arc::new(Panics(Mutex::new(vec!["claim", "worker_seen", "worker_seen"])));
    let metrics = Metrics::default();
    let store = place.store.with_hook(Arc::<Panics>::clone(&panics));
    let pool = place.start_over(store, |options| {
        options.heartbeat = Duration::from_millis(50);
        options.metrics = metrics.clone();
    });
    let job = place.ended(place.queue("ok", 1).await).await;
    assert_eq!((job.status, job.attempts), (Status::Succeeded, 1));
    while place.store.workers().await.unwrap().is_empty() {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(*panics.0.lock().unwrap(), [""; 0]);
    let text = metrics.text();
    for line in ["oviduct_task_panics_total{task=\"claims\"} 1", "oviduct_task_panics_total{task=\"heartbeats\"} 2"] {
        assert!(text.lines().any(|found| found == line), "{line} in\n{text}");
    }
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_failure_affects_only_its_own_job() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|_| {});
    let mut ids = Vec::new();
    let scripts = [
        ("panic", "the script says so: 1"),
        ("memory", "the limit is 1073741824"),
        ("certificate", "slab 7"),
        ("spec", "slab 7"),
        ("ok", ""),
    ];
    for (script, says) in scripts {
        ids.push((script, says, place.queue(script, 1).await));
    }
    for (script, says, id) in ids {
        let job = place.ended(id).await;
        assert_eq!(job.attempts, 1);
        if script == "ok" {
            assert_eq!(job.status, Status::Succeeded);
        } else {
            let problem = job.problem.unwrap();
            assert_eq!((job.status, problem.kind.as_str()), (Status::Failed, script));
            assert!(problem.detail.contains(says), "{}", problem.detail);
        }
    }
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_transient_fault_is_retried_until_the_attempts_are_used_up() {
    let place = Place::fresh(|options| options.max_attempts = 2).await;
    let pool = place.start(|_| {});
    let job = place.ended(place.queue("io", 1).await).await;
    assert_eq!((job.status, job.attempts), (Status::Failed, 2));
    let problem = job.problem.unwrap();
    assert_eq!(problem.kind, "attempts-exhausted");
    assert!(problem.detail.contains("attempt 2") && problem.detail.contains("model.glb"), "{}", problem.detail);
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_running_job_stops_within_a_second_of_its_cancel() {
    let place = Place::fresh(|_| {}).await;
    // The heartbeat interval is far above the bound, so the worker must learn of the cancellation
    // by a notification.
    let pool = place.start(|options| {
        options.heartbeat = Duration::from_secs(60);
        options.lease = Duration::from_secs(240);
    });
    best_of_five(async |seed| {
        let id = place.queue("wait", seed).await;
        place.until(id, |job| job.progress.is_some()).await;
        let since = Stopwatch::start();
        let asked = place.store.cancel(id).await.unwrap().unwrap();
        assert_eq!(asked.status, Status::Running);
        let job = place.ended(id).await;
        let kept = within(1.0, since);
        assert_eq!(job.status, Status::Cancelled);
        // The worker is free again.
        let next = place.ended(place.queue("ok", seed).await).await;
        assert_eq!(next.status, Status::Succeeded);
        kept
    })
    .await;
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_next_job_is_claimed_during_the_certificate_of_the_one_before_and_waits_for_its_threads() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|_| {});
    let first = place.queue("prove", 1).await;
    let next = place.queue("ok", 2).await;
    let last = place.queue("ok", 3).await;
    let claimed = place.until(next, |job| job.status == Status::Running).await;
    assert_eq!((claimed.attempts, claimed.progress), (1, None));
    // The worker claims no other job. It keeps this one only while the threads may become free
    // soon.
    let released = place.until(next, |job| job.status == Status::Queued).await;
    let now = place.store.get(last).await.unwrap().unwrap();
    assert_eq!((released.attempts, now.status, now.attempts), (1, Status::Queued, 0));
    let attempts = place.store.attempts(next).await.unwrap();
    assert!(attempts[0].detail.as_deref().unwrap_or_default().starts_with("busy: "), "{attempts:?}");
    tokio::time::sleep(Duration::from_millis(1500)).await;
    let now = place.store.get(next).await.unwrap().unwrap();
    assert_eq!((now.status, now.attempts), (Status::Queued, 1), "it was claimed early twice");
    place.store.cancel(first).await.unwrap();
    for id in [next, last] {
        assert_eq!(place.ended(id).await.status, Status::Succeeded);
    }
    assert_eq!(place.busy.most(), 1);
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn short_models_run_beside_a_long_one() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|_| {});
    let long = place.queue("hold", 1).await;
    place.until(long, |job| job.status == Status::Running).await;
    let waiting = place.queue("ok", 2).await;
    for seed in 3..6 {
        let short = place.store.submit(NewJob { short: true, ..scripted("ok", seed) }).await.unwrap().job().id;
        let ended = place.ended(short).await;
        assert_eq!((ended.status, ended.attempts), (Status::Succeeded, 1), "{ended:?}");
        assert_eq!(ended.backend.device.as_deref(), Some("scripted, 1 threads"));
    }
    for (id, status) in [(long, Status::Running), (waiting, Status::Queued)] {
        assert_eq!(place.store.get(id).await.unwrap().unwrap().status, status);
    }
    place.open_gate();
    for id in [long, waiting] {
        assert_eq!(place.ended(id).await.status, Status::Succeeded);
    }
    pool.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_next_job_is_claimed_once_the_threads_are_free() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|options| options.heartbeat = Duration::from_millis(100));
    let first = place.queue("hold", 1).await;
    let next = place.queue("ok", 2).await;
    place.until(first, |job| job.progress.is_some()).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    // The job stays in the queue, where another worker could claim it.
    assert_eq!(place.store.get(next).await.unwrap().unwrap().status, Status::Queued);
    place.open_gate();
    for id in [first, next] {
        let job = place.ended(id).await;
        assert_eq!((job.status, job.attempts), (Status::Succeeded, 1), "{:?}", job.problem);
    }
    assert_eq!(place.busy.most(), 1);
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cancel_is_recorded_within_a_second_even_if_a_stage_is_slow_to_stop() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|options| options.heartbeat = Duration::from_secs(60));
    best_of_five(async |seed| {
        let id = place.queue("deaf", seed).await;
        place.until(id, |job| job.progress.is_some()).await;
        let since = Stopwatch::start();
        place.store.cancel(id).await.unwrap();
        assert_eq!(place.ended(id).await.status, Status::Cancelled);
        let kept = within(1.0, since);
        // The threads of the cancelled job are still busy; the next job begins when they are free.
        let next = place.queue("ok", seed).await;
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert_eq!(place.store.get(next).await.unwrap().unwrap().progress, None);
        place.open_gate();
        assert_eq!(place.ended(next).await.status, Status::Succeeded);
        place.close_gate();
        kept
    })
    .await;
    assert_eq!(place.busy.most(), 1, "two jobs ran on the same threads");
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_notifications_a_worker_relies_on_polling_and_heartbeats() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start_over(Heartbeats::deaf(&place.store), |options| {
        options.poll = Duration::from_millis(100);
        options.heartbeat = Duration::from_millis(200);
    });
    tokio::time::sleep(Duration::from_millis(300)).await;
    let id = place.queue("wait", 1).await;
    place.until(id, |job| job.progress.is_some()).await;
    place.store.cancel(id).await.unwrap();
    assert_eq!(place.ended(id).await.status, Status::Cancelled);
    let deleted = place.queue("wait", 2).await;
    place.until(deleted, |job| job.progress.is_some()).await;
    place.store.delete(deleted).await.unwrap();
    assert_eq!(place.ended(place.queue("ok", 3).await).await.status, Status::Succeeded);
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_deleted_job_stops_and_leaves_nothing() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|_| {});
    let id = place.queue("wait", 1).await;
    place.until(id, |job| job.progress.is_some()).await;
    place.store.delete(id).await.unwrap().unwrap();
    assert_eq!(place.ended(place.queue("ok", 3).await).await.status, Status::Succeeded);
    pool.shutdown(Duration::from_secs(5)).await;
    assert_eq!(place.visible().len(), OBJECTS);
    assert!(place.scratch().is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_whose_files_cannot_be_stored_is_retried_and_then_released() {
    let place = Place::fresh(|options| options.max_attempts = 1).await;
    let wall = place.dir.join("artifacts/models");
    std::fs::write(&wall, "a file instead of a directory").unwrap();
    let pool = place.start(|options| options.storage_wait = Duration::from_millis(10));
    let id = place.queue("ok", 1).await;
    place.until(id, |job| job.attempts > 0 && job.status == Status::Queued).await;
    let attempts = place.store.attempts(id).await.unwrap();
    let detail = attempts[0].detail.as_deref().unwrap_or_default();
    assert_eq!(attempts[0].outcome, Some(AttemptEnd::Released));
    assert!(detail.starts_with("storage: ") && detail.contains("tried "), "{detail}");
    std::fs::remove_file(&wall).unwrap();
    let job = place.ended(id).await;
    assert_eq!(job.status, Status::Succeeded, "{:?}", job.problem);
    place.check_files(&job).await;
    pool.shutdown(Duration::from_secs(5)).await;
    // The artifact store becomes available before the worker gives up the upload, so the same
    // attempt continues.
    std::fs::rename(place.dir.join("artifacts/models"), place.dir.join("artifacts/away")).unwrap();
    std::fs::write(&wall, "a file instead of a directory").unwrap();
    let pool = place.start(|_| {});
    let id = place.queue("ok", 2).await;
    place.until(id, |job| job.progress.and_then(JobProgress::model).is_some_and(|p| p.stage == Stage::Store)).await;
    std::fs::remove_file(&wall).unwrap();
    let job = place.ended(id).await;
    assert_eq!((job.status, job.attempts), (Status::Succeeded, 1));
    place.check_files(&job).await;
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_lost_its_lease_stops_and_writes_nothing() {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let place = Place::fresh(|options| options.clock = clock.clone()).await;
    let pool = place.start(|options| (options.heartbeat, options.lease) = (Duration::from_secs(60), LEASE));
    let id = place.queue("wait", 1).await;
    place.until(id, |job| job.progress.is_some()).await;
    // The lease expires, and another worker claims the job.
    clock.advance(LEASE);
    let other = place.store.claim("other", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    assert_eq!((other.job().id, other.attempt()), (id, 2));
    assert_eq!(place.ended(place.queue("ok", 3).await).await.status, Status::Succeeded);
    pool.shutdown(Duration::from_secs(5)).await;
    let job = place.store.get(id).await.unwrap().unwrap();
    assert_eq!((job.status, job.attempts, job.version), (Status::Running, 2, other.job().version));
    assert_eq!(place.visible().len(), OBJECTS);
    place.store.release(other, None).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn heartbeats_keep_a_lease_that_is_shorter_than_the_job() {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let place = Place::fresh(|options| options.clock = clock.clone()).await;
    let (store, heartbeats) = Heartbeats::over(&place.store);
    let id = place.queue("hold", 1).await;
    let pool = place.start_over(store, |options| {
        options.workers = 3;
        options.heartbeat = Duration::from_millis(80);
        options.lease = Duration::from_millis(400);
        options.poll = Duration::from_millis(20);
    });
    // The store's clock times the leases. The test advances it only after a renewal.
    for _ in 0..6 {
        heartbeats.beats(2).await;
        clock.advance(Duration::from_millis(300));
    }
    place.open_gate();
    let job = place.ended(id).await;
    assert_eq!((job.status, job.attempts), (Status::Succeeded, 1));
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_slow_store_does_not_delay_the_next_heartbeat() {
    let place = Place::fresh(|_| {}).await;
    let (heartbeat, call) = (Duration::from_millis(500), Duration::from_millis(400));
    let (store, heartbeats) = Heartbeats::slow(&place.store, call);
    let pool = place.start_over(store, |options| {
        (options.heartbeat, options.progress) = (heartbeat, heartbeat);
    });
    let id = place.queue("hold", 1).await;
    // Once there is a section, heartbeats only renew the lease.
    place.until(id, |job| job.section.is_some()).await;
    heartbeats.forget_pace();
    // On a busy machine, one punctual heartbeat of many suffices. If the calls delayed the
    // heartbeats, none would be punctual.
    for _ in 0..20 {
        heartbeats.beats(1).await;
        if heartbeats.pace() < heartbeat + call {
            break;
        }
    }
    assert!(heartbeats.pace() < heartbeat + call, "{:?}", heartbeats.pace());
    place.open_gate();
    assert_eq!(place.ended(id).await.status, Status::Succeeded);
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_shutdown_lets_short_jobs_end_and_releases_long_ones() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|options| options.workers = 2);
    let (short, long) = (place.queue("hold", 1).await, place.queue("wait", 2).await);
    for id in [short, long] {
        place.until(id, |job| job.progress.is_some()).await;
    }
    let shutdown = pool.shutdown(Duration::from_secs(10));
    tokio::pin!(shutdown);
    assert!(shutdown.as_mut().now_or_never().is_none(), "it did not wait for running jobs");
    let idle = place.queue("ok", 3).await;
    place.open_gate();
    shutdown.await;
    assert_eq!(place.store.get(short).await.unwrap().unwrap().status, Status::Succeeded);
    let job = place.store.get(long).await.unwrap().unwrap();
    assert_eq!((job.status, job.queue_position, job.progress), (Status::Queued, Some(0), None));
    let attempts = place.store.attempts(long).await.unwrap();
    assert_eq!((attempts.len(), attempts[0].outcome), (1, Some(AttemptEnd::Released)));
    assert_eq!(place.store.get(idle).await.unwrap().unwrap().status, Status::Queued);
    assert!(place.scratch().is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_error_at_any_point_costs_an_attempt_at_most_on_sqlite() {
    errors_at_all_points(Database::Sqlite).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_error_at_any_point_costs_an_attempt_at_most_on_postgres() {
    errors_at_all_points(Database::Postgres).await;
}

async fn errors_at_all_points(database: Database) {
    let run = async |point: &'static str| {
        let place = Place::on(database, StoreOptions::default()).await;
        let pool = place.start(|options| options.faults = Faults::parse(&format!("{point}:error")).unwrap());
        let script = if point == "during-renewal" { "slow" } else { "ok" };
        let job = place.ended(place.queue(script, 5).await).await;
        assert_eq!(job.status, Status::Succeeded, "{point}");
        place.check_files(&job).await;
        let unharmed = matches!(point, "during-renewal" | "after-commit");
        assert_eq!(job.attempts, if unharmed { 1 } else { 2 }, "{point}");
        pool.shutdown(Duration::from_secs(5)).await;
        assert_eq!(place.visible().len(), OBJECTS, "{point}: files of the failed attempt were left");
        place.store.close().await;
    };
    join_all(POINTS.into_iter().map(run)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_sweep_removes_files_that_no_job_names_and_no_others() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|_| {});
    let made = place.ended(place.queue("ok", 1).await).await;
    let shared = NewJob { reuse: true, ..scripted("ok", 1) };
    let shared = place.store.submit(shared).await.unwrap();
    assert!(matches!(shared, Submitted::Reused(_)));
    assert_eq!(place.store.delete(made.id).await.unwrap(), Some(vec![]));
    // A dead process left a complete file and a partial upload.
    let scratch = place.dir.join("orphan");
    std::fs::write(&scratch, "orphan").unwrap();
    place.artifacts.put_file("models/gone/1/model.glb", &scratch).await.unwrap();
    let staged = place.dir.join("artifacts/models/gone/2/model.glb#1");
    std::fs::create_dir_all(staged.parent().unwrap()).unwrap();
    std::fs::write(&staged, "half").unwrap();

    let now = Clock::System.now() + Duration::from_secs(60);
    let sweep = async |age| place.sweep_orphans(now, age).await;
    assert_eq!(sweep(Duration::from_secs(3600)).await, 0, "a young file may still be committed");
    assert!(staged.exists() && place.visible().len() == OBJECTS + 1);
    assert_eq!(sweep(Duration::ZERO).await, 2);
    assert!(!staged.parent().unwrap().exists());
    place.check_files(shared.job()).await;
    assert_eq!(place.visible().len(), OBJECTS);
    pool.shutdown(Duration::from_secs(5)).await;
}
