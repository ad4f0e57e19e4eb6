//! Errors of operations on the database.

use crate::jobs::store::StoreError;

/// Why an operation on the database failed.
#[derive(Debug, thiserror::Error)]
pub(in crate::jobs) enum SqlError {
    /// A refusal by the store itself.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Another transaction holds the lock of the owner's submissions.
    #[error("another submission of the same owner is under way")]
    OwnerLocked,
    /// The database failed or is unavailable.
    #[error(transparent)]
    Database(#[from] sqlx::Error),
}

impl From<SqlError> for StoreError {
    fn from(error: SqlError) -> Self {
        match error {
            SqlError::Store(error) => error,
            SqlError::OwnerLocked => Self::Database(error.to_string()),
            SqlError::Database(error) => Self::Database(error.to_string()),
        }
    }
}

/// The error of a column whose content this version cannot read.
pub(super) fn broken(error: &dyn std::error::Error) -> SqlError {
    SqlError::Store(StoreError::Database(format!("a broken record: {error}")))
}
