//! The job store on SQLite: one file, or memory for tests. What it does is in `jobs::sql`.
//!
//! WAL with one writing connection and several reading ones, so readers never wait for a writer.
//! `synchronous = FULL`: an accepted job survives the loss of power, not only of the process; a commit then
//! costs one fsync, which is small against a model. Writers begin with `BEGIN IMMEDIATE`, so that what they
//! read is still true when they write.
//!
//! A full disk: the log is kept some megabytes longer than checkpoints let it grow, so that records can still be changed
//! and removed where nothing else finds room. Where that is used up too, changes fail until there is room again.
//!
//! A file store is held by one process at a time (a lock file beside it says so), which is what makes
//! [`SqliteStore::recover`] sound. Time is that of the process's clock; leases and delays run by time that passes evenly, so
//! that a clock that is set ends no attempt.

use super::job::JobId;
use super::sql::{Connection, Done, Engine, Expire, Link, Operation, Reader, SqlError, SqlStore, Time};
use super::store::{Change, StoreError, StoreOptions};
use sqlx::AssertSqlSafe;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous,
};
use std::fs::{File, TryLockError};
use std::path::Path;
use std::time::Duration;

/// How long a connection waits for another's lock before it fails.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// The length that the write-ahead log has at least. SQLite writes it back into the database file from 4 MB on, and then
/// begins at its front again, in the room that it has.
const LOG: u64 = 8 << 20;
/// Connections for reading.
const READERS: u32 = 4;

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
        let writer = pool(1).connect_with(connect.clone()).await.map_err(SqlError::from)?;
        migrate(&writer).await?;
        reserve(&writer).await?;
        let reader = pool(READERS).connect_with(connect.pragma("query_only", "ON")).await.map_err(SqlError::from)?;
        Ok(Self::with(writer, reader, Some(lock), options))
    }

    /// Opens an empty store in memory, for tests: one connection reads and writes, and all is gone with it.
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

    /// Takes over at once the leases that the process before left: to be called on start, before any worker.
    /// Each counts as an attempt whose worker vanished. Returns the jobs concerned.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn recover(&self) -> Result<Vec<JobId>, StoreError> {
        let mut jobs = Vec::new();
        loop {
            let some = self.run(Expire { all: true }).await?;
            if some.is_empty() {
                return Ok(jobs);
            }
            jobs.extend(some);
        }
    }
}

fn pool(connections: u32) -> SqlitePoolOptions {
    // Connections to memory must never be closed: the data go with them. One is closed too where whoever asked for it goes
    // away while it is being tested, for which there is no need here.
    SqlitePoolOptions::new()
        .min_connections(1)
        .max_connections(connections)
        .idle_timeout(None)
        .max_lifetime(None)
        .test_before_acquire(false)
}

async fn migrate(pool: &SqlitePool) -> Result<(), StoreError> {
    // Tables of a later version, of which there was a way back, are as good.
    sqlx::migrate!("src/jobs/sqlite/migrations")
        .set_ignore_missing(true)
        .run(pool)
        .await
        .map_err(|error| StoreError::Database(error.to_string()))
}

/// Makes the log as long as [`LOG`], by something large that is not committed: its place in the file stays. On a disk that
/// is full already the store opens without.
async fn reserve(writer: &SqlitePool) -> Result<(), SqlError> {
    let mut connection = writer.acquire().await?;
    begin(&mut connection).await?;
    let sql = format!("CREATE TABLE room AS SELECT zeroblob({LOG}) AS bytes");
    let grown = sqlx::query(AssertSqlSafe(sql)).execute(&mut *connection).await;
    rollback(&mut connection).await;
    if let Err(error) = grown {
        tracing::warn!(%error, "no room is kept for changes of records on a full disk");
    }
    Ok(())
}

/// Transactions are begun and ended by hand: where a disk is full, SQLite rolls back by itself, and sqlx would for ever
/// take the connection to be in a transaction.
async fn begin(connection: &mut SqliteConnection) -> Result<(), SqlError> {
    let begin = "BEGIN IMMEDIATE";
    if sqlx::query(begin).execute(&mut *connection).await.is_err() {
        // A panic may have left one open.
        rollback(connection).await;
        sqlx::query(begin).execute(connection).await?;
    }
    Ok(())
}

/// Fails where SQLite has done so already, which is as well.
async fn rollback(connection: &mut SqliteConnection) {
    let _ = sqlx::query("ROLLBACK").execute(connection).await;
}

impl Engine for Sqlite {
    async fn transact<O: Operation>(&self, operation: &O, options: &StoreOptions) -> Result<Done<O::Output>, SqlError> {
        let mut connection = self.writer.acquire().await?;
        begin(&mut connection).await?;
        let done = operation.run(&mut Link::new(Connection::Sqlite(&mut connection), &self.time), options).await;
        let committed = match done {
            Ok(done) => sqlx::query("COMMIT").execute(&mut *connection).await.map(|_| done).map_err(SqlError::from),
            Err(error) => Err(error),
        };
        if committed.is_err() {
            rollback(&mut connection).await;
        }
        committed
    }

    async fn reader(&self) -> Result<Reader, SqlError> {
        Ok(Reader::Sqlite(self.reader.acquire().await?))
    }

    fn time(&self) -> &Time {
        &self.time
    }

    /// There are no other processes.
    fn tell(&self, _: &[Change]) {}

    async fn close(&self) {
        self.reader.close().await;
        // Last, so that it writes the log back into the file.
        self.writer.close().await;
        // By hand: a child process between fork and exec shares the handle, and with it the lock.
        if let Some(Err(error)) = self.lock.as_ref().map(File::unlock) {
            tracing::warn!(%error, "the lock of the job store could not be let go");
        }
    }
}
