//! A store that forwards every call to another one; an [`Eye`] observes the calls that matter to a test, or interferes.

use async_trait::async_trait;
use jiff::Timestamp;
use oviduct::generate::Backend;
use oviduct::jobs::keys::{Key, KeyStore, NewKey, NewTicket};
use oviduct::jobs::{
    Applied, Attempt, BackendReport, Batch, BatchFilter, BatchId, BatchPage, Change, ClaimedJob, Counts, Directive,
    Finished, Instruction, Job, JobId, JobProgress, ListFilter, LiveSection, NewBatch, NewJob, Page, Pause, PoolUse,
    Problem, Status, Store, StoreError, Submitted, SubmittedBatch, UpkeepTask, WorkerInfo,
};
use std::collections::BTreeSet;
use std::ops::Deref;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;

/// What a test observes of a store, and where it interferes.
#[async_trait]
pub(crate) trait Eye: Send + Sync + 'static {
    /// The changes that subscribers get.
    fn changes(&self, store: &dyn Store) -> broadcast::Receiver<Change> {
        store.changes()
    }

    /// A job is about to be read; on an error the reader gets that instead.
    fn before_get(&self) -> Result<(), StoreError> {
        Ok(())
    }

    /// The keys are about to be read.
    async fn before_keys(&self) {}

    /// Many jobs are about to be removed.
    async fn before_delete_many(&self) {}

    /// A heartbeat begins.
    async fn before_heartbeat(&self) {}

    /// A heartbeat has been answered.
    fn after_heartbeat(&self) {}
}

/// A store observed by an [`Eye`], to which it dereferences.
pub(crate) struct Between<E> {
    store: Arc<dyn Store>,
    eye: E,
}

impl<E: Eye> Between<E> {
    pub(crate) fn new(store: Arc<dyn Store>, eye: E) -> Arc<Self> {
        Arc::new(Self { store, eye })
    }
}

impl<E> Deref for Between<E> {
    type Target = E;

    fn deref(&self) -> &E {
        &self.eye
    }
}

#[async_trait]
impl<E: Eye> KeyStore for Between<E> {
    async fn add_key(&self, new: NewKey) -> Result<Key, StoreError> {
        self.store.add_key(new).await
    }

    async fn add_first_key(&self, new: NewKey) -> Result<Option<Key>, StoreError> {
        self.store.add_first_key(new).await
    }

    async fn keys(&self) -> Result<(Timestamp, Vec<Key>), StoreError> {
        self.eye.before_keys().await;
        self.store.keys().await
    }

    async fn revoke_key(&self, prefix: &str, after: Duration) -> Result<Option<Key>, StoreError> {
        self.store.revoke_key(prefix, after).await
    }

    async fn add_ticket(&self, new: NewTicket) -> Result<Timestamp, StoreError> {
        self.store.add_ticket(new).await
    }

    async fn ticket(&self, hash: &str, path: &str) -> Result<Option<String>, StoreError> {
        self.store.ticket(hash, path).await
    }

    async fn use_ticket(&self, hash: &str, path: &str) -> Result<Option<String>, StoreError> {
        self.store.use_ticket(hash, path).await
    }
}

#[async_trait]
impl<E: Eye> Store for Between<E> {
    fn changes(&self) -> broadcast::Receiver<Change> {
        self.eye.changes(&*self.store)
    }

    async fn submit(&self, new: NewJob) -> Result<Submitted, StoreError> {
        self.store.submit(new).await
    }

    async fn replayed(&self, owner: Option<&str>, key: &str, body: &str) -> Result<Option<Job>, StoreError> {
        self.store.replayed(owner, key, body).await
    }

    async fn replayed_batch(&self, owner: Option<&str>, key: &str, body: &str) -> Result<Option<Batch>, StoreError> {
        self.store.replayed_batch(owner, key, body).await
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        self.eye.before_get()?;
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

    async fn ids(&self, filter: &ListFilter) -> Result<Vec<JobId>, StoreError> {
        self.store.ids(filter).await
    }

    async fn cancel_many(&self, ids: Vec<JobId>, status: Option<Status>) -> Result<Applied, StoreError> {
        self.store.cancel_many(ids, status).await
    }

    async fn delete_many(&self, ids: Vec<JobId>, status: Option<Status>) -> Result<Applied, StoreError> {
        self.eye.before_delete_many().await;
        self.store.delete_many(ids, status).await
    }

    async fn queue_stranded(&self) -> Result<Vec<JobId>, StoreError> {
        self.store.queue_stranded().await
    }

    async fn batches(&self, filter: &BatchFilter) -> Result<BatchPage, StoreError> {
        self.store.batches(filter).await
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
        progress: Option<&JobProgress>,
        section: Option<&LiveSection>,
    ) -> Result<Directive, StoreError> {
        self.eye.before_heartbeat().await;
        let answer = self.store.heartbeat(claimed, lease, backend, progress, section).await;
        self.eye.after_heartbeat();
        answer
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

    async fn release(&self, claimed: ClaimedJob, problem: Option<Problem>) -> Result<(), StoreError> {
        self.store.release(claimed, problem).await
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

    async fn workers_within(&self, within: Duration) -> Result<Vec<WorkerInfo>, StoreError> {
        self.store.workers_within(within).await
    }

    async fn claimers(&self, backend: Backend, within: Duration) -> Result<u64, StoreError> {
        self.store.claimers(backend, within).await
    }

    async fn set_paused(&self, paused: bool, by: Option<&str>) -> Result<(), StoreError> {
        self.store.set_paused(paused, by).await
    }

    async fn paused(&self) -> Result<Option<Pause>, StoreError> {
        self.store.paused().await
    }

    async fn instruct(&self, worker: &str, instruction: Instruction, by: Option<&str>) -> Result<bool, StoreError> {
        self.store.instruct(worker, instruction, by).await
    }

    async fn queue_ages(&self) -> Result<[(Backend, Duration); 4], StoreError> {
        self.store.queue_ages().await
    }

    fn pools(&self) -> Vec<PoolUse> {
        self.store.pools()
    }

    async fn reusable(&self, new: &NewJob) -> Result<Option<Job>, StoreError> {
        self.store.reusable(new).await
    }

    async fn acquire_upkeep(&self, task: UpkeepTask, owner: &str, lease: Duration) -> Result<bool, StoreError> {
        self.store.acquire_upkeep(task, owner, lease).await
    }

    async fn queued_by_backend(&self) -> Result<[(Backend, u64); 4], StoreError> {
        self.store.queued_by_backend().await
    }

    async fn keys_in_use(&self, keys: &[String]) -> Result<BTreeSet<String>, StoreError> {
        self.store.keys_in_use(keys).await
    }

    async fn ready(&self) -> Result<(), StoreError> {
        self.store.ready().await
    }

    async fn submit_batch(&self, new: NewBatch) -> Result<SubmittedBatch, StoreError> {
        self.store.submit_batch(new).await
    }

    async fn batch_jobs(&self, id: BatchId, after: Option<JobId>, limit: u32) -> Result<Vec<Job>, StoreError> {
        self.store.batch_jobs(id, after, limit).await
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

    async fn ended(&self, age: Option<Duration>, limit: u32) -> Result<Vec<JobId>, StoreError> {
        self.store.ended(age, limit).await
    }

    async fn alive(&self, backend: Backend, within: Duration) -> Result<u64, StoreError> {
        self.store.alive(backend, within).await
    }

    async fn stored_bytes(&self) -> Result<u64, StoreError> {
        self.store.stored_bytes().await
    }

    async fn counts(&self) -> Result<Counts, StoreError> {
        self.store.counts().await
    }
}
