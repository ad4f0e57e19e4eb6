//! Deletion of jobs.
//!
//! A deletion has a random identity, by which it is recognised if the response to its commit is
//! lost: a record that is gone may have been deleted by another.

use super::codec::{enum_from_sql, values};
use super::error::SqlError;
use super::operation::{Done, Run, Uncertain};
use super::share;
use super::spent;
use super::store::Store;
use super::tx::Tx;
use crate::jobs::{BatchId, Change, JobId, Status, StoreError};
use uuid::Uuid;

/// The call that deletes a single job.
impl Store {
    /// Deletes the record, which fences out a running attempt. Returns the keys for removal from
    /// the artifact store: the checkpoint, and files that no other job names. `None` if the job
    /// does not exist.
    pub async fn delete(&self, id: JobId) -> Result<Option<Vec<String>>, StoreError> {
        // The job, and the random identity of the deletion.
        type Input = (JobId, String);
        const DELETES: Uncertain<Input, Option<Vec<String>>> =
            Uncertain::Recognised(|(id, deletion), _, tx| Box::pin(was_deleted(*id, deletion, tx)));
        let run: Run<Input, _> = |(id, deletion), tx, _| Box::pin(delete_one(*id, deletion, tx));
        self.apply("delete", (id, Uuid::new_v4().to_string()), run, DELETES).await
    }
}

/// True if the deletion has taken effect. Waits for a commit that is still under way.
async fn was_deleted(id: JobId, deletion: &str, tx: &mut Tx<'_>) -> Result<bool, SqlError> {
    let sql = format!("SELECT id FROM jobs WHERE id = $1{}", tx.either("", " FOR UPDATE"));
    tx.optional(sql, values![id]).await?;
    spent::is_spent_by(tx, id.0, deletion).await
}

async fn delete_one(id: JobId, deletion: &str, tx: &mut Tx<'_>) -> Result<Done<Option<Vec<String>>>, SqlError> {
    let (keys, changes) = job(tx, id, None, deletion).await?.map(|Done { output, changes }| (output, changes)).unzip();
    Ok(Done::new(keys, changes.unwrap_or_default()))
}

/// Deletes a record; with `status`, only if the job is in that status. `deletion` is the random
/// identity of the change. Returns the keys that no other record names; `None` if nothing was
/// deleted.
pub(super) async fn job(
    tx: &mut Tx<'_>,
    id: JobId,
    status: Option<Status>,
    deletion: &str,
) -> Result<Option<Done<Vec<String>>>, SqlError> {
    // Locks the batch before the job, as the deletion of a batch does. A job's batch never changes.
    let row = tx.optional("SELECT batch FROM jobs WHERE id = $1", values![id]).await?;
    let Some(row) = row else { return Ok(None) };
    let batch = row.optional_id("batch")?.map(BatchId);
    if let Some(batch) = batch {
        let sql = format!("SELECT id FROM batches WHERE id = $1{}", tx.either("", " FOR UPDATE"));
        tx.optional(sql, values![batch]).await?;
    }
    // A submission that reuses its files comes before or after this lock, not between.
    let sql = format!("SELECT status, finished_at FROM jobs WHERE id = $1{}", tx.either("", " FOR UPDATE"));
    let Some(row) = tx.optional(sql, values![id]).await? else { return Ok(None) };
    let found: Status = enum_from_sql(row.get("status")?)?;
    if status.is_some_and(|status| status != found) {
        return Ok(None);
    }
    let mut changes = vec![Change { id, version: None }];
    if row.optional_time("finished_at")?.is_none() {
        changes.extend(share::promote(tx, id).await?);
    }
    let sql = "SELECT DISTINCT key FROM files f WHERE job_id = $1 \
               AND NOT EXISTS (SELECT 1 FROM files o WHERE o.key = f.key AND o.job_id <> $1)";
    let rows = tx.all(sql, values![id]).await?;
    let mut keys = rows.iter().map(|row| row.get("key")).collect::<Result<Vec<String>, _>>()?;
    let gone = tx.one("DELETE FROM jobs WHERE id = $1 RETURNING checkpoint", values![id]).await?;
    keys.extend(gone.get::<Option<String>>("checkpoint")?);
    spent::spend(tx, id.0, Some(deletion)).await?;
    if let Some(batch) = batch {
        empty_batch(tx, batch, deletion).await?;
    }
    Ok(Some(Done::new(keys, changes)))
}

/// Deletes the batch and its idempotency key if it has no jobs left.
pub(super) async fn empty_batch(tx: &mut Tx<'_>, batch: BatchId, deletion: &str) -> Result<(), SqlError> {
    let sql = "DELETE FROM batches WHERE id = $1 AND NOT EXISTS (SELECT 1 FROM jobs WHERE batch = $1)";
    if tx.execute(sql, values![batch]).await? > 0 {
        spent::spend(tx, batch.0, Some(deletion)).await?;
    }
    Ok(())
}
