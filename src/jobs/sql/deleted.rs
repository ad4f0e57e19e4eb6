//! Ids of young jobs and batches that were deleted.
//!
//! A submission whose commit has an unknown outcome runs again. If its job was committed, shown to
//! other clients and deleted in the meantime, nothing else tells that from a job that was never
//! committed, and the submission would take effect twice.

use super::codec::values;
use super::error::SqlError;
use super::tx::Tx;
use crate::jobs::JobId;
use jiff::Timestamp;
use std::time::Duration;
use uuid::Uuid;

/// Age at which no submission of a job or batch is retried any more; the store gives up after
/// [`RETRY_LIMIT`](super::operation::RETRY_LIMIT).
const OLD: Duration = Duration::from_secs(3600);

/// The first id that is not old. Ids begin with the time of the submission.
fn first_young(now: Timestamp) -> JobId {
    JobId::least_at(now.checked_sub(OLD).unwrap_or(Timestamp::MIN))
}

/// Notes that the job or batch with this id was deleted, if it is young.
pub(super) async fn note(tx: &mut Tx<'_>, id: Uuid) -> Result<(), SqlError> {
    if id >= first_young(tx.now().await?).0 {
        tx.execute("INSERT INTO deleted (id) VALUES ($1)", values![JobId(id)]).await?;
    }
    Ok(())
}

/// True if the job or batch with this id was deleted while it was young.
pub(super) async fn is_noted(tx: &mut Tx<'_>, id: Uuid) -> Result<bool, SqlError> {
    Ok(tx.optional("SELECT id FROM deleted WHERE id = $1", values![JobId(id)]).await?.is_some())
}

/// Fails if the job or batch that a retry has just inserted was deleted before: its first
/// transaction was committed between [`is_noted`] and the insertion.
pub(super) async fn refuse_second(tx: &mut Tx<'_>, id: Uuid) -> Result<(), SqlError> {
    if is_noted(tx, id).await? {
        return Err(SqlError::Inconsistent(format!("the deletion of {id}")));
    }
    Ok(())
}

/// Removes the ids that are old.
pub(super) async fn forget_old(tx: &mut Tx<'_>) -> Result<(), SqlError> {
    let first = first_young(tx.now().await?);
    tx.execute("DELETE FROM deleted WHERE id < $1", values![first]).await?;
    Ok(())
}
