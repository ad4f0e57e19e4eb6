//! A job store that is unavailable, or hangs when it is checked, and panics in one method.

use async_trait::async_trait;
use jiff::Timestamp;
use oviduct::generate::Backend;
use oviduct::jobs::keys::{Key, KeyStore, NewKey, NewTicket};
use oviduct::jobs::{
    Applied, Attempt, BackendReport, Batch, BatchFilter, BatchId, BatchPage, Change, ClaimedJob, Counts, Directive,
    Finished, Instruction, Job, JobId, JobProgress, ListFilter, LiveSection, NewBatch, NewJob, Page, Pause, Problem,
    Status, Store, StoreError, Submitted, SubmittedBatch, UpkeepTask, WorkerInfo,
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
impl KeyStore for Faulty {
    async fn add_key(&self, _: NewKey) -> Result<Key, StoreError> {
        away()
    }
    async fn add_first_key(&self, _: NewKey) -> Result<Option<Key>, StoreError> {
        away()
    }
    /// It has none: so far as keys are concerned, everyone is let through.
    async fn keys(&self) -> Result<(Timestamp, Vec<Key>), StoreError> {
        Ok((Timestamp::UNIX_EPOCH, Vec::new()))
    }
    async fn revoke_key(&self, _: &str, _: Duration) -> Result<Option<Key>, StoreError> {
        away()
    }
    async fn add_ticket(&self, _: NewTicket) -> Result<Timestamp, StoreError> {
        away()
    }
    async fn ticket(&self, _: &str, _: &str) -> Result<Option<String>, StoreError> {
        away()
    }
    async fn use_ticket(&self, _: &str, _: &str) -> Result<Option<String>, StoreError> {
        away()
    }
}

#[async_trait]
impl Store for Faulty {
    async fn submit(&self, _: NewJob) -> Result<Submitted, StoreError> {
        away()
    }
    async fn replayed(&self, _: Option<&str>, _: &str, _: &str) -> Result<Option<Job>, StoreError> {
        away()
    }
    async fn replayed_batch(&self, _: Option<&str>, _: &str, _: &str) -> Result<Option<Batch>, StoreError> {
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
    async fn ids(&self, _: &ListFilter) -> Result<Vec<JobId>, StoreError> {
        away()
    }
    async fn cancel_many(&self, _: Vec<JobId>, _: Option<Status>) -> Result<Applied, StoreError> {
        away()
    }
    async fn delete_many(&self, _: Vec<JobId>, _: Option<Status>) -> Result<Applied, StoreError> {
        away()
    }
    async fn queue_stranded(&self) -> Result<Vec<JobId>, StoreError> {
        away()
    }
    async fn batches(&self, _: &BatchFilter) -> Result<BatchPage, StoreError> {
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
        _: Option<&JobProgress>,
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
    async fn workers_within(&self, _: Duration) -> Result<Vec<WorkerInfo>, StoreError> {
        away()
    }
    async fn claimers(&self, _: Backend, _: Duration) -> Result<u64, StoreError> {
        away()
    }
    async fn set_paused(&self, _: bool, _: Option<&str>) -> Result<(), StoreError> {
        away()
    }
    async fn paused(&self) -> Result<Option<Pause>, StoreError> {
        away()
    }
    async fn instruct(&self, _: &str, _: Instruction, _: Option<&str>) -> Result<bool, StoreError> {
        away()
    }
    async fn queue_ages(&self) -> Result<[(Backend, Duration); 4], StoreError> {
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
    async fn batch_jobs(&self, _: BatchId, _: Option<JobId>, _: u32) -> Result<Vec<Job>, StoreError> {
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
