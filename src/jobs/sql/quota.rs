//! What an owner has, compared with its quota.

use super::codec::values;
use super::error::SqlError;
use super::tx::Tx;
use crate::jobs::job::Quota;
use crate::jobs::store::{Quantity, StoreError};
use std::time::Duration;

/// Lets submissions of an owner with a quota come one after the other, or several could each find room for themselves alone. To
/// be called first, before keys of idempotency are looked for. While another takes long, as one of a large batch does, the
/// transaction is given up and tried again later, so that it does not hold a connection.
pub(super) async fn lock_owner(tx: &mut Tx<'_>, owner: Option<&str>, quota: Quota) -> Result<(), SqlError> {
    let sql = tx.either("", "SELECT pg_try_advisory_xact_lock(hashtextextended($1, 1)) AS taken");
    let Some(owner) = owner.filter(|_| quota != Quota::default() && !sql.is_empty()) else { return Ok(()) };
    for wait in [2, 4, 8, 16, 32] {
        if tx.one(sql, values![owner]).await?.flag("taken")? {
            return Ok(());
        }
        tokio::time::sleep(Duration::from_millis(wait)).await;
    }
    Err(SqlError::OwnerLocked)
}

/// Refuses `more` jobs of an owner that would exceed its quota. Reused models count as jobs here, although they end at once.
pub(super) async fn check(tx: &mut Tx<'_>, owner: Option<&str>, quota: Quota, more: u64) -> Result<(), SqlError> {
    let Some(owner) = owner else { return Ok(()) };
    if let Some(limit) = quota.unfinished {
        let used = unfinished(tx, owner, limit).await?;
        if used + more > limit {
            return Err(StoreError::QuotaExceeded { what: Quantity::Unfinished, used, limit }.into());
        }
    }
    if let Some(limit) = quota.bytes {
        let used = bytes(tx, owner).await?;
        if used >= limit {
            return Err(StoreError::QuotaExceeded { what: Quantity::Bytes, used, limit }.into());
        }
    }
    Ok(())
}

/// Queued and running jobs of an owner, counted up to `limit`.
async fn unfinished(tx: &mut Tx<'_>, owner: &str, limit: u64) -> Result<u64, SqlError> {
    let mut used = 0;
    for status in ["queued", "running"] {
        // The second condition is that of the partial index.
        let sql = format!(
            "SELECT COUNT(*) AS n FROM (SELECT 1 FROM jobs WHERE submitter = $1 AND submitter <> '' \
             AND status = '{status}' LIMIT {limit}) AS counted"
        );
        used += tx.one(sql, values![owner]).await?.count::<u64>("n")?;
    }
    Ok(used)
}

/// Bytes of files that the records of an owner's jobs name. Kept by triggers, as rows to be summed.
async fn bytes(tx: &mut Tx<'_>, owner: &str) -> Result<u64, SqlError> {
    let sql = "SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) AS n FROM kept_bytes WHERE submitter = $1";
    tx.one(sql, values![owner]).await?.count("n")
}
