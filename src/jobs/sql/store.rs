//! The [`Store`] trait over either database: retries, notification, and when leases may be expired.

use super::batch::{self, DeleteBatch, SubmitBatch};
use super::bulk::{self, CancelMany, DeleteMany};
use super::claim::{self, Claim};
use super::error::SqlError;
use super::keys::{self, AddKey, AddTicket, RevokeKey, UseTicket};
use super::lease::{Cancel, End, Expire, Record, Renew, SetCheckpoint};
use super::operation::{Done, Operation};
use super::pause::{self, Instruct};
use super::share::QueueStranded;
use super::submit::{self, Delete, Ids, Submit};
use super::tx::{Connection, Time, Tx};
use super::upkeep::{self, AcquireUpkeep};
use super::workers::{self, WorkerSeen};
use super::{order, read};
use crate::clock::Stopwatch;
use crate::generate::Backend;
use crate::jobs::job::{BackendReport, BatchId, Job, JobId, JobProgress, LiveSection, NewJob, Problem, Status};
use crate::jobs::keys::{Key, KeyStore, NewKey, NewTicket};
use crate::jobs::operators::{Instruction, Pause, PoolUse, WorkerInfo};
use crate::jobs::state::Event;
use crate::jobs::store::{
    Applied, Attempt, Batch, BatchFilter, BatchPage, Change, ClaimedJob, Counts, Directive, Finished, ListFilter,
    NewBatch, Page, Store, StoreError, StoreOptions, Submitted, SubmittedBatch, UpkeepTask,
};
use async_trait::async_trait;
use jiff::Timestamp;
use sqlx::pool::PoolConnection;
use sqlx::{Postgres, Sqlite};
use std::collections::BTreeSet;
use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::broadcast;

/// Changes that a slow subscriber may be behind before it is told that it lags.
const CHANGES: usize = 4096;
/// First and longest wait before a transaction is tried again.
const WAITS: (Duration, Duration) = (Duration::from_millis(20), Duration::from_secs(1));

/// What a database must be able to do for [`SqlStore`].
pub(in crate::jobs) trait Engine: std::fmt::Debug + Send + Sync + 'static {
    /// Runs `operation` once in a transaction and commits it durably. Sets `unknown` before the commit: if that fails, it
    /// may have taken effect nevertheless. If `unknown` was set by an earlier try, asks [`Operation::done_before`] first.
    fn once<O: Operation>(
        &self,
        operation: &O,
        options: &StoreOptions,
        unknown: &mut bool,
    ) -> impl Future<Output = Result<Done<O::Output>, SqlError>> + Send;

    /// What an error means for the caller.
    fn trouble(&self, error: &SqlError) -> Trouble;

    /// Whether [`Engine::close`] was called.
    fn is_closed(&self) -> bool;

    /// A connection for reading alone.
    fn reader(&self) -> impl Future<Output = Result<Reader, SqlError>> + Send;

    /// Where the time comes from.
    fn time(&self) -> &Time;

    /// The use of its connections.
    fn pools(&self) -> Vec<PoolUse>;

    /// Notifies other processes.
    fn notify(&self, changes: &[Change]);

    /// Closes all connections.
    fn close(&self) -> impl Future<Output = ()> + Send;
}

/// What an error of the database means for the caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::jobs) enum Trouble {
    /// The operation is refused, or would fail again.
    Lasting,
    /// Another try may succeed: a deadlock, a race for a key.
    Passing,
    /// The database is unavailable, to this process at least: another try may succeed, and workers may have been unable to
    /// renew their leases.
    Outage,
}

/// Runs `operation` on an open transaction, unless an earlier try was committed after all.
pub(in crate::jobs) async fn run_or_find<O: Operation>(
    operation: &O,
    tx: &mut Tx<'_>,
    options: &StoreOptions,
    unknown: bool,
) -> Result<Done<O::Output>, SqlError> {
    if unknown && let Some(done) = operation.done_before(tx).await? {
        return Ok(done);
    }
    operation.run(tx, options).await
}

/// A connection for reading.
#[derive(Debug)]
pub(in crate::jobs) enum Reader {
    Sqlite(PoolConnection<Sqlite>),
    Postgres(PoolConnection<Postgres>),
}

impl Reader {
    fn tx<'c>(&'c mut self, time: &'c Time) -> Tx<'c> {
        let connection = match self {
            Self::Sqlite(connection) => Connection::Sqlite(connection),
            Self::Postgres(connection) => Connection::Postgres(connection),
        };
        Tx::new(connection, time)
    }
}

/// A job store on a database. Clones share it.
///
/// Every change runs in a task of its own: if the caller is dropped (a client disconnects), neither the transaction nor the
/// notification of others is interrupted.
#[derive(Debug)]
pub struct SqlStore<E> {
    shared: Arc<Shared<E>>,
}

#[derive(Debug)]
struct Shared<E> {
    engine: E,
    options: StoreOptions,
    changes: broadcast::Sender<Change>,
    ids: Arc<Ids>,
    /// When this process first saw the database answer a claim, after its start or after the last outage; by the clock of
    /// leases. `None`: not yet.
    available_since: Mutex<Option<Timestamp>>,
}

impl<E> Clone for SqlStore<E> {
    fn clone(&self) -> Self {
        Self { shared: Arc::clone(&self.shared) }
    }
}

impl<E: Engine> Shared<E> {
    /// Tries `operation` until it is done, its patience is over, or another try would fail too.
    async fn transact<O: Operation>(&self, operation: &O) -> Result<Done<O::Output>, SqlError> {
        let since = Stopwatch::start();
        let mut unknown = false;
        let mut wait = WAITS.0;
        loop {
            let error = match self.engine.once(operation, &self.options, &mut unknown).await {
                Ok(done) => return Ok(done),
                Err(error) => self.noted(error),
            };
            let over = since.elapsed() > operation.patience() || self.engine.is_closed();
            if over || self.engine.trouble(&error) == Trouble::Lasting {
                return Err(error);
            }
            match error {
                SqlError::OwnerLocked => tracing::debug!(%error, "a transaction is tried again"),
                _ => tracing::warn!(%error, "a transaction is tried again"),
            }
            tokio::time::sleep(wait).await;
            wait = (wait * 2).min(WAITS.1);
        }
    }

    /// Remembers an outage.
    fn noted(&self, error: SqlError) -> SqlError {
        if self.engine.trouble(&error) == Trouble::Outage {
            *self.available_since() = None;
        }
        error
    }

    /// Whether leases that have expired by `now` may be ended: the workers that hold them had a whole lease time to renew
    /// them since the database became available.
    fn may_expire(&self, now: Timestamp, lease: Duration) -> bool {
        let since = *self.available_since().get_or_insert(now);
        now.duration_since(since).unsigned_abs() >= lease
    }

    fn available_since(&self) -> std::sync::MutexGuard<'_, Option<Timestamp>> {
        self.available_since.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[expect(private_bounds, reason = "only the engines of this crate make stores")]
impl<E: Engine> SqlStore<E> {
    /// `changes` notifies this process; the engine may keep a clone of it to pass on changes made elsewhere.
    pub(in crate::jobs) fn over(engine: E, options: StoreOptions, changes: broadcast::Sender<Change>) -> Self {
        let (ids, available_since) = (Arc::new(Ids::new()), Mutex::default());
        Self { shared: Arc::new(Shared { engine, options, changes, ids, available_since }) }
    }

    pub(in crate::jobs) fn channel() -> broadcast::Sender<Change> {
        broadcast::Sender::new(CHANGES)
    }

    #[cfg(test)]
    pub(in crate::jobs) fn engine(&self) -> &E {
        &self.shared.engine
    }

    /// Does `operation` to its end even if the caller is dropped, and notifies subscribers.
    pub(in crate::jobs) async fn run<O: Operation>(&self, operation: O) -> Result<O::Output, StoreError> {
        let shared = Arc::clone(&self.shared);
        let task = tokio::spawn(async move {
            let done = shared.transact(&operation).await?;
            for change in &done.changes {
                // Fails if nobody subscribes.
                let _ = shared.changes.send(*change);
            }
            shared.engine.notify(&done.changes);
            Ok::<_, SqlError>(done.output)
        });
        match task.await {
            Ok(result) => Ok(result?),
            Err(error) => Err(StoreError::Database(format!("the task of the store ended: {error}"))),
        }
    }

    async fn end(&self, claimed: &ClaimedJob, event: Event, record: Record) -> Result<Job, StoreError> {
        self.run(End { id: claimed.job.id, fence: claimed.fence(), event, record }).await
    }

    async fn reader(&self) -> Result<Reader, StoreError> {
        Ok(self.shared.engine.reader().await?)
    }

    async fn look(&self, worker: &str, backend: Backend) -> Result<claim::Found, SqlError> {
        let found =
            async { claim::look(&mut self.shared.engine.reader().await?.tx(self.time()), worker, backend).await };
        found.await.map_err(|error| self.shared.noted(error))
    }

    fn time(&self) -> &Time {
        self.shared.engine.time()
    }
}

#[async_trait]
impl<E: Engine> KeyStore for SqlStore<E> {
    async fn add_key(&self, new: NewKey) -> Result<Key, StoreError> {
        let key = self.run(AddKey { new, first: false }).await?;
        key.ok_or_else(|| StoreError::Database("a key was not stored".to_owned()))
    }

    async fn add_first_key(&self, new: NewKey) -> Result<Option<Key>, StoreError> {
        self.run(AddKey { new, first: true }).await
    }

    async fn keys(&self) -> Result<(Timestamp, Vec<Key>), StoreError> {
        Ok(keys::keys(&mut self.reader().await?.tx(self.time())).await?)
    }

    async fn revoke_key(&self, prefix: &str, after: Duration) -> Result<Option<Key>, StoreError> {
        self.run(RevokeKey { prefix: prefix.to_owned(), after }).await
    }

    async fn add_ticket(&self, new: NewTicket) -> Result<Timestamp, StoreError> {
        self.run(AddTicket(new)).await
    }

    async fn ticket(&self, hash: &str, path: &str) -> Result<Option<String>, StoreError> {
        Ok(keys::ticket(&mut self.reader().await?.tx(self.time()), hash, path).await?)
    }

    async fn use_ticket(&self, hash: &str, path: &str) -> Result<Option<String>, StoreError> {
        self.run(UseTicket { hash: hash.to_owned(), path: path.to_owned() }).await
    }
}

#[async_trait]
impl<E: Engine> Store for SqlStore<E> {
    async fn submit(&self, new: NewJob) -> Result<Submitted, StoreError> {
        self.run(Submit { new, ids: Arc::clone(&self.shared.ids), tried: Mutex::new(None) }).await
    }

    async fn replayed(&self, owner: Option<&str>, key: &str, body: &str) -> Result<Option<Job>, StoreError> {
        Ok(submit::replayed(&mut self.reader().await?.tx(self.time()), owner, key, body).await?)
    }

    async fn reusable(&self, new: &NewJob) -> Result<Option<Job>, StoreError> {
        Ok(submit::reusable(&mut self.reader().await?.tx(self.time()), new).await?)
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        Ok(read::job(&mut self.reader().await?.tx(self.time()), id).await?)
    }

    async fn list(&self, filter: &ListFilter) -> Result<Page, StoreError> {
        Ok(read::list(&mut self.reader().await?.tx(self.time()), filter).await?)
    }

    async fn cancel(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        self.run(Cancel(id)).await
    }

    async fn delete(&self, id: JobId) -> Result<Option<Vec<String>>, StoreError> {
        self.run(Delete(id)).await
    }

    async fn ids(&self, filter: &ListFilter) -> Result<Vec<JobId>, StoreError> {
        Ok(bulk::ids(&mut self.reader().await?.tx(self.time()), filter).await?)
    }

    async fn cancel_many(&self, ids: Vec<JobId>, status: Option<Status>) -> Result<Applied, StoreError> {
        self.run(CancelMany(ids, status)).await
    }

    async fn delete_many(&self, ids: Vec<JobId>, status: Option<Status>) -> Result<Applied, StoreError> {
        self.run(DeleteMany(ids, status)).await
    }

    async fn queue_stranded(&self) -> Result<Vec<JobId>, StoreError> {
        self.run(QueueStranded).await
    }

    async fn submit_batch(&self, new: NewBatch) -> Result<SubmittedBatch, StoreError> {
        self.run(SubmitBatch { new, ids: Arc::clone(&self.shared.ids), tried: Mutex::new(None) }).await
    }

    async fn replayed_batch(&self, owner: Option<&str>, key: &str, body: &str) -> Result<Option<Batch>, StoreError> {
        Ok(batch::replayed(&mut self.reader().await?.tx(self.time()), owner, key, body).await?)
    }

    async fn batch(&self, id: BatchId) -> Result<Option<Batch>, StoreError> {
        Ok(batch::read(&mut self.reader().await?.tx(self.time()), id).await?)
    }

    async fn batch_jobs(&self, id: BatchId, after: Option<JobId>, limit: u32) -> Result<Vec<Job>, StoreError> {
        Ok(batch::jobs(&mut self.reader().await?.tx(self.time()), id, after, limit).await?)
    }

    async fn batches(&self, filter: &BatchFilter) -> Result<BatchPage, StoreError> {
        Ok(batch::list(&mut self.reader().await?.tx(self.time()), filter).await?)
    }

    async fn delete_batch(&self, id: BatchId) -> Result<Option<Vec<String>>, StoreError> {
        self.run(DeleteBatch(id)).await
    }

    async fn claim(
        &self,
        worker: &str,
        backend: Backend,
        lease: Duration,
        limit: u32,
    ) -> Result<Vec<ClaimedJob>, StoreError> {
        let since = Stopwatch::start();
        let found = self.look(worker, backend).await?;
        if since.elapsed() >= lease {
            // The database hung for so long that no worker may have been able to renew its lease.
            *self.shared.available_since() = None;
        }
        let may_expire = self.shared.may_expire(found.at, lease);
        if found.expired && may_expire {
            // What expired before the look, not while an outage interrupts this.
            self.run(Expire { before: found.at }).await?;
        } else if !found.due {
            return Ok(Vec::new());
        }
        self.run(Claim { worker: worker.to_owned(), backend, lease, limit, tried: Mutex::default() }).await
    }

    async fn waiting(&self, backend: Backend) -> Result<u64, StoreError> {
        Ok(order::waiting(&mut self.reader().await?.tx(self.time()), backend).await?)
    }

    async fn heartbeat(
        &self,
        claimed: &ClaimedJob,
        lease: Duration,
        backend: &BackendReport,
        progress: Option<&JobProgress>,
        section: Option<&LiveSection>,
    ) -> Result<Directive, StoreError> {
        let (id, fence, backend) = (claimed.job.id, claimed.fence(), backend.clone());
        self.run(Renew { id, fence, lease, backend, progress: progress.copied(), section: section.cloned() }).await
    }

    async fn set_checkpoint(&self, claimed: &ClaimedJob, key: &str) -> Result<Option<String>, StoreError> {
        self.run(SetCheckpoint { id: claimed.job.id, fence: claimed.fence(), key: key.to_owned() }).await
    }

    async fn finish(&self, claimed: ClaimedJob, finished: Finished) -> Result<Job, StoreError> {
        self.end(&claimed, Event::Finish(claimed.fence()), Record::Finished(finished)).await
    }

    async fn fail(&self, claimed: ClaimedJob, backend: BackendReport, problem: Problem) -> Result<Job, StoreError> {
        self.end(&claimed, Event::Fail(claimed.fence()), Record::Failed(backend, problem)).await
    }

    async fn cancelled(&self, claimed: ClaimedJob) -> Result<Job, StoreError> {
        self.end(&claimed, Event::Stopped(claimed.fence()), Record::Nothing).await
    }

    async fn release(&self, claimed: ClaimedJob, problem: Option<Problem>) -> Result<(), StoreError> {
        let record = problem.map_or(Record::Nothing, Record::Fault);
        self.end(&claimed, Event::Release(claimed.fence()), record).await.map(drop)
    }

    async fn retry(&self, claimed: ClaimedJob, problem: Problem) -> Result<Job, StoreError> {
        self.end(&claimed, Event::Retry(claimed.fence()), Record::Fault(problem)).await
    }

    async fn attempts(&self, id: JobId) -> Result<Vec<Attempt>, StoreError> {
        Ok(read::attempts(&mut self.reader().await?.tx(self.time()), id).await?)
    }

    async fn worker_seen(&self, worker: &WorkerInfo) -> Result<(), StoreError> {
        self.run(WorkerSeen(worker.clone())).await
    }

    async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError> {
        self.workers_within(workers::SEEN).await
    }

    async fn workers_within(&self, within: Duration) -> Result<Vec<WorkerInfo>, StoreError> {
        Ok(workers::workers(&mut self.reader().await?.tx(self.time()), within).await?)
    }

    async fn alive(&self, backend: Backend, within: Duration) -> Result<u64, StoreError> {
        Ok(workers::alive(&mut self.reader().await?.tx(self.time()), backend, within).await?)
    }

    async fn claimers(&self, backend: Backend, within: Duration) -> Result<u64, StoreError> {
        Ok(workers::claimers(&mut self.reader().await?.tx(self.time()), backend, within).await?)
    }

    async fn set_paused(&self, paused: bool, by: Option<&str>) -> Result<(), StoreError> {
        let instruction = if paused { Instruction::Pause } else { Instruction::Resume };
        self.run(Instruct { worker: None, instruction, by: by.map(str::to_owned) }).await.map(drop)
    }

    async fn paused(&self) -> Result<Option<Pause>, StoreError> {
        Ok(pause::paused(&mut self.reader().await?.tx(self.time())).await?)
    }

    async fn instruct(&self, worker: &str, instruction: Instruction, by: Option<&str>) -> Result<bool, StoreError> {
        self.run(Instruct { worker: Some(worker.to_owned()), instruction, by: by.map(str::to_owned) }).await
    }

    async fn acquire_upkeep(&self, task: UpkeepTask, owner: &str, lease: Duration) -> Result<bool, StoreError> {
        self.run(AcquireUpkeep { task, owner: owner.to_owned(), lease }).await
    }

    async fn keys_in_use(&self, keys: &[String]) -> Result<BTreeSet<String>, StoreError> {
        Ok(upkeep::keys_in_use(&mut self.reader().await?.tx(self.time()), keys).await?)
    }

    async fn ended(&self, age: Option<Duration>, limit: u32) -> Result<Vec<JobId>, StoreError> {
        Ok(read::ended(&mut self.reader().await?.tx(self.time()), age, limit).await?)
    }

    async fn stored_bytes(&self) -> Result<u64, StoreError> {
        Ok(read::stored_bytes(&mut self.reader().await?.tx(self.time())).await?)
    }

    async fn counts(&self) -> Result<Counts, StoreError> {
        Ok(read::counts(&mut self.reader().await?.tx(self.time())).await?)
    }

    async fn queued_by_backend(&self) -> Result<[(Backend, u64); 4], StoreError> {
        Ok(read::queued_by_backend(&mut self.reader().await?.tx(self.time())).await?)
    }

    async fn queue_ages(&self) -> Result<[(Backend, Duration); 4], StoreError> {
        Ok(read::queue_ages(&mut self.reader().await?.tx(self.time())).await?)
    }

    fn pools(&self) -> Vec<PoolUse> {
        self.shared.engine.pools()
    }

    fn changes(&self) -> broadcast::Receiver<Change> {
        self.shared.changes.subscribe()
    }

    async fn ready(&self) -> Result<(), StoreError> {
        let mut reader = self.reader().await?;
        reader.tx(self.time()).optional("SELECT 1 AS one FROM jobs LIMIT 1", vec![]).await?;
        Ok(())
    }

    async fn close(&self) {
        self.shared.engine.close().await;
    }
}
