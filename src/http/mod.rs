//! The HTTP service: a router over a job store and an artifact store.
//!
//! Handlers translate between the wire and the stores, nothing more: no SQL, no computing of models, no reading of
//! clocks. Every error response is a problem (RFC 9457, [`problem`]). All routes are in `router.rs`.

mod access;
mod batches;
mod console;
mod dto;
mod events;
mod fits;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod health;
mod metrics;
mod models;
mod openapi;
mod pictures;
mod presets;
mod router;
mod wire;
mod workers;

pub use access::{AccessOptions, WithoutKeys};
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub use batches::fuzzing as batch_fuzzing;
pub use batches::study::{BatchStudy, StudyModel};
pub use dto::{
    Batch, BatchCounts, BatchList, Model, ModelEvent, ModelFile, ModelList, ModelProblem, ModelWarning, Pause, Queue,
    Worker, WorkerList,
};
pub use models::request::SEED_MAX;
pub use router::{openapi_yaml, router, watch_router};
pub use wire::cors::{NoOrigin, Origin};
pub use wire::headers::REQUEST_ID;

use crate::availability::Availability;
use crate::jobs::Store;
use crate::jobs::artifacts::Artifacts;
use crate::metrics::Metrics;
use crate::status::Status;
use access::Access;
use events::{Feed, FeedTiming};
use pictures::bodies::Bodies;
use pictures::queue::Pictures;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

/// Limits of the service.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Longest request body, bytes.
    pub body_bytes: usize,
    /// Longest request body with images, bytes.
    pub large_body_bytes: usize,
    /// Time within which a request body must arrive.
    pub body_time: Duration,
    /// Most open event streams.
    pub streams: usize,
    /// Most responses held at a time by `Prefer: wait`; further ones are sent at once.
    pub held: usize,
    /// Most downloads at a time. Each holds a descriptor: an open file, or a connection to an object store.
    pub downloads: usize,
    /// Most pictures that are drawn at a time; each uses all cores.
    pub pictures: usize,
    /// Longest time that a request for a picture waits until it can be drawn.
    pub picture_wait: Duration,
    /// Least time between two progress events, or two section events, of one model.
    pub event_interval: Duration,
    /// Time after which a watched model is read again although the store reported no change.
    pub event_poll: Duration,
    /// Silence after which a stream sends a comment.
    pub event_comment: Duration,
    /// Time since its last heartbeat after which a GPU worker no longer counts.
    pub gpu_memory: Duration,
    /// Time since its last heartbeat after which a worker is not counted in the metrics.
    pub worker_memory: Duration,
    /// Whether models for `gpu` are queued although no GPU worker is alive, because one will be started for them.
    pub gpu_expected: bool,
    /// Longest time that a request for `gpu` waits while workers of this process open their devices.
    pub gpu_wait: Duration,
    /// Most models of a batch.
    pub batch: usize,
    /// Time after its end at which a model is removed; `None` to keep it forever. The Model shows it, retention does it.
    pub keep: Option<Duration>,
    /// Whether downloads are redirected to the artifact store, if it can sign addresses.
    pub redirect_downloads: bool,
    /// Other origins whose pages may call the service.
    pub cors_origins: Vec<Origin>,
    /// Greatest predicted cost of one model.
    pub cost: crate::generate::CostLimits,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            body_bytes: 1 << 20,
            large_body_bytes: 8 << 20,
            body_time: Duration::from_secs(30),
            streams: 4096,
            held: 256,
            downloads: 256,
            pictures: 2,
            picture_wait: Duration::from_secs(10),
            event_interval: Duration::from_millis(250),
            event_poll: Duration::from_secs(2),
            event_comment: Duration::from_secs(15),
            gpu_memory: Duration::from_secs(300),
            worker_memory: Duration::from_secs(20),
            gpu_wait: Duration::from_secs(20),
            batch: 1000,
            keep: None,
            redirect_downloads: false,
            gpu_expected: false,
            cors_origins: Vec::new(),
            cost: crate::generate::CostLimits::default(),
        }
    }
}

/// What handlers share. Cloning shares everything.
#[derive(Clone)]
pub struct AppState {
    pub(crate) store: Store,
    pub(crate) artifacts: Artifacts,
    pub(crate) limits: Arc<Limits>,
    pub(crate) shutdown: CancellationToken,
    pub(crate) metrics: Metrics,
    access: Arc<Access>,
    status: Status,
    /// What the checks of `store` found.
    store_availability: Arc<Availability>,
    feed: Arc<Feed>,
    streams: Arc<Semaphore>,
    held: Arc<Semaphore>,
    downloads: Arc<Semaphore>,
    pictures: Arc<Pictures>,
    bodies: Arc<Bodies>,
}

impl AppState {
    /// A service over these stores. When `shutdown` is cancelled, event streams end and held responses are sent, so that the
    /// server can drain; other requests go on. Must be called within a Tokio runtime: it starts a task that
    /// follows the store's changes until `shutdown`.
    #[must_use]
    pub fn new(store: Store, artifacts: Artifacts, limits: Limits, shutdown: CancellationToken) -> Self {
        let timing = FeedTiming { interval: limits.event_interval, poll: limits.event_poll, keep: limits.keep };
        let feed = Feed::start(store.clone(), timing, shutdown.clone());
        let [streams, held, downloads] =
            [limits.streams, limits.held, limits.downloads].map(|most| Arc::new(Semaphore::new(most)));
        let access = Arc::new(Access::new(store.clone(), AccessOptions::default(), limits.cors_origins.clone()));
        let pictures = Arc::new(Pictures::new(limits.pictures));
        Self {
            store,
            artifacts,
            limits: Arc::new(limits),
            shutdown,
            metrics: Metrics::default(),
            access,
            status: Status::default(),
            store_availability: Arc::default(),
            feed,
            streams,
            held,
            downloads,
            pictures,
            bodies: Arc::default(),
        }
    }

    /// Admits requests by these options.
    #[must_use]
    pub fn with_access(self, options: AccessOptions) -> Self {
        let access = Access::new(self.store.clone(), options, self.limits.cors_origins.clone());
        Self { access: Arc::new(access), ..self }
    }

    /// Counts into `metrics`.
    #[must_use]
    pub fn with_metrics(self, metrics: Metrics) -> Self {
        Self { metrics, ..self }
    }

    /// Reports `status` at `/healthz` and `/readyz`.
    #[must_use]
    pub fn with_status(self, status: Status) -> Self {
        Self { status, ..self }
    }

    /// Removes files that no record names any more; waits at most a second for it. No client can reach them, and a later
    /// sweep removes what is left.
    async fn forget(&self, keys: Vec<String>) {
        let artifacts = self.artifacts.clone();
        let removal = tokio::spawn(async move {
            if let Err(error) = artifacts.delete(&keys).await {
                tracing::warn!(%error, "files of a deleted model could not be removed; a sweep will remove them");
            }
        });
        let _ = tokio::time::timeout(Duration::from_secs(1), removal).await;
    }

    /// Number of open event streams.
    #[must_use]
    pub fn open_streams(&self) -> usize {
        self.limits.streams - self.streams.available_permits()
    }
}
