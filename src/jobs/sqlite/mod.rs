//! The job store on SQLite: one file, or memory for tests.
//!
//! WAL with one writing connection and several reading ones, so readers never wait for a writer.
//! `synchronous = FULL`: an accepted job survives the loss of power, not only of the process; a commit then
//! costs one fsync, which is small against a model. Writers begin with `BEGIN IMMEDIATE`, so that what they
//! read is still true when they write. Every change runs in a task of its own: a caller that goes away (a
//! client that hangs up) can break off neither a transaction nor the word of it to others.
//!
//! A file store is held by one process at a time (a lock file beside it says so), which is what makes
//! [`SqliteStore::recover`] sound.

mod batch;
mod lease;
mod read;
mod submit;

use super::job::{BackendReport, BatchId, Job, JobId, LiveSection, NewJob, Problem};
use super::state::Event;
use super::store::{
    Attempt, Batch, Change, ClaimedJob, Counts, Directive, Finished, ListFilter, NewBatch, Page, Store, StoreError,
    StoreOptions, Submitted, SubmittedBatch, WorkerInfo,
};
use crate::generate::{Backend, Progress};
use async_trait::async_trait;
use jiff::Timestamp;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{Sqlite, Transaction};
use std::fs::{File, TryLockError};
use std::future::Future;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::broadcast;

/// How long a connection waits for another's lock before it fails.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Connections for reading.
const READERS: u32 = 4;
/// Changes that a slow receiver may be behind before it is told that it lags.
const CHANGES: usize = 4096;
/// Workers seen within this time are listed.
const WORKERS_SEEN: Duration = Duration::from_secs(5 * 60);

/// The job store on SQLite. Clones share it.
#[derive(Clone, Debug)]
pub struct SqliteStore {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    writer: SqlitePool,
    reader: SqlitePool,
    options: StoreOptions,
    changes: broadcast::Sender<Change>,
    /// Keeps ids made within one millisecond in order.
    ids: Mutex<uuid::ContextV7>,
    /// Held while the store is open.
    _lock: Option<File>,
}

type Tx = Transaction<'static, Sqlite>;

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        Self::Database(error.to_string())
    }
}

fn micros(at: Timestamp) -> i64 {
    at.as_microsecond()
}

fn timestamp(micros: i64) -> Result<Timestamp, StoreError> {
    Timestamp::from_microsecond(micros).map_err(|error| StoreError::Database(format!("a broken record: {error}")))
}

fn json<T: serde::Serialize>(value: &T) -> String {
    serde_json::to_string(value).expect("records have string keys and finite numbers only")
}

/// A unit variant as the string that serde names it by.
fn word<T: serde::Serialize>(value: T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => unreachable!("only unit variants are stored as words"),
    }
}

impl SqliteStore {
    /// Opens the store in the file at `path`, which is made where there is none, and brings its tables up to date.
    /// Jobs that a process before left running keep their leases; see [`SqliteStore::recover`].
    ///
    /// # Errors
    /// [`StoreError::Database`] where the file cannot be opened, or another process has it open.
    pub async fn open(path: impl AsRef<Path>, options: StoreOptions) -> Result<Self, StoreError> {
        let path = path.as_ref();
        let failed = |error: std::io::Error| StoreError::Database(format!("{}: {error}", path.display()));
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(failed)?;
        }
        let lock = File::create(path.with_added_extension("lock")).map_err(failed)?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(StoreError::Database(format!("{} is in use by another process", path.display())));
            }
            Err(TryLockError::Error(error)) => {
                tracing::warn!(path = %path.display(), %error, "no lock on the job store: keep it to one process");
            }
        }
        let connect = SqliteConnectOptions::new()
            .filename(path)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(BUSY_TIMEOUT)
            .foreign_keys(true);
        let writer = pool(1).connect_with(connect.clone()).await?;
        migrate(&writer).await?;
        let reader = pool(READERS).connect_with(connect.pragma("query_only", "ON")).await?;
        Ok(Self::over(writer, reader, Some(lock), options))
    }

    /// Opens an empty store in memory, for tests: one connection reads and writes, and all is gone with it.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn open_in_memory(options: StoreOptions) -> Result<Self, StoreError> {
        let connect = SqliteConnectOptions::new().in_memory(true).foreign_keys(true);
        let writer = pool(1).connect_with(connect).await?;
        migrate(&writer).await?;
        Ok(Self::over(writer.clone(), writer, None, options))
    }

    fn over(writer: SqlitePool, reader: SqlitePool, lock: Option<File>, options: StoreOptions) -> Self {
        let changes = broadcast::Sender::new(CHANGES);
        let ids = Mutex::new(uuid::ContextV7::new());
        Self { inner: Arc::new(Inner { writer, reader, options, changes, ids, _lock: lock }) }
    }

    /// Takes over at once the leases that the process before left: to be called on start, before any worker.
    /// Each counts as an attempt whose worker vanished. Returns the jobs concerned.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn recover(&self) -> Result<Vec<JobId>, StoreError> {
        self.detached(|inner| async move {
            let mut tx = inner.begin().await?;
            let changes = lease::expire(&mut tx, &inner.options, None).await?;
            inner.commit(tx, &changes).await?;
            Ok(changes.iter().map(|change| change.id).collect())
        })
        .await
    }

    /// Closes all connections and writes the log back into the file. The store cannot be used afterwards.
    pub async fn close(&self) {
        self.inner.reader.close().await;
        self.inner.writer.close().await;
    }

    /// Runs `work` to its end even where the caller goes away.
    async fn detached<T, F>(&self, work: impl FnOnce(Arc<Inner>) -> F) -> Result<T, StoreError>
    where
        T: Send + 'static,
        F: Future<Output = Result<T, StoreError>> + Send + 'static,
    {
        match tokio::spawn(work(Arc::clone(&self.inner))).await {
            Ok(result) => result,
            Err(error) => Err(StoreError::Database(format!("the task of the store ended: {error}"))),
        }
    }

    /// Ends a claimed job's attempt by `event`.
    async fn end(&self, claimed: ClaimedJob, event: Event, record: lease::Record) -> Result<Job, StoreError> {
        self.detached(|inner| async move {
            let mut tx = inner.begin().await?;
            let job = lease::end(&mut tx, &inner.options, claimed.job.id, &event, record).await?;
            inner.commit(tx, &[Change { id: job.id, version: Some(job.version) }]).await?;
            Ok(job)
        })
        .await
    }
}

impl Inner {
    async fn begin(&self) -> Result<Tx, StoreError> {
        Ok(self.writer.begin_with("BEGIN IMMEDIATE").await?)
    }

    /// Commits, then tells others.
    async fn commit(&self, tx: Tx, changes: &[Change]) -> Result<(), StoreError> {
        tx.commit().await?;
        for change in changes {
            // Nobody listens: nobody needs to be told.
            let _ = self.changes.send(*change);
        }
        Ok(())
    }

    /// A fresh id, greater than all that this process made before.
    fn new_id(&self) -> JobId {
        let now = self.options.clock.now();
        let seconds = u64::try_from(now.as_second()).unwrap_or_default();
        let nanos = u32::try_from(now.subsec_nanosecond()).unwrap_or_default();
        let ids = self.ids.lock().unwrap_or_else(PoisonError::into_inner);
        JobId(uuid::Uuid::new_v7(uuid::Timestamp::from_unix(&*ids, seconds, nanos)))
    }
}

fn pool(connections: u32) -> SqlitePoolOptions {
    // Connections to memory must never be closed: the data go with them.
    SqlitePoolOptions::new().min_connections(1).max_connections(connections).idle_timeout(None).max_lifetime(None)
}

async fn migrate(pool: &SqlitePool) -> Result<(), StoreError> {
    sqlx::migrate!("src/jobs/sqlite/migrations")
        .run(pool)
        .await
        .map_err(|error| StoreError::Database(error.to_string()))
}

#[async_trait]
impl Store for SqliteStore {
    async fn submit(&self, new: NewJob) -> Result<Submitted, StoreError> {
        self.detached(|inner| async move {
            let mut tx = inner.begin().await?;
            let submitted = submit::submit(&mut tx, &inner.options, inner.new_id(), &new).await?;
            let job = submitted.job();
            let change = Change { id: job.id, version: Some(job.version) };
            match submitted {
                Submitted::Replayed(_) => tx.rollback().await?,
                Submitted::Queued(_) | Submitted::Reused(_) => inner.commit(tx, &[change]).await?,
            }
            Ok(submitted)
        })
        .await
    }

    async fn get(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        read::job(&mut *self.inner.reader.acquire().await?, id).await
    }

    async fn list(&self, filter: &ListFilter) -> Result<Page, StoreError> {
        read::list(&mut *self.inner.reader.acquire().await?, filter).await
    }

    async fn cancel(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        self.detached(|inner| async move {
            let mut tx = inner.begin().await?;
            let Some((job, changed)) = lease::cancel(&mut tx, &inner.options, id).await? else {
                return Ok(None);
            };
            if changed {
                inner.commit(tx, &[Change { id, version: Some(job.version) }]).await?;
            }
            Ok(Some(job))
        })
        .await
    }

    async fn delete(&self, id: JobId) -> Result<Option<Vec<String>>, StoreError> {
        self.detached(|inner| async move {
            let mut tx = inner.begin().await?;
            let keys = submit::delete(&mut tx, id).await?;
            if keys.is_some() {
                inner.commit(tx, &[Change { id, version: None }]).await?;
            }
            Ok(keys)
        })
        .await
    }

    async fn submit_batch(&self, new: NewBatch) -> Result<SubmittedBatch, StoreError> {
        self.detached(|inner| async move {
            let id = BatchId(inner.new_id().0);
            let jobs: Vec<(JobId, &NewJob)> = new.jobs.iter().map(|job| (inner.new_id(), job)).collect();
            let mut tx = inner.begin().await?;
            let submitted = batch::submit(&mut tx, &inner.options, id, &new, &jobs).await?;
            match submitted {
                SubmittedBatch::Replayed(_) => tx.rollback().await?,
                SubmittedBatch::Accepted(_) => {
                    let changes: Vec<Change> =
                        jobs.iter().map(|(id, _)| Change { id: *id, version: Some(1) }).collect();
                    inner.commit(tx, &changes).await?;
                }
            }
            Ok(submitted)
        })
        .await
    }

    async fn batch(&self, id: BatchId) -> Result<Option<Batch>, StoreError> {
        batch::read(&mut *self.inner.reader.acquire().await?, id).await
    }

    async fn delete_batch(&self, id: BatchId) -> Result<Option<Vec<String>>, StoreError> {
        self.detached(move |inner| async move {
            let mut tx = inner.begin().await?;
            let Some((jobs, keys)) = batch::delete(&mut tx, id).await? else {
                return Ok(None);
            };
            let changes: Vec<Change> = jobs.into_iter().map(|id| Change { id, version: None }).collect();
            inner.commit(tx, &changes).await?;
            Ok(Some(keys))
        })
        .await
    }

    async fn claim(
        &self,
        worker: &str,
        backend: Backend,
        lease: Duration,
        limit: u32,
    ) -> Result<Vec<ClaimedJob>, StoreError> {
        let now = self.inner.options.clock.now();
        // Most polls find nothing: they need not wait for the writer.
        if !lease::any_to_claim(&mut *self.inner.reader.acquire().await?, backend, now).await? {
            return Ok(Vec::new());
        }
        let worker = worker.to_owned();
        self.detached(move |inner| async move {
            let mut tx = inner.begin().await?;
            let mut changes = lease::expire(&mut tx, &inner.options, Some(now)).await?;
            let claimed = lease::claim(&mut tx, &inner.options, &worker, backend, lease, limit).await?;
            changes.extend(claimed.iter().map(|c| Change { id: c.job.id, version: Some(c.job.version) }));
            inner.commit(tx, &changes).await?;
            Ok(claimed)
        })
        .await
    }

    async fn heartbeat(
        &self,
        claimed: &ClaimedJob,
        lease: Duration,
        backend: &BackendReport,
        progress: Option<&Progress>,
        section: Option<&LiveSection>,
    ) -> Result<Directive, StoreError> {
        let (id, fence) = (claimed.job.id, claimed.fence());
        let live = lease::Live { backend: backend.clone(), progress: progress.copied(), section: section.cloned() };
        self.detached(move |inner| async move {
            let mut tx = inner.begin().await?;
            let (directive, version) = lease::renew(&mut tx, &inner.options, id, fence, lease, &live).await?;
            match version {
                Some(version) => inner.commit(tx, &[Change { id, version: Some(version) }]).await?,
                None => inner.commit(tx, &[]).await?,
            }
            Ok(directive)
        })
        .await
    }

    async fn set_checkpoint(&self, claimed: &ClaimedJob, key: &str) -> Result<Option<String>, StoreError> {
        let (id, fence, key) = (claimed.job.id, claimed.fence(), key.to_owned());
        self.detached(move |inner| async move {
            let mut tx = inner.begin().await?;
            let before = lease::set_checkpoint(&mut tx, &inner.options, id, fence, &key).await?;
            inner.commit(tx, &[]).await?;
            Ok(before)
        })
        .await
    }

    async fn finish(&self, claimed: ClaimedJob, finished: Finished) -> Result<Job, StoreError> {
        let event = Event::Finish(claimed.fence());
        self.end(claimed, event, lease::Record::Finished(finished)).await
    }

    async fn fail(&self, claimed: ClaimedJob, backend: BackendReport, problem: Problem) -> Result<Job, StoreError> {
        let event = Event::Fail(claimed.fence());
        self.end(claimed, event, lease::Record::Failed(backend, problem)).await
    }

    async fn cancelled(&self, claimed: ClaimedJob) -> Result<Job, StoreError> {
        let event = Event::Stopped(claimed.fence());
        self.end(claimed, event, lease::Record::Nothing).await
    }

    async fn release(&self, claimed: ClaimedJob) -> Result<(), StoreError> {
        let event = Event::Release(claimed.fence());
        self.end(claimed, event, lease::Record::Nothing).await.map(drop)
    }

    async fn retry(&self, claimed: ClaimedJob, problem: Problem) -> Result<Job, StoreError> {
        let event = Event::Retry(claimed.fence());
        self.end(claimed, event, lease::Record::Fault(problem)).await
    }

    async fn attempts(&self, id: JobId) -> Result<Vec<Attempt>, StoreError> {
        read::attempts(&mut *self.inner.reader.acquire().await?, id).await
    }

    async fn worker_seen(&self, worker: &WorkerInfo) -> Result<(), StoreError> {
        let worker = worker.clone();
        self.detached(move |inner| async move {
            let mut tx = inner.begin().await?;
            submit::worker_seen(&mut tx, &worker).await?;
            inner.commit(tx, &[]).await
        })
        .await
    }

    async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError> {
        let since = self.inner.options.clock.now() - WORKERS_SEEN;
        read::workers(&mut *self.inner.reader.acquire().await?, since).await
    }

    async fn names_key(&self, key: &str) -> Result<bool, StoreError> {
        read::names_key(&mut *self.inner.reader.acquire().await?, key).await
    }

    async fn ended_before(&self, before: Timestamp, limit: u32) -> Result<Vec<JobId>, StoreError> {
        read::ended_before(&mut *self.inner.reader.acquire().await?, before, limit).await
    }

    async fn stored_bytes(&self) -> Result<u64, StoreError> {
        read::stored_bytes(&mut *self.inner.reader.acquire().await?).await
    }

    async fn counts(&self) -> Result<Counts, StoreError> {
        read::counts(&mut *self.inner.reader.acquire().await?).await
    }

    fn changes(&self) -> broadcast::Receiver<Change> {
        self.inner.changes.subscribe()
    }

    async fn ready(&self) -> Result<(), StoreError> {
        sqlx::query("SELECT 1 FROM jobs LIMIT 1").fetch_optional(&self.inner.reader).await?;
        Ok(())
    }
}
