//! The job store on PostgreSQL, shared by any number of processes. Its operations are in `jobs::sql`.
//!
//! - **Leases do not depend on the clocks of workers**: the time of every lease and record is that of the database
//!   (`clock_timestamp()`), read within the transaction. Only a store with a manual [`Clock`], as in tests, uses that.
//! - **Claims** take several rows in one statement and skip those that another claim has locked
//!   (`FOR UPDATE SKIP LOCKED`). No transaction is open while a job runs.
//! - **Changes** are sent to other processes by `NOTIFY` after the commit, see `notify`.
//! - **Outages** (a restart, a failover): a transaction that was rolled back is run again; if the answer to a commit was
//!   lost, the records are read to find out whether it succeeded.
//! - **A process that stalls** inside a transaction loses it after `IDLE_IN_TRANSACTION`, so that its locks are released.

mod notify;

use super::operators::PoolUse;
use super::sql::{
    Connection, Done, Engine, Operation, Reader, SqlError, SqlStore, Time, Trouble, Tx, migrations, migrator,
    run_or_find,
};
use super::store::{Change, StoreError, StoreOptions};
use crate::clock::Clock;
use notify::Notifier;
use sqlx::postgres::{PgConnectOptions, PgPool, PgPoolOptions};
use std::str::FromStr;
use std::time::Duration;

/// Longest wait for a connection.
const ACQUIRE: Duration = Duration::from_secs(5);
/// How long a transaction may wait for its process before the database aborts it.
const IDLE_IN_TRANSACTION: &str = "5s";
/// How long a statement may wait for a lock, and how long it may run.
const LOCK: &str = "10s";
const STATEMENT: &str = "30s";
/// Every query uses its index, whatever the statistics say about a queue that was short a minute ago. Parallel workers cost
/// more than any of these queries.
const PLANS: [(&str, &str); 5] = [
    ("enable_seqscan", "off"),
    ("enable_hashjoin", "off"),
    ("enable_mergejoin", "off"),
    ("jit", "off"),
    ("max_parallel_workers_per_gather", "0"),
];

/// The tables, and how they became what they are.
const MIGRATIONS: [(&str, &str); 10] = migrations![
    "0001_jobs",
    "0002_priorities",
    "0003_traces",
    "0004_upkeep",
    "0005_owners",
    "0006_studies",
    "0007_claiming",
    "0008_front_ends",
    "0009_shared_growth",
    "0010_fits",
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
    /// [`StoreError::Database`] if the URL is invalid or the database cannot be reached.
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
            manual @ Clock::Manual(_) => Time::of(manual.clone()),
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
    let migrated = migrator(&MIGRATIONS).run(&pool).await;
    pool.close().await;
    migrated.map_err(|error| StoreError::Database(error.to_string()))
}

fn connect_options(url: &str) -> Result<PgConnectOptions, StoreError> {
    let options = PgConnectOptions::from_str(url).map_err(|error| StoreError::Database(error.to_string()))?;
    Ok(options.application_name("oviduct"))
}

impl Engine for Postgres {
    async fn once<O: Operation>(
        &self,
        operation: &O,
        options: &StoreOptions,
        unknown: &mut bool,
    ) -> Result<Done<O::Output>, SqlError> {
        let mut transaction = self.pool.begin().await?;
        let mut tx = Tx::new(Connection::Postgres(&mut transaction), &self.time);
        match run_or_find(operation, &mut tx, options, *unknown).await {
            Ok(done) => {
                *unknown = true;
                transaction.commit().await?;
                Ok(done)
            }
            Err(error) => {
                // Awaited, because the next claim would skip rows that are still locked. If it fails, the connection is
                // lost, and its locks with it.
                let _ = transaction.rollback().await;
                Err(error)
            }
        }
    }

    fn trouble(&self, error: &SqlError) -> Trouble {
        let error = match error {
            SqlError::Store(_) => return Trouble::Lasting,
            SqlError::OwnerLocked => return Trouble::Passing,
            SqlError::Database(error) => error,
        };
        match error {
            sqlx::Error::Io(_) | sqlx::Error::PoolTimedOut | sqlx::Error::WorkerCrashed => Trouble::Outage,
            // A connection that was closed in the middle of an answer.
            sqlx::Error::Protocol(_) => Trouble::Outage,
            sqlx::Error::Database(error) => {
                let code = error.code().unwrap_or_default();
                let class = |classes: &[&str]| classes.iter().any(|class| code.starts_with(class));
                // Two submissions with the same idempotency key, or a second try after a commit that succeeded after all:
                // the next try finds the other's record.
                let is_key = |name: &str| name.contains("idempotency_key") || name.ends_with("_pkey");
                let same_key = code == "23505" && error.constraint().is_some_and(is_key);
                if class(&["08", "53", "57P", "58"]) || code == "25006" {
                    // Connection lost; no connection, disk space or memory left; shutting down or starting up; I/O error;
                    // a standby after a failover.
                    Trouble::Outage
                } else if same_key || class(&["40"]) || ["55P03", "25P03", "57014"].contains(&code.as_ref()) {
                    // Serialization, deadlock; lock timeout, transaction timeout, statement timeout.
                    Trouble::Passing
                } else {
                    Trouble::Lasting
                }
            }
            _ => Trouble::Lasting,
        }
    }

    fn is_closed(&self) -> bool {
        self.pool.is_closed()
    }

    async fn reader(&self) -> Result<Reader, SqlError> {
        Ok(Reader::Postgres(self.pool.acquire().await?))
    }

    fn time(&self) -> &Time {
        &self.time
    }

    fn pools(&self) -> Vec<PoolUse> {
        let idle = u32::try_from(self.pool.num_idle()).unwrap_or(u32::MAX);
        vec![PoolUse {
            name: "postgres",
            open: self.pool.size(),
            idle,
            most: self.pool.options().get_max_connections(),
        }]
    }

    fn notify(&self, changes: &[Change]) {
        self.notifier.send(changes);
    }

    async fn close(&self) {
        self.notifier.close().await;
        self.pool.close().await;
    }
}
