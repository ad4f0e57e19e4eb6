//! The job store on PostgreSQL, shared by any number of processes. What it does is in `jobs::sql`.
//!
//! - **Leases do not depend on the clocks of workers**: the time of every lease and record is that of the database
//!   (`clock_timestamp()`), asked for within the transaction. Only where the store's [`Clock`] is set by hand, as in
//!   tests, is that one the time.
//! - **Claims** take several rows in one statement and pass over those that another is just taking
//!   (`FOR UPDATE SKIP LOCKED`). No transaction is open while a job runs.
//! - **Changes** are told to other processes by `NOTIFY` once they stand, see `notify`.
//! - **A database that goes away** (a restart, a failover) is waited for: what was rolled back is done again, and
//!   after a commit whose answer got lost the records are asked whether it stands. An end of an attempt is tried for a
//!   minute, all else for some seconds.
//! - **A process that stalls** inside a transaction loses it after `IDLE_IN_TRANSACTION`, so that no lock outlives it.

mod notify;

use super::sql::{Connection, Done, Engine, Link, Operation, Reader, SqlError, SqlStore, Time};
use super::store::{Change, StoreError, StoreOptions};
use crate::clock::{Clock, Stopwatch};
use notify::Notifier;
use sqlx::postgres::{PgConnectOptions, PgPool, PgPoolOptions};
use std::str::FromStr;
use std::time::Duration;

/// How long a connection is waited for.
const ACQUIRE: Duration = Duration::from_secs(5);
/// First and longest wait before a transaction is tried again.
const WAITS: (Duration, Duration) = (Duration::from_millis(20), Duration::from_secs(1));
/// How long a transaction may wait for its process before the database breaks it off.
const IDLE_IN_TRANSACTION: &str = "5s";
/// How long a statement may wait for another's lock, and run.
const LOCK: &str = "10s";
const STATEMENT: &str = "30s";
/// Every query is kept to its index, whatever the statistics say of a queue that was short a minute ago.
/// Processes that help with one cost more than any query here takes alone.
const PLANS: [(&str, &str); 5] = [
    ("enable_seqscan", "off"),
    ("enable_hashjoin", "off"),
    ("enable_mergejoin", "off"),
    ("jit", "off"),
    ("max_parallel_workers_per_gather", "0"),
];

/// The job store on PostgreSQL. Clones share it.
pub type PostgresStore = SqlStore<Postgres>;

/// The connections to a PostgreSQL database.
#[derive(Debug)]
pub struct Postgres {
    pool: PgPool,
    time: Time,
    notifier: Notifier,
}

impl PostgresStore {
    /// Connects to the database at `url` (`postgres://user:password@host/name?sslmode=…`) and brings its tables up
    /// to date; several processes may do so at a time.
    ///
    /// # Errors
    /// [`StoreError::Database`] where the URL cannot be read or the database not be reached.
    pub async fn open(url: &str, options: StoreOptions) -> Result<Self, StoreError> {
        migrate(url).await?;
        let connect = connect_options(url)?;
        let pool = PgPoolOptions::new()
            .max_connections(options.connections)
            .acquire_timeout(ACQUIRE)
            .connect_with(connect.clone().options(PLANS).options([
                ("idle_in_transaction_session_timeout", IDLE_IN_TRANSACTION),
                ("lock_timeout", LOCK),
                ("statement_timeout", STATEMENT),
            ]))
            .await
            .map_err(SqlError::from)?;
        let time = match &options.clock {
            Clock::System => Time::Database,
            by_hand @ Clock::Manual(_) => Time::of(by_hand.clone()),
        };
        let changes = Self::channel();
        let notifier = Notifier::start(connect, pool.clone(), changes.clone()).await.map_err(SqlError::from)?;
        Ok(Self::over(Postgres { pool, time, notifier }, options, changes))
    }
}

/// Brings the tables of the database at `url` up to date. Tables that a newer version made are left as they are, so
/// that versions can run side by side during an upgrade.
///
/// # Errors
/// [`StoreError::Database`].
pub async fn migrate(url: &str) -> Result<(), StoreError> {
    let pool = PgPoolOptions::new()
        .max_connections(1)
        .acquire_timeout(ACQUIRE)
        .connect_with(connect_options(url)?)
        .await
        .map_err(SqlError::from)?;
    let migrated = sqlx::migrate!("src/jobs/postgres/migrations").set_ignore_missing(true).run(&pool).await;
    pool.close().await;
    migrated.map_err(|error| StoreError::Database(error.to_string()))
}

fn connect_options(url: &str) -> Result<PgConnectOptions, StoreError> {
    let options = PgConnectOptions::from_str(url).map_err(|error| StoreError::Database(error.to_string()))?;
    Ok(options.application_name("oviduct"))
}

/// Whether a transaction that ended in this way may fare better another time.
fn may_pass(error: &SqlError) -> bool {
    let SqlError::Database(error) = error else { return false };
    match error {
        sqlx::Error::Io(_) | sqlx::Error::PoolTimedOut | sqlx::Error::WorkerCrashed => true,
        // A connection that ended in the middle of an answer.
        sqlx::Error::Protocol(_) => true,
        sqlx::Error::Database(error) => {
            let code = error.code().unwrap_or_default();
            // Two with the same idempotency key at a time, or a try after one whose commit came through after all: the
            // second finds the first when it looks again.
            let is_key = |name: &str| name.contains("idempotency_key") || name.ends_with("_pkey");
            let same_key = code == "23505" && error.constraint().is_some_and(is_key);
            // Connection lost; serialization, deadlock; no lock, no connection left; shutting down or starting up;
            // broken off for stalling.
            let passing = ["08", "40", "57P"].iter().any(|class| code.starts_with(class))
                || ["55P03", "53300", "25P03"].contains(&code.as_ref());
            same_key || passing
        }
        _ => false,
    }
}

impl Postgres {
    /// Tries `operation` once. `unknown` is set where it may have been committed although there was an error; where
    /// it was set before, what was done then is looked for first.
    async fn once<O: Operation>(
        &self,
        operation: &O,
        options: &StoreOptions,
        unknown: &mut bool,
    ) -> Result<Done<O::Output>, SqlError> {
        let mut tx = self.pool.begin().await?;
        let mut link = Link::new(Connection::Postgres(&mut tx), &self.time);
        let before = if *unknown { operation.done_before(&mut link).await } else { Ok(None) };
        let done = match before {
            Ok(Some(done)) => Ok(done),
            Ok(None) => operation.run(&mut link, options).await,
            Err(error) => Err(error),
        };
        match done {
            Ok(done) => {
                *unknown = true;
                tx.commit().await?;
                Ok(done)
            }
            Err(error) => {
                // Here, not some time after the answer: the next claim would pass over rows that are still locked. If
                // it fails, the connection is lost, and the locks with it.
                let _ = tx.rollback().await;
                Err(error)
            }
        }
    }
}

impl Engine for Postgres {
    async fn transact<O: Operation>(&self, operation: &O, options: &StoreOptions) -> Result<Done<O::Output>, SqlError> {
        let since = Stopwatch::start();
        let mut unknown = false;
        let mut wait = WAITS.0;
        loop {
            let error = match self.once(operation, options, &mut unknown).await {
                Ok(done) => return Ok(done),
                Err(error) => error,
            };
            if !may_pass(&error) || since.elapsed() > operation.patience() || self.pool.is_closed() {
                return Err(error);
            }
            tracing::warn!(%error, "a transaction is tried again");
            tokio::time::sleep(wait).await;
            wait = (wait * 2).min(WAITS.1);
        }
    }

    async fn reader(&self) -> Result<Reader, SqlError> {
        Ok(Reader::Postgres(self.pool.acquire().await?))
    }

    fn time(&self) -> &Time {
        &self.time
    }

    fn tell(&self, changes: &[Change]) {
        self.notifier.tell(changes);
    }

    async fn close(&self) {
        self.notifier.close().await;
        self.pool.close().await;
    }
}
