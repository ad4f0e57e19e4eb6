//! Errors of operations on the database.

use crate::jobs::StoreError;
use crate::jobs::error::Cause;
use std::time::Duration;

/// Reason why an operation on the database failed.
#[derive(Debug, thiserror::Error)]
pub(in crate::jobs) enum SqlError {
    /// The store refused the operation.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Another transaction holds the lock of the owner's submissions.
    #[error("another submission of the same owner is under way")]
    OwnerLocked,
    /// An earlier run of a change that is refused now may have taken effect.
    #[error("the outcome of the change is unknown")]
    Unknown,
    /// A column has a value that this version cannot read.
    #[error("a broken record: {0}")]
    BrokenRecord(#[source] Cause),
    /// A record changed or vanished although this transaction had locked it.
    #[error("{0} changed within a transaction")]
    Inconsistent(String),
    /// The database did not answer within this time. The outcome of the statement is unknown.
    #[error("the database did not answer within {0:?}")]
    NoAnswer(Duration),
    /// The database failed or is unavailable.
    #[error(transparent)]
    Database(#[from] sqlx::Error),
}

impl SqlError {
    /// True if the database has refused the statement, which then had no effect. A server that
    /// shuts down (57P) may have committed it.
    pub(super) fn is_refusal(&self) -> bool {
        let Self::Database(sqlx::Error::Database(error)) = self else { return false };
        error.code().is_some_and(|code| !code.starts_with("57P"))
    }
}

impl From<SqlError> for StoreError {
    fn from(error: SqlError) -> Self {
        match error {
            SqlError::Store(error) => error,
            SqlError::Database(error) => Self::Database(Box::new(error)),
            error => Self::Database(Box::new(error)),
        }
    }
}

/// The error of a column with a value that this version cannot read.
pub(super) fn broken(error: impl std::error::Error + Send + Sync + 'static) -> SqlError {
    SqlError::BrokenRecord(Box::new(error))
}

/// Consequence of an error of the database for the caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::jobs) enum Severity {
    /// The operation was refused, or would fail again.
    Permanent,
    /// A retry can succeed: a deadlock, or a race for a key.
    Transient,
    /// The database is unavailable, at least to this process. A retry can succeed, but workers may
    /// have been unable to renew their leases.
    Outage,
}
