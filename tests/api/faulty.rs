//! A job store that is unavailable, or hangs when it is checked, and panics in one method.

use async_trait::async_trait;
use oviduct::generate::{Backend, Progress};
use oviduct::jobs::{
    Attempt, BackendReport, Batch, BatchId, Change, ClaimedJob, Counts, Directive, Finished, Job, JobId, ListFilter,
    LiveSection, NewBatch, NewJob, Page, Problem, Store, StoreError, Submitted, SubmittedBatch, UpkeepTask, WorkerInfo,
};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::sync::broadcast;

/// Fails each call; panics in `list`.
pub(super) struct Faulty {
    changes: broadcast::Sender<Change>,
    hangs: bool,
}

impl Faulty {
    pub(super) fn new() -> Self {
        Self { changes: broadcast::Sender::new(1), hangs: false }
    }

    /// A store whose check never ends.
    pub(super) fn hanging() -> Self {
        Self { hangs: true, ..Self::new() }
    }
}

fn away<T>() -> Result<T, StoreError> {
    Err(StoreError::Database("connection refused: secret-host:5432".into()))
}

#[async_trait]
impl Store for Faulty {
    async fn submit(&self, _: NewJob) -> Result<Submitted, StoreError> {
        away()
    }
    async fn replayed(&self, _: &str, _: &str) -> Result<Option<Job>, StoreError> {
        away()
    }
    async fn replayed_batch(&self, _: &str, _: &str) -> Result<Option<Batch>, StoreError> {
        away()
    }
    async fn get(&self, _: JobId) -> Result<Option<Job>, StoreError> {
        away()
    }
    async fn list(&self, _: &ListFilter) -> Result<Page, StoreError> {
        panic!("a fault, on purpose, with a secret")
    }
    async fn cancel(&self, _: JobId) -> Result<Option<Job>, StoreError> {
        away()
    }
    async fn delete(&self, _: JobId) -> Result<Option<Vec<String>>, StoreError> {
        away()
    }
    async fn claim(&self, _: &str, _: Backend, _: Duration, _: u32) -> Result<Vec<ClaimedJob>, StoreError> {
        away()
    }
    async fn waiting(&self, _: Backend) -> Result<u64, StoreError> {
        away()
    }
    async fn heartbeat(
        &self,
        _: &ClaimedJob,
        _: Duration,
        _: &BackendReport,
        _: Option<&Progress>,
        _: Option<&LiveSection>,
    ) -> Result<Directive, StoreError> {
        away()
    }
    async fn finish(&self, _: ClaimedJob, _: Finished) -> Result<Job, StoreError> {
        away()
    }
    async fn fail(&self, _: ClaimedJob, _: BackendReport, _: Problem) -> Result<Job, StoreError> {
        away()
    }
    async fn cancelled(&self, _: ClaimedJob) -> Result<Job, StoreError> {
        away()
    }
    async fn release(&self, _: ClaimedJob, _: Option<Problem>) -> Result<(), StoreError> {
        away()
    }
    async fn retry(&self, _: ClaimedJob, _: Problem) -> Result<Job, StoreError> {
        away()
    }
    async fn attempts(&self, _: JobId) -> Result<Vec<Attempt>, StoreError> {
        away()
    }
    async fn worker_seen(&self, _: &WorkerInfo) -> Result<(), StoreError> {
        away()
    }
    async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError> {
        away()
    }
    async fn reusable(&self, _: &NewJob) -> Result<Option<Job>, StoreError> {
        away()
    }
    async fn acquire_upkeep(&self, _: UpkeepTask, _: &str, _: Duration) -> Result<bool, StoreError> {
        away()
    }
    async fn queued_by_backend(&self) -> Result<[(Backend, u64); 4], StoreError> {
        away()
    }
    async fn keys_in_use(&self, _: &[String]) -> Result<BTreeSet<String>, StoreError> {
        away()
    }
    fn changes(&self) -> broadcast::Receiver<Change> {
        self.changes.subscribe()
    }
    async fn ready(&self) -> Result<(), StoreError> {
        if self.hangs {
            std::future::pending::<()>().await;
        }
        away()
    }
    async fn submit_batch(&self, _: NewBatch) -> Result<SubmittedBatch, StoreError> {
        away()
    }
    async fn batch(&self, _: BatchId) -> Result<Option<Batch>, StoreError> {
        away()
    }
    async fn delete_batch(&self, _: BatchId) -> Result<Option<Vec<String>>, StoreError> {
        away()
    }
    async fn set_checkpoint(&self, _: &ClaimedJob, _: &str) -> Result<Option<String>, StoreError> {
        away()
    }
    async fn ended(&self, _: Option<Duration>, _: u32) -> Result<Vec<JobId>, StoreError> {
        away()
    }
    async fn alive(&self, _: Backend, _: Duration) -> Result<u64, StoreError> {
        away()
    }
    async fn stored_bytes(&self) -> Result<u64, StoreError> {
        away()
    }
    async fn counts(&self) -> Result<Counts, StoreError> {
        away()
    }
}
