//! The store's contract over either database.

use super::batch::{self, DeleteBatch, SubmitBatch};
use super::claim::{self, Claim};
use super::lease::{Cancel, End, Expire, Record, Renew, SetCheckpoint};
use super::submit::{self, Delete, Ids, Submit};
use super::workers::{WorkerSeen, alive, workers};
use super::{CHANGES, Connection, Done, Link, Operation, SqlError, Time, order, read};
use crate::generate::{Backend, Progress};
use crate::jobs::job::{BackendReport, BatchId, Job, JobId, LiveSection, NewJob, Problem};
use crate::jobs::state::Event;
use crate::jobs::store::{
    Attempt, Batch, Change, ClaimedJob, Counts, Directive, Finished, ListFilter, NewBatch, Page, Store, StoreError,
    StoreOptions, Submitted, SubmittedBatch, WorkerInfo,
};
use async_trait::async_trait;
use sqlx::pool::PoolConnection;
use sqlx::{Postgres, Sqlite};
use std::future::Future;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::broadcast;

/// What a database must be able to do for [`SqlStore`].
pub(in crate::jobs) trait Engine: std::fmt::Debug + Send + Sync + 'static {
    /// Does `operation` in a transaction, as one, durably; says what it did once that stands.
    fn transact<O: Operation>(
        &self,
        operation: &O,
        options: &StoreOptions,
    ) -> impl Future<Output = Result<Done<O::Output>, SqlError>> + Send;

    /// A connection for reading alone.
    fn reader(&self) -> impl Future<Output = Result<Reader, SqlError>> + Send;

    /// Where the time comes from.
    fn time(&self) -> &Time;

    /// Tells other processes.
    fn tell(&self, changes: &[Change]);

    /// Closes all connections.
    fn close(&self) -> impl Future<Output = ()> + Send;
}

/// A connection for reading.
#[derive(Debug)]
pub(in crate::jobs) enum Reader {
    Sqlite(PoolConnection<Sqlite>),
    Postgres(PoolConnection<Postgres>),
}

impl Reader {
    fn link<'c>(&'c mut self, time: &'c Time) -> Link<'c> {
        let connection = match self {
            Self::Sqlite(connection) => Connection::Sqlite(connection),
            Self::Postgres(connection) => Connection::Postgres(connection),
        };
        Link::new(connection, time)
    }
}

/// A job store on a database. Clones share it.
///
/// Every change runs in a task of its own: a caller that goes away (a client that hangs up) can break off
/// neither a transaction nor the word of it to others.
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
}

impl<E> Clone for SqlStore<E> {
    fn clone(&self) -> Self {
        Self { shared: Arc::clone(&self.shared) }
    }
}

#[expect(private_bounds, reason = "only the engines of this crate make stores")]
impl<E: Engine> SqlStore<E> {
    /// Whoever makes an engine may give it a clone of the sender that tells this process of changes elsewhere.
    pub(in crate::jobs) fn over(engine: E, options: StoreOptions, changes: broadcast::Sender<Change>) -> Self {
        Self { shared: Arc::new(Shared { engine, options, changes, ids: Arc::new(Ids::new()) }) }
    }

    pub(in crate::jobs) fn channel() -> broadcast::Sender<Change> {
        broadcast::Sender::new(CHANGES)
    }

    /// Does `operation` to its end even where the caller goes away, and tells of it.
    pub(in crate::jobs) async fn run<O: Operation>(&self, operation: O) -> Result<O::Output, StoreError> {
        let shared = Arc::clone(&self.shared);
        let task = tokio::spawn(async move {
            let done = shared.engine.transact(&operation, &shared.options).await?;
            for change in &done.changes {
                // Nobody listens: nobody needs to be told.
                let _ = shared.changes.send(*change);
            }
            shared.engine.tell(&done.changes);
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

    fn time(&self) -> &Time {
        self.shared.engine.time()
    }
}

#[async_trait]
impl<E: Engine> Store for SqlStore<E> {
    async fn submit(&self, new: NewJob) -> Result<Submitted, StoreError> {
        self.run(Submit { new, ids: Arc::clone(&self.shared.ids), tried: Mutex::new(None) }).await
    }

    async fn replayed(&self, key: &str, body: &str) -> Result<Option<Job>, StoreError> {
        Ok(submit::replayed(&mut self.reader().await?.link(self.time()), key, body).await?)
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        Ok(read::job(&mut self.reader().await?.link(self.time()), id).await?)
    }

    async fn list(&self, filter: &ListFilter) -> Result<Page, StoreError> {
        Ok(read::list(&mut self.reader().await?.link(self.time()), filter).await?)
    }

    async fn cancel(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        self.run(Cancel(id)).await
    }

    async fn delete(&self, id: JobId) -> Result<Option<Vec<String>>, StoreError> {
        self.run(Delete(id)).await
    }

    async fn submit_batch(&self, new: NewBatch) -> Result<SubmittedBatch, StoreError> {
        self.run(SubmitBatch { new, ids: Arc::clone(&self.shared.ids), tried: Mutex::new(None) }).await
    }

    async fn replayed_batch(&self, key: &str, body: &str) -> Result<Option<Batch>, StoreError> {
        Ok(batch::replayed(&mut self.reader().await?.link(self.time()), key, body).await?)
    }

    async fn batch(&self, id: BatchId) -> Result<Option<Batch>, StoreError> {
        Ok(batch::read(&mut self.reader().await?.link(self.time()), id).await?)
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
        let found = claim::look(&mut self.reader().await?.link(self.time()), backend).await?;
        if found.expired {
            self.run(Expire { all: false }).await?;
        } else if !found.due {
            return Ok(Vec::new());
        }
        self.run(Claim { worker: worker.to_owned(), backend, lease, limit }).await
    }

    async fn waiting(&self, backend: Backend) -> Result<u64, StoreError> {
        Ok(order::waiting(&mut self.reader().await?.link(self.time()), backend).await?)
    }

    async fn heartbeat(
        &self,
        claimed: &ClaimedJob,
        lease: Duration,
        backend: &BackendReport,
        progress: Option<&Progress>,
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

    async fn release(&self, claimed: ClaimedJob) -> Result<(), StoreError> {
        self.end(&claimed, Event::Release(claimed.fence()), Record::Nothing).await.map(drop)
    }

    async fn release_because(&self, claimed: ClaimedJob, problem: Problem) -> Result<(), StoreError> {
        self.end(&claimed, Event::Release(claimed.fence()), Record::Fault(problem)).await.map(drop)
    }

    async fn retry(&self, claimed: ClaimedJob, problem: Problem) -> Result<Job, StoreError> {
        self.end(&claimed, Event::Retry(claimed.fence()), Record::Fault(problem)).await
    }

    async fn attempts(&self, id: JobId) -> Result<Vec<Attempt>, StoreError> {
        Ok(read::attempts(&mut self.reader().await?.link(self.time()), id).await?)
    }

    async fn worker_seen(&self, worker: &WorkerInfo) -> Result<(), StoreError> {
        self.run(WorkerSeen(worker.clone())).await
    }

    async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError> {
        Ok(workers(&mut self.reader().await?.link(self.time())).await?)
    }

    async fn names_key(&self, key: &str) -> Result<bool, StoreError> {
        Ok(read::names_key(&mut self.reader().await?.link(self.time()), key).await?)
    }

    async fn alive(&self, backend: Backend, within: Duration) -> Result<u64, StoreError> {
        Ok(alive(&mut self.reader().await?.link(self.time()), backend, within).await?)
    }

    async fn ended_before(&self, age: Duration, limit: u32) -> Result<Vec<JobId>, StoreError> {
        Ok(read::ended_before(&mut self.reader().await?.link(self.time()), age, limit).await?)
    }

    async fn stored_bytes(&self) -> Result<u64, StoreError> {
        Ok(read::stored_bytes(&mut self.reader().await?.link(self.time())).await?)
    }

    async fn counts(&self) -> Result<Counts, StoreError> {
        Ok(read::counts(&mut self.reader().await?.link(self.time())).await?)
    }

    fn changes(&self) -> broadcast::Receiver<Change> {
        self.shared.changes.subscribe()
    }

    async fn ready(&self) -> Result<(), StoreError> {
        let mut reader = self.reader().await?;
        reader.link(self.time()).optional("SELECT 1 AS one FROM jobs LIMIT 1", vec![]).await?;
        Ok(())
    }

    async fn close(&self) {
        self.shared.engine.close().await;
    }
}
