//! The job store on SQLite: one file, or memory for tests. Its operations are in `jobs::sql`.
//!
//! WAL with one writing connection and several reading ones, so readers never wait for a writer.
//! `synchronous = FULL`: an accepted job survives a power failure; a commit costs one fsync, which is small compared with a
//! model. Writers begin with `BEGIN IMMEDIATE`, so that what they read is still true when they write.
//!
//! Full disk: the write-ahead log is kept some megabytes longer than checkpoints need, so that records can still be changed
//! and removed. When that is used up too, changes fail until there is space again.
//!
//! A file is opened by one process at a time (a lock file beside it ensures that), which is what makes
//! [`SqliteStore::recover`] sound. Time is that of the process's clock; leases and delays use monotonic time, so that
//! setting the clock ends no attempt.
//!
//! The file is checked at start (`check`): a damaged one would otherwise fail only at the first query that reads a
//! damaged page.

use super::job::JobId;
use super::operators::PoolUse;
use super::sql::{
    Connection, Done, Engine, Expire, FreeUpkeep, Operation, Reader, SqlError, SqlStore, Time, Trouble, Tx, migrations,
    migrator, run_or_find,
};
use super::store::{Change, StoreError, StoreOptions};
use crate::clock::Stopwatch;
use jiff::Timestamp;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection as _};
use std::fs::{File, TryLockError};
use std::path::Path;
use std::time::Duration;

/// The tables, and how they became what they are.
const MIGRATIONS: [(&str, &str); 12] = migrations![
    "0001_jobs",
    "0002_operations",
    "0003_fair_share",
    "0004_priorities",
    "0005_traces",
    "0006_upkeep",
    "0007_owners",
    "0008_studies",
    "0009_claiming",
    "0010_front_ends",
    "0011_shared_growth",
    "0012_fits",
];

/// How long a connection waits for a lock of another process before it fails.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Least length of the write-ahead log, bytes. SQLite writes it back into the database file from 4 MB on, and then overwrites
/// it from its beginning.
const LOG: u64 = 8 << 20;
/// Longest wait for a free connection.
const ACQUIRE: Duration = Duration::from_secs(10);
/// Longest time of the check at start. It reads the whole file, at some 100 MB/s or more; in a larger file the rest is not
/// checked.
const CHECK_TIME: Duration = Duration::from_secs(20);

/// Primary result codes of SQLite.
mod code {
    pub(super) const BUSY: u32 = 5;
    pub(super) const LOCKED: u32 = 6;
    pub(super) const INTERRUPT: u32 = 9;
    pub(super) const IOERR: u32 = 10;
    pub(super) const CORRUPT: u32 = 11;
    pub(super) const FULL: u32 = 13;
    pub(super) const CANTOPEN: u32 = 14;
    pub(super) const PROTOCOL: u32 = 15;
    pub(super) const NOTADB: u32 = 26;
}

/// The job store on SQLite. Clones share it.
pub type SqliteStore = SqlStore<Sqlite>;

/// The connections to a SQLite database.
#[derive(Debug)]
pub struct Sqlite {
    writer: SqlitePool,
    reader: SqlitePool,
    time: Time,
    /// Held while the store is open.
    lock: Option<File>,
}

impl SqliteStore {
    /// Opens the store in the file at `path`, which is created if it does not exist, and brings its tables up to date.
    /// Jobs that an earlier process left running keep their leases; see [`SqliteStore::recover`].
    ///
    /// # Errors
    /// [`StoreError::Database`] if the file cannot be opened or is damaged, or another process has it open.
    pub async fn open(path: impl AsRef<Path>, options: StoreOptions) -> Result<Self, StoreError> {
        let path = path.as_ref();
        let failed = |error: std::io::Error| StoreError::Database(format!("{}: {error}", path.display()));
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(failed)?;
        }
        let Some(lock) = lock(path)? else {
            return Err(StoreError::Database(format!("{} is in use by another process", path.display())));
        };
        let connect = connect_options(path);
        check(path, &connect).await?;
        let writer = pool(1).connect_with(connect.clone()).await.map_err(SqlError::from)?;
        migrate(&writer).await?;
        reserve(&writer).await?;
        let reader =
            pool(options.readers).connect_with(connect.pragma("query_only", "ON")).await.map_err(SqlError::from)?;
        Ok(Self::with(writer, reader, Some(lock), options))
    }

    /// Opens the file at `path` to manage its keys, also while another process has it open; then it must be up to date.
    /// Nothing else may be done with this store.
    ///
    /// # Errors
    /// As [`SqliteStore::open`].
    pub async fn open_for_keys(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        let path = path.as_ref();
        // Whoever has it open has checked it and brought it up to date.
        if !path.exists() || lock(path)?.is_some() {
            return Self::open(path, StoreOptions::default()).await;
        }
        let connect = connect_options(path).create_if_missing(false);
        let writer = pool(1).connect_with(connect).await.map_err(SqlError::from)?;
        Ok(Self::with(writer.clone(), writer, None, StoreOptions::default()))
    }

    /// Opens an empty store in memory, for tests: one connection reads and writes; the data are lost with it.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn open_in_memory(options: StoreOptions) -> Result<Self, StoreError> {
        let connect = SqliteConnectOptions::new().in_memory(true).foreign_keys(true);
        let writer = pool(1).connect_with(connect).await.map_err(SqlError::from)?;
        migrate(&writer).await?;
        Ok(Self::with(writer.clone(), writer, None, options))
    }

    fn with(writer: SqlitePool, reader: SqlitePool, lock: Option<File>, options: StoreOptions) -> Self {
        let engine = Sqlite { writer, reader, time: Time::of(options.clock.clone()), lock };
        Self::over(engine, options, Self::channel())
    }

    /// Ends at once the attempts that an earlier process left running, and frees its locks of upkeep tasks: to be called at
    /// start, before any worker. Each attempt counts as one whose worker vanished. Returns the jobs concerned.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn recover(&self) -> Result<Vec<JobId>, StoreError> {
        self.run(FreeUpkeep).await?;
        let mut jobs = Vec::new();
        loop {
            let some = self.run(Expire { before: Timestamp::MAX }).await?;
            if some.is_empty() {
                return Ok(jobs);
            }
            jobs.extend(some);
        }
    }
}

/// Locks the file at `path` for this process; `None` if another one has it open.
fn lock(path: &Path) -> Result<Option<File>, StoreError> {
    let failed = |error| StoreError::Database(format!("{}: {error}", path.display()));
    let lock = File::create(path.with_added_extension("lock")).map_err(failed)?;
    match lock.try_lock() {
        Err(TryLockError::WouldBlock) => return Ok(None),
        Err(TryLockError::Error(error)) => {
            tracing::warn!(path = %path.display(), %error, "the job store could not be locked; make sure that only one process uses it");
        }
        Ok(()) => {}
    }
    Ok(Some(lock))
}

fn connect_options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .busy_timeout(BUSY_TIMEOUT)
        .foreign_keys(true)
}

/// The primary result code of an error.
fn primary(error: &sqlx::Error) -> Option<u32> {
    let code: u32 = error.as_database_error()?.code()?.parse().ok()?;
    Some(code & 0xff)
}

/// Refuses a damaged file: `PRAGMA quick_check`, for at most [`CHECK_TIME`].
async fn check(path: &Path, connect: &SqliteConnectOptions) -> Result<(), StoreError> {
    let damaged = |detail: &str| {
        StoreError::Database(format!(
            "{} is damaged ({detail}). Restore it from a backup: docs/operations.md, \"Backup and restore\"",
            path.display()
        ))
    };
    let since = Stopwatch::start();
    let found = async {
        let mut connection = connect.clone().connect().await?;
        connection.lock_handle().await?.set_progress_handler(1000, move || since.elapsed() < CHECK_TIME);
        let found: String = sqlx::query_scalar("PRAGMA quick_check(1)").fetch_one(&mut connection).await?;
        connection.lock_handle().await?.remove_progress_handler();
        connection.close().await?;
        Ok(found)
    };
    match found.await {
        Ok(found) if found == "ok" => Ok(()),
        Ok(found) => Err(damaged(&found.lines().collect::<Vec<_>>().join(" "))),
        Err(error) => match primary(&error) {
            Some(code::INTERRUPT) => {
                let seconds = CHECK_TIME.as_secs();
                tracing::warn!(path = %path.display(), seconds, "the job store is too large to be checked whole at start");
                Ok(())
            }
            Some(code::CORRUPT | code::NOTADB) => Err(damaged(&error.to_string())),
            _ => Err(SqlError::from(error).into()),
        },
    }
}

fn pool(connections: u32) -> SqlitePoolOptions {
    // A connection to memory must never be closed: the data would be lost. Nor are connections tested before each use: they
    // do not fail by themselves, and one is closed if the caller is dropped while it is being tested.
    SqlitePoolOptions::new()
        .min_connections(1)
        .max_connections(connections)
        .acquire_timeout(ACQUIRE)
        .idle_timeout(None)
        .max_lifetime(None)
        .test_before_acquire(false)
}

fn pool_use(name: &'static str, pool: &SqlitePool) -> PoolUse {
    let idle = u32::try_from(pool.num_idle()).unwrap_or(u32::MAX);
    PoolUse { name, open: pool.size(), idle, most: pool.options().get_max_connections() }
}

async fn migrate(pool: &SqlitePool) -> Result<(), StoreError> {
    migrator(&MIGRATIONS).run(pool).await.map_err(|error| StoreError::Database(error.to_string()))
}

/// Makes the log as long as [`LOG`] by a large write that is rolled back: the file keeps its length. If the disk is full
/// already, the store opens without this reserve.
async fn reserve(writer: &SqlitePool) -> Result<(), SqlError> {
    let mut connection = writer.acquire().await?;
    begin(&mut connection).await?;
    let sql = format!("CREATE TABLE room AS SELECT zeroblob({LOG}) AS bytes");
    let grown = sqlx::query(AssertSqlSafe(sql)).execute(&mut *connection).await;
    rollback(&mut connection).await;
    if let Err(error) = grown {
        tracing::warn!(%error, "no space could be reserved for changes of records on a full disk");
    }
    Ok(())
}

/// Begins and ends are explicit statements: on a full disk SQLite rolls back by itself, and sqlx would consider the
/// connection to be in a transaction forever.
async fn begin(connection: &mut SqliteConnection) -> Result<(), SqlError> {
    let begin = "BEGIN IMMEDIATE";
    if sqlx::query(begin).execute(&mut *connection).await.is_err() {
        // A panic may have left one open.
        rollback(connection).await;
        sqlx::query(begin).execute(connection).await?;
    }
    Ok(())
}

/// Fails if SQLite has rolled back already, which is harmless.
async fn rollback(connection: &mut SqliteConnection) {
    let _ = sqlx::query("ROLLBACK").execute(connection).await;
}

impl Engine for Sqlite {
    async fn once<O: Operation>(
        &self,
        operation: &O,
        options: &StoreOptions,
        unknown: &mut bool,
    ) -> Result<Done<O::Output>, SqlError> {
        let mut connection = self.writer.acquire().await?;
        begin(&mut connection).await?;
        let mut tx = Tx::new(Connection::Sqlite(&mut connection), &self.time);
        let committed = match run_or_find(operation, &mut tx, options, *unknown).await {
            Ok(done) => {
                *unknown = true;
                sqlx::query("COMMIT").execute(&mut *connection).await.map(|_| done).map_err(SqlError::from)
            }
            Err(error) => Err(error),
        };
        if committed.is_err() {
            rollback(&mut connection).await;
        }
        committed
    }

    fn trouble(&self, error: &SqlError) -> Trouble {
        let SqlError::Database(error) = error else { return Trouble::Lasting };
        let passes = [code::BUSY, code::LOCKED, code::IOERR, code::FULL, code::CANTOPEN, code::PROTOCOL];
        let waits = matches!(error, sqlx::Error::PoolTimedOut);
        if waits || primary(error).is_some_and(|code| passes.contains(&code)) {
            Trouble::Outage
        } else {
            Trouble::Lasting
        }
    }

    fn is_closed(&self) -> bool {
        self.writer.is_closed()
    }

    async fn reader(&self) -> Result<Reader, SqlError> {
        Ok(Reader::Sqlite(self.reader.acquire().await?))
    }

    fn time(&self) -> &Time {
        &self.time
    }

    fn pools(&self) -> Vec<PoolUse> {
        vec![pool_use("readers", &self.reader), pool_use("writer", &self.writer)]
    }

    /// There are no other processes.
    fn notify(&self, _: &[Change]) {}

    async fn close(&self) {
        self.reader.close().await;
        // Last, so that it writes the log back into the database file.
        self.writer.close().await;
        // Explicitly: a child process between fork and exec shares the handle, and with it the lock.
        if let Some(Err(error)) = self.lock.as_ref().map(File::unlock) {
            tracing::warn!(%error, "the lock of the job store could not be released");
        }
    }
}

#[cfg(test)]
mod tests;
