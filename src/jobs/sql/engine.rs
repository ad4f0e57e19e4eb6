//! Connections to the database of a store, whichever it is.

use super::error::{Severity, SqlError};
use super::tx::Connection;
use crate::jobs::postgres::Postgres;
use crate::jobs::sqlite::Sqlite;
use crate::jobs::{Change, PoolUse};

/// Connections to the database of a store.
#[derive(Debug)]
pub(in crate::jobs) enum Engine {
    Sqlite(Sqlite),
    Postgres(Postgres),
}

/// Evaluates an expression over the engine of either database.
macro_rules! over {
    ($self:expr, $engine:ident => $value:expr) => {
        match $self {
            Self::Sqlite($engine) => $value,
            Self::Postgres($engine) => $value,
        }
    };
}

impl Engine {
    /// A connection in a new transaction.
    pub(super) async fn begin(&self) -> Result<Connection, SqlError> {
        over!(self, engine => engine.begin().await)
    }

    /// A connection for reading alone.
    pub(super) async fn reader(&self) -> Result<Connection, SqlError> {
        over!(self, engine => engine.reader().await)
    }

    /// Consequence of an error for the caller.
    pub(super) fn severity(&self, error: &SqlError) -> Severity {
        over!(self, engine => engine.severity(error))
    }

    /// Notifies other processes of changes. No other process opens a SQLite file.
    pub(super) fn notify(&self, changes: &[Change]) {
        if let Self::Postgres(engine) = self {
            engine.notify(changes);
        }
    }

    /// Use of the pools of connections.
    pub(super) fn pools(&self) -> Vec<PoolUse> {
        over!(self, engine => engine.pools())
    }

    /// True after [`Engine::close`].
    pub(super) fn is_closed(&self) -> bool {
        over!(self, engine => engine.is_closed())
    }

    /// Closes all connections.
    pub(super) async fn close(&self) {
        over!(self, engine => engine.close().await);
    }
}
