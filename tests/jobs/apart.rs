//! Busy workers and workers that do not stop do not delay jobs that other workers could run.

use crate::scripted::{Database, FakeGpu, Fate, Place, generate, scripted};
use futures_util::future::join_all;
use oviduct::generate::{Backend, CancelToken, Outcome, Progress, Sink, Stage, UsedBackend};
use oviduct::jobs::{JobId, JobProgress, NewJob, Status, StoreOptions};
use oviduct::worker::{GenerationInput, Generator, WorkError};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

/// Seed of the job that the gate holds.
const HELD: u64 = 99;

/// Holds the job with seed [`HELD`] in its certificate stage until the gate opens. In the meantime
/// the job ignores its cancel token.
#[derive(Default)]
struct Gate {
    open: Mutex<bool>,
    opened: Condvar,
    ended: AtomicBool,
}

impl Gate {
    fn open(&self) {
        *self.open.lock().unwrap() = true;
        self.opened.notify_all();
    }
}

/// Opens the gate even if the test fails. Otherwise the waiting thread would keep the runtime from
/// ending.
struct OpenGateOnDrop(Arc<Gate>);

impl Drop for OpenGateOnDrop {
    fn drop(&mut self) {
        self.0.open();
    }
}

fn gated(gate: &Arc<Gate>) -> Arc<Generator> {
    let gate = Arc::clone(gate);
    Arc::new(move |input: GenerationInput<'_>, sink: &dyn Sink, cancel: &CancelToken| -> Result<Outcome, WorkError> {
        if input.job.seed == HELD {
            let stage = Stage::Certify;
            sink.progress(&Progress {
                stage,
                fraction: 0.8,
                step: 1,
                steps: 2,
                particles: 8,
                sections: 1,
                eta_seconds: None,
            });
            let closed = gate.open.lock().unwrap();
            drop(gate.opened.wait_while(closed, |open| !*open).unwrap());
            gate.ended.store(true, Ordering::SeqCst);
        }
        generate(input, sink, cancel)
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn while_one_worker_is_held_the_other_runs_all_jobs() {
    let place = Place::fresh(|_| {}).await;
    let gate = Arc::new(Gate::default());
    let _opens = OpenGateOnDrop(Arc::clone(&gate));
    let pool = place.start_with(place.store.clone(), gated(&gate), |options| {
        options.workers = 2;
        options.poll = Duration::from_millis(100);
    });
    let held = place.queue("ok", HELD).await;
    let at = |stage| {
        move |job: &oviduct::jobs::Job| {
            job.progress.and_then(JobProgress::model).is_some_and(|progress| progress.stage == stage)
        }
    };
    place.until(held, at(Stage::Certify)).await;
    // First jobs one at a time, as from a client that waits for each; then many at once.
    for seed in 0..5 {
        let job = place.ended(place.queue("ok", seed).await).await;
        assert_eq!(job.status, Status::Succeeded);
    }
    let mut ids = Vec::new();
    for seed in 10..30 {
        ids.push(place.queue("ok", seed).await);
    }
    let jobs = join_all(ids.iter().map(|&id| place.ended(id))).await;
    assert!(!gate.ended.load(Ordering::SeqCst), "the gate is closed");
    assert_eq!(place.store.get(held).await.unwrap().unwrap().status, Status::Running);
    for job in jobs {
        assert_eq!(job.status, Status::Succeeded, "{:?}", job.problem);
    }
    gate.open();
    assert_eq!(place.ended(held).await.status, Status::Succeeded);
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_job_waits_behind_one_that_timed_out_and_does_not_stop() {
    let place = Place::fresh(|_| {}).await;
    let gate = Arc::new(Gate::default());
    let _opens = OpenGateOnDrop(Arc::clone(&gate));
    let start = |name: &'static str| {
        place.start_with(place.store.clone(), gated(&gate), move |options| {
            options.host = name.into();
            options.poll = Duration::from_millis(100);
            options.job_timeout = Some(Duration::from_secs(1));
        })
    };
    let first = start("first");
    let held = place.queue("ok", HELD).await;
    let behind = place.queue("ok", 1).await;
    let problem = place.ended(held).await.problem.unwrap();
    assert_eq!(problem.kind, "timeout");
    let second = start("second");
    let job = place.ended(behind).await;
    assert!(!gate.ended.load(Ordering::SeqCst), "the gate is closed");
    assert_eq!(job.status, Status::Succeeded, "{:?}", job.problem);
    let attempts = place.store.attempts(behind).await.unwrap();
    assert!(attempts.last().unwrap().worker.starts_with("second"), "{attempts:?}");
    gate.open();
    first.shutdown(Duration::from_secs(5)).await;
    second.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_whose_generation_does_not_stop_is_reported_as_stuck() {
    let place = Place::fresh(|_| {}).await;
    let status = oviduct::status::Status::default();
    let reported = status.clone();
    let pool = place.start(|options| {
        options.stuck_after = Duration::from_millis(100);
        options.status = reported;
    });
    let id = place.queue("deaf", 1).await;
    place.until(id, |job| job.progress.is_some()).await;
    assert!(status.stuck_workers().is_empty());
    place.store.cancel(id).await.unwrap();
    let until = async |stuck: usize| {
        while status.stuck_workers().len() != stuck {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    let deadline = Duration::from_secs(600);
    tokio::time::timeout(deadline, until(1)).await.expect("it was never reported");
    let detail = status.stuck_workers().pop().unwrap();
    assert!(detail.contains("told to stop a model") && !detail.contains(&id.to_string()), "{detail}");
    place.open_gate();
    tokio::time::timeout(deadline, until(0)).await.expect("it is reported although the worker is free");
    assert_eq!(place.ended(place.queue("ok", 2).await).await.status, Status::Succeeded);
    pool.shutdown(Duration::from_secs(5)).await;
}

/// After the GPU is lost, its jobs run on the CPU one at a time. The time a job waits for the
/// others does not count towards the time limit.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn waiting_for_the_cpu_after_a_lost_gpu_does_not_count_against_the_time_limit() {
    let place = Place::on(Database::Sqlite, StoreOptions::default()).await;
    let mut ids: Vec<JobId> = Vec::new();
    for seed in 1..=5 {
        let spec = serde_json::json!({ "script": "slow", "size": 1 }).into();
        let new = NewJob { backend: Backend::Auto, spec, ..scripted("slow", seed) };
        ids.push(place.store.submit(new).await.unwrap().job().id);
    }
    let gpu = FakeGpu::new(Fate::Lost);
    // Together the jobs take more than six seconds, each about 1.5 s.
    let pool = place.start_with_gpu(&gpu, |options| {
        options.workers = 0;
        options.job_timeout = Some(Duration::from_secs(4));
    });
    for job in join_all(ids.iter().map(|&id| place.ended(id))).await {
        assert_eq!((job.status, job.attempts), (Status::Succeeded, 1), "{:?}", job.problem);
        assert_eq!(job.backend.used, Some(UsedBackend::Cpu));
    }
    assert_eq!(gpu.batches.lock().unwrap().len(), 1);
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_deleted_model_is_not_counted_as_a_lost_lease() {
    let place = Place::fresh(|_| {}).await;
    let metrics = oviduct::metrics::Metrics::default();
    let counts = metrics.clone();
    let pool = place.start(move |options| options.metrics = counts);
    let id = place.queue("wait", 1).await;
    place.until(id, |job| job.progress.is_some()).await;
    place.store.delete(id).await.unwrap().unwrap();
    pool.shutdown(Duration::from_secs(5)).await;
    let text = metrics.text();
    assert!(text.contains("oviduct_leases_lost_total 0"), "{text}");
    assert!(text.contains("oviduct_attempts_total{end=\"deleted\"} 1"), "{text}");
}
