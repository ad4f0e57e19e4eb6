//! Ids of young jobs and batches that no submission may use any more.
//!
//! A submission whose outcome is unknown is sent again, with the same id. Both may be under way at
//! the same time: PostgreSQL may receive a statement long after its sender gave up. The primary key
//! lets only one of them insert the job, but not after the job was deleted. The id of a deleted job
//! is therefore spent, and so is the id of a submission that was answered with another job.

use super::codec::values;
use super::error::SqlError;
use super::tx::Tx;
use crate::jobs::JobId;
use jiff::Timestamp;
use std::time::Duration;
use uuid::Uuid;

/// Age of an id from which no submission with it is under way any more. A submission is retried for
/// [`RETRY_LIMIT`](super::operation::RETRY_LIMIT); TCP may repeat a statement for some 15 minutes.
const OLD: Duration = Duration::from_secs(3600);

/// The first id that is not old. Ids begin with the time of the submission.
fn first_young(now: Timestamp) -> JobId {
    JobId::least_at(now.checked_sub(OLD).unwrap_or(Timestamp::MIN))
}

/// Makes sure that no submission uses this id from now on.
pub(super) async fn spend(tx: &mut Tx<'_>, id: Uuid) -> Result<(), SqlError> {
    if id >= first_young(tx.now().await?).0 {
        let sql = "INSERT INTO spent_ids (id) VALUES ($1) ON CONFLICT (id) DO NOTHING";
        tx.execute(sql, values![JobId(id)]).await?;
    }
    Ok(())
}

/// True if the id is spent.
pub(super) async fn is_spent(tx: &mut Tx<'_>, id: Uuid) -> Result<bool, SqlError> {
    Ok(tx.optional("SELECT id FROM spent_ids WHERE id = $1", values![JobId(id)]).await?.is_some())
}

/// Fails if the id is spent. Called by retries after they have inserted a row with it, because the
/// first row may have been deleted just before.
pub(super) async fn refuse_spent(tx: &mut Tx<'_>, id: Uuid) -> Result<(), SqlError> {
    if is_spent(tx, id).await? { Err(SqlError::NoAnswer(Duration::ZERO)) } else { Ok(()) }
}

/// Removes old ids.
pub(super) async fn forget_old(tx: &mut Tx<'_>) -> Result<(), SqlError> {
    let first = first_young(tx.now().await?);
    tx.execute("DELETE FROM spent_ids WHERE id < $1", values![first]).await?;
    Ok(())
}
