//! Whole models on a device: grown by the library, by the command, and by a worker whose device is
//! lost or hangs during a batch.

use crate::common::{OPTIONS, device, generate, leave, no_vulkan, small};
use oviduct::clock::Stopwatch;
use oviduct::generate::{
    Backend, Calls, CancelToken, Member, Outcome, Output, ParticleCounts, Progress, Request, Sink, UsedBackend,
    generate_batch,
};
use oviduct::jobs::artifacts::Artifacts;
use oviduct::jobs::{Job, JobId, JobKind, NewJob, Priority, Status, Store, StoreOptions};
use oviduct::model::Section;
use oviduct::sim::Plan;
use oviduct::sim::gpu::{GpuDevice, GpuOptions};
use oviduct::spec::ModelSpec;
use oviduct::worker::{
    AdmittedPlan, BatchCallbacks, BatchGenerator, BatchMember, GpuGenerator, PoolOptions, WorkerPool, generate_on_cpu,
};
use rayon::ThreadPool;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

fn spec(steps: u32, particles: u32) -> ModelSpec {
    let patch = json!({
        "steps": steps, "burn_in": 20,
        "particles": { "total": { "keys": [[0, (particles / 4).max(180)], [1, particles]] }, "outer": { "keys": [[0, 50], [1, 60]] } },
    });
    small(&patch)
}

fn grow(seeds: &[u64]) -> Vec<Outcome> {
    let dir = tempfile::tempdir().unwrap();
    let requests: Vec<Request> = seeds
        .iter()
        .map(|&seed| {
            let dir = dir.path().join(seed.to_string());
            std::fs::create_dir(&dir).unwrap();
            let (preset, backend, outputs) = ("pig".into(), Backend::Gpu, vec![Output::Glb].into());
            Request { preset, spec: spec(60, 400), seed, backend, outputs, dir, memory_limit_bytes: None }
        })
        .collect();
    let cancel = CancelToken::default();
    let members: Vec<Member<'_>> =
        requests.iter().map(|request| Member { request, plan: None, sink: &(), cancel: &cancel }).collect();
    let ends: Vec<Mutex<Option<Outcome>>> = seeds.iter().map(|_| Mutex::new(None)).collect();
    let ended = |index: usize, result: Result<_, _>| *ends[index].lock().unwrap() = Some(result.unwrap());
    generate_batch(device(), None, &members, Calls { simulated: &|| (), ended: &ended });
    ends.into_iter().map(|end| end.into_inner().unwrap().unwrap()).collect()
}

#[test]
fn a_batch_gives_certified_models_with_the_same_bytes_alone_or_together() {
    if no_vulkan() {
        return;
    }
    let together = grow(&[1, 2]);
    for outcome in &together {
        assert_eq!((outcome.used, outcome.device.as_str()), (UsedBackend::Gpu, device().name()));
        assert!(outcome.findings.certificate.passed);
        assert_eq!(outcome.findings.summary.sections, 7);
        assert_eq!(outcome.findings.summary.particles, ParticleCounts { start: 180, end: 400 });
    }
    assert_eq!(grow(&[2])[0].files, together[1].files);
}

#[test]
fn the_command_grows_on_a_gpu() {
    if no_vulkan() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| generate(dir.path()).args(arguments).output().unwrap();
    let output = run(&["--backend", "gpu", "--allow-software-adapter"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let told: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&told["backend"]["used"], &told["backend"]["fallback"]), (&json!("gpu"), &Value::Null));
    assert_eq!(told["certificate"]["passed"], true);
    assert!(dir.path().join("model/model.glb").exists());

    // A card is chosen by its number or a part of its name.
    let name = told["backend"]["device"].as_str().unwrap().to_lowercase();
    for choice in ["0", &name[..name.len().min(8)]] {
        let output = run(&["--backend", "gpu", "--allow-software-adapter", "--force", "--gpu", choice]);
        let told: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(told["backend"]["used"], "gpu", "{choice}");
    }
    // A card that does not exist is an error even where the CPU would do.
    let output = run(&["--allow-software-adapter", "--gpu", "no such card"]);
    let told = String::from_utf8_lossy(&output.stderr).to_lowercase();
    assert_eq!(output.status.code(), Some(1));
    assert!(told.contains("there is no gpu `no such card`; this machine has 0: ") && told.contains(&name), "{told}");

    let output = run(&["--backend", "gpu", "--gpu", "off"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--gpu off"));
    let output = run(&["--gpu", "off"]);
    let told: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(told["backend"]["used"], "cpu");
    assert!(told["backend"]["fallback"].as_str().unwrap().contains("--gpu off"));
}

/// Maximum duration of a job on a loaded machine, seconds.
const DEADLINE: f64 = 600.0;

/// Calls `how` once with its device, after the first steps of a batch.
struct Losing {
    gpu: Arc<GpuGenerator>,
    lost: AtomicBool,
    how: fn(&GpuDevice),
}

impl BatchGenerator for Losing {
    fn device(&self) -> String {
        BatchGenerator::device(&*self.gpu)
    }
    fn open(&self) -> Result<(), String> {
        self.gpu.open()
    }
    fn admit(&self, jobs: &[&Job]) -> Result<Vec<Option<AdmittedPlan>>, String> {
        self.gpu.admit(jobs)
    }
    fn generate(&self, members: &[BatchMember<'_>], pool: &ThreadPool, calls: BatchCallbacks<'_>) {
        let sinks: Vec<LosingSink<'_>> =
            members.iter().map(|member| LosingSink { sink: member.sink, generator: self }).collect();
        let members: Vec<BatchMember<'_>> =
            members.iter().zip(&sinks).map(|(&member, sink)| BatchMember { sink, ..member }).collect();
        self.gpu.generate(&members, pool, calls);
    }
}

struct LosingSink<'a> {
    sink: &'a dyn Sink,
    generator: &'a Losing,
}

impl Sink for LosingSink<'_> {
    fn progress(&self, progress: &Progress) {
        self.sink.progress(progress);
        // The thread that drives the device makes this call, so it submits nothing in the meantime.
        if progress.step > 0 && !self.generator.lost.swap(true, Ordering::Relaxed) {
            (self.generator.how)(&self.generator.gpu.device().expect("it is open"));
        }
    }
    fn section(&self, section: &Section) {
        self.sink.section(section);
    }
}

/// A job store and the generator of a GPU worker.
struct Place {
    store: Store,
    gpu: Arc<GpuGenerator>,
    dir: tempfile::TempDir,
}

impl Place {
    async fn new(options: GpuOptions) -> Self {
        let dir = tempfile::tempdir().unwrap();
        // An in-memory job store would disappear with its connection.
        let store = Store::open_sqlite(&dir.path().join("jobs.db"), StoreOptions::default()).await.unwrap();
        let gpu = Arc::new(GpuGenerator::all(options).unwrap().swap_remove(0));
        Self { store, gpu, dir }
    }

    async fn submit(&self, seed: u64, spec: &ModelSpec) -> JobId {
        let new = NewJob {
            kind: JobKind::Model,
            preset: "pig".into(),
            seed,
            spec: spec.json(),
            outputs: vec![Output::Glb].into(),
            backend: Backend::Auto,
            labels: BTreeMap::new(),
            priority: Priority::default(),
            digest: seed.to_string(),
            engine: oviduct::ENGINE_VERSION.into(),
            owner: None,
            quota: Default::default(),
            weight: 1,
            trace: None,
            retry_of: None,
            reuse: false,
            missing: Vec::new(),
            batch_key: Some(oviduct::spec::batch_key(spec)),
            short: false,
            idempotency: None,
        };
        self.store.submit(new).await.unwrap().job().id
    }

    fn start(&self) -> WorkerPool {
        self.start_with(Arc::clone(&self.gpu) as Arc<dyn BatchGenerator>)
    }

    fn start_with(&self, gpu: Arc<dyn BatchGenerator>) -> WorkerPool {
        let options = PoolOptions {
            workers: 0,
            progress: Duration::from_millis(20),
            heartbeat: Duration::from_millis(200),
            lease: Duration::from_secs(60),
            ..PoolOptions::new(self.dir.path().join("scratch"))
        };
        WorkerPool::start(
            self.store.clone(),
            Artifacts::local(&self.dir.path().join("artifacts")).unwrap(),
            Arc::new(generate_on_cpu),
            vec![gpu],
            options,
        )
        .unwrap()
    }

    async fn until(&self, id: JobId, done: impl Fn(&Job) -> bool) -> Job {
        let since = Stopwatch::start();
        loop {
            let job = self.store.get(id).await.unwrap().expect("the job is gone");
            if done(&job) {
                return job;
            }
            assert!(since.seconds() < DEADLINE, "it did not happen in time: {job:?}");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    /// Waits until the job has ended; it must have succeeded.
    async fn grown(&self, id: JobId) -> Job {
        let job = self.until(id, |job| job.status.is_ended()).await;
        assert_eq!((job.status, &job.problem), (Status::Succeeded, &None));
        job
    }
}

/// Jobs whose device is lost during their batch complete on the CPU, and the next batch opens a new
/// device.
async fn survives(options: GpuOptions, how: fn(&GpuDevice), reason: &str) {
    let place = Place::new(options).await;
    let mut ids = Vec::new();
    for seed in 1..=3 {
        ids.push(place.submit(seed, &spec(1200, 400)).await);
    }
    let losing = Arc::new(Losing { gpu: Arc::clone(&place.gpu), lost: AtomicBool::new(false), how });
    let pool = place.start_with(losing);
    for id in ids {
        let job = place.grown(id).await;
        assert_eq!((job.attempts, job.backend.used), (1, Some(UsedBackend::Cpu)));
        assert!(job.backend.fallback.as_ref().unwrap().contains(reason), "{:?}", job.backend);
    }
    let job = place.grown(place.submit(4, &spec(60, 400)).await).await;
    assert_eq!((job.backend.used, job.backend.fallback), (Some(UsedBackend::Gpu), None));
    pool.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_device_lost_in_mid_batch_fails_no_job_and_is_reopened() {
    if no_vulkan() {
        return;
    }
    survives(OPTIONS, GpuDevice::lose, "the GPU was lost").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_device_that_hangs_in_mid_batch_fails_no_job_and_is_reopened() {
    if no_vulkan() {
        return;
    }
    let options = GpuOptions { stall: Duration::from_secs(3), ..OPTIONS };
    survives(options, GpuDevice::hang, "the GPU was lost: nothing was completed for 3 s").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_batch_that_gets_no_memory_is_halved_and_what_does_not_fit_alone_falls_back() {
    if no_vulkan() {
        return;
    }
    let plan = Plan::new(&spec(60, 400), 1);
    let place = Place::new(leave(GpuDevice::batch_bytes(&plan, 3))).await;
    let mut ids = Vec::new();
    for seed in 1..=4 {
        ids.push(place.submit(seed, &spec(60, 400)).await);
    }
    // This model alone needs more memory than the device has.
    let many = spec(60, 3000);
    assert!(GpuDevice::batch_bytes(&Plan::new(&many, 5), 1) > 2 * GpuDevice::batch_bytes(&plan, 3));
    let large = place.submit(5, &many).await;
    let pool = place.start();
    for id in ids {
        let job = place.grown(id).await;
        assert_eq!((job.attempts, job.backend.used, job.backend.fallback), (1, Some(UsedBackend::Gpu), None));
    }
    let job = place.grown(large).await;
    assert_eq!((job.backend.requested, job.backend.used), (Backend::Auto, Some(UsedBackend::Cpu)));
    assert_eq!(job.backend.fallback.as_deref(), Some("the GPU ran out of memory"));
    pool.shutdown(Duration::from_secs(5)).await;
}
