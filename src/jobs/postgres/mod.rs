//! PostgreSQL as the database of a job store, shared by any number of processes.
//!
//! - **Leases do not depend on the clocks of workers.** The time of every lease and record is the
//!   time of the database (`clock_timestamp()`), read within the transaction. Only a store with a
//!   manual clock, as in tests, uses that clock.
//! - **Claims** take several rows in one statement and skip rows that another claim has locked
//!   (`FOR UPDATE SKIP LOCKED`). No transaction is open while a job runs.
//! - **Changes** are sent to other processes by `NOTIFY` after the commit; see `notify`.
//! - **Outages** (a restart, a failover): the store retries a transaction that was rolled back. If
//!   the response to a commit was lost, the store reads the records to find out whether the commit
//!   succeeded.
//! - **A process that stalls** inside a transaction loses it after `IDLE_IN_TRANSACTION`, which
//!   releases its locks.

mod notify;

use super::error::StoreError;
use super::list::Change;
use super::operators::PoolUse;
use super::options::StoreOptions;
use super::sql::{Connection, Severity, SqlError, migrations, migrator};
use notify::Notifier;
use sqlx::postgres::{PgConnectOptions, PgPool, PgPoolOptions};
use std::str::FromStr;
use std::time::Duration;
use tokio::sync::broadcast;

/// Maximum wait for a connection.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum time that a transaction may wait for its process; the database then aborts it.
const IDLE_IN_TRANSACTION: &str = "5s";
/// Maximum time that a statement may wait for a lock.
const LOCK_TIMEOUT: &str = "10s";
/// Maximum time that a statement may run.
const STATEMENT_TIMEOUT: &str = "30s";
/// Settings of the planner that make every query use its index, even if the statistics describe a
/// queue that was short a minute ago. Parallel workers cost more than any of these queries.
const PLANS: [(&str, &str); 5] = [
    ("enable_seqscan", "off"),
    ("enable_hashjoin", "off"),
    ("enable_mergejoin", "off"),
    ("jit", "off"),
    ("max_parallel_workers_per_gather", "0"),
];

/// Migrations of the tables, oldest first.
const MIGRATIONS: [(&str, &str); 11] = migrations![
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
    "0011_upkeep_state",
];

/// The connections to a PostgreSQL database.
#[derive(Debug)]
pub(super) struct Postgres {
    pool: PgPool,
    notifier: Notifier,
}

/// Migrates the tables of the database at `url`. Tables of a newer version stay unchanged, so that
/// versions can run side by side during an upgrade.
pub(super) async fn migrate(url: &str) -> Result<(), StoreError> {
    let pool = PgPoolOptions::new()
        .max_connections(1)
        .acquire_timeout(ACQUIRE_TIMEOUT)
        .connect_with(connect_options(url)?)
        .await
        .map_err(SqlError::from)?;
    let migrated = migrator(&MIGRATIONS).run(&pool).await;
    pool.close().await;
    migrated.map_err(|error| StoreError::Database(Box::new(error)))
}

fn connect_options(url: &str) -> Result<PgConnectOptions, StoreError> {
    let options = PgConnectOptions::from_str(url).map_err(SqlError::from)?;
    Ok(options.application_name("oviduct"))
}

impl Postgres {
    /// Connects to the database at `url` (`postgres://user:password@host/name?sslmode=…`) and
    /// migrates its tables; several processes may do so at the same time. Changes made by other
    /// processes go to `changes`.
    pub(super) async fn open(
        url: &str,
        options: &StoreOptions,
        changes: broadcast::Sender<Change>,
    ) -> Result<Self, StoreError> {
        migrate(url).await?;
        let connect = connect_options(url)?;
        let pool = PgPoolOptions::new()
            .max_connections(options.connections)
            .acquire_timeout(ACQUIRE_TIMEOUT)
            .connect_with(connect.clone().options(PLANS).options([
                ("idle_in_transaction_session_timeout", IDLE_IN_TRANSACTION),
                ("lock_timeout", LOCK_TIMEOUT),
                ("statement_timeout", STATEMENT_TIMEOUT),
            ]))
            .await
            .map_err(SqlError::from)?;
        let notifier = Notifier::start(connect, pool.clone(), changes).await.map_err(SqlError::from)?;
        Ok(Self { pool, notifier })
    }

    /// A connection in a new transaction.
    pub(super) async fn begin(&self) -> Result<Connection, SqlError> {
        Ok(Connection::PostgresTransaction(self.pool.begin().await?))
    }

    /// A connection for reading alone.
    pub(super) async fn reader(&self) -> Result<Connection, SqlError> {
        Ok(Connection::Postgres(self.pool.acquire().await?))
    }

    /// Consequence of an error for the caller.
    pub(super) fn severity(&self, error: &SqlError) -> Severity {
        let error = match error {
            SqlError::Store(_) | SqlError::BrokenRecord(_) | SqlError::Inconsistent(_) => return Severity::Permanent,
            SqlError::OwnerLocked => return Severity::Transient,
            SqlError::Database(error) => error,
        };
        match error {
            sqlx::Error::Io(_) | sqlx::Error::PoolTimedOut | sqlx::Error::WorkerCrashed => Severity::Outage,
            // A connection that was closed in the middle of a response.
            sqlx::Error::Protocol(_) => Severity::Outage,
            sqlx::Error::Database(error) => {
                let code = error.code().unwrap_or_default();
                let class = |classes: &[&str]| classes.iter().any(|class| code.starts_with(class));
                // Two submissions with the same idempotency key, or a retry after a commit that
                // succeeded nevertheless: the next run finds the other record.
                let is_key = |name: &str| name.contains("idempotency_key") || name.ends_with("_pkey");
                let same_key = code == "23505" && error.constraint().is_some_and(is_key);
                if class(&["08", "53", "57P", "58"]) || code == "25006" {
                    // Connection lost; no connection, disk space or memory left; shutting down or
                    // starting up; I/O error; a standby after a failover.
                    Severity::Outage
                } else if same_key || class(&["40"]) || ["55P03", "25P03", "57014"].contains(&code.as_ref()) {
                    // Serialization, deadlock; lock timeout, transaction timeout, statement
                    // timeout.
                    Severity::Transient
                } else {
                    Severity::Permanent
                }
            }
            _ => Severity::Permanent,
        }
    }

    /// True after [`Postgres::close`].
    pub(super) fn is_closed(&self) -> bool {
        self.pool.is_closed()
    }

    /// Use of the pool of connections.
    pub(super) fn pools(&self) -> Vec<PoolUse> {
        let (open, most) = (self.pool.size(), self.pool.options().get_max_connections());
        let idle = u32::try_from(self.pool.num_idle()).unwrap_or(u32::MAX);
        vec![PoolUse { name: "postgres", open, idle, most }]
    }

    /// Notifies other processes.
    pub(super) fn notify(&self, changes: &[Change]) {
        self.notifier.send(changes);
    }

    /// Sends the last notifications and closes all connections.
    pub(super) async fn close(&self) {
        self.notifier.close().await;
        self.pool.close().await;
    }
}
