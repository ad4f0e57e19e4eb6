//! Tests on full disks. Each test runs itself again in child processes whose disk can be filled and
//! freed:
//!
//! - On every machine, the child runs with a limit on the size of files (`RLIMIT_FSIZE`, with
//!   `SIGXFSZ` ignored). Writes then fail with `EFBIG`.
//! - If the kernel lets a process mount a tmpfs in its own namespace (root, or user namespaces),
//!   the child runs on a tmpfs of a few megabytes. Writes then fail with `ENOSPC`.

use crate::scripted::{OBJECTS, Place, generate, scripted};
use crate::suite::{new_job, objects};
use crate::watched::Heartbeats;
use axum::body::Body;
use axum::http::{Method, Request};
use http_body_util::BodyExt;
use oviduct::clock::Clock;
use oviduct::generate::{Backend, CancelToken, Outcome, Sink, Stage};
use oviduct::http::{AppState, Limits, router};
use oviduct::jobs::artifacts::Artifacts;
use oviduct::jobs::state::AttemptEnd;
use oviduct::jobs::{Job, JobId, JobProgress, NewJob, Status, StoreError, StoreOptions};
use oviduct::spec::{ModelSpec, preset};
use oviduct::worker::{GenerationInput, WorkError, generate_on_cpu};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

const FOLDER: &str = "OVIDUCT_TEST_FOLDER";
const DISK: &str = "OVIDUCT_TEST_DISK";
const BALLAST: &str = "ballast";

/// A disk that can be filled.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Disk {
    /// A tmpfs of a few megabytes at this path.
    Tmpfs(PathBuf),
    /// Every disk, as seen by this process: no file may grow beyond this many bytes.
    Limit(u64),
}

impl Disk {
    fn fill(&self) {
        match self {
            Self::Limit(bytes) => limit(&bytes.to_string()),
            Self::Tmpfs(folder) => {
                let mut ballast = File::options().create(true).append(true).open(folder.join(BALLAST)).unwrap();
                let full = std::iter::repeat_with(|| ballast.write_all(&[0; 4096])).find_map(Result::err).unwrap();
                assert_eq!(full.kind(), std::io::ErrorKind::StorageFull, "{full}");
            }
        }
    }

    fn free(&self) {
        match self {
            Self::Limit(_) => limit("unlimited"),
            Self::Tmpfs(folder) => std::fs::remove_file(folder.join(BALLAST)).unwrap(),
        }
    }
}

/// Sets the limit on the size of files that this process writes.
fn limit(bytes: &str) {
    let process = std::process::id().to_string();
    let status = Command::new("prlimit").args(["--pid", &process, &format!("--fsize={bytes}:")]).status().unwrap();
    assert!(status.success(), "prlimit: {status}");
}

/// A command that runs another command with a small tmpfs at `folder`. `None` if this machine does
/// not allow the mount.
fn tmpfs(folder: &Path) -> Option<Command> {
    let mount = "mount -t tmpfs -o size=48m tmpfs \"$0\" && exec \"$@\"";
    let command = |namespaces: &[&str]| {
        let mut command = Command::new("unshare");
        command.args(namespaces).args(["--", "sh", "-c", mount]).arg(folder);
        command
    };
    let ways: [&[&str]; 2] = [&["--mount"], &["--user", "--map-root-user", "--mount"]];
    let works = |way: &&&[&str]| command(way).arg("true").output().is_ok_and(|out| out.status.success());
    ways.iter().find(works).map(|way| command(way))
}

/// A command that runs another command with `SIGXFSZ` ignored, so that writes beyond the limit fail
/// instead of ending the process.
fn limited() -> Command {
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' XFSZ; exec \"$@\"", "sh"]);
    command
}

/// Runs `body` in a child process on each available kind of disk. The subfolder `part` lies on that
/// disk.
async fn on_full_disks(test: &str, part: &str, body: impl AsyncFn(&Path, Disk)) {
    if let (Ok(folder), Ok(kind)) = (std::env::var(FOLDER), std::env::var(DISK)) {
        let folder = PathBuf::from(folder);
        let disk = if kind == "tmpfs" { Disk::Tmpfs(folder.join(part)) } else { Disk::Limit(512) };
        return body(&folder, disk).await;
    }
    let mut disks = 0;
    for kind in ["limit", "tmpfs"] {
        let dir = tempfile::tempdir().unwrap();
        let at = dir.path().join(part);
        std::fs::create_dir(&at).unwrap();
        let Some(mut command) = (if kind == "limit" { Some(limited()) } else { tmpfs(&at) }) else {
            eprintln!("{test}: a tmpfs cannot be mounted here; the test ran under a limit on the size of files");
            continue;
        };
        command.arg(std::env::current_exe().unwrap()).args(["--exact", test, "--nocapture", "--test-threads=1"]);
        command.env(FOLDER, dir.path()).env(DISK, kind);
        let output = tokio::task::spawn_blocking(move || command.output()).await.unwrap().unwrap();
        let said = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
        assert!(output.status.success() && said.contains("1 passed"), "on {kind}: {}\n{said}", output.status);
        disks += 1;
    }
    assert!(disks > 0);
}

/// The HTTP service over a place, called in process.
struct Service(axum::Router);

impl Service {
    fn over(place: &Place, status: &oviduct::status::Status) -> Self {
        let (store, artifacts) = (place.store.clone(), place.artifacts.clone());
        let state = AppState::new(store, artifacts, Limits::default(), CancellationToken::new());
        Self(router(state.with_status(status.clone())))
    }

    /// The status of a response to a submission.
    async fn submits(&self) -> u16 {
        let request = Request::post("/models").header("host", "here").header("content-type", "application/json");
        let request = request.body(Body::from(r#"{ "backend": "cpu", "reuse": false }"#)).unwrap();
        self.0.clone().oneshot(request).await.unwrap().status().as_u16()
    }

    /// The reason why a model waits. Numbers of workers are up to a second old.
    async fn waits_for(&self, id: JobId, reason: &str) {
        for _ in 0..600 {
            let model = self.ask(Method::GET, &format!("/models/{id}")).await.1;
            let model: serde_json::Value = serde_json::from_slice(&model).unwrap();
            if model["queue"]["reason"] == reason {
                return;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        panic!("the model never waits for the reason {reason}");
    }

    async fn ask(&self, method: Method, path: &str) -> (u16, Vec<u8>) {
        let request = Request::builder().method(method).uri(path).header("host", "here").body(Body::empty()).unwrap();
        let (parts, body) = self.0.clone().oneshot(request).await.unwrap().into_parts();
        (parts.status.as_u16(), body.collect().await.unwrap().to_bytes().to_vec())
    }

    /// Reads the model's files and compares them with its record.
    async fn reads(&self, job: &Job) {
        use sha2::{Digest, Sha256};
        for file in &job.files {
            let (status, bytes) = self.ask(Method::GET, &format!("/models/{}/files/{}", job.id, file.name)).await;
            assert_eq!((status, bytes.len() as u64), (200, file.bytes), "{}", file.name);
            assert_eq!(hex::encode(Sha256::digest(&bytes)), file.sha256, "{}", file.name);
        }
    }

    /// Reads the model `read`, cancels the job `waits`, then deletes both.
    async fn goes_on(&self, read: &Job, waits: JobId) {
        self.reads(read).await;
        let (status, body) = self.ask(Method::POST, &format!("/models/{waits}/cancel")).await;
        let model: serde_json::Value = serde_json::from_slice(&body).unwrap();
        assert_eq!((status, &model["status"]), (200, &"cancelled".into()));
        for id in [waits, read.id] {
            assert_eq!(self.ask(Method::DELETE, &format!("/models/{id}")).await.0, 204);
            assert_eq!(self.ask(Method::GET, &format!("/models/{id}")).await.0, 404);
        }
    }
}

/// All files below a folder except the ballast file, including partially written ones.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false if entry.file_name() == BALLAST => {}
            false => found.push(path),
        }
    }
    found
}

/// Waits until at most `count` files are left. The service removes files after it has responded to
/// a deletion.
async fn left(folder: &Path, count: usize) {
    for _ in 0..6000 {
        if files(folder).len() <= count {
            break;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(files(folder).len(), count, "{:?}", files(folder));
}

/// A place with its files in the folder, its records in memory, and `clock` as the store's clock.
async fn place(folder: &Path, max_attempts: u32, clock: &Clock) -> Place {
    let change = |options: &mut StoreOptions| (options.max_attempts, options.clock) = (max_attempts, clock.clone());
    let mut place = Place::fresh(change).await;
    folder.clone_into(&mut place.dir);
    place.artifacts = Artifacts::local(&folder.join("artifacts")).unwrap();
    place
}

fn is_about_room(text: &str) -> bool {
    text.contains("No space left on device") || text.contains("File too large")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_artifact_store_costs_no_attempt() {
    let body = async |folder: &Path, disk: Disk| {
        let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
        let place = place(folder, 1, &clock).await;
        let (store, heartbeats) = Heartbeats::over(&place.store);
        let (service, full) =
            (Service::over(&place, &oviduct::status::Status::default()), Arc::new(AtomicBool::new(false)));
        let generator = {
            let (disk, full) = (disk.clone(), Arc::clone(&full));
            move |input: GenerationInput<'_>, sink: &dyn Sink, cancel: &CancelToken| -> Result<Outcome, WorkError> {
                // The limit applies to both directories. Only the artifact store must be full, so
                // lift the limit while the generator writes to the scratch directory.
                if matches!(disk, Disk::Limit(_)) {
                    disk.free();
                }
                let made = generate(input, sink, cancel)?;
                if full.load(Ordering::Relaxed) {
                    disk.fill();
                }
                Ok(made)
            }
        };
        let start = |storage_wait| {
            place.start_with(store.clone(), Arc::new(generator.clone()), |options| {
                options.storage_wait = storage_wait;
                options.heartbeat = Duration::from_millis(200);
                options.lease = Duration::from_millis(800);
            })
        };
        let pool = start(Duration::from_millis(10));
        let (first, second) = (place.queue("ok", 1).await, place.queue("ok", 3).await);
        let (first, second) = (place.ended(first).await, place.ended(second).await);
        assert_eq!((first.status, second.status), (Status::Succeeded, Status::Succeeded));
        full.store(true, Ordering::Relaxed);

        // After all upload attempts, the job is released with the cause, and none of its files
        // remain, not even partially. Seed 2 has a large file.
        let waits = place.queue("ok", 2).await;
        released_for_storage(&place, waits).await;
        assert_eq!(files(&folder.join("artifacts")).len(), 2 * OBJECTS);
        assert!(place.scratch().is_empty());
        let behind = NewJob { backend: Backend::Gpu, ..scripted("ok", 9) };
        let behind = place.store.submit(behind).await.unwrap().job().id;
        service.goes_on(&first, behind).await;
        left(&folder.join("artifacts"), OBJECTS).await;
        let paused = place.store.get(waits).await.unwrap().unwrap();
        assert_eq!((paused.status, paused.attempts), (Status::Queued, 1), "it was claimed although the disk is full");
        full.store(false, Ordering::Relaxed);
        disk.free();
        let job = place.ended(waits).await;
        assert_eq!((job.status, job.attempts), (Status::Succeeded, 2), "{:?}", job.problem);
        place.check_files(&job).await;
        place.store.delete(waits).await.unwrap().unwrap();
        place.artifacts.delete(&job.files.iter().map(|file| file.key.clone()).collect::<Vec<_>>()).await.unwrap();
        pool.shutdown(Duration::from_secs(5)).await;

        // The disk stays full for longer than a lease. The worker renews the lease and stores the
        // files once there is space.
        full.store(true, Ordering::Relaxed);
        let pool = start(Duration::from_secs(1));
        let waits = place.queue("ok", 2).await;
        place
            .until(waits, |job| job.progress.and_then(JobProgress::model).is_some_and(|at| at.stage == Stage::Store))
            .await;
        for _ in 0..3 {
            heartbeats.beats(2).await;
            clock.advance(Duration::from_millis(600));
        }
        let waiting = place.store.get(waits).await.unwrap().unwrap();
        assert_eq!((waiting.status, waiting.attempts, waiting.files.len()), (Status::Running, 1, 0));
        service.reads(&second).await;
        full.store(false, Ordering::Relaxed);
        disk.free();
        let job = place.ended(waits).await;
        assert_eq!((job.status, job.attempts), (Status::Succeeded, 1), "{:?}", job.problem);
        place.check_files(&job).await;
        service.reads(&job).await;
        let next = place.ended(place.queue("ok", 4).await).await;
        assert_eq!(next.status, Status::Succeeded);
        service.reads(&next).await;
        pool.shutdown(Duration::from_secs(5)).await;
        assert_eq!(
            files(&folder.join("artifacts")).len(),
            objects([second, job, next].iter().flat_map(|job| &job.files))
        );
    };
    on_full_disks("disk::a_full_artifact_store_costs_no_attempt", "artifacts", body).await;
}

/// Waits until the first attempt at a job is released because a disk is full.
async fn released_for_storage(place: &Place, id: JobId) {
    place.until(id, |job| job.status == Status::Queued && job.attempts > 0).await;
    let attempts = place.store.attempts(id).await.unwrap();
    let detail = attempts[0].detail.as_deref().unwrap_or_default();
    assert_eq!(attempts[0].outcome, Some(AttemptEnd::Released));
    assert!(detail.starts_with("storage: ") && is_about_room(detail), "{detail}");
}

/// A real model runs out of space while its files are written.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_scratch_directory_costs_no_attempt_and_no_partial_file_is_stored() {
    let body = async |folder: &Path, disk: Disk| {
        let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
        let place = place(folder, 1, &clock).await;
        let status = oviduct::status::Status::default();
        let service = Service::over(&place, &status);
        let patch = serde_json::json!({ "steps": 60, "particles": { "total": { "keys": [[0, 300], [1, 420]] } } });
        let spec = ModelSpec::resolve(preset("pig").unwrap(), &patch).unwrap();
        let ask = async |seed: u64| {
            let new = NewJob { seed, spec: spec.json(), reuse: false, ..new_job(&spec.digest(seed)) };
            place.store.submit(new).await.unwrap().job().id
        };
        let pool = place.start_with(place.store.clone(), Arc::new(generate_on_cpu), |options| {
            options.poll = Duration::from_millis(100);
            options.storage_wait = Duration::from_millis(100);
            options.status = status.clone();
        });
        let whole = place.ended(ask(7).await).await;
        assert_eq!(whole.status, Status::Succeeded, "{:?}", whole.problem);

        // A job ends before its scratch files are removed. Removing them while the disk is full
        // would make space for another attempt.
        while !place.scratch().is_empty() {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        // The first attempt is released. No second attempt begins while the disk is full.
        disk.fill();
        let waits = ask(7).await;
        released_for_storage(&place, waits).await;
        assert_eq!(files(&folder.join("artifacts")).len(), objects(&whole.files), "half a model was stored");
        let behind = NewJob { backend: Backend::Gpu, ..scripted("ok", 9) };
        service.goes_on(&whole, place.store.submit(behind).await.unwrap().job().id).await;
        tokio::time::sleep(Duration::from_millis(500)).await;
        let paused = place.store.get(waits).await.unwrap().unwrap();
        assert_eq!((paused.status, paused.attempts), (Status::Queued, 1), "it was claimed although the disk is full");
        assert_eq!(status.not_ready().unwrap().0, oviduct::status::Condition::Storage);
        // Deletions have gone on above; a submission would use up the reserve that they need.
        assert_eq!(service.submits().await, 503);
        service.waits_for(waits, "storage").await;
        disk.free();
        let job = place.ended(waits).await;
        assert_eq!((job.status, job.attempts), (Status::Succeeded, 2), "{:?}", job.problem);
        let hashes = |job: &Job| job.files.iter().map(|file| file.sha256.clone()).collect::<Vec<_>>();
        assert_eq!(hashes(&job), hashes(&whole));
        assert!(status.not_ready().is_none());
        let next = place.ended(ask(9).await).await;
        assert_eq!(next.status, Status::Succeeded, "{:?}", next.problem);
        service.reads(&next).await;
        pool.shutdown(Duration::from_secs(5)).await;
        assert!(place.scratch().is_empty());
        assert_eq!(files(&folder.join("artifacts")).len(), objects(&job.files) + objects(&next.files));
    };
    let test = "disk::a_full_scratch_directory_costs_no_attempt_and_no_partial_file_is_stored";
    on_full_disks(test, "scratch", body).await;
}

/// Records and files share one disk. The store has reserved space in which it can change and remove
/// records on the full disk. After that space is used up, the store refuses submissions. Everything
/// works again once there is space.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn on_a_full_disk_under_everything_models_are_still_cancelled_and_deleted() {
    let body = async |folder: &Path, disk: Disk| {
        let all = folder.join("all");
        // Above the size of the write-ahead log, below the size of a large model.
        let disk = if matches!(disk, Disk::Limit(_)) { Disk::Limit(8_800_000) } else { disk };
        let place = Place::at(&all, &format!("sqlite:{}", all.join("jobs.db").display())).await;
        let service = Service::over(&place, &oviduct::status::Status::default());
        let (full, room) = (Arc::new(AtomicBool::new(false)), disk.clone());
        let filled = Arc::clone(&full);
        let generator =
            move |input: GenerationInput<'_>, sink: &dyn Sink, cancel: &CancelToken| -> Result<Outcome, WorkError> {
                // Free the disk while the generator writes to the scratch directory.
                if filled.load(Ordering::Relaxed) {
                    room.free();
                }
                let made = generate(input, sink, cancel)?;
                if filled.load(Ordering::Relaxed) {
                    room.fill();
                }
                Ok(made)
            };
        let pool = place.start_with(place.store.clone(), Arc::new(generator), |options| {
            options.storage_wait = Duration::from_millis(10);
        });
        let first = place.ended(place.queue("ok", 1).await).await;
        let mut waiting = Vec::new();
        for seed in 0..30 {
            let new = NewJob { backend: Backend::Gpu, ..scripted("ok", 100 + seed) };
            waiting.push(place.store.submit(new).await.unwrap().job().id);
        }
        disk.fill();
        full.store(true, Ordering::Relaxed);
        let released = place.queue("ok", 2).await;
        released_for_storage(&place, released).await;
        assert_eq!(service.ask(Method::POST, &format!("/models/{released}/cancel")).await.0, 200);
        assert_eq!(place.ended(released).await.status, Status::Cancelled);
        // Fill the space that the released job's files had occupied.
        disk.fill();
        for id in waiting.split_off(1) {
            assert_eq!(service.ask(Method::POST, &format!("/models/{id}/cancel")).await.0, 200);
            assert_eq!(service.ask(Method::DELETE, &format!("/models/{id}")).await.0, 204);
        }
        service.goes_on(&first, waiting[0]).await;
        left(&all.join("artifacts"), 0).await;

        // Submit until there is no space for another record.
        disk.fill();
        // Random digits, which do not compress well.
        let digits: String = (0..6_000).map(|_| uuid::Uuid::new_v4().simple().to_string()).collect();
        let large = serde_json::json!({ "script": "ok", "large": digits });
        let mut asked = Vec::new();
        let refused = loop {
            let new =
                NewJob { backend: Backend::Gpu, spec: large.clone().into(), ..scripted("ok", asked.len() as u64) };
            match place.store.submit(new).await {
                Ok(submitted) => asked.push(submitted.job().id),
                Err(error) => break error,
            }
            assert!(asked.len() < 500, "the disk never filled up");
        };
        assert!(matches!(refused, StoreError::Database(_)), "{refused}");
        let counts = place.store.counts().await.unwrap();
        assert_eq!((counts.queued, counts.cancelled), (asked.len() as u64, 1), "a refused submission left a record");
        assert_eq!(service.ask(Method::GET, &format!("/models/{released}")).await.0, 200);
        full.store(false, Ordering::Relaxed);
        disk.free();
        for id in asked {
            place.store.delete(id).await.unwrap().unwrap();
        }
        let next = place.ended(place.queue("ok", 2).await).await;
        assert_eq!(next.status, Status::Succeeded, "{:?}", next.problem);
        place.check_files(&next).await;
        pool.shutdown(Duration::from_secs(5)).await;
        place.store.close().await;
    };
    on_full_disks("disk::on_a_full_disk_under_everything_models_are_still_cancelled_and_deleted", "all", body).await;
}
