//! The HTTP service: a router over a job store and an artifact store.
//!
//! Handlers only translate between HTTP and the stores: they contain no SQL, grow no models and
//! read no clocks. Every error response is a problem (RFC 9457, `wire/problem.rs`). `router.rs`
//! lists all routes.

mod access;
mod batches;
mod console;
mod events;
mod fits;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod health;
mod metrics;
mod models;
mod openapi;
mod operations;
mod pictures;
mod presets;
mod router;
mod wire;
mod workers;
mod workforce;

pub use access::{AccessOptions, WithoutKeys};
pub use batches::batch::{Batch, BatchCounts, BatchList};
pub use batches::study::{BatchStudy, StudyModel};
pub use models::model::{Model, ModelEvent, ModelFile, ModelList, ModelProblem, ModelWarning, Queue};
pub use operations::execute_operations;
pub use router::{openapi_yaml, router, watch_router};
pub use wire::cors::{NoOrigin, Origin};
pub use wire::headers::REQUEST_ID;
pub use workers::{Pause, Worker, WorkerList};

use crate::availability::Availability;
use crate::jobs::artifacts::Artifacts;
use crate::jobs::{Job, Status as JobStatus, Store};
use crate::metrics::Metrics;
use crate::status::Status;
use access::Access;
use events::{Feed, FeedTiming};
use models::specs::Specs;
use pictures::queue::Pictures;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use wire::shares::{Shares, Turns};
use workforce::{JobContext, WorkforceCache};

/// Maximum number of large bodies that are parsed at a time. More threads would also leave more
/// memory to the allocator, which keeps what each of them has freed for a while.
const MAX_PARSED_BODIES: usize = 2;

/// Limits of the service.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Maximum size of a request body, bytes.
    pub body_bytes: usize,
    /// Maximum size of a request body with images, bytes.
    pub large_body_bytes: usize,
    /// Maximum time until a request body has arrived.
    pub body_time: Duration,
    /// Maximum memory of all request bodies together: the text that has arrived, and parsed values.
    pub body_memory: usize,
    /// Maximum number of open event streams.
    pub streams: usize,
    /// Maximum number of responses that `Prefer: wait` delays at a time. Others are sent
    /// immediately.
    pub held: usize,
    /// Maximum number of concurrent downloads. Each uses a descriptor: of a file, or of a
    /// connection to an object store.
    pub downloads: usize,
    /// Maximum number of concurrently drawn pictures. Each uses all cores.
    pub pictures: usize,
    /// Maximum number of batches that are checked and queued at the same time. A batch takes up to
    /// 100 MB.
    pub batches: usize,
    /// Maximum time for which a request waits until its picture can be drawn or its batch checked.
    pub picture_wait: Duration,
    /// Minimum time between two progress events, or two section events, of one model.
    pub event_interval: Duration,
    /// Interval at which watched models are read even if the store reports no change.
    pub event_poll: Duration,
    /// Time without events after which a stream sends a comment.
    pub event_comment: Duration,
    /// Time since the last heartbeat after which a GPU worker no longer counts as available.
    pub gpu_memory: Duration,
    /// Time since the last heartbeat after which the metrics no longer count a worker.
    pub worker_memory: Duration,
    /// True if models for `gpu` are queued even without a live GPU worker, because one will be
    /// started for them.
    pub gpu_expected: bool,
    /// Maximum time for which a request for `gpu` waits while workers of this process open their
    /// devices.
    pub gpu_wait: Duration,
    /// Maximum number of models of a batch.
    pub batch: usize,
    /// Time after which an ended model is removed; `None` keeps it forever. Responses report this
    /// time; the retention sweep removes the models.
    pub keep: Option<Duration>,
    /// True if downloads are redirected to the artifact store. This requires a store that signs
    /// URLs.
    pub redirect_downloads: bool,
    /// Other origins whose pages may call the service.
    pub cors_origins: Vec<Origin>,
    /// Maximum predicted cost of one model.
    pub cost: crate::generate::CostLimits,
    /// Maximum predicted time of a fit on one core.
    pub fit_time: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            body_bytes: 1 << 20,
            large_body_bytes: 8 << 20,
            body_time: Duration::from_secs(30),
            body_memory: 64 << 20,
            streams: 4096,
            held: 256,
            downloads: 256,
            pictures: 2,
            batches: 1,
            picture_wait: Duration::from_secs(10),
            event_interval: Duration::from_millis(250),
            event_poll: Duration::from_secs(2),
            event_comment: Duration::from_secs(15),
            gpu_memory: Duration::from_secs(300),
            worker_memory: Duration::from_secs(20),
            gpu_wait: Duration::from_secs(20),
            batch: crate::spec::study::DEFAULT_MAX_POINTS,
            keep: None,
            redirect_downloads: false,
            gpu_expected: false,
            cors_origins: Vec::new(),
            cost: crate::generate::CostLimits::default(),
            fit_time: Duration::from_secs(24 * 3600),
        }
    }
}

impl Limits {
    /// Maximum number of values in the JSON of a request body: 50 per model of the largest batch,
    /// which is many times what a study needs, and at least 50,000.
    fn body_values(&self) -> usize {
        50 * self.batch.max(1000)
    }
}

/// State that handlers share. Clones share it, too.
#[derive(Clone)]
pub struct AppState {
    pub(crate) store: Store,
    pub(crate) artifacts: Artifacts,
    pub(crate) limits: Arc<Limits>,
    pub(crate) shutdown: CancellationToken,
    pub(crate) metrics: Metrics,
    access: Arc<Access>,
    status: Status,
    /// Availability of `store`, from its checks.
    store_availability: Arc<Availability>,
    workforce: Arc<WorkforceCache>,
    feed: Arc<Feed>,
    bodies: Arc<Shares>,
    parsing: Arc<Turns>,
    streams: Arc<Shares>,
    held: Arc<Shares>,
    downloads: Arc<Shares>,
    pictures: Arc<Pictures>,
    specs: Arc<Specs>,
    batches: Arc<Turns>,
    /// Wakes [`execute_operations`].
    operations: Arc<Notify>,
}

impl AppState {
    /// A service over these stores.
    ///
    /// When `shutdown` is cancelled, event streams end and delayed responses are sent, so that the
    /// server can drain. Other requests continue. Must be called within a Tokio runtime, because it
    /// starts a task that follows the changes of the store until `shutdown`.
    #[must_use]
    pub fn new(store: Store, artifacts: Artifacts, limits: Limits, shutdown: CancellationToken) -> Self {
        let timing = FeedTiming { interval: limits.event_interval, poll: limits.event_poll, keep: limits.keep };
        let workforce = Arc::new(WorkforceCache::new(store.clone(), limits.worker_memory));
        let feed = Feed::start(store.clone(), Arc::clone(&workforce), timing, shutdown.clone());
        let [bodies, streams, held, downloads] =
            [limits.body_memory, limits.streams, limits.held, limits.downloads].map(Shares::halves);
        let access = Arc::new(Access::new(store.clone(), AccessOptions::default(), limits.cors_origins.clone()));
        let pictures = Arc::new(Pictures::new(limits.pictures));
        let store_availability = Arc::new(Availability::new(store.ready_within()));
        let [parsing, batches] = [MAX_PARSED_BODIES, limits.batches].map(|max_turns| Arc::new(Turns::new(max_turns)));
        Self {
            store,
            artifacts,
            limits: Arc::new(limits),
            shutdown,
            metrics: Metrics::default(),
            access,
            status: Status::default(),
            store_availability,
            workforce,
            feed,
            bodies,
            parsing,
            streams,
            held,
            downloads,
            pictures,
            specs: Arc::default(),
            batches,
            operations: Arc::default(),
        }
    }

    /// Replaces the options of access control.
    #[must_use]
    pub fn with_access(self, options: AccessOptions) -> Self {
        let access = Access::new(self.store.clone(), options, self.limits.cors_origins.clone());
        Self { access: Arc::new(access), ..self }
    }

    /// Records metrics in `metrics`.
    #[must_use]
    pub fn with_metrics(self, metrics: Metrics) -> Self {
        Self { metrics, ..self }
    }

    /// Reports `status` at `/healthz` and `/readyz`.
    #[must_use]
    pub fn with_status(self, status: Status) -> Self {
        Self { status, ..self }
    }

    /// The context of responses about these jobs. Counts the workers only if one of the jobs is
    /// queued.
    async fn job_context<'a>(&self, jobs: impl IntoIterator<Item = &'a Job>) -> JobContext {
        let is_queued = jobs.into_iter().any(|job| job.status == JobStatus::Queued);
        let workforce = if is_queued { self.workforce.current().await } else { None };
        JobContext { keep: self.limits.keep, workforce }
    }

    /// Deletes artifacts that no record names. Waits at most one second; clients cannot reach the
    /// files, and the orphan sweep deletes the rest.
    async fn forget(&self, keys: Vec<String>) {
        if !keys.is_empty() {
            let state = self.clone();
            let removal = tokio::spawn(async move { state.remove_files(&keys).await });
            let _ = tokio::time::timeout(Duration::from_secs(1), removal).await;
        }
    }

    /// Deletes artifacts that no record names.
    async fn remove_files(&self, keys: &[String]) {
        if let Err(error) = self.artifacts.delete(keys).await {
            tracing::warn!(%error, "could not delete the files of a deleted model; the orphan sweep will delete them");
        }
    }

    /// Number of open event streams.
    #[must_use]
    pub fn open_streams(&self) -> usize {
        self.streams.used()
    }
}
