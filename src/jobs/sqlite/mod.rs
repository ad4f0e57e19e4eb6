//! SQLite as the database of a job store: one file, or memory for tests.
//!
//! The file is in WAL mode, with one connection that writes and several that read, so readers never
//! wait for a writer. `synchronous = FULL` makes an accepted job survive a power failure. A commit
//! costs one fsync, which is short compared with the growth of a model.
//!
//! - **Writers** begin with `BEGIN IMMEDIATE`, so what they read is still true when they write.
//! - **Full disk**: the write-ahead log is some megabytes longer than checkpoints need, so records
//!   can still be changed and deleted on a full disk. Once this reserve is used up, changes fail
//!   until there is space.
//! - **One process** at a time opens a file; locks of it and of a file next to it ensure that.
//!   Therefore [`Store::recover`](super::Store::recover) may end the attempts of earlier processes.
//! - **Time** is the clock of the process. Leases and delays use monotonic time, so setting the
//!   clock ends no attempt.
//! - **Specs** are compressed ([`packed`]), so that a submission writes few pages.
//! - **Damage** is searched for at the start (`check`). Otherwise a damaged file would fail only at
//!   the first query that reads a damaged page.

pub(super) mod packed;
pub(super) mod pool;

use super::error::StoreError;
use super::folders::create_durably;
use super::operators::PoolUse;
use super::options::StoreOptions;
use super::sql::{Connection, Severity, SqlError, migrations, migrator, roll_back};
use crate::clock::Stopwatch;
use pool::{Pool, acquire, pool};
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqliteSynchronous};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection as _};
use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Migrations of the tables, oldest first.
const MIGRATIONS: [(&str, &str); 20] = migrations![
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
    "0013_upkeep_state",
    "0014_worker_conditions",
    "0015_fit_lane",
    "0016_operations",
    "0017_packs",
    "0018_short_models",
    "0019_spent_ids",
    "0020_fewer_pages",
];

/// Maximum wait of a connection for a lock of another process.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Minimum length of the write-ahead log, bytes. At 4 MB, SQLite writes the log back into the
/// database file and then overwrites it from the beginning; the rest is the reserve for a full
/// disk.
const LOG: u64 = 8 << 20;
/// Maximum time of the check at the start, which reads 100 MB/s or more. In a file that takes
/// longer, the rest is not checked.
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

/// Reason why a database file cannot be used.
#[derive(Debug, thiserror::Error)]
enum FileError {
    #[error("{}: {source}", .path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("{} is in use by another process", .path.display())]
    InUse { path: PathBuf },
    #[error(
        "{} is damaged ({detail}). Restore it from a backup: docs/operations.md, \"Backup and restore\"",
        .path.display()
    )]
    Damaged { path: PathBuf, detail: String, source: Option<sqlx::Error> },
}

impl From<FileError> for StoreError {
    fn from(error: FileError) -> Self {
        Self::Database(Box::new(error))
    }
}

/// The connections to a SQLite database.
#[derive(Debug)]
pub(super) struct Sqlite {
    writer: Pool,
    reader: Pool,
    /// Held while the file is open.
    lock: Option<FileLock>,
}

impl Sqlite {
    /// Opens the file at `path`, creates it if it does not exist, and migrates its tables.
    pub(super) async fn open(path: &Path, options: &StoreOptions) -> Result<Self, StoreError> {
        let failed = |source| FileError::Io { path: path.to_owned(), source };
        if let Some(parent) = path.parent() {
            create_durably(parent).map_err(failed)?;
        }
        let Some(lock) = lock(path)? else { return Err(FileError::InUse { path: path.to_owned() }.into()) };
        let connect = connect_options(path);
        check(path, &connect).await?;
        let writer = pool(connect.clone(), 1);
        migrate(&writer).await?;
        reserve(&writer).await?;
        let reader = pool(connect.pragma("query_only", "ON"), options.readers);
        Ok(Self { writer, reader, lock: Some(lock) })
    }

    /// Opens a file that another process has open, for changes of single rows. `None` if no other
    /// process has it open.
    pub(super) async fn open_shared(path: &Path) -> Result<Option<Self>, StoreError> {
        // The other process has checked and migrated the file.
        if !path.exists() || lock(path)?.is_some() {
            return Ok(None);
        }
        let connect = connect_options(path).create_if_missing(false);
        let writer = pool(connect, 1);
        Ok(Some(Self { reader: writer.clone(), writer, lock: None }))
    }

    /// Opens an empty database in memory. One connection reads and writes; the data are lost with
    /// it.
    pub(super) async fn open_in_memory() -> Result<Self, StoreError> {
        let connect = SqliteConnectOptions::new().in_memory(true).foreign_keys(true);
        let writer = pool(connect, 1);
        migrate(&writer).await?;
        Ok(Self { reader: writer.clone(), writer, lock: None })
    }

    /// A connection in a new transaction.
    pub(super) async fn begin(&self) -> Result<Connection, SqlError> {
        let mut connection = acquire(&self.writer).await?;
        begin(&mut connection).await?;
        Ok(Connection::Sqlite(connection))
    }

    /// A connection for reading alone.
    pub(super) async fn reader(&self) -> Result<Connection, SqlError> {
        Ok(Connection::Sqlite(acquire(&self.reader).await?))
    }

    /// Consequence of an error for the caller.
    pub(super) fn severity(&self, error: &SqlError) -> Severity {
        let error = match error {
            SqlError::Database(error) => error,
            SqlError::NoAnswer(_) => return Severity::Outage,
            SqlError::Unknown => return Severity::Transient,
            _ => return Severity::Permanent,
        };
        let passing = [code::BUSY, code::LOCKED, code::IOERR, code::FULL, code::CANTOPEN, code::PROTOCOL];
        let timed_out = matches!(error, sqlx::Error::PoolTimedOut);
        if timed_out || primary(error).is_some_and(|code| passing.contains(&code)) {
            Severity::Outage
        } else {
            Severity::Permanent
        }
    }

    /// Use of the pools of connections.
    pub(super) fn pools(&self) -> Vec<PoolUse> {
        vec![pool_use("readers", &self.reader), pool_use("writer", &self.writer)]
    }

    /// Closes all connections and releases the lock of the file.
    pub(super) async fn close(&self) {
        pool::close(&self.reader).await;
        // Last, so that it writes the log back into the database file.
        pool::close(&self.writer).await;
        // Explicitly: a child process between fork and exec shares the handle, and with it the
        // lock.
        if let Some(Err(error)) = self.lock.as_ref().map(FileLock::unlock) {
            tracing::warn!(%error, "could not release the lock of the job store; the next start may have to wait for it");
        }
    }
}

/// The locks of a database file. Both belong to this process while it has the file open.
#[derive(Debug)]
struct FileLock {
    /// The lock file, which all versions lock.
    beside: File,
    /// The database file: somebody may remove the lock file. `None` where a lock would exclude
    /// SQLite itself.
    database: Option<File>,
}

impl FileLock {
    fn unlock(&self) -> io::Result<()> {
        self.database.as_ref().map_or(Ok(()), File::unlock)?;
        self.beside.unlock()
    }
}

/// Locks the file at `path` for this process, and creates it if it does not exist. `None` if
/// another process has it open.
fn lock(path: &Path) -> Result<Option<FileLock>, FileError> {
    let failed = |source| FileError::Io { path: path.to_owned(), source };
    let beside = File::create(path.with_added_extension("lock")).map_err(failed)?;
    if !is_locked(&beside, path) {
        return Ok(None);
    }
    // `flock` on Unix, which does not interfere with the locks of SQLite.
    let database = if cfg!(unix) {
        let mut options = File::options();
        Some(options.read(true).append(true).create(true).open(path).map_err(failed)?)
    } else {
        None
    };
    if database.as_ref().is_some_and(|database| !is_locked(database, path)) {
        return Ok(None);
    }
    Ok(Some(FileLock { beside, database }))
}

/// Locks a file for this process. False if another process has locked it.
fn is_locked(file: &File, path: &Path) -> bool {
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => return false,
        Err(TryLockError::Error(error)) => {
            tracing::warn!(path = %path.display(), %error, "could not lock the job store; make sure that only one process uses it");
        }
        Ok(()) => {}
    }
    true
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

/// Refuses a damaged file, by `PRAGMA quick_check` of at most [`CHECK_TIME`].
async fn check(path: &Path, connect: &SqliteConnectOptions) -> Result<(), StoreError> {
    let damaged = |detail, source| FileError::Damaged { path: path.to_owned(), detail, source }.into();
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
        Ok(found) => Err(damaged(found.lines().collect::<Vec<_>>().join(" "), None)),
        Err(error) => match primary(&error) {
            Some(code::INTERRUPT) => {
                let seconds = CHECK_TIME.as_secs();
                tracing::warn!(path = %path.display(), seconds, "the job store is too large to check all of it at the start");
                Ok(())
            }
            Some(code::CORRUPT | code::NOTADB) => Err(damaged(error.to_string(), Some(error))),
            _ => Err(SqlError::from(error).into()),
        },
    }
}

fn pool_use(name: &'static str, pool: &Pool) -> PoolUse {
    let status = pool.status();
    let [open, idle, most] = [status.size, status.available, status.max_size].map(|connections| connections as u32);
    PoolUse { name, open, idle, most }
}

async fn migrate(writer: &Pool) -> Result<(), StoreError> {
    let mut connection = acquire(writer).await?;
    // A migration that rebuilds a table would delete the rows that refer to it.
    sqlx::query("PRAGMA foreign_keys = OFF").execute(&mut *connection).await.map_err(SqlError::from)?;
    let migrated = migrator(&MIGRATIONS).run_direct(None, &mut *connection, false).await;
    migrated.map_err(|error| StoreError::Database(Box::new(error)))?;
    sqlx::query("PRAGMA foreign_keys = ON").execute(&mut *connection).await.map_err(SqlError::from)?;
    Ok(())
}

/// Extends the log to [`LOG`] by a large write that is rolled back, which leaves the length of the
/// file unchanged. If the disk is full already, the store opens without this reserve.
async fn reserve(writer: &Pool) -> Result<(), SqlError> {
    let mut connection = acquire(writer).await?;
    begin(&mut connection).await?;
    let sql = format!("CREATE TABLE room AS SELECT zeroblob({LOG}) AS bytes");
    let grown = sqlx::query(AssertSqlSafe(sql)).execute(&mut *connection).await;
    roll_back(&mut connection).await;
    if let Err(error) = grown {
        tracing::warn!(
            %error,
            "could not reserve space in the write-ahead log; if the disk fills up, cancelling and deleting models may fail"
        );
    }
    Ok(())
}

/// Begins a transaction by an explicit statement. On a full disk SQLite rolls back by itself, and
/// sqlx would consider its own transaction open for ever.
async fn begin(connection: &mut SqliteConnection) -> Result<(), SqlError> {
    let begin = "BEGIN IMMEDIATE";
    if sqlx::query(begin).execute(&mut *connection).await.is_err() {
        // A panic may have left a transaction open.
        roll_back(connection).await;
        sqlx::query(begin).execute(connection).await?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
