//! GPU workers over a scripted device: batches, assignment of jobs to workers, every kind of
//! fallback.

use crate::bounds::{best_of_five, within};
use crate::gate;
use crate::scripted::{FakeGpu, Fate, OBJECTS, Place, ROOM, scripted};
use crate::suite::{LEASE, objects};
use oviduct::clock::{Clock, Stopwatch};
use oviduct::generate::{Backend, Stage, UsedBackend};
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{ClaimScope, Job, JobId, JobProgress, NewJob, Status, WorkerInfo, WorkerKind};
use oviduct::metrics::Metrics;
use oviduct::status::{Condition, Status as ProcessStatus};
use std::sync::atomic::Ordering;
use std::time::Duration;

impl Place {
    /// Queues a job of this size for a backend.
    async fn ask(&self, backend: Backend, script: &str, size: u64, seed: u64) -> JobId {
        let mut spec = gate::spec(&self.dir, script);
        spec["size"] = size.into();
        self.store.submit(NewJob { backend, spec: spec.into(), ..scripted(script, seed) }).await.unwrap().job().id
    }
}

fn stage(job: &Job) -> Option<Stage> {
    job.progress.and_then(JobProgress::model).map(|progress| progress.stage)
}

fn no_cpu(options: &mut oviduct::worker::PoolOptions) {
    options.workers = 0;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_that_fit_run_together_and_end_individually() {
    let place = Place::fresh(|_| {}).await;
    let ok = place.ask(Backend::Auto, "hold", 1, 1).await;
    let other = place.ask(Backend::Gpu, "ok", ROOM, 2).await;
    let bad = place.ask(Backend::Gpu, "certificate", 1, 3).await;
    let waits = place.ask(Backend::Auto, "wait", 1, 4).await;
    let gone = place.ask(Backend::Auto, "wait", 1, 5).await;
    let cpu = place.ask(Backend::Cpu, "ok", 1, 6).await;
    let gpu = FakeGpu::new(Fate::Well);
    let metrics = Metrics::default();
    let pool = place.start_with_gpu(&gpu, |options| {
        options.metrics = metrics.clone();
        no_cpu(options);
    });

    let running = place.until(waits, |job| job.progress.is_some()).await;
    assert_eq!((running.backend.used, running.backend.device.as_deref()), (Some(UsedBackend::Gpu), Some("a fake GPU")));
    let worker = place.store.workers().await.unwrap().pop().unwrap();
    assert_eq!((worker.kind, worker.device.as_str()), (WorkerKind::Gpu, "a fake GPU"));
    assert!([waits, gone].iter().all(|id| worker.jobs.contains(id)), "not all that it runs: {:?}", worker.jobs);
    assert!(!worker.jobs.contains(&other), "a job that did not fit was not released");
    place.until(gone, |job| job.progress.is_some()).await;
    place.store.delete(gone).await.unwrap().unwrap();
    place.store.cancel(waits).await.unwrap();
    assert_eq!(place.ended(waits).await.status, Status::Cancelled);
    let failed = place.ended(bad).await;
    assert_eq!((failed.status, failed.problem.unwrap().kind.as_str()), (Status::Failed, "certificate"));
    place.open_gate();
    let job = place.ended(ok).await;
    assert_eq!(
        (job.status, job.backend.used, job.backend.fallback.as_deref()),
        (Status::Succeeded, Some(UsedBackend::Gpu), None)
    );
    place.check_files(&job).await;
    // The job that did not fit was released to its place in the queue and ran in the next batch.
    let job = place.ended(other).await;
    assert_eq!((job.status, job.backend.used), (Status::Succeeded, Some(UsedBackend::Gpu)));
    let outcomes: Vec<_> = place.store.attempts(other).await.unwrap().iter().map(|a| a.outcome.unwrap()).collect();
    assert_eq!(outcomes, [AttemptEnd::Released, AttemptEnd::Succeeded]);
    // The wait in the queue is recorded once per job, at the claim after which the job ran.
    let text = metrics.text();
    assert!(text.contains("oviduct_queue_wait_seconds_count 5\n"), "{text}");
    assert_eq!(*gpu.batches.lock().unwrap(), [vec![1, 3, 4, 5], vec![2]]);
    assert_eq!(place.store.get(cpu).await.unwrap().unwrap().status, Status::Queued);
    // The heartbeat after the last batch has these numbers.
    let listed = async || place.store.workers().await.unwrap().pop().unwrap();
    while listed().await.jobs_done < 4 {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!((listed().await.jobs.len(), listed().await.jobs_done), (0, 4));
    pool.shutdown(Duration::from_secs(5)).await;
    assert_eq!(place.store.workers().await.unwrap(), [], "a worker that has stopped is not listed");
    assert!(place.scratch().is_empty());
    assert_eq!(place.visible().len(), OBJECTS + objects(&job.files), "files of two models");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_of_another_batch_key_wait_for_a_separate_batch() {
    let place = Place::fresh(|_| {}).await;
    let mut ids = Vec::new();
    for (seed, key) in [(1, "small"), (2, "large"), (3, "small")] {
        let spec = serde_json::json!({ "script": "ok", "size": 1 }).into();
        let new = NewJob { backend: Backend::Gpu, batch_key: Some(key.into()), spec, ..scripted("ok", seed) };
        ids.push(place.store.submit(new).await.unwrap().job().id);
    }
    let gpu = FakeGpu::new(Fate::Well);
    let pool = place.start_with_gpu(&gpu, no_cpu);
    for id in ids {
        let job = place.ended(id).await;
        assert_eq!(
            (job.status, job.attempts),
            (Status::Succeeded, 1),
            "it was claimed for a batch that it does not fit"
        );
    }
    assert_eq!(*gpu.batches.lock().unwrap(), [vec![1, 3], vec![2]]);
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_member_of_a_batch_stops_within_a_second_of_its_cancel() {
    let place = Place::fresh(|_| {}).await;
    let gpu = FakeGpu::new(Fate::Well);
    best_of_five(async |round| {
        let goes_on = place.ask(Backend::Auto, "hold", 1, 2 * round).await;
        let stops = place.ask(Backend::Gpu, "wait", 1, 2 * round + 1).await;
        // The heartbeat interval is far above the bound, so no heartbeat can report the change in
        // time.
        let pool = place.start_with_gpu(&gpu, |options| {
            options.heartbeat = Duration::from_secs(60);
            no_cpu(options);
        });
        for id in [goes_on, stops] {
            place.until(id, |job| job.progress.is_some()).await;
        }
        let since = Stopwatch::start();
        place.store.cancel(stops).await.unwrap();
        assert_eq!(place.ended(stops).await.status, Status::Cancelled);
        let kept = within(1.0, since);
        assert_eq!(place.store.get(goes_on).await.unwrap().unwrap().status, Status::Running);
        place.open_gate();
        assert_eq!(place.ended(goes_on).await.status, Status::Succeeded);
        place.close_gate();
        pool.shutdown(Duration::from_secs(5)).await;
        assert_eq!(gpu.batches.lock().unwrap().pop(), Some(vec![2 * round, 2 * round + 1]));
        kept
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_that_a_gpu_cannot_grow_falls_back_within_the_attempt_or_fails_if_it_requires_a_gpu() {
    let cases = [
        (Fate::Lost, "the GPU was lost: it was pulled out"),
        (Fate::OutOfMemory, "the GPU ran out of memory"),
        (Fate::Unfit, "it is too large for the GPU"),
        (Fate::Gone, "it was pulled out"),
    ];
    for (fate, reason) in cases {
        let place = Place::fresh(|_| {}).await;
        let auto = place.ask(Backend::Auto, "hold", 1, 1).await;
        let only = place.ask(Backend::Gpu, "slow", 1, 2).await;
        let gpu = FakeGpu::new(fate);
        let pool = place.start_with_gpu(&gpu, |options| {
            options.heartbeat = Duration::from_millis(100);
            no_cpu(options);
        });
        if fate == Fate::Lost {
            // The record is updated while the job still runs, and its progress does not decrease.
            let job = place.until(auto, |job| job.backend.used == Some(UsedBackend::Cpu)).await;
            assert_eq!((job.status, job.backend.fallback.as_deref()), (Status::Running, Some(reason)));
            let job = place.until(auto, |job| job.section.is_some()).await;
            assert!(job.progress.unwrap().fraction() >= 0.6);
            assert_eq!(job.section.unwrap().index, 0);
        }
        place.open_gate();
        let job = place.ended(auto).await;
        assert_eq!((job.status, job.attempts, &job.problem), (Status::Succeeded, 1, &None), "{fate:?}");
        assert_eq!(job.backend.requested, Backend::Auto);
        assert_eq!(job.backend.used, Some(UsedBackend::Cpu), "{fate:?}");
        assert_eq!(job.backend.device.as_deref(), Some("scripted, 2 threads"));
        assert_eq!(job.backend.fallback.as_deref(), Some(reason), "{fate:?}");
        place.check_files(&job).await;
        let job = place.ended(only).await;
        let problem = job.problem.unwrap();
        assert_eq!((job.status, problem.kind.as_str()), (Status::Failed, "gpu"), "{fate:?}");
        assert!(problem.detail.contains(reason), "{}", problem.detail);
        pool.shutdown(Duration::from_secs(5)).await;
        assert!(place.scratch().is_empty());
        if fate == Fate::Gone {
            assert_eq!(place.store.workers().await.unwrap(), [], "a GPU that cannot be opened must not count as alive");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_process_is_not_ready_until_its_devices_are_open_or_have_failed() {
    for fate in [Fate::Well, Fate::Gone] {
        let place = Place::fresh(|_| {}).await;
        let gpu = FakeGpu::new(fate);
        gpu.is_opening.store(true, Ordering::SeqCst);
        let status = ProcessStatus::default();
        let pool = place.start_with_gpu(&gpu, |options| options.status = status.clone());
        assert_eq!(status.not_ready().map(|(condition, _)| condition), Some(Condition::OpeningDevices));
        let alive = async || place.store.count_live_workers(WorkerKind::Gpu, Duration::from_secs(600)).await.unwrap();
        assert_eq!(alive().await, 0);
        gpu.is_opening.store(false, Ordering::SeqCst);
        assert!(status.cleared(Condition::OpeningDevices, Duration::from_secs(600)).await);
        assert_eq!(
            alive().await,
            u64::from(fate == Fate::Well),
            "{fate:?}: what is known of it once the process is ready"
        );
        pool.shutdown(Duration::from_secs(5)).await;
    }
    let place = Place::fresh(|_| {}).await;
    let status = ProcessStatus::default();
    let pool = place.start(|options| options.status = status.clone());
    assert!(status.not_ready().is_none(), "there is no device to open");
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lost_device_affects_only_unfinished_jobs_and_is_opened_again() {
    let place = Place::fresh(|_| {}).await;
    let done = place.ask(Backend::Auto, "ok", 1, 1).await;
    let first = place.ask(Backend::Auto, "slow", 1, 2).await;
    let second = place.ask(Backend::Auto, "slow", 1, 3).await;
    let gpu = FakeGpu::new(Fate::Lost);
    let pool = place.start_with_gpu(&gpu, no_cpu);
    let job = place.ended(done).await;
    assert_eq!((job.backend.used, job.backend.fallback), (Some(UsedBackend::Gpu), None));
    for id in [first, second] {
        let job = place.ended(id).await;
        assert_eq!((job.status, job.attempts, job.backend.used), (Status::Succeeded, 1, Some(UsedBackend::Cpu)));
        assert!(job.backend.fallback.unwrap().contains("lost"));
    }
    assert_eq!(place.busy.most(), 1, "two jobs ran on the threads of the CPU at a time");
    let next = place.ended(place.ask(Backend::Gpu, "ok", 1, 4).await).await;
    assert_eq!((next.status, next.backend.used), (Status::Succeeded, Some(UsedBackend::Gpu)));
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_panic_of_the_batch_fails_its_jobs_and_the_worker_continues() {
    let place = Place::fresh(|_| {}).await;
    let ids = [place.ask(Backend::Auto, "slow", 1, 1).await, place.ask(Backend::Gpu, "slow", 1, 2).await];
    let gpu = FakeGpu::new(Fate::Panics);
    let pool = place.start_with_gpu(&gpu, no_cpu);
    for id in ids {
        let problem = place.ended(id).await.problem.unwrap();
        assert_eq!((problem.kind.as_str(), problem.detail.as_str()), ("panic", "the driver is at fault"));
    }
    *gpu.fate.lock().unwrap() = Fate::Well;
    let next = place.ended(place.ask(Backend::Gpu, "ok", 1, 3).await).await;
    assert_eq!(next.status, Status::Succeeded);
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_member_that_lost_its_lease_is_dropped_and_the_others_continue() {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let place = Place::fresh(|options| options.clock = clock.clone()).await;
    let ids = [place.ask(Backend::Auto, "wait", 1, 1).await, place.ask(Backend::Auto, "hold", 1, 2).await];
    let gpu = FakeGpu::new(Fate::Well);
    let pool = place.start_with_gpu(&gpu, |options| {
        (options.heartbeat, options.lease) = (Duration::from_secs(60), LEASE);
        no_cpu(options);
    });
    for id in ids {
        place.until(id, |job| job.progress.is_some()).await;
    }
    // Both leases expire. Another worker claims the older job, and the younger one returns to the
    // queue.
    clock.advance(LEASE);
    let other = place.store.claim("other", ClaimScope::Gpu, LEASE, 1).await.unwrap().pop().unwrap();
    assert_eq!((other.job().id, other.attempt()), (ids[0], 2));
    place.open_gate();
    let job = place.ended(ids[1]).await;
    assert_eq!((job.status, job.attempts), (Status::Succeeded, 2));
    pool.shutdown(Duration::from_secs(5)).await;
    assert_eq!(place.store.get(ids[0]).await.unwrap().unwrap().version, other.job().version);
    place.store.release(other, None).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_shutdown_releases_the_whole_batch() {
    let place = Place::fresh(|_| {}).await;
    let ids = [place.ask(Backend::Auto, "wait", 1, 1).await, place.ask(Backend::Gpu, "wait", 1, 2).await];
    let gpu = FakeGpu::new(Fate::Well);
    let pool = place.start_with_gpu(&gpu, no_cpu);
    for id in ids {
        place.until(id, |job| job.progress.is_some()).await;
    }
    pool.shutdown(Duration::from_millis(100)).await;
    for id in ids {
        let job = place.store.get(id).await.unwrap().unwrap();
        // Each job is the first in the lane of its requested backend.
        assert_eq!((job.status, job.queue_position), (Status::Queued, Some(0)));
        assert_eq!((job.backend.used, job.backend.device), (None, None));
    }
    assert!(place.scratch().is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cpu_worker_leaves_auto_to_gpu_workers_until_the_queue_is_long() {
    let place = Place::fresh(|_| {}).await;
    let gpu = FakeGpu::new(Fate::Well);
    let pool = place.start_with_gpu(&gpu, |options| {
        options.batch = 1;
        options.poll = Duration::from_millis(50);
    });
    let seen = Stopwatch::start();
    while place.store.workers().await.unwrap().len() < 2 {
        assert!(seen.seconds() < 600.0);
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    // The GPU is busy and the CPU is free.
    let busy = place.ask(Backend::Gpu, "wait", 1, 1).await;
    place.until(busy, |job| job.progress.is_some()).await;
    let first = place.ask(Backend::Auto, "ok", 1, 2).await;
    let named = place.ended(place.ask(Backend::Cpu, "ok", 1, 3).await).await;
    assert_eq!((named.status, named.backend.fallback), (Status::Succeeded, None));
    assert_eq!(place.store.get(first).await.unwrap().unwrap().status, Status::Queued);
    // CPU workers leave the GPU as many jobs as two of its claims take. The third job exceeds that
    // number.
    place.ask(Backend::Auto, "ok", 1, 4).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!(place.store.get(first).await.unwrap().unwrap().status, Status::Queued);
    place.ask(Backend::Auto, "ok", 1, 5).await;
    let job = place.ended(first).await;
    assert_eq!((job.status, job.backend.used), (Status::Succeeded, Some(UsedBackend::Cpu)));
    assert_eq!(job.backend.fallback.as_deref(), Some("3 jobs were waiting for 1 GPU worker"));
    place.store.cancel(busy).await.unwrap();
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_next_batch_begins_when_the_device_is_free_and_cpu_workers_leave_the_cores_to_the_surfaces() {
    let place = Place::fresh(|_| {}).await;
    let gpu = FakeGpu::new(Fate::Well);
    let pool = place.start_with_gpu(&gpu, |options| {
        options.batch = 1;
        options.poll = Duration::from_millis(50);
    });
    // Two batches are past their simulation and in their certificate stage, so the device is idle.
    for seed in [1, 2] {
        let proving = place.ask(Backend::Gpu, "prove", 1, seed).await;
        place.until(proving, |job| stage(job) == Some(Stage::Certify)).await;
    }
    // The worker decides about its next claim just after the device becomes free.
    tokio::time::sleep(Duration::from_millis(100)).await;
    let jobs = [3, 4, 5, 6].map(|seed| place.ask(Backend::Auto, "ok", 1, seed));
    let jobs = futures_util::future::join_all(jobs).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    for &job in &jobs {
        assert_eq!(place.store.get(job).await.unwrap().unwrap().status, Status::Queued);
    }
    assert_eq!(*gpu.batches.lock().unwrap(), [vec![1], vec![2]]);
    pool.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn while_no_gpu_worker_is_alive_a_cpu_worker_takes_auto_and_records_why() {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let place = Place::fresh(|options| options.clock = clock.clone()).await;
    // A worker on another machine that has sent no heartbeat for long.
    let dead = WorkerInfo {
        id: "far-1-gpu0".into(),
        host: "far".into(),
        kind: WorkerKind::Gpu,
        device: "a far GPU".into(),
        jobs: Vec::new(),
        jobs_done: 3,
        heartbeat_at: clock.now(),
        pause: None,
        condition: None,
    };
    place.store.worker_seen(&dead).await.unwrap();
    clock.advance(Duration::from_secs(60));
    let pool = place.start(|options| options.no_gpu = Some("no GPU was found".into()));
    let job = place.ended(place.ask(Backend::Auto, "ok", 1, 1).await).await;
    let listed = place.store.workers().await.unwrap();
    assert!(listed.iter().any(|worker| worker.id == dead.id), "it is not listed: {listed:?}");
    assert_eq!((job.backend.used, job.backend.fallback.as_deref()), (Some(UsedBackend::Cpu), Some("no GPU was found")));
    let named = place.ended(place.ask(Backend::CpuSingle, "ok", 1, 2).await).await;
    assert_eq!(named.backend.fallback, None);
    // A job for the backend `gpu` stays queued until there is a GPU worker.
    let gpu = place.ask(Backend::Gpu, "ok", 1, 3).await;
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert_eq!(place.store.get(gpu).await.unwrap().unwrap().status, Status::Queued);
    pool.shutdown(Duration::from_secs(5)).await;
}
