//! The job store: runs operations on either database, retries them, and notifies subscribers.
//!
//! Siblings of this file implement the calls of [`Store`], each next to its SQL.

use super::error::{Severity, SqlError};
use super::group::{Group, Outcome, Transactions};
use super::hook::{Call, Hook};
use super::operation::{Done, Grouped, Operation, Run, Simple, Uncertain};
use super::tx::{Time, Tx};
use crate::clock::Stopwatch;
use crate::jobs::job::IdGenerator;
use crate::jobs::postgres::Postgres;
use crate::jobs::sqlite::Sqlite;
use crate::jobs::{Change, PoolUse, StoreError, StoreOptions};
use crate::lock::Mutex;
use jiff::Timestamp;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;
use tokio::time::timeout;
use tokio_util::task::TaskTracker;

/// Number of changes by which a subscriber may lag before it is told so.
const CHANGES: usize = 4096;
/// First and maximum wait before a transaction is retried.
const RETRY_WAITS: (Duration, Duration) = (Duration::from_millis(20), Duration::from_secs(1));

/// Age up to which an answer of PostgreSQL shows that it is available.
const ANSWERED_WITHIN: Duration = Duration::from_millis(500);
/// Maximum difference between the database's clock and the time that has passed, between two looks
/// at the queue, that does not count as a step of the clock.
const CLOCK_TOLERANCE: Duration = Duration::from_secs(2);
/// Maximum time for which a store waits for its changes, and for its database, while it closes.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(10);

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
    group: Group,
    changes: broadcast::Sender<Change>,
    ids: Arc<IdGenerator>,
    /// Looks at the queue since the start or since the last outage; `None` before the first one.
    looks: Mutex<Option<Looks>>,
    watch: Stopwatch,
    /// Tasks that change records. Closed when the store is.
    changing: TaskTracker,
}

/// Looks at the queue without an outage between them, by the clock of leases.
#[derive(Clone, Copy, Debug)]
struct Looks {
    first: Timestamp,
    latest: Timestamp,
    /// Reading of [`Shared::watch`] at the latest look.
    read_at: Duration,
}

impl Looks {
    /// True if the clock was not set between the latest look and `now`.
    fn agree(&self, now: Timestamp, read_at: Duration) -> bool {
        let passed = now.duration_since(self.latest);
        let error = passed.as_secs_f64() - read_at.saturating_sub(self.read_at).as_secs_f64();
        error.abs() < CLOCK_TOLERANCE.as_secs_f64()
    }
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

impl std::fmt::Debug for Store {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Store").field("engine", &self.shared.engine).finish_non_exhaustive()
    }
}

impl Transactions for Shared {
    async fn begin(&self) -> Result<Tx<'_>, SqlError> {
        Ok(Tx::new(over!(self.engine, database => database.begin().await?), &self.time))
    }

    fn options(&self) -> &StoreOptions {
        &self.options
    }

    fn failed(&self, error: SqlError) {
        let error = self.noted(error);
        tracing::debug!(%error, "a transaction of several changes failed; each change runs alone");
    }
}

impl Shared {
    /// Runs the operation of `call` until it succeeds, its retry limit has passed, or a retry would
    /// fail too.
    async fn transact<O: Operation>(&self, call: &Arc<Call>, operation: &Arc<O>) -> Result<Done<O::Output>, SqlError> {
        let since = Stopwatch::start();
        let mut uncertain = None;
        let is_grouped = match O::GROUPED {
            Grouped::Never => false,
            Grouped::OnSqlite => matches!(self.engine, Engine::Sqlite(_)),
            Grouped::Always => true,
        };
        if is_grouped {
            match self.group.transact(self, call, operation).await {
                Outcome::Committed(done) => return Ok(done),
                Outcome::Refused(error) => return Err(error),
                Outcome::Alone(done) => uncertain = done,
            }
        }
        let mut wait = RETRY_WAITS.0;
        loop {
            let error = match self.run_once(call, &**operation, &mut uncertain).await {
                Ok(done) => return Ok(done),
                Err(error) => self.noted(error),
            };
            let is_over = since.elapsed() > operation.retry_limit(uncertain.is_some()) || self.is_closing();
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

    /// Runs `operation` in one transaction and commits it durably. `uncertain` is the result of an
    /// earlier run whose commit failed: it may have taken effect nevertheless.
    async fn run_once<O: Operation>(
        &self,
        call: &Call,
        operation: &O,
        uncertain: &mut Option<Done<O::Output>>,
    ) -> Result<Done<O::Output>, SqlError> {
        let mut tx = self.begin().await?;
        let run = async {
            if let Some(done) = &*uncertain
                && operation.was_committed(&mut tx, done).await?
            {
                return Ok(None);
            }
            operation.run(&mut tx, &self.options).await.map(Some)
        };
        let done = match run.await {
            Ok(done) => done,
            Err(error) => {
                tx.roll_back().await;
                return Err(error);
            }
        };
        if let Some(done) = done {
            *uncertain = Some(done);
        }
        tx.commit().await?;
        if call.loses_commit() {
            return Err(SqlError::NoAnswer(Duration::ZERO));
        }
        Ok(uncertain.take().expect("a result of this run or of an earlier one"))
    }

    fn is_closing(&self) -> bool {
        self.changing.is_closed()
    }

    /// Consequence of an error for the caller.
    fn severity(&self, error: &SqlError) -> Severity {
        over!(self.engine, database => database.severity(error))
    }

    /// Remembers an outage.
    fn noted(&self, error: SqlError) -> SqlError {
        if self.severity(&error) == Severity::Outage {
            *self.looks.lock() = None;
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
        let shared = Shared {
            engine,
            time,
            options,
            group: Group::default(),
            changes,
            ids: Arc::new(IdGenerator::new()),
            looks: Mutex::default(),
            watch: Stopwatch::start(),
            changing: TaskTracker::new(),
        };
        Self { shared: Arc::new(shared), hook: None }
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

    /// Checks that the store is available. PostgreSQL is asked only if it has not answered any
    /// statement of this process for some time, so a busy pool of connections is no outage.
    ///
    /// # Errors
    /// [`StoreError::Database`] if it is not.
    pub async fn ready(&self) -> Result<(), StoreError> {
        self.before("ready").await?;
        let answered = match &self.shared.engine {
            Engine::Postgres(database) => database.answered_within(ANSWERED_WITHIN),
            Engine::Sqlite(_) => false,
        };
        if !answered {
            self.reader().await?.optional("SELECT 1 AS one FROM jobs LIMIT 1", vec![]).await?;
        }
        Ok(())
    }

    /// Maximum time of [`Store::ready`] that does not count as an outage.
    #[must_use]
    pub fn ready_within(&self) -> Duration {
        match &self.shared.engine {
            Engine::Sqlite(_) => Duration::from_secs(5),
            Engine::Postgres(_) => Duration::from_millis(800),
        }
    }

    /// Closes the store, which cannot be used afterwards. Waits for changes that are under way,
    /// and for the database, at most 10 s each.
    pub async fn close(&self) {
        // From now on, a change that fails is not retried.
        self.shared.changing.close();
        let changes = timeout(CLOSE_TIMEOUT, self.shared.changing.wait()).await;
        let closing = async { over!(self.shared.engine, database => database.close().await) };
        if timeout(CLOSE_TIMEOUT, closing).await.is_err() || changes.is_err() {
            tracing::warn!("the database did not answer while the store was closed; the last changes may be lost");
        }
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
        let result = self.transact(call, operation).await;
        self.after(call, result)
    }

    /// Makes the change of `call` by `run`.
    pub(super) async fn apply<I, T>(
        &self,
        call: &'static str,
        input: I,
        run: Run<I, T>,
        uncertain: Uncertain<I, T>,
    ) -> Result<T, StoreError>
    where
        I: Send + Sync + 'static,
        T: Send + Sync + 'static,
    {
        self.change(call, Simple { input, run, uncertain }).await
    }

    /// Completes `operation` even if the caller is dropped, and notifies subscribers.
    pub(super) async fn transact<O: Operation>(
        &self,
        call: &'static str,
        operation: O,
    ) -> Result<O::Output, StoreError> {
        let shared = Arc::clone(&self.shared);
        let call = Arc::new(Call::new(call, self.hook.clone()));
        let operation = Arc::new(operation);
        let task = self.shared.changing.spawn(async move {
            let done = shared.transact(&call, &operation).await?;
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
        *self.shared.looks.lock() = None;
    }

    /// Forgets the same if `error` is an outage.
    pub(super) fn noted(&self, error: SqlError) -> SqlError {
        self.shared.noted(error)
    }

    /// True if leases that have expired by `now`, the time of a look at the queue, may be ended:
    /// since the database became available and since its clock was last set, their holders had a
    /// whole lease time to renew them.
    pub(super) fn may_expire(&self, now: Timestamp, lease: Duration) -> bool {
        let read_at = self.shared.options.clock.elapsed(&self.shared.watch);
        let mut looks = self.shared.looks.lock();
        let first = looks.filter(|looks| looks.agree(now, read_at)).map_or(now, |looks| looks.first);
        *looks = Some(Looks { first, latest: now, read_at });
        now.duration_since(first).unsigned_abs() >= lease
    }
}
