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
//! - **A database that does not answer** fails every use after a deadline; see `pool`.
//! - **A process that stalls** inside a transaction loses it after `IDLE_IN_TRANSACTION`, which
//!   releases its locks. The server closes the connections of a process that has vanished.

mod notify;
pub(super) mod pool;

use super::error::StoreError;
use super::list::Change;
use super::operators::PoolUse;
use super::options::StoreOptions;
use super::sql::{Connection, Severity, SqlError, migrations, migrator};
use crate::clock::Stopwatch;
use notify::Notifier;
use pool::{ACQUIRE_TIMEOUT, Pool};
use sqlx::migrate::MigrateError;
use sqlx::postgres::{PgConnectOptions, PgConnection};
use sqlx::{ConnectOptions as _, Connection as _};
use std::str::FromStr;
use std::time::Duration;
use tokio::sync::broadcast;
use tokio::time::{sleep, timeout};

/// Maximum time that a transaction may wait for its process; the database then aborts it.
const IDLE_IN_TRANSACTION: &str = "5s";
/// Maximum time of a migration, which may wait for that of another process.
const MIGRATION_TIMEOUT: Duration = Duration::from_secs(30 * 60);
/// Wait before a start that found no database tries again, for [`ACQUIRE_TIMEOUT`] in total.
const RETRY_WAIT: Duration = Duration::from_millis(200);
/// Settings by which the server notices within half a minute that a process has vanished.
const KEEPALIVE: [(&str, &str); 4] = [
    ("tcp_keepalives_idle", "10"),
    ("tcp_keepalives_interval", "5"),
    ("tcp_keepalives_count", "3"),
    ("tcp_user_timeout", "25s"),
];
/// Settings of the planner that make every query use its index, even if the statistics describe a
/// queue that was short a minute ago. Parallel workers cost more than any of these queries.
const PLANS: [(&str, &str); 7] = [
    // Plans do not depend on values, and planning a claim takes longer than running it.
    ("plan_cache_mode", "force_generic_plan"),
    ("enable_seqscan", "off"),
    ("enable_bitmapscan", "off"),
    ("enable_hashjoin", "off"),
    ("enable_mergejoin", "off"),
    ("jit", "off"),
    ("max_parallel_workers_per_gather", "0"),
];

/// Migrations of the tables, oldest first.
const MIGRATIONS: [(&str, &str); 19] = migrations![
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
    "0012_worker_conditions",
    "0013_fit_lane",
    "0014_operations",
    "0015_packs",
    "0016_short_models",
    "0017_spent_ids",
    "0018_functions",
    "0019_fewer_indexes",
];

/// The connections to a PostgreSQL database.
#[derive(Debug)]
pub(super) struct Postgres {
    pool: Pool,
    notifier: Notifier,
}

/// Migrates the tables of the database at `url`. Tables of a newer version stay unchanged, so that
/// versions can run side by side during an upgrade. Retries for some seconds if the database is
/// unavailable, because it may be restarting.
pub(super) async fn migrate(url: &str) -> Result<(), StoreError> {
    let connect = connect_options(url)?;
    let since = Stopwatch::start();
    loop {
        let Err(error) = migrate_once(&connect).await else { return Ok(()) };
        if severity(&error) != Severity::Outage || since.elapsed() > ACQUIRE_TIMEOUT {
            return Err(error.into());
        }
        tracing::warn!(%error, "the database is unavailable; trying again");
        sleep(RETRY_WAIT).await;
    }
}

async fn migrate_once(connect: &PgConnectOptions) -> Result<(), SqlError> {
    let connected = timeout(ACQUIRE_TIMEOUT, connect.connect()).await;
    let mut connection: PgConnection = connected.map_err(|_| SqlError::NoAnswer(ACQUIRE_TIMEOUT))??;
    let migrated = timeout(MIGRATION_TIMEOUT, migrator(&MIGRATIONS).run_direct(None, &mut connection, false)).await;
    // Fails if the connection is lost; the server then closes its end by itself.
    let _ = timeout(ACQUIRE_TIMEOUT, connection.close()).await;
    migrated.map_err(|_| SqlError::NoAnswer(MIGRATION_TIMEOUT))?.map_err(|error| match error {
        MigrateError::Execute(error) | MigrateError::ExecuteMigration(error, _) => SqlError::Database(error),
        error => StoreError::Database(Box::new(error)).into(),
    })
}

fn connect_options(url: &str) -> Result<PgConnectOptions, StoreError> {
    let options = PgConnectOptions::from_str(url).map_err(SqlError::from)?;
    Ok(options.application_name("oviduct").options(KEEPALIVE))
}

/// Settings of the sessions that run transactions. The server ends a statement shortly before the
/// process stops waiting for its answer, and a wait for a lock after half of that time.
fn session_options(answer_within: Duration) -> [(&'static str, String); 4] {
    let limit = |share: f64| format!("{}ms", answer_within.mul_f64(share).as_millis());
    [
        ("idle_in_transaction_session_timeout", IDLE_IN_TRANSACTION.to_owned()),
        ("lock_timeout", limit(0.5)),
        ("statement_timeout", limit(0.9)),
        // A database whose default is weaker would lose accepted jobs.
        ("synchronous_commit", "on".to_owned()),
    ]
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
        let session = connect.clone().options(PLANS).options(session_options(options.answer_within));
        let pool = pool::pool(session, options);
        // Settings that the server refuses fail the start, not the first request.
        drop(pool::acquire(&pool).await?);
        let notifier = Notifier::start(connect, pool.clone(), changes).await?;
        Ok(Self { pool, notifier })
    }

    /// A session in a new transaction.
    pub(super) async fn begin(&self) -> Result<Connection, SqlError> {
        let mut session = pool::acquire(&self.pool).await?;
        session.begin();
        Ok(Connection::Postgres(session))
    }

    /// A session for reading alone.
    pub(super) async fn reader(&self) -> Result<Connection, SqlError> {
        Ok(Connection::Postgres(pool::acquire(&self.pool).await?))
    }

    /// True if the database answered this process `within` this time, whatever the question was.
    pub(super) fn answered_within(&self, within: Duration) -> bool {
        pool::answers(&self.pool).any_within(within)
    }

    /// Consequence of an error for the caller.
    pub(super) fn severity(&self, error: &SqlError) -> Severity {
        severity(error)
    }

    /// Use of the pool of connections.
    pub(super) fn pools(&self) -> Vec<PoolUse> {
        let status = self.pool.status();
        let [open, idle, most] = [status.size, status.available, status.max_size].map(|sessions| sessions as u32);
        vec![PoolUse { name: "postgres", open, idle, most }]
    }

    /// Notifies other processes.
    pub(super) fn notify(&self, changes: &[Change]) {
        self.notifier.send(changes);
    }

    /// Sends the last notifications and closes all idle sessions; the others close when their
    /// callers return them.
    pub(super) async fn close(&self) {
        self.notifier.close().await;
        self.pool.close();
    }
}

fn severity(error: &SqlError) -> Severity {
    let error = match error {
        SqlError::Store(_) | SqlError::BrokenRecord(_) | SqlError::Inconsistent(_) => return Severity::Permanent,
        SqlError::OwnerLocked | SqlError::Unknown => return Severity::Transient,
        SqlError::NoAnswer(_) => return Severity::Outage,
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
