//! A store seen over a wire: reading may fail for a while, reads are counted, and changes may be told by the test alone.

use super::app::App;
use async_trait::async_trait;
use oviduct::clock::Clock;
use oviduct::generate::{Backend, Progress};
use oviduct::http::Limits;
use oviduct::jobs::sqlite::SqliteStore;
use oviduct::jobs::{
    Attempt, BackendReport, Batch, BatchId, Change, ClaimedJob, Counts, Directive, Finished, Job, JobId, ListFilter,
    LiveSection, NewBatch, NewJob, Page, Problem, Store, StoreError, StoreOptions, Submitted, SubmittedBatch,
    WorkerInfo,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::broadcast;

/// Hands everything on.
pub(super) struct Wire {
    store: Arc<dyn Store>,
    broken: AtomicBool,
    reads: AtomicU64,
    changes: Option<broadcast::Sender<Change>>,
}

impl Wire {
    /// A service over a wire; changes are told by `changes`, where it is there, and by nobody else.
    pub(super) async fn app(limits: Limits, changes: Option<broadcast::Sender<Change>>) -> (App, Arc<Self>) {
        let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
        let options = StoreOptions { clock: clock.clone(), max_attempts: 5, queue_limit: 1000 };
        let store = Arc::new(SqliteStore::open_in_memory(options).await.unwrap());
        let wire = Arc::new(Self { store, broken: AtomicBool::new(false), reads: AtomicU64::new(0), changes });
        (App::over(wire.clone(), clock, limits), wire)
    }

    /// From here on no model can be read, or again.
    pub(super) fn set_broken(&self, broken: bool) {
        self.broken.store(broken, Ordering::Relaxed);
    }

    /// How often a model was read.
    pub(super) fn reads(&self) -> u64 {
        self.reads.load(Ordering::Relaxed)
    }
}

#[async_trait]
impl Store for Wire {
    fn changes(&self) -> broadcast::Receiver<Change> {
        self.changes.as_ref().map_or_else(|| self.store.changes(), broadcast::Sender::subscribe)
    }

    async fn submit(&self, new: NewJob) -> Result<Submitted, StoreError> {
        self.store.submit(new).await
    }

    async fn replayed(&self, key: &str, body: &str) -> Result<Option<Job>, StoreError> {
        self.store.replayed(key, body).await
    }

    async fn replayed_batch(&self, key: &str, body: &str) -> Result<Option<Batch>, StoreError> {
        self.store.replayed_batch(key, body).await
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        self.reads.fetch_add(1, Ordering::Relaxed);
        if self.broken.load(Ordering::Relaxed) {
            return Err(StoreError::Database("connection refused".into()));
        }
        self.store.get(id).await
    }

    async fn list(&self, filter: &ListFilter) -> Result<Page, StoreError> {
        self.store.list(filter).await
    }

    async fn cancel(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        self.store.cancel(id).await
    }

    async fn delete(&self, id: JobId) -> Result<Option<Vec<String>>, StoreError> {
        self.store.delete(id).await
    }

    async fn claim(
        &self,
        worker: &str,
        backend: Backend,
        lease: Duration,
        limit: u32,
    ) -> Result<Vec<ClaimedJob>, StoreError> {
        self.store.claim(worker, backend, lease, limit).await
    }

    async fn waiting(&self, backend: Backend) -> Result<u64, StoreError> {
        self.store.waiting(backend).await
    }

    async fn heartbeat(
        &self,
        claimed: &ClaimedJob,
        lease: Duration,
        backend: &BackendReport,
        progress: Option<&Progress>,
        section: Option<&LiveSection>,
    ) -> Result<Directive, StoreError> {
        self.store.heartbeat(claimed, lease, backend, progress, section).await
    }

    async fn finish(&self, claimed: ClaimedJob, finished: Finished) -> Result<Job, StoreError> {
        self.store.finish(claimed, finished).await
    }

    async fn fail(&self, claimed: ClaimedJob, backend: BackendReport, problem: Problem) -> Result<Job, StoreError> {
        self.store.fail(claimed, backend, problem).await
    }

    async fn cancelled(&self, claimed: ClaimedJob) -> Result<Job, StoreError> {
        self.store.cancelled(claimed).await
    }

    async fn release(&self, claimed: ClaimedJob) -> Result<(), StoreError> {
        self.store.release(claimed).await
    }

    async fn retry(&self, claimed: ClaimedJob, problem: Problem) -> Result<Job, StoreError> {
        self.store.retry(claimed, problem).await
    }

    async fn attempts(&self, id: JobId) -> Result<Vec<Attempt>, StoreError> {
        self.store.attempts(id).await
    }

    async fn worker_seen(&self, worker: &WorkerInfo) -> Result<(), StoreError> {
        self.store.worker_seen(worker).await
    }

    async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError> {
        self.store.workers().await
    }

    async fn alive(&self, backend: Backend, within: Duration) -> Result<u64, StoreError> {
        self.store.alive(backend, within).await
    }

    async fn names_key(&self, key: &str) -> Result<bool, StoreError> {
        self.store.names_key(key).await
    }

    async fn ready(&self) -> Result<(), StoreError> {
        self.store.ready().await
    }

    async fn submit_batch(&self, new: NewBatch) -> Result<SubmittedBatch, StoreError> {
        self.store.submit_batch(new).await
    }

    async fn batch(&self, id: BatchId) -> Result<Option<Batch>, StoreError> {
        self.store.batch(id).await
    }

    async fn delete_batch(&self, id: BatchId) -> Result<Option<Vec<String>>, StoreError> {
        self.store.delete_batch(id).await
    }

    async fn set_checkpoint(&self, claimed: &ClaimedJob, key: &str) -> Result<Option<String>, StoreError> {
        self.store.set_checkpoint(claimed, key).await
    }

    async fn ended_before(&self, age: Duration, limit: u32) -> Result<Vec<JobId>, StoreError> {
        self.store.ended_before(age, limit).await
    }

    async fn stored_bytes(&self) -> Result<u64, StoreError> {
        self.store.stored_bytes().await
    }

    async fn counts(&self) -> Result<Counts, StoreError> {
        self.store.counts().await
    }
}
