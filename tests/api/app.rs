//! A service in process; the test plays the worker.
//!
//! The app checks every response: an error must be a complete problem, and a server error must be
//! expected. When the app is dropped, no event stream may be open.

use axum::Router;
use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, Method, Request, StatusCode, header};
use http_body_util::BodyExt;
use jiff::Timestamp;
use oviduct::clock::Clock;
use oviduct::generate::{Backend, Progress, Stage, UsedBackend};
use oviduct::http::{AccessOptions, AppState, Limits, REQUEST_ID, WithoutKeys, execute_operations, router};
use oviduct::jobs::artifacts::{Artifacts, Stored, key};
use oviduct::jobs::keys::{KeyLimits, NewKey, Scope, Secret};
use oviduct::jobs::{
    BackendReport, BulkAction, ClaimScope, ClaimedJob, Directive, File, Finished, JobId, JobProgress, ListFilter,
    LiveSection, NewBulk, Status as JobStatus, Store, StoreOptions, WorkerInfo, WorkerKind,
};
use oviduct::status::Status;
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tempfile::TempDir;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

/// Lease of the worker that the test plays.
pub(super) const LEASE: Duration = Duration::from_secs(8);

pub(super) struct App {
    router: Router,
    state: AppState,
    pub(super) store: Store,
    pub(super) artifacts: Artifacts,
    pub(super) clock: Clock,
    pub(super) shutdown: CancellationToken,
    pub(super) dir: TempDir,
    faults_expected: AtomicBool,
}

/// A response with its complete body.
#[derive(Debug)]
pub(super) struct Reply {
    pub(super) status: StatusCode,
    pub(super) headers: HeaderMap,
    pub(super) body: Bytes,
}

impl Reply {
    pub(super) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&self.body)))
    }

    pub(super) fn header(&self, name: impl header::AsHeaderName) -> Option<&str> {
        self.headers.get(name).map(|v| v.to_str().unwrap())
    }

    /// The path that `Location` names, in a response to a request whose path has one segment.
    pub(super) fn location(&self) -> String {
        let reference = self.header(header::LOCATION).unwrap();
        assert!(!reference.starts_with(['/', '.']), "{reference}");
        format!("/{reference}")
    }

    /// Last part of the problem's type.
    pub(super) fn slug(&self) -> String {
        self.json()["type"].as_str().unwrap().strip_prefix("urn:oviduct:problem:").unwrap().to_owned()
    }

    /// The pointers, parameters and headers that the problem names.
    pub(super) fn places(&self) -> Vec<String> {
        let json = self.json();
        let errors = json["errors"].as_array().unwrap().iter();
        let place =
            |e: &Value| ["pointer", "parameter", "header"].into_iter().find_map(|m| Some(e[m].as_str()?.to_owned()));
        errors.map(|e| place(e).unwrap()).collect()
    }
}

impl App {
    pub(super) async fn new() -> Self {
        Self::with(Limits::default(), 100).await
    }

    pub(super) async fn with(limits: Limits, queue_limit: u64) -> Self {
        let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
        let options = StoreOptions { clock: clock.clone(), queue_limit, ..StoreOptions::default() };
        let store = Store::open_in_memory(options).await.unwrap();
        Self::over(store, clock, limits)
    }

    /// The id of a new operation that changes nothing.
    pub(super) async fn operation(&self, owner: Option<&str>) -> String {
        let filter = ListFilter { status: Some(JobStatus::Failed), ..ListFilter::default() };
        let owner = owner.map(str::to_owned);
        let new = NewBulk { action: BulkAction::Delete, filter, conditions: Vec::new(), owner };
        self.store.create_operation(new).await.unwrap().id.to_string()
    }

    /// Executes operations in the background.
    pub(super) fn execute_operations(&self) -> tokio::task::JoinHandle<()> {
        tokio::spawn(execute_operations(self.state.clone()))
    }

    /// Replaces the artifact store.
    pub(super) fn with_artifacts(mut self, artifacts: Artifacts) -> Self {
        self.state = AppState::new(self.store.clone(), artifacts.clone(), Limits::default(), self.shutdown.clone());
        self.router = router(self.state.clone());
        self.artifacts = artifacts;
        self
    }

    /// Replaces the status that the probes report.
    pub(super) fn with_status(mut self, status: Status) -> Self {
        self.state = self.state.clone().with_status(status);
        self.router = router(self.state.clone());
        self
    }

    /// Sets the access options.
    pub(super) fn with_access(mut self, without_keys: WithoutKeys, limits: KeyLimits) -> Self {
        let options = AccessOptions { without_keys, limits, refresh: Duration::ZERO };
        self.state = self.state.clone().with_access(options);
        self.router = router(self.state.clone());
        self
    }

    /// Creates an API key; returns the value for `Authorization`.
    pub(super) async fn key(&self, owner: &str, scopes: &[Scope]) -> String {
        self.key_with(owner, scopes, KeyLimits::default(), None).await
    }

    pub(super) async fn key_with(
        &self,
        owner: &str,
        scopes: &[Scope],
        limits: KeyLimits,
        expires_at: Option<Timestamp>,
    ) -> String {
        let secret = Secret::generate();
        let new = NewKey {
            prefix: secret.prefix().into(),
            hash: secret.hash(),
            owner: owner.parse().unwrap(),
            scopes: scopes.iter().copied().collect(),
            limits,
            expires_at,
        };
        self.store.add_key(new).await.unwrap();
        format!("Bearer {}", secret.reveal())
    }

    pub(super) fn over(store: Store, clock: Clock, limits: Limits) -> Self {
        let dir = TempDir::new().unwrap();
        let artifacts = Artifacts::local(&dir.path().join("files")).unwrap();
        let shutdown = CancellationToken::new();
        let state = AppState::new(store.clone(), artifacts.clone(), limits, shutdown.clone());
        let router = router(state.clone());
        Self { router, state, store, artifacts, clock, shutdown, dir, faults_expected: AtomicBool::new(false) }
    }

    /// Permits server errors from this call on.
    pub(super) fn expect_faults(&self) {
        self.faults_expected.store(true, Ordering::Relaxed);
    }

    pub(super) fn open_streams(&self) -> usize {
        self.state.open_streams()
    }

    /// Sends a request; the caller reads the body of the response.
    pub(super) async fn start(&self, request: Request<Body>) -> axum::response::Response {
        let response = self.router.clone().oneshot(with_host(request)).await.unwrap();
        assert!(response.headers().contains_key(REQUEST_ID));
        let faults = self.faults_expected.load(Ordering::Relaxed);
        assert!(faults || !response.status().is_server_error(), "the service failed: {response:?}");
        response
    }

    pub(super) async fn send(&self, request: Request<Body>) -> Reply {
        let (method, path) = (request.method().clone(), request.uri().path().to_owned());
        let (parts, body) = self.start(request).await.into_parts();
        let body = body.collect().await.unwrap().to_bytes();
        let reply = Reply { status: parts.status, headers: parts.headers, body };
        if reply.status.as_u16() >= 400 && method != Method::HEAD {
            assert_eq!(reply.header(header::CONTENT_TYPE), Some("application/problem+json"), "{method} {path}");
            let problem = reply.json();
            for member in ["type", "title", "detail", "request_id"] {
                assert!(problem[member].as_str().is_some_and(|s| !s.is_empty()), "{member} of {problem}");
            }
            assert_eq!(problem["status"], reply.status.as_u16());
            assert_eq!(problem["instance"], path);
            assert_eq!(problem["request_id"], reply.header(REQUEST_ID).unwrap());
        }
        reply
    }

    pub(super) async fn get(&self, path: &str) -> Reply {
        self.send(Request::get(path).body(Body::empty()).unwrap()).await
    }

    pub(super) async fn get_with(&self, path: &str, headers: &[(&str, &str)]) -> Reply {
        self.request(Method::GET, path, headers, Body::empty()).await
    }

    pub(super) async fn request(&self, method: Method, path: &str, headers: &[(&str, &str)], body: Body) -> Reply {
        let mut request = Request::builder().method(method).uri(path);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        self.send(request.body(body).unwrap()).await
    }

    pub(super) async fn post(&self, path: &str, body: &Value) -> Reply {
        self.post_with(path, &[], body).await
    }

    pub(super) async fn post_with(&self, path: &str, headers: &[(&str, &str)], body: &Value) -> Reply {
        let headers = [&[("content-type", "application/json")], headers].concat();
        self.request(Method::POST, path, &headers, Body::from(body.to_string())).await
    }

    pub(super) async fn delete(&self, path: &str) -> Reply {
        self.request(Method::DELETE, path, &[], Body::empty()).await
    }

    /// Requests a model with this seed; returns its path.
    pub(super) async fn model(&self, seed: u64) -> String {
        let reply = self.post("/models", &json!({ "seed": seed, "reuse": false })).await;
        assert_eq!(reply.status, 202, "{reply:?}");
        reply.location()
    }

    /// Claims the next model, as a worker does.
    pub(super) async fn claim(&self) -> ClaimedJob {
        self.store.claim("w1", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().expect("a model is queued")
    }

    pub(super) async fn beat(&self, job: &ClaimedJob, step: u32, section: Option<&LiveSection>) -> Directive {
        let progress = progress(step);
        self.store.heartbeat(job, LEASE, &used(), Some(&progress), section).await.unwrap()
    }

    /// Stores files and ends the model as succeeded.
    pub(super) async fn finish(&self, job: ClaimedJob, contents: &[(&str, &str, Vec<u8>)]) {
        let mut files = Vec::new();
        for (name, media_type, bytes) in contents {
            let path = self.dir.path().join("scratch");
            std::fs::write(&path, bytes).unwrap();
            let key = key(job.job().id, job.attempt(), name);
            let stored = self.artifacts.put_file(&key, &path).await.unwrap();
            files.push(File {
                name: (*name).into(),
                media_type: (*media_type).into(),
                bytes: stored.bytes,
                sha256: stored.sha256,
                key,
                start: None,
            });
        }
        self.succeed(job, files).await;
    }

    /// Stores files in one object and ends the model as succeeded.
    pub(super) async fn finish_packed(&self, job: ClaimedJob, contents: &[(&str, &str, Vec<u8>)]) {
        let path = |name: &str| self.dir.path().join(format!("scratch-{name}"));
        for (name, _, bytes) in contents {
            std::fs::write(path(name), bytes).unwrap();
        }
        let key = key(job.job().id, job.attempt(), "pack");
        let paths = contents.iter().map(|(name, ..)| path(name)).collect();
        let stored = self.artifacts.put_pack(&key, paths).await.unwrap();
        let mut end = 0;
        let file = |((name, media_type, _), stored): (&(&str, &str, Vec<u8>), Stored)| {
            let start = Some(end);
            end += stored.bytes;
            let (name, media_type, key) = ((*name).into(), (*media_type).into(), key.clone());
            File { name, media_type, bytes: stored.bytes, sha256: stored.sha256, key, start }
        };
        let files = contents.iter().zip(stored).map(file).collect();
        self.succeed(job, files).await;
    }

    async fn succeed(&self, job: ClaimedJob, files: Vec<File>) {
        let summary = json!({ "sections": 201, "particles": { "start": 710, "end": 8300 }, "vertices": 790_211,
            "triangles": 1_580_422, "min_gap_um": 6.2, "volume_mm3": 41.7, "area_mm2": 2710.5 });
        self.store
            .finish(job, Finished { backend: used(), files, summary, engine: oviduct::ENGINE_VERSION.into() })
            .await
            .unwrap();
    }

    /// Requests a model and ends it with these files; returns its path.
    pub(super) async fn finished(&self, seed: u64, contents: &[(&str, &str, Vec<u8>)]) -> String {
        let model = self.model(seed).await;
        let job = self.claim().await;
        assert_eq!(model, format!("/models/{}", job.job().id));
        self.finish(job, contents).await;
        model
    }

    pub(super) async fn worker(&self, kind: WorkerKind) {
        let worker = WorkerInfo {
            id: "w1".into(),
            host: "here".into(),
            kind,
            device: "test".into(),
            jobs: Vec::new(),
            jobs_done: 3,
            heartbeat_at: self.clock.now(),
            pause: None,
            condition: None,
        };
        self.store.worker_seen(&worker).await.unwrap();
    }
}

/// The request as a client sends it over a connection: HTTP/1.1 requires `Host`.
fn with_host(mut request: Request<Body>) -> Request<Body> {
    request.headers_mut().entry(header::HOST).or_insert(header::HeaderValue::from_static("here"));
    request
}

impl Drop for App {
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        // Tests with open streams use a multi-threaded runtime, so the stream tasks can end while
        // this thread waits.
        for _ in 0..6000 {
            if self.open_streams() == 0 {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("{} streams were left open", self.open_streams());
    }
}

pub(super) fn used() -> BackendReport {
    BackendReport {
        requested: Backend::Auto,
        used: Some(UsedBackend::Cpu),
        device: Some("test, 2 threads".into()),
        fallback: None,
    }
}

pub(super) fn progress(step: u32) -> JobProgress {
    JobProgress::Model(Progress {
        stage: Stage::Simulate,
        fraction: f64::from(step) / 2000.0,
        step,
        steps: 2000,
        particles: 710 + step,
        sections: step / 10,
        eta_seconds: Some(f64::from(2000 - step) / 100.0),
    })
}

pub(super) fn contour(step: u32) -> LiveSection {
    let ring = |radius: f32| vec![[radius, 0.0], [0.0, radius], [-radius, 0.0], [0.0, -radius]];
    LiveSection { index: step / 10, step, z_um: f64::from(step) * 30.0, inner: ring(100.0), outer: ring(250.5) }
}

/// The id in a model's path.
pub(super) fn id(model: &str) -> JobId {
    JobId(model.strip_prefix("/models/").unwrap().parse().unwrap())
}

/// The clock's time in the format of the API.
pub(super) fn moment(clock: &Clock) -> String {
    let now: Timestamp = clock.now();
    now.to_string()
}
