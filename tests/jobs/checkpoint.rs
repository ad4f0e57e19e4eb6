//! Interrupted generations resume from their checkpoints and produce the same bytes, both after a
//! shutdown and after a worker vanished. Also: time limits of jobs, and retention.

use crate::bounds::best_of_five;
use crate::bucket::Bucket;
use crate::scripted::{OBJECTS, Place, scripted};
use crate::suite::new_job;
use oviduct::clock::Clock;
use oviduct::generate::{Backend, CancelToken, Checkpoint, Outcome, Output, Progress, Request, Sink, generate, resume};
use oviduct::jobs::sweep::Retention;
use oviduct::jobs::{ClaimScope, Job, NewJob, Status, Submitted};
use oviduct::model::Section;
use oviduct::spec::{ModelSpec, preset};
use oviduct::worker::{GenerationInput, Generator, PoolOptions, WorkError, WorkerPool};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use tempfile::TempPath;

fn spec() -> ModelSpec {
    let patch = serde_json::json!({
        "steps": 600, "burn_in": 20,
        "particles": { "total": { "keys": [[0, 260], [1, 620]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
    });
    ModelSpec::resolve(preset("pig").unwrap(), &patch).unwrap()
}

fn request(dir: &Path) -> Request {
    Request {
        preset: "pig".into(),
        spec: spec(),
        seed: 7,
        backend: Backend::Cpu,
        outputs: vec![Output::Glb].into(),
        dir: dir.into(),
        memory_limit_bytes: None,
    }
}

/// Pauses a generation after its first checkpoint, until another checkpoint is requested or the
/// generation is cancelled. The generation therefore cannot end too early.
struct Pausing<'a> {
    sink: &'a dyn Sink,
    cancel: &'a CancelToken,
    steps: AtomicU32,
}

/// Number of steps before the first checkpoint.
const STEPS: u32 = 150;

impl Sink for Pausing<'_> {
    fn progress(&self, progress: &Progress) {
        self.sink.progress(progress);
    }

    fn section(&self, section: &Section) {
        self.sink.section(section);
    }

    fn wants_checkpoint(&self) -> bool {
        self.steps.fetch_add(1, Ordering::Relaxed) == STEPS || self.sink.wants_checkpoint()
    }

    fn checkpoint(&self, file: TempPath) {
        self.sink.checkpoint(file);
        while !self.cancel.is_cancelled() && !self.sink.wants_checkpoint() {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// A generator that counts how often it resumes from a checkpoint.
fn generator(
    resumed: Arc<AtomicU32>,
    pauses: bool,
) -> impl Fn(GenerationInput<'_>, &dyn Sink, &CancelToken) -> Result<Outcome, WorkError> {
    move |work, sink, cancel| {
        let request = request(work.dir);
        let pausing = Pausing { sink, cancel, steps: AtomicU32::new(0) };
        let sink = if pauses { &pausing } else { sink };
        Ok(match work.checkpoint {
            Some(path) => {
                resumed.fetch_add(1, Ordering::Relaxed);
                resume(&request, Checkpoint::open(&request, path).unwrap(), sink, cancel)?
            }
            None => generate(&request, sink, cancel)?,
        })
    }
}

/// Starts a worker whose generations store a checkpoint every 20 ms.
fn start(place: &Place, resumed: &Arc<AtomicU32>, change: impl FnOnce(&mut PoolOptions)) -> WorkerPool {
    start_with(place, Arc::new(generator(Arc::clone(resumed), false)), Duration::from_millis(20), change)
}

/// Starts a worker whose generations pause after their first checkpoint.
fn start_pausing(place: &Place, resumed: &Arc<AtomicU32>, change: impl FnOnce(&mut PoolOptions)) -> WorkerPool {
    start_with(place, Arc::new(generator(Arc::clone(resumed), true)), Duration::from_secs(3600), change)
}

fn start_with(
    place: &Place,
    generator: Arc<Generator>,
    checkpoints: Duration,
    change: impl FnOnce(&mut PoolOptions),
) -> WorkerPool {
    let mut options = PoolOptions { checkpoint_every: Some(checkpoints), ..place.options() };
    change(&mut options);
    let (store, artifacts) = (place.store.clone(), place.artifacts.clone());
    WorkerPool::start(store, artifacts, generator, Vec::new(), options).unwrap()
}

fn unbroken() -> BTreeMap<String, String> {
    let dir = tempfile::tempdir().unwrap();
    let outcome = generate(&request(dir.path()), &(), &CancelToken::default()).unwrap();
    outcome.files.into_iter().map(|file| (file.name, file.sha256)).collect()
}

fn hashes(job: &Job) -> BTreeMap<String, String> {
    job.files.iter().map(|file| (file.name.clone(), file.sha256.clone())).collect()
}

/// Waits until the record names a checkpoint. The store does not notify subscribers of checkpoints.
async fn until_saved(place: &Place, id: oviduct::jobs::JobId, attempt: u32) -> String {
    let wait = async {
        loop {
            let job = place.store.get(id).await.unwrap().unwrap();
            assert!(!job.status.is_ended(), "it ended before its first checkpoint");
            // A checkpoint's artifact key is `models/<job>/<attempt>/…`.
            if let Some(key) = job.checkpoint.filter(|key| key.contains(&format!("/{attempt}/"))) {
                return key;
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(600), wait).await.unwrap()
}

async fn a_shutdown_loses_nothing(place: &Place) {
    let expected = unbroken();
    let resumed = Arc::new(AtomicU32::new(0));
    let Submitted::Queued(job) = place.store.submit(new_job("d")).await.unwrap() else { panic!("queued") };
    for round in 0..2 {
        let pool = start_pausing(place, &resumed, |_| {});
        until_saved(place, job.id, round + 1).await;
        pool.shutdown(Duration::ZERO).await;
        let now = place.store.get(job.id).await.unwrap().unwrap();
        assert_eq!((now.status, now.attempts), (Status::Queued, round + 1));
        let key = now.checkpoint.unwrap();
        assert!(place.artifacts.read_all(&key).await.is_ok(), "{key} is missing");
    }
    let pool = start(place, &resumed, |_| {});
    let ended = place.ended(job.id).await;
    assert_eq!((ended.status, ended.attempts), (Status::Succeeded, 3), "{:?}", ended.problem);
    assert_eq!(hashes(&ended), expected);
    assert_eq!((resumed.load(Ordering::Relaxed), ended.checkpoint), (2, None));
    pool.shutdown(Duration::from_secs(5)).await;
    // The model's files remain. Each attempt that ended during an upload may leave up to two
    // checkpoints.
    let far = Clock::System.now() + Duration::from_secs(3600);
    let orphans = place.sweep_orphans(far, Duration::ZERO).await;
    assert!(orphans <= 6, "{orphans}");
    for file in &ended.files {
        assert!(place.artifacts.read_all(&file.key).await.is_ok(), "{}", file.key);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_released_job_resumes_from_its_checkpoint() {
    a_shutdown_loses_nothing(&Place::fresh(|_| {}).await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_released_job_resumes_from_its_checkpoint_in_a_bucket() {
    let bucket = Bucket::start().await;
    let mut place = Place::fresh(|_| {}).await;
    place.artifacts = bucket.artifacts();
    a_shutdown_loses_nothing(&place).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_of_a_vanished_worker_resumes_from_its_checkpoint() {
    let place = Place::fresh(|_| {}).await;
    let resumed = Arc::new(AtomicU32::new(0));
    let job = place.store.submit(new_job("d")).await.unwrap().job().clone();
    let pool = start_pausing(&place, &resumed, |options| {
        options.heartbeat = Duration::from_millis(100);
        options.lease = Duration::from_millis(400);
    });
    until_saved(&place, job.id, 1).await;
    drop(pool);
    // A process expires leases only after the store has been available for one whole lease of that
    // process.
    let pool = start(&place, &resumed, |options| {
        options.poll = Duration::from_millis(50);
        (options.heartbeat, options.lease) = (Duration::from_millis(500), Duration::from_secs(2));
    });
    let ended = place.ended(job.id).await;
    assert_eq!((ended.status, ended.attempts), (Status::Succeeded, 2), "{:?}", ended.problem);
    assert_eq!((hashes(&ended), resumed.load(Ordering::Relaxed)), (unbroken(), 1));
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_whose_checkpoint_is_gone_starts_from_the_beginning() {
    let place = Place::fresh(|_| {}).await;
    let resumed = Arc::new(AtomicU32::new(0));
    let job = place.store.submit(new_job("d")).await.unwrap().job().clone();
    let claimed = place.store.claim("w", ClaimScope::Cpu, Duration::from_secs(8), 1).await.unwrap().pop().unwrap();
    place.store.set_checkpoint(&claimed, "models/lost/1/checkpoint-1").await.unwrap();
    place.store.release(claimed, None).await.unwrap();
    let pool = start(&place, &resumed, |_| {});
    let ended = place.ended(job.id).await;
    assert_eq!((ended.status, hashes(&ended), resumed.load(Ordering::Relaxed)), (Status::Succeeded, unbroken(), 0));
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_that_takes_too_long_fails_alone() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start(|options| options.job_timeout = Some(Duration::from_secs(3)));
    let job = place.ended(place.queue("wait", 1).await).await;
    let problem = job.problem.unwrap();
    assert_eq!((job.status, job.attempts, problem.kind.as_str()), (Status::Failed, 1, "timeout"));
    assert!(problem.detail.contains(" 3 seconds"), "{}", problem.detail);
    // Each job has its own time limit.
    best_of_five(async |round| {
        let job = place.ended(place.queue("ok", 1 + round).await).await;
        if job.status == Status::Succeeded { Ok(()) } else { Err(format!("{:?}", job.problem)) }
    })
    .await;
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn retention_is_by_age_and_by_size() {
    let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
    let place = Place::fresh(|options| options.clock = clock.clone()).await;
    let pool = place.start(|_| {});
    let mut made = Vec::new();
    for seed in [10, 11, 12, 13] {
        made.push(place.ended(place.queue("ok", seed).await).await);
    }
    pool.shutdown(Duration::from_secs(5)).await;
    let queued = place.store.submit(NewJob { reuse: false, ..scripted("ok", 14) }).await.unwrap().job().id;
    let sweep = async |age, bytes| place.retain(Retention { age, bytes }).await;
    // Each model has two files of 1000 bytes.
    let swept = sweep(None, Some(8000)).await;
    assert_eq!((swept.removed, swept.stored_bytes), (0, Some(8000)));
    let swept = sweep(Some(Duration::from_secs(3600)), Some(7999)).await;
    assert_eq!((swept.removed, swept.stored_bytes), (1, Some(6000)), "the model that ended first is removed");
    assert!(place.store.get(made[0].id).await.unwrap().is_none());
    assert_eq!(place.visible().len(), 3 * OBJECTS, "with its files");
    clock.advance(Duration::from_secs(3601));
    let swept = sweep(Some(Duration::from_secs(3600)), None).await;
    assert_eq!((swept.removed, swept.stored_bytes), (3, None));
    assert!(place.visible().is_empty());
    let swept = sweep(Some(Duration::ZERO), Some(0)).await;
    assert_eq!(swept.removed, 0);
    assert_eq!(
        place.store.get(queued).await.unwrap().unwrap().status,
        Status::Queued,
        "a job that has not ended was removed"
    );
}
