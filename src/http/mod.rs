//! The HTTP service: a router over a job store and an artifact store.
//!
//! Handlers translate between the wire and the store, nothing more: no SQL, no computing of models, no reading of
//! clocks. Every error answer is a problem (RFC 9457, [`problem`]); all routes stand on one page (`router.rs`).

mod batches;
mod conditional;
mod create;
mod docs;
mod dto;
mod envelope;
mod events;
mod extract;
mod faults;
mod feed;
mod files;
mod headers;
mod health;
mod home;
mod json;
mod metrics;
mod models;
mod openapi;
mod presets;
pub mod problem;
mod range;
mod request;
mod router;
mod sections;
mod sse;
mod workers;

pub use dto::{Batch, BatchCounts, Model, ModelEvent, ModelFile, ModelList, ModelProblem, Queue, Worker, WorkerList};
pub use envelope::REQUEST_ID;
pub use openapi::openapi_yaml;
pub use request::SEED_MAX;
pub use router::{router, watch_router};

use crate::jobs::Store;
use crate::jobs::artifacts::Artifacts;
use crate::metrics::Metrics;
use crate::status::Status;
use feed::Feed;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

/// What the service takes on, decided before any work is queued.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Longest request body, bytes.
    pub body_bytes: usize,
    /// Longest time for a request body to arrive.
    pub body_time: Duration,
    /// Most event streams open at a time.
    pub streams: usize,
    /// Most answers held at a time by `Prefer: wait`; others come at once.
    pub held: usize,
    /// Least time between two progress events, or two section events, of one model in one stream.
    pub event_interval: Duration,
    /// Time after which a stream reads its model again although no change was told.
    pub event_poll: Duration,
    /// Silence after which a stream sends a comment.
    pub event_comment: Duration,
    /// Time since its last sign of life after which a GPU worker no longer counts.
    pub gpu_memory: Duration,
    /// Most models of a batch.
    pub batch: usize,
    /// Time after its end that a model is kept, where it is not kept for good: told in the Model, carried out by the
    /// sweep.
    pub keep: Option<Duration>,
    /// Whether downloads are sent on to the file store, where it can be asked directly.
    pub redirect_downloads: bool,
    /// Whether models with backend `gpu` are queued although no GPU worker is alive, as some are started on demand.
    pub gpu_expected: bool,
    /// Greatest predicted cost of one model.
    pub cost: crate::spec::Limits,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            body_bytes: 1 << 20,
            body_time: Duration::from_secs(30),
            streams: 1024,
            held: 256,
            event_interval: Duration::from_millis(250),
            event_poll: Duration::from_secs(2),
            event_comment: Duration::from_secs(15),
            gpu_memory: Duration::from_secs(300),
            batch: 1000,
            keep: None,
            redirect_downloads: false,
            gpu_expected: false,
            cost: crate::spec::Limits::default(),
        }
    }
}

/// What handlers share. Cloning shares everything.
#[derive(Clone)]
pub struct AppState {
    pub(crate) store: Arc<dyn Store>,
    pub(crate) artifacts: Artifacts,
    pub(crate) limits: Arc<Limits>,
    pub(crate) shutdown: CancellationToken,
    pub(crate) metrics: Metrics,
    pub(crate) status: Status,
    feed: Arc<Feed>,
    streams: Arc<Semaphore>,
    held: Arc<Semaphore>,
}

impl AppState {
    /// A service over these stores. When `shutdown` is cancelled, event streams and held answers end, so that the
    /// server can drain; the other requests go on. Must be called within a Tokio runtime: it starts a task that
    /// follows the store's changes, which ends with the store or with `shutdown`.
    #[must_use]
    pub fn new(store: Arc<dyn Store>, artifacts: Artifacts, limits: Limits, shutdown: CancellationToken) -> Self {
        let feed = Feed::follow(store.changes(), shutdown.clone());
        let streams = Arc::new(Semaphore::new(limits.streams));
        let held = Arc::new(Semaphore::new(limits.held));
        let (limits, metrics, status) = (Arc::new(limits), Metrics::default(), Status::default());
        Self { store, artifacts, limits, shutdown, metrics, status, feed, streams, held }
    }

    /// The same, counting into `metrics`.
    #[must_use]
    pub fn with_metrics(self, metrics: Metrics) -> Self {
        Self { metrics, ..self }
    }

    /// The same, reporting `status` at `/healthz` and `/readyz`.
    #[must_use]
    pub fn with_status(self, status: Status) -> Self {
        Self { status, ..self }
    }

    /// Removes files that no record names any more, in the background where that takes long. Nobody can see them; what
    /// cannot be removed is swept up later.
    async fn forget(&self, keys: Vec<String>) {
        let artifacts = self.artifacts.clone();
        let removal = tokio::spawn(async move {
            if let Err(error) = artifacts.delete(&keys).await {
                tracing::warn!(%error, "files of a deleted model were left to the sweep");
            }
        });
        // Where the file store is away, a client need not wait for it.
        let _ = tokio::time::timeout(Duration::from_secs(1), removal).await;
    }

    /// Event streams that are open now.
    #[must_use]
    pub fn open_streams(&self) -> usize {
        self.limits.streams - self.streams.available_permits()
    }
}
