//! The job store: runs operations on either database, retries them, and notifies subscribers.
//!
//! Siblings of this file implement the calls of [`Store`], each next to its SQL.

use super::error::{Severity, SqlError};
use super::group::{Group, Outcome, Transactions};
use super::hook::{Call, Hook};
use super::operation::{Done, Grouped, Operation, Run, Simple, Uncertain};
use super::place::FarPlace;
use super::tx::{Time, Tx};
use crate::clock::Stopwatch;
use crate::jobs::job::IdGenerator;
use crate::jobs::postgres::Postgres;
use crate::jobs::sqlite::Sqlite;
use crate::jobs::state::Looks;
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

/// Time after which a claim looks at the queue, and for expired leases, although jobs are due.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// Age up to which an answer of PostgreSQL shows that it is available.
const ANSWERED_WITHIN: Duration = Duration::from_millis(500);
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
    /// Groups of submissions; on SQLite, of all changes.
    submissions: Group,
    /// Groups of claims, on PostgreSQL.
    claims: Group,
    /// Groups of ends of attempts, on PostgreSQL.
    ends: Group,
    /// Time of the last look at the queue, by [`Shared::elapsed`]; `None` if the last claim found no
    /// job.
    busy_since_look: Mutex<Option<Duration>>,
    changes: broadcast::Sender<Change>,
    ids: Arc<IdGenerator>,
    far: Arc<FarPlace>,
    /// Looks at the queue since the start or since the last outage; `None` before the first one.
    looks: Mutex<Option<Looks>>,
    watch: Stopwatch,
    /// Tasks that change records. Closed when the store is.
    changing: TaskTracker,
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
        let group = match (O::GROUPED, &self.engine) {
            (Grouped::Never, _) | (Grouped::OnSqlite, Engine::Postgres(_)) => None,
            (_, Engine::Sqlite(_)) | (Grouped::Submissions, _) => Some(&self.submissions),
            (Grouped::Claims, _) => Some(&self.claims),
            (Grouped::Ends, _) => Some(&self.ends),
        };
        if let Some(group) = group {
            match group.transact(self, call, operation).await {
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

    /// Time since the store was opened, whatever the clock was set to.
    fn elapsed(&self) -> Duration {
        self.options.clock.elapsed(&self.watch)
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
            submissions: Group::default(),
            claims: Group::default(),
            ends: Group::default(),
            busy_since_look: Mutex::default(),
            changes,
            ids: Arc::new(IdGenerator::new()),
            far: Arc::default(),
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

    /// A place that submissions need not count the jobs before.
    pub(super) fn far_place(&self) -> Arc<FarPlace> {
        Arc::clone(&self.shared.far)
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

    /// True if the queue need not be looked at before a claim: the last claim found a job, and the
    /// last look was not long ago.
    pub(super) fn is_busy(&self) -> bool {
        let now = self.shared.elapsed();
        self.shared.busy_since_look.lock().is_some_and(|look| now.saturating_sub(look) < LOOK_EVERY)
    }

    /// Notes a look at the queue.
    pub(super) fn note_look(&self) {
        *self.shared.busy_since_look.lock() = Some(self.shared.elapsed());
    }

    /// Notes that a claim found no job.
    pub(super) fn note_idle(&self) {
        *self.shared.busy_since_look.lock() = None;
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

    /// Notes a look at the queue at `now`. Returns true if leases that have expired by then may be
    /// ended.
    pub(super) fn may_expire(&self, now: Timestamp, lease: Duration) -> bool {
        Looks::may_expire(&mut self.shared.looks.lock(), now, self.shared.elapsed(), lease)
    }
}
