//! A generator that follows a script in the job's spec, and a [`Place`] to run it: job store,
//! artifact store and scratch directory.

use crate::cluster::Cluster;
use crate::gate::{self, Busy};
use crate::suite::new_job;
use bytes::Bytes;
use futures_util::TryStreamExt;
use jiff::Timestamp;
use oviduct::clock::Stopwatch;
use oviduct::generate::{
    CancelToken, FileOutput, Findings, GenerateError, Outcome, Progress, Seconds, Sink, Stage, Summary, UsedBackend,
};
use oviduct::jobs::artifacts::Artifacts;
use oviduct::jobs::sweep::{Retention, Sweeper, Swept};
use oviduct::jobs::{Job, JobId, NewJob, Store, StoreOptions};
use oviduct::model::{Ring, Section};
use oviduct::sim::gpu::GpuError;
use oviduct::worker::{
    AdmittedPlan, BatchCallbacks, BatchGenerator, BatchMember, GenerationInput, Generator, PoolOptions, WorkError,
    WorkerPool,
};
use rayon::ThreadPool;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

/// Expected bytes of a job's file, which depend only on seed and name. `model.glb` of seed 2 is
/// large enough for a multipart upload.
pub fn content(seed: u64, name: &str) -> Vec<u8> {
    let length = if name == "model.glb" && seed == 2 { 9_000_000 } else { 1000 };
    let mut word = seed * 2 + name.len() as u64;
    (0..length)
        .map(|_| {
            word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (word >> 33) as u8
        })
        .collect()
}

pub const NAMES: [&str; 2] = ["report.json", "model.glb"];

/// Number of objects in which the files of a job are stored, unless its seed is 2.
pub const OBJECTS: usize = 1;

fn progress(stage: Stage, fraction: f64) -> Progress {
    Progress { stage, fraction, step: 1, steps: 2, particles: 8, sections: 1, eta_seconds: None }
}

fn section() -> Section {
    let ring = |n: u32| Ring { ids: (0..n).collect(), points: (0..n).map(|i| [i as f32, 1.0]).collect() };
    Section { step: 10.0, z_um: 300.0, added: false, inner: ring(1000), outer: ring(100) }
}

/// Runs the script in `spec.script`:
///
/// - `ok`: succeeds after 20 ms.
/// - `slow`: succeeds after 1.2 s.
/// - `wait`: runs until it is cancelled.
/// - `prove`: like `wait`, but in the certificate stage.
/// - `hold`: runs until the gate of the place opens or the job is cancelled.
/// - `deaf`: runs until the gate opens and ignores the cancel token.
/// - `panic`: panics.
/// - `memory`, `certificate`, `io`, `spec`: fails with that error.
pub fn generate(input: GenerationInput<'_>, sink: &dyn Sink, cancel: &CancelToken) -> Result<Outcome, WorkError> {
    let script = input.job.spec["script"].as_str().unwrap().to_owned();
    sink.progress(&progress(Stage::Simulate, 0.1));
    sink.section(&section());
    if script == "prove" {
        sink.progress(&progress(Stage::Certify, 0.8));
    }
    let since = Stopwatch::start();
    let goes_on = || match script.as_str() {
        "hold" | "deaf" => !gate::is_open(&input.job.spec),
        "wait" | "prove" => since.elapsed() < Duration::from_secs(600),
        "slow" => since.elapsed() < Duration::from_millis(1200),
        _ => since.elapsed() < Duration::from_millis(20),
    };
    while goes_on() {
        std::thread::sleep(Duration::from_millis(10));
        if cancel.is_cancelled() && script != "deaf" {
            return Err(GenerateError::Cancelled.into());
        }
    }
    let detail = "slab 7".to_owned();
    match script.as_str() {
        "panic" => panic!("the script says so: {}", input.job.seed),
        "memory" => {
            let limit = input.memory_limit_bytes.unwrap();
            return Err(GenerateError::Memory { needed: limit + 1, limit }.into());
        }
        "certificate" => return Err(GenerateError::Certificate { detail }.into()),
        "io" => {
            let source = std::io::Error::from(std::io::ErrorKind::InvalidData);
            return Err(GenerateError::Io { name: "model.glb".into(), source }.into());
        }
        "spec" => return Err(WorkError::Spec { detail }),
        _ => {}
    }
    for (stage, fraction) in [(Stage::Mesh, 0.7), (Stage::Certify, 0.8), (Stage::Export, 0.9)] {
        sink.progress(&progress(stage, fraction));
        if cancel.is_cancelled() {
            return Err(GenerateError::Cancelled.into());
        }
    }
    let files = NAMES.map(|name| {
        let bytes = content(input.job.seed, name);
        std::fs::write(input.dir.join(name), &bytes).unwrap();
        FileOutput {
            name: name.into(),
            media_type: "application/octet-stream".into(),
            bytes: bytes.len() as u64,
            sha256: hex::encode(Sha256::digest(&bytes)),
        }
    });
    Ok(Outcome {
        used: if rayon::current_num_threads() == 1 { UsedBackend::CpuSingle } else { UsedBackend::Cpu },
        device: format!("scripted, {} threads", rayon::current_num_threads()),
        files: files.into(),
        findings: Findings { summary: Summary { vertices: 8, ..Summary::default() }, ..Findings::default() },
        seconds: Seconds::default(),
    })
}

/// Behaviour of a [`FakeGpu`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    Well,
    /// The next batch loses the device, which can be opened again afterwards.
    Lost,
    OutOfMemory,
    /// Admits no job.
    Unfit,
    /// Cannot be opened.
    Gone,
    Panics,
}

/// Memory of a [`FakeGpu`], in units of `spec.size`.
pub const ROOM: u64 = 8;

/// A GPU that runs the scripts of a batch's members, one thread per member. A batch may have a
/// total `spec.size` of up to [`ROOM`]. Members with the script `ok` succeed even if the device
/// fails. The device is free when all members have ended, or immediately if all members have the
/// script `prove`.
pub struct FakeGpu {
    pub fate: Mutex<Fate>,
    /// Opening the device blocks while this is true.
    pub is_opening: AtomicBool,
    /// Seeds of the jobs in each batch.
    pub batches: Mutex<Vec<Vec<u64>>>,
}

impl FakeGpu {
    pub fn new(fate: Fate) -> Arc<Self> {
        Arc::new(Self { fate: Mutex::new(fate), is_opening: AtomicBool::new(false), batches: Mutex::default() })
    }
}

impl BatchGenerator for FakeGpu {
    fn device(&self) -> String {
        "a fake GPU".to_owned()
    }

    fn open(&self) -> Result<(), String> {
        while self.is_opening.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(5));
        }
        if *self.fate.lock().unwrap() == Fate::Gone { Err("it was pulled out".to_owned()) } else { Ok(()) }
    }

    fn admit(&self, jobs: &[&Job]) -> Result<Vec<Option<AdmittedPlan>>, String> {
        self.open()?;
        if *self.fate.lock().unwrap() == Fate::Unfit {
            return Err("it is too large for the GPU".to_owned());
        }
        let mut used = 0;
        let mut fits = |job: &&Job| {
            let size = job.spec["size"].as_u64().unwrap();
            let fits = used + size <= ROOM;
            used += if fits { size } else { 0 };
            fits.then_some(None)
        };
        Ok(jobs.iter().map(&mut fits).collect())
    }

    fn generate(&self, members: &[BatchMember<'_>], _: &ThreadPool, calls: BatchCallbacks<'_>) {
        self.batches.lock().unwrap().push(members.iter().map(|m| m.input.job.seed).collect());
        let fate = *self.fate.lock().unwrap();
        assert!(fate != Fate::Panics, "the driver is at fault");
        let error = match fate {
            Fate::Lost => Some(GpuError::Lost { detail: "it was pulled out".to_owned() }),
            Fate::OutOfMemory => Some(GpuError::OutOfMemory),
            _ => None,
        };
        std::thread::scope(|scope| {
            let ended = calls.ended;
            for (place, member) in members.iter().enumerate() {
                let error = error.clone().filter(|_| member.input.job.spec["script"] != "ok");
                scope.spawn(move || {
                    let result = match error {
                        Some(error) => {
                            member.sink.progress(&progress(Stage::Simulate, 0.6));
                            std::thread::sleep(Duration::from_millis(300));
                            Err(GenerateError::Gpu(error).into())
                        }
                        None => generate(member.input, member.sink, member.cancel),
                    };
                    ended(place, result.map(|made| Outcome { used: UsedBackend::Gpu, device: self.device(), ..made }));
                });
            }
            if members.iter().all(|member| member.input.job.spec["script"] == "prove") {
                (calls.simulated)();
            }
        });
        if fate == Fate::Lost {
            *self.fate.lock().unwrap() = Fate::Well;
        }
    }
}

pub fn scripted(script: &str, seed: u64) -> NewJob {
    let spec = serde_json::json!({ "script": script }).into();
    NewJob { seed, spec, reuse: false, ..new_job(&format!("{script} {seed}")) }
}

/// Kind of database of a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Database {
    Sqlite,
    Postgres,
}

impl Database {
    /// URL of a new database. A SQLite file is created in `dir`.
    pub async fn url(self, dir: &Path) -> String {
        match self {
            Self::Sqlite => format!("sqlite:{}", dir.join("jobs.db").display()),
            Self::Postgres => tokio::task::spawn_blocking(|| Cluster::shared().database()).await.unwrap(),
        }
    }
}

/// A job store, an artifact store and a scratch directory in one directory.
pub struct Place {
    pub dir: PathBuf,
    pub store: Store,
    pub artifacts: Artifacts,
    /// Counts the generations that run on CPU workers of this place.
    pub busy: Arc<Busy>,
    sweeper: OnceLock<Sweeper>,
    own: Option<tempfile::TempDir>,
}

impl Place {
    /// A place over an in-memory job store and a temporary directory.
    pub async fn fresh(change: impl FnOnce(&mut StoreOptions)) -> Self {
        let mut options = StoreOptions::default();
        change(&mut options);
        let own = tempfile::tempdir().unwrap();
        let store = Store::open_in_memory(options).await.unwrap();
        Self {
            dir: own.path().to_owned(),
            store,
            artifacts: Artifacts::local(&own.path().join("artifacts")).unwrap(),
            busy: Arc::default(),
            sweeper: OnceLock::new(),
            own: Some(own),
        }
    }

    /// A place over a new database of this kind and a temporary directory.
    pub async fn on(database: Database, options: StoreOptions) -> Self {
        let own = tempfile::tempdir().unwrap();
        let url = database.url(own.path()).await;
        let mut place = Self::with(own.path(), &url, options).await;
        place.own = Some(own);
        place
    }

    /// A place over the database at `url`, with files under `dir`.
    pub async fn at(dir: &Path, url: &str) -> Self {
        Self::with(dir, url, StoreOptions::default()).await
    }

    pub async fn with(dir: &Path, url: &str, options: StoreOptions) -> Self {
        let store = oviduct::jobs::open(url, options).await.unwrap();
        let artifacts = Artifacts::local(&dir.join("artifacts")).unwrap();
        Self { dir: dir.to_owned(), store, artifacts, busy: Arc::default(), sweeper: OnceLock::new(), own: None }
    }

    /// Default options of the worker pool. The lease is long enough that none expires on a slow
    /// machine; tests of expiry set a shorter one.
    pub fn options(&self) -> PoolOptions {
        let (scratch, lease) = (self.dir.join("scratch"), Duration::from_secs(600));
        PoolOptions { threads: 2, memory_limit_bytes: Some(1 << 30), lease, ..PoolOptions::new(scratch) }
    }

    pub fn start(&self, change: impl FnOnce(&mut PoolOptions)) -> WorkerPool {
        self.start_over(self.store.clone(), change)
    }

    /// Starts workers; the first one has a GPU.
    pub fn start_with_gpu(&self, gpu: &Arc<FakeGpu>, change: impl FnOnce(&mut PoolOptions)) -> WorkerPool {
        let mut options = self.options();
        change(&mut options);
        let gpus: Vec<Arc<dyn BatchGenerator>> = vec![Arc::clone(gpu) as Arc<dyn BatchGenerator>];
        let (store, artifacts) = (self.store.clone(), self.artifacts.clone());
        WorkerPool::start(store, artifacts, self.busy.generator(), gpus, options).unwrap()
    }

    /// Starts workers over another view of the job store.
    pub fn start_over(&self, store: Store, change: impl FnOnce(&mut PoolOptions)) -> WorkerPool {
        self.start_with(store, self.busy.generator(), change)
    }

    pub fn start_with(
        &self,
        store: Store,
        generator: Arc<Generator>,
        change: impl FnOnce(&mut PoolOptions),
    ) -> WorkerPool {
        let mut options = self.options();
        change(&mut options);
        WorkerPool::start(store, self.artifacts.clone(), generator, Vec::new(), options).unwrap()
    }

    pub async fn queue(&self, script: &str, seed: u64) -> JobId {
        let spec = gate::spec(&self.dir, script).into();
        self.store.submit(NewJob { spec, ..scripted(script, seed) }).await.unwrap().job().id
    }

    /// Waits until `done` returns true for the job.
    pub async fn until(&self, id: JobId, done: impl Fn(&Job) -> bool) -> Job {
        let mut changes = self.store.changes();
        let wait = async {
            loop {
                let job = self.store.get(id).await.unwrap().expect("the job is gone");
                if done(&job) {
                    return job;
                }
                // The timeout finds changes without notifications.
                let _ = tokio::time::timeout(Duration::from_millis(500), changes.recv()).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(600), wait).await.expect("it never happened")
    }

    pub async fn ended(&self, id: JobId) -> Job {
        self.until(id, |job| job.status.is_ended()).await
    }

    /// The complete files in the artifact store.
    pub fn visible(&self) -> Vec<PathBuf> {
        visible(&self.dir.join("artifacts"))
    }

    /// All files in the scratch directory.
    pub fn scratch(&self) -> Vec<PathBuf> {
        visible(&self.dir.join("scratch"))
    }

    /// Runs retention once, as the only process.
    pub async fn retain(&self, retention: Retention) -> Swept {
        let round = self.sweeper().observe(retention, false).await.unwrap();
        self.sweeper().retain(retention, &round.state).await.unwrap().unwrap()
    }

    /// Runs the orphan sweep once, as the only process; returns the number of removed files.
    pub async fn sweep_orphans(&self, now: Timestamp, age: Duration) -> u64 {
        self.sweeper().sweep_orphans(now, age, Duration::ZERO).await.unwrap().unwrap()
    }

    fn sweeper(&self) -> &Sweeper {
        self.sweeper.get_or_init(|| Sweeper::new(self.store.clone(), self.artifacts.clone(), "the only process"))
    }

    /// Compares the job's files with their expected bytes.
    pub async fn check_files(&self, job: &Job) {
        let names: Vec<&str> = job.files.iter().map(|file| file.name.as_str()).collect();
        assert_eq!(names, NAMES);
        for file in &job.files {
            let expected = content(job.seed, &file.name);
            let chunks: Vec<Bytes> =
                self.artifacts.open(file, None).await.unwrap().try_collect().await.expect("it equals its record");
            assert!(chunks.concat() == expected, "{} at {}", file.name, file.key);
            assert_eq!(file.bytes, expected.len() as u64);
        }
    }
}

/// Files below a directory, except lock files and files of unfinished uploads.
pub fn visible(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let name = entry.file_name().to_string_lossy().into_owned();
        if path.is_dir() {
            found.extend(visible(&path));
        } else if !name.contains('#') && name != ".lock" {
            found.push(path);
        }
    }
    found
}
