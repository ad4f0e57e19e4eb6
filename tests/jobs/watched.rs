//! A store that never tells of changes, as a worker on another machine sees one whose notifications are lost.

use async_trait::async_trait;
use jiff::Timestamp;
use oviduct::generate::{Backend, Progress};
use oviduct::jobs::{
    Attempt, BackendReport, Batch, BatchId, Change, ClaimedJob, Counts, Directive, Finished, Job, JobId, ListFilter,
    LiveSection, NewBatch, NewJob, Page, Problem, Store, StoreError, Submitted, SubmittedBatch, WorkerInfo,
};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;

/// Hands everything on but changes.
pub struct Deaf(pub Arc<dyn Store>);

#[async_trait]
impl Store for Deaf {
    fn changes(&self) -> broadcast::Receiver<Change> {
        broadcast::channel(1).1
    }

    async fn submit(&self, new: NewJob) -> Result<Submitted, StoreError> {
        self.0.submit(new).await
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
        self.0.heartbeat(claimed, lease, backend, progress, section).await
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

    async fn ended_before(&self, before: Timestamp, limit: u32) -> Result<Vec<JobId>, StoreError> {
        self.0.ended_before(before, limit).await
    }

    async fn stored_bytes(&self) -> Result<u64, StoreError> {
        self.0.stored_bytes().await
    }

    async fn counts(&self) -> Result<Counts, StoreError> {
        self.0.counts().await
    }
}
