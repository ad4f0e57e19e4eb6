//! Connections to a SQLite file or to a database in memory.
//!
//! A connection is never tested or replaced: it does not fail by itself, and closing a connection to
//! memory would lose the data.

use crate::jobs::sql::SqlError;
use deadpool::Runtime;
use deadpool::managed::{self, Metrics, Object, PoolError, QueueMode, RecycleResult};
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{ConnectOptions as _, Connection as _};
use std::time::Duration;

/// Maximum wait for a free connection.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(10);

/// A pool of connections.
pub(super) type Pool = managed::Pool<Connections>;
/// A connection on loan from the pool.
pub(in crate::jobs) type Loan = Object<Connections>;

/// Opens the connections of a pool.
#[derive(Debug)]
pub(in crate::jobs) struct Connections(SqliteConnectOptions);

impl managed::Manager for Connections {
    type Type = SqliteConnection;
    type Error = sqlx::Error;

    async fn create(&self) -> Result<SqliteConnection, sqlx::Error> {
        self.0.connect().await
    }

    async fn recycle(&self, _: &mut SqliteConnection, _: &Metrics) -> RecycleResult<sqlx::Error> {
        Ok(())
    }
}

/// A pool of at most `connections` connections. Opens none yet.
pub(super) fn pool(connect: SqliteConnectOptions, connections: u32) -> Pool {
    Pool::builder(Connections(connect))
        .max_size(connections as usize)
        .wait_timeout(Some(ACQUIRE_TIMEOUT))
        .queue_mode(QueueMode::Lifo)
        .runtime(Runtime::Tokio1)
        .build()
        .expect("a runtime is given")
}

/// A connection of the pool.
pub(super) async fn acquire(pool: &Pool) -> Result<Loan, SqlError> {
    pool.get().await.map_err(|error| match error {
        PoolError::Backend(error) => error.into(),
        PoolError::Closed => sqlx::Error::PoolClosed.into(),
        _ => sqlx::Error::PoolTimedOut.into(),
    })
}

/// Waits for all connections of the pool and closes them.
pub(super) async fn close(pool: &Pool) {
    for _ in 0..pool.status().size {
        let Ok(connection) = pool.get().await else { break };
        if let Err(error) = Object::take(connection).close().await {
            tracing::warn!(%error, "could not close a connection to the job store");
        }
    }
    pool.close();
}
