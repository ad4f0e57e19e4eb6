//! Quotas: the jobs and bytes of an owner compared with its limits.

use super::codec::values;
use super::error::SqlError;
use super::tx::Tx;
use crate::jobs::{Quantity, Quota, StoreError};
use std::time::Duration;

/// Serialises the submissions of an owner with a quota; otherwise several could each find room for
/// themselves. To be called before the transaction looks for idempotency keys.
///
/// If another submission takes long, such as a large batch, the transaction fails and the store
/// retries it later, so that it does not occupy a connection.
pub(super) async fn lock_owner(tx: &mut Tx<'_>, owner: Option<&str>, quota: Quota) -> Result<(), SqlError> {
    let sql = tx.either("", "SELECT pg_try_advisory_xact_lock(hashtextextended($1, 1)) AS taken");
    let Some(owner) = owner.filter(|_| quota != Quota::default() && !sql.is_empty()) else { return Ok(()) };
    for wait in [2, 4, 8, 16, 32] {
        if tx.one(sql, values![owner]).await?.get("taken")? {
            return Ok(());
        }
        tokio::time::sleep(Duration::from_millis(wait)).await;
    }
    Err(SqlError::OwnerLocked)
}

/// Refuses `more` jobs of an owner that would exceed its quota. Reused models count as jobs here,
/// although they end immediately.
pub(super) async fn check(tx: &mut Tx<'_>, owner: Option<&str>, quota: Quota, more: u64) -> Result<(), SqlError> {
    let Some(owner) = owner else { return Ok(()) };
    if let Some(limit) = quota.unfinished {
        let used = unfinished(tx, owner, limit).await? + extra_weight(tx, owner).await?;
        if used + more > limit {
            return Err(StoreError::QuotaExceeded { what: Quantity::Unfinished, used, more, limit }.into());
        }
    }
    if let Some(limit) = quota.bytes {
        let used = bytes(tx, owner).await?;
        if used >= limit {
            return Err(StoreError::QuotaExceeded { what: Quantity::Bytes, used, more: 0, limit }.into());
        }
    }
    Ok(())
}

/// Number of queued and running jobs of an owner; each status counts at most `limit`.
async fn unfinished(tx: &mut Tx<'_>, owner: &str, limit: u64) -> Result<u64, SqlError> {
    let mut used = 0;
    for status in ["queued", "running"] {
        // The second condition makes the partial index apply.
        let sql = format!(
            "SELECT COUNT(*) AS n FROM (SELECT 1 FROM jobs WHERE submitter = $1 AND submitter <> '' \
             AND status = '{status}' LIMIT {limit}) AS counted"
        );
        used += tx.one(sql, values![owner]).await?.count::<u64>("n")?;
    }
    Ok(used)
}

/// What the unfinished fits of an owner count in addition to their number.
async fn extra_weight(tx: &mut Tx<'_>, owner: &str) -> Result<u64, SqlError> {
    let sql = format!(
        "SELECT CAST(COALESCE(SUM(weight - 1), 0) AS BIGINT) AS n FROM jobs{} \
         WHERE submitter = $1 AND kind = 'fit' AND finished_at IS NULL",
        tx.either(" INDEXED BY jobs_unfinished_fits", ""),
    );
    tx.one(sql, values![owner]).await?.count("n")
}

/// Bytes of files that the jobs of an owner name. Triggers keep them, as rows to be summed.
async fn bytes(tx: &mut Tx<'_>, owner: &str) -> Result<u64, SqlError> {
    let sql = "SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) AS n FROM kept_bytes WHERE submitter = $1";
    tx.one(sql, values![owner]).await?.count("n")
}
