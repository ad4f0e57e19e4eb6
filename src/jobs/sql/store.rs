//! The job store: runs operations on either database, retries them, and notifies subscribers.
//!
//! Siblings of this file implement the calls of [`Store`], each next to its SQL.

use super::error::{Severity, SqlError};
use super::operation::{Done, Operation, Repeatable, Run};
use super::tx::{Time, Tx};
use crate::clock::Stopwatch;
use crate::jobs::job::IdGenerator;
use crate::jobs::postgres::Postgres;
use crate::jobs::sqlite::Sqlite;
use crate::jobs::{Change, PoolUse, StoreError, StoreOptions};
use crate::lock::Mutex;
use futures_util::future::BoxFuture;
use jiff::Timestamp;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;

/// Number of changes by which a subscriber may lag before it is told so.
const CHANGES: usize = 4096;
/// First and maximum wait before a transaction is retried.
const RETRY_WAITS: (Duration, Duration) = (Duration::from_millis(20), Duration::from_secs(1));

/// A job store on SQLite or PostgreSQL, with the API keys and tickets of clients. Clones share it.
///
/// Every call is atomic, and durable when it returns. Every change runs in a separate task:
/// dropping the caller (a client disconnects) interrupts neither the transaction nor the
/// notification of others.
#[derive(Clone)]
pub struct Store {
    shared: Arc<Shared>,
    hook: Option<Arc<dyn Hook>>,
}

struct Shared {
    engine: Engine,
    time: Time,
    options: StoreOptions,
    changes: broadcast::Sender<Change>,
    ids: Arc<IdGenerator>,
    /// Time of the first claim that the database answered after the start or after the last outage,
    /// by the clock of leases. `None` if there was none yet.
    available_since: Mutex<Option<Timestamp>>,
}

/// Connections to the database of a store.
#[derive(Debug)]
pub(in crate::jobs) enum Engine {
    Sqlite(Sqlite),
    Postgres(Postgres),
}

/// Evaluates an expression over the connections to either database.
macro_rules! over {
    ($engine:expr, $connections:ident => $value:expr) => {
        match &$engine {
            Engine::Sqlite($connections) => $value,
            Engine::Postgres($connections) => $value,
        }
    };
}

/// Intervenes in the calls of a [`Store`], for tests: observes them, delays them, makes them fail,
/// or replaces notifications. A call has the name of its method.
pub trait Hook: Send + Sync + 'static {
    /// Runs before a call. An error becomes the result of the call, which then does nothing.
    fn before<'a>(&'a self, _call: &'static str) -> BoxFuture<'a, Result<(), StoreError>> {
        Box::pin(async { Ok(()) })
    }

    /// Runs after a call that changes records, whether or not it succeeded. An error becomes the
    /// result of the call, as if the response was lost.
    ///
    /// # Errors
    /// The error to inject.
    fn after(&self, _call: &'static str) -> Result<(), StoreError> {
        Ok(())
    }

    /// Changes that subscribers receive instead of the changes of the store.
    fn changes(&self) -> Option<broadcast::Receiver<Change>> {
        None
    }
}

impl std::fmt::Debug for Store {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Store").field("engine", &self.shared.engine).finish_non_exhaustive()
    }
}

/// Runs `operation` on an open transaction. If an earlier commit may have succeeded, looks for its
/// result first.
async fn run_or_recover<O: Operation>(
    operation: &O,
    tx: &mut Tx<'_>,
    options: &StoreOptions,
    maybe_committed: bool,
) -> Result<Done<O::Output>, SqlError> {
    if maybe_committed && let Some(done) = operation.recover_committed(tx).await? {
        return Ok(done);
    }
    operation.run(tx, options).await
}

impl Shared {
    /// Runs `operation` until it succeeds, its retry limit has passed, or a retry would fail too.
    async fn transact<O: Operation>(&self, operation: &O) -> Result<Done<O::Output>, SqlError> {
        let since = Stopwatch::start();
        let mut maybe_committed = false;
        let mut wait = RETRY_WAITS.0;
        loop {
            let error = match self.run_once(operation, &mut maybe_committed).await {
                Ok(done) => return Ok(done),
                Err(error) => self.noted(error),
            };
            let is_closed = over!(self.engine, database => database.is_closed());
            let is_over = since.elapsed() > operation.retry_limit() || is_closed;
            if is_over || self.severity(&error) == Severity::Permanent {
                return Err(error);
            }
            match error {
                SqlError::OwnerLocked => tracing::debug!(%error, "a transaction failed and will be retried"),
                _ => tracing::warn!(%error, "a transaction failed and will be retried"),
            }
            tokio::time::sleep(wait).await;
            wait = (wait * 2).min(RETRY_WAITS.1);
        }
    }

    /// Runs `operation` in one transaction and commits it durably. Sets `maybe_committed` before
    /// the commit: if the commit fails, it may have taken effect nevertheless.
    async fn run_once<O: Operation>(
        &self,
        operation: &O,
        maybe_committed: &mut bool,
    ) -> Result<Done<O::Output>, SqlError> {
        let mut tx = Tx::new(over!(self.engine, database => database.begin().await?), &self.time);
        match run_or_recover(operation, &mut tx, &self.options, *maybe_committed).await {
            Ok(done) => {
                *maybe_committed = true;
                tx.commit().await.map(|()| done)
            }
            Err(error) => {
                tx.roll_back().await;
                Err(error)
            }
        }
    }

    /// Consequence of an error for the caller.
    fn severity(&self, error: &SqlError) -> Severity {
        over!(self.engine, database => database.severity(error))
    }

    /// Remembers an outage.
    fn noted(&self, error: SqlError) -> SqlError {
        if self.severity(&error) == Severity::Outage {
            *self.available_since.lock() = None;
        }
        error
    }
}

impl Store {
    /// `changes` notifies this process; the engine may keep a clone of it to pass on changes made
    /// elsewhere.
    pub(in crate::jobs) fn new(
        engine: Engine,
        time: Time,
        options: StoreOptions,
        changes: broadcast::Sender<Change>,
    ) -> Self {
        let (ids, available_since) = (Arc::new(IdGenerator::new()), Mutex::default());
        Self { shared: Arc::new(Shared { engine, time, options, changes, ids, available_since }), hook: None }
    }

    pub(in crate::jobs) fn channel() -> broadcast::Sender<Change> {
        broadcast::Sender::new(CHANGES)
    }

    /// The same store with `hook` in its calls; calls of `self` stay without it.
    #[must_use]
    pub fn with_hook(&self, hook: Arc<dyn Hook>) -> Self {
        Self { shared: Arc::clone(&self.shared), hook: Some(hook) }
    }

    /// Changes as they happen. A receiver that lags gets an error and must read the records again.
    #[must_use]
    pub fn changes(&self) -> broadcast::Receiver<Change> {
        let replaced = self.hook.as_ref().and_then(|hook| hook.changes());
        replaced.unwrap_or_else(|| self.shared.changes.subscribe())
    }

    /// Use of this process's connections to the database.
    #[must_use]
    pub fn pools(&self) -> Vec<PoolUse> {
        over!(self.shared.engine, database => database.pools())
    }

    /// Checks that the store is available.
    ///
    /// # Errors
    /// [`StoreError::Database`] if it is not.
    pub async fn ready(&self) -> Result<(), StoreError> {
        self.read("ready").await?.optional("SELECT 1 AS one FROM jobs LIMIT 1", vec![]).await?;
        Ok(())
    }

    /// Closes the store, which cannot be used afterwards.
    pub async fn close(&self) {
        over!(self.shared.engine, database => database.close().await);
    }

    #[cfg(test)]
    pub(in crate::jobs) fn engine(&self) -> &Engine {
        &self.shared.engine
    }

    /// The generator of this process's job ids.
    pub(super) fn id_generator(&self) -> Arc<IdGenerator> {
        Arc::clone(&self.shared.ids)
    }

    /// Runs the part of the hook that comes before `call`.
    pub(super) async fn before(&self, call: &'static str) -> Result<(), StoreError> {
        match &self.hook {
            Some(hook) => hook.before(call).await,
            None => Ok(()),
        }
    }

    /// Replaces the result of `call` if the hook injects an error.
    pub(super) fn after<T>(&self, call: &'static str, result: Result<T, StoreError>) -> Result<T, StoreError> {
        match &self.hook {
            Some(hook) => hook.after(call).and(result),
            None => result,
        }
    }

    /// A connection for the reads of `call`.
    pub(super) async fn read(&self, call: &'static str) -> Result<Tx<'_>, StoreError> {
        self.before(call).await?;
        Ok(self.reader().await?)
    }

    /// A connection for reading.
    pub(super) async fn reader(&self) -> Result<Tx<'_>, SqlError> {
        Ok(Tx::new(over!(self.shared.engine, database => database.reader().await?), &self.shared.time))
    }

    /// Makes the change of `call`.
    pub(super) async fn change<O: Operation>(&self, call: &'static str, operation: O) -> Result<O::Output, StoreError> {
        self.before(call).await?;
        let result = self.transact(operation).await;
        self.after(call, result)
    }

    /// Makes the change of `call` by `run`. Its result must be the same if it runs again after its
    /// commit.
    pub(super) async fn apply<I, T>(&self, call: &'static str, input: I, run: Run<I, T>) -> Result<T, StoreError>
    where
        I: Send + Sync + 'static,
        T: Send + 'static,
    {
        self.change(call, Repeatable { input, run }).await
    }

    /// Completes `operation` even if the caller is dropped, and notifies subscribers.
    pub(super) async fn transact<O: Operation>(&self, operation: O) -> Result<O::Output, StoreError> {
        let shared = Arc::clone(&self.shared);
        let task = tokio::spawn(async move {
            let done = shared.transact(&operation).await?;
            for change in &done.changes {
                // Fails if nobody subscribes.
                let _ = shared.changes.send(*change);
            }
            // No other process opens a SQLite file.
            if let Engine::Postgres(database) = &shared.engine {
                database.notify(&done.changes);
            }
            Ok::<_, SqlError>(done.output)
        });
        match task.await {
            Ok(result) => Ok(result?),
            Err(error) => Err(StoreError::Database(Box::new(error))),
        }
    }

    /// Forgets since when the database was available: workers may have been unable to renew their
    /// leases.
    pub(super) fn note_outage(&self) {
        *self.shared.available_since.lock() = None;
    }

    /// Forgets the same if `error` is an outage.
    pub(super) fn noted(&self, error: SqlError) -> SqlError {
        self.shared.noted(error)
    }

    /// True if leases that have expired by `now` may be ended: since the database became available,
    /// their holders had a whole lease time to renew them.
    pub(super) fn may_expire(&self, now: Timestamp, lease: Duration) -> bool {
        let since = *self.shared.available_since.lock().get_or_insert(now);
        now.duration_since(since).unsigned_abs() >= lease
    }
}
