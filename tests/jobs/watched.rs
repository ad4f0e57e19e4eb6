//! A store as its workers see it, under a test's eye: it counts their heartbeats. It can be one that never tells of
//! changes, as a worker on another machine sees one whose notifications are lost, or one that is slow.

use async_trait::async_trait;
use oviduct::clock::Stopwatch;
use oviduct::generate::{Backend, Progress};
use oviduct::jobs::{
    Attempt, BackendReport, Batch, BatchId, Change, ClaimedJob, Counts, Directive, Finished, Job, JobId, ListFilter,
    LiveSection, NewBatch, NewJob, Page, Problem, Store, StoreError, Submitted, SubmittedBatch, WorkerInfo,
};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::{broadcast, watch};

/// Longest wait for heartbeats that shall come.
const DEADLINE: Duration = Duration::from_secs(600);

/// Hands everything on, but changes where it is deaf.
pub struct Watched(Arc<dyn Store>, Eye);

struct Eye {
    deaf: bool,
    /// What each heartbeat takes at least.
    call: Duration,
    /// Heartbeats that have arrived.
    beats: watch::Sender<u32>,
    /// Since the last heartbeat was begun, and the least time between two.
    pace: Mutex<(Option<Stopwatch>, Duration)>,
}

impl Watched {
    pub fn new(store: &Arc<dyn Store>) -> Arc<Self> {
        Self::with(store, false, Duration::ZERO)
    }

    /// Never tells of changes.
    pub fn deaf(store: &Arc<dyn Store>) -> Arc<Self> {
        Self::with(store, true, Duration::ZERO)
    }

    /// Whose heartbeats take their time.
    pub fn slow(store: &Arc<dyn Store>, call: Duration) -> Arc<Self> {
        Self::with(store, false, call)
    }

    fn with(store: &Arc<dyn Store>, deaf: bool, call: Duration) -> Arc<Self> {
        let pace = Mutex::new((None, Duration::MAX));
        Arc::new(Self(Arc::clone(store), Eye { deaf, call, beats: watch::Sender::new(0), pace }))
    }

    /// Waits for so many more heartbeats to arrive. Of two of one job the later was begun after this was called.
    pub async fn beats(&self, more: u32) {
        let mut beats = self.1.beats.subscribe();
        let enough = *beats.borrow() + more;
        let waited = tokio::time::timeout(DEADLINE, beats.wait_for(|beats| *beats >= enough)).await;
        waited.expect("no heartbeat came").unwrap();
    }

    /// Forgets the pace of heartbeats so far.
    pub fn forget_pace(&self) {
        *self.1.pace.lock().unwrap() = (None, Duration::MAX);
    }

    /// The least time between the begins of two heartbeats.
    pub fn pace(&self) -> Duration {
        self.1.pace.lock().unwrap().1
    }
}

#[async_trait]
impl Store for Watched {
    fn changes(&self) -> broadcast::Receiver<Change> {
        if self.1.deaf { broadcast::channel(1).1 } else { self.0.changes() }
    }

    async fn submit(&self, new: NewJob) -> Result<Submitted, StoreError> {
        self.0.submit(new).await
    }

    async fn replayed(&self, key: &str, body: &str) -> Result<Option<Job>, StoreError> {
        self.0.replayed(key, body).await
    }

    async fn replayed_batch(&self, key: &str, body: &str) -> Result<Option<Batch>, StoreError> {
        self.0.replayed_batch(key, body).await
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        self.0.get(id).await
    }

    async fn list(&self, filter: &ListFilter) -> Result<Page, StoreError> {
        self.0.list(filter).await
    }

    async fn cancel(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        self.0.cancel(id).await
    }

    async fn delete(&self, id: JobId) -> Result<Option<Vec<String>>, StoreError> {
        self.0.delete(id).await
    }

    async fn claim(
        &self,
        worker: &str,
        backend: Backend,
        lease: Duration,
        limit: u32,
    ) -> Result<Vec<ClaimedJob>, StoreError> {
        self.0.claim(worker, backend, lease, limit).await
    }

    async fn waiting(&self, backend: Backend) -> Result<u64, StoreError> {
        self.0.waiting(backend).await
    }

    async fn heartbeat(
        &self,
        claimed: &ClaimedJob,
        lease: Duration,
        backend: &BackendReport,
        progress: Option<&Progress>,
        section: Option<&LiveSection>,
    ) -> Result<Directive, StoreError> {
        {
            let mut pace = self.1.pace.lock().unwrap();
            let before = pace.0.replace(Stopwatch::start());
            pace.1 = before.map_or(pace.1, |before| pace.1.min(before.elapsed()));
        }
        tokio::time::sleep(self.1.call).await;
        let told = self.0.heartbeat(claimed, lease, backend, progress, section).await;
        self.1.beats.send_modify(|beats| *beats += 1);
        told
    }

    async fn finish(&self, claimed: ClaimedJob, finished: Finished) -> Result<Job, StoreError> {
        self.0.finish(claimed, finished).await
    }

    async fn fail(&self, claimed: ClaimedJob, backend: BackendReport, problem: Problem) -> Result<Job, StoreError> {
        self.0.fail(claimed, backend, problem).await
    }

    async fn cancelled(&self, claimed: ClaimedJob) -> Result<Job, StoreError> {
        self.0.cancelled(claimed).await
    }

    async fn release(&self, claimed: ClaimedJob) -> Result<(), StoreError> {
        self.0.release(claimed).await
    }

    async fn retry(&self, claimed: ClaimedJob, problem: Problem) -> Result<Job, StoreError> {
        self.0.retry(claimed, problem).await
    }

    async fn attempts(&self, id: JobId) -> Result<Vec<Attempt>, StoreError> {
        self.0.attempts(id).await
    }

    async fn worker_seen(&self, worker: &WorkerInfo) -> Result<(), StoreError> {
        self.0.worker_seen(worker).await
    }

    async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError> {
        self.0.workers().await
    }

    async fn names_key(&self, key: &str) -> Result<bool, StoreError> {
        self.0.names_key(key).await
    }

    async fn ready(&self) -> Result<(), StoreError> {
        self.0.ready().await
    }

    async fn submit_batch(&self, new: NewBatch) -> Result<SubmittedBatch, StoreError> {
        self.0.submit_batch(new).await
    }

    async fn batch(&self, id: BatchId) -> Result<Option<Batch>, StoreError> {
        self.0.batch(id).await
    }

    async fn delete_batch(&self, id: BatchId) -> Result<Option<Vec<String>>, StoreError> {
        self.0.delete_batch(id).await
    }

    async fn set_checkpoint(&self, claimed: &ClaimedJob, key: &str) -> Result<Option<String>, StoreError> {
        self.0.set_checkpoint(claimed, key).await
    }

    async fn ended_before(&self, age: Duration, limit: u32) -> Result<Vec<JobId>, StoreError> {
        self.0.ended_before(age, limit).await
    }

    async fn alive(&self, backend: Backend, within: Duration) -> Result<u64, StoreError> {
        self.0.alive(backend, within).await
    }

    async fn stored_bytes(&self) -> Result<u64, StoreError> {
        self.0.stored_bytes().await
    }

    async fn counts(&self) -> Result<Counts, StoreError> {
        self.0.counts().await
    }
}
