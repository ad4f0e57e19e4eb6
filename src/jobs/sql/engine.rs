//! Connections to the database of a store, whichever it is.

use super::error::{Severity, SqlError};
use super::tx::Connection;
use crate::jobs::list::Change;
use crate::jobs::operators::PoolUse;
use crate::jobs::postgres::Postgres;
use crate::jobs::sqlite::Sqlite;

/// Connections to the database of a store.
#[derive(Debug)]
pub(in crate::jobs) enum Engine {
    Sqlite(Sqlite),
    Postgres(Postgres),
}

impl Engine {
    /// A connection in a new transaction.
    pub(super) async fn begin(&self) -> Result<Connection, SqlError> {
        match self {
            Self::Sqlite(engine) => engine.begin().await,
            Self::Postgres(engine) => engine.begin().await,
        }
    }

    /// A connection for reading alone.
    pub(super) async fn reader(&self) -> Result<Connection, SqlError> {
        match self {
            Self::Sqlite(engine) => engine.reader().await,
            Self::Postgres(engine) => engine.reader().await,
        }
    }

    /// Consequence of an error for the caller.
    pub(super) fn severity(&self, error: &SqlError) -> Severity {
        match self {
            Self::Sqlite(engine) => engine.severity(error),
            Self::Postgres(engine) => engine.severity(error),
        }
    }

    /// Notifies other processes of changes. A SQLite file has no other processes.
    pub(super) fn notify(&self, changes: &[Change]) {
        if let Self::Postgres(engine) = self {
            engine.notify(changes);
        }
    }

    /// Use of the pools of connections.
    pub(super) fn pools(&self) -> Vec<PoolUse> {
        match self {
            Self::Sqlite(engine) => engine.pools(),
            Self::Postgres(engine) => engine.pools(),
        }
    }

    /// True after [`Engine::close`].
    pub(super) fn is_closed(&self) -> bool {
        match self {
            Self::Sqlite(engine) => engine.is_closed(),
            Self::Postgres(engine) => engine.is_closed(),
        }
    }

    /// Closes all connections.
    pub(super) async fn close(&self) {
        match self {
            Self::Sqlite(engine) => engine.close().await,
            Self::Postgres(engine) => engine.close().await,
        }
    }
}
