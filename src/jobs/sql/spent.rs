//! Ids of jobs and batches that no submission may use any more.
//!
//! A submission whose outcome is unknown is sent again, with the same id. Both may be under way at
//! the same time: PostgreSQL may receive a statement long after its sender gave up. The primary key
//! lets only one of them insert the job, but not after the job was deleted. The id of a deleted job
//! is therefore spent, and so is the id of a submission that was answered with another job.
//!
//! A deletion whose outcome is unknown finds here whether it, or another one, deleted the job.

use super::codec::values;
use super::error::SqlError;
use super::tx::Tx;
use jiff::Timestamp;
use std::time::Duration;
use uuid::Uuid;

/// Time for which ids are kept. Changes are retried for much less; TCP may repeat a statement for
/// some 15 minutes.
const KEPT_FOR: Duration = Duration::from_secs(3600);

/// Makes sure that no submission uses this id from now on. `deletion` is the random identity of the
/// deletion that spends it; `None` if there was no row with this id.
pub(super) async fn spend(tx: &mut Tx<'_>, id: Uuid, deletion: Option<&str>) -> Result<(), SqlError> {
    let sql = format!(
        "INSERT INTO spent_ids (id, deletion, spent_at) VALUES ($1, $2, COALESCE($3, {})) ON CONFLICT (id) DO NOTHING",
        tx.either("NULL", Tx::NOW),
    );
    let now = tx.known_now()?;
    tx.execute(sql, values![id, deletion.map(str::to_owned), now]).await?;
    Ok(())
}

/// True if the id is spent.
pub(super) async fn is_spent(tx: &mut Tx<'_>, id: Uuid) -> Result<bool, SqlError> {
    Ok(tx.optional("SELECT id FROM spent_ids WHERE id = $1", values![id]).await?.is_some())
}

/// True if this deletion has spent the id.
pub(super) async fn is_spent_by(tx: &mut Tx<'_>, id: Uuid, deletion: &str) -> Result<bool, SqlError> {
    let sql = "SELECT id FROM spent_ids WHERE id = $1 AND deletion = $2";
    Ok(tx.optional(sql, values![id, deletion]).await?.is_some())
}

/// Fails if the id is spent. Called by retries after they have inserted a row with it, because the
/// first row may have been deleted just before.
pub(super) async fn refuse_spent(tx: &mut Tx<'_>, id: Uuid) -> Result<(), SqlError> {
    if is_spent(tx, id).await? { Err(SqlError::Unknown) } else { Ok(()) }
}

/// Removes ids that were spent long ago.
pub(super) async fn forget_old(tx: &mut Tx<'_>) -> Result<(), SqlError> {
    let kept_from = tx.now().await?.checked_sub(KEPT_FOR).unwrap_or(Timestamp::MIN);
    tx.execute("DELETE FROM spent_ids WHERE spent_at < $1", values![kept_from]).await?;
    Ok(())
}
