//! Batches: jobs that are queued, read and removed together.

use super::codec::{enum_from_sql, values};
use super::error::SqlError;
use super::operation::{Before, Done, Operation};
use super::order::queue_room;
use super::record::priority;
use super::submit::{self, Ids, place};
use super::tx::Tx;
use crate::jobs::job::{BatchId, JobId, NewJob};
use crate::jobs::store::{Batch, Change, Counts, NewBatch, StoreError, StoreOptions, SubmittedBatch};
use std::sync::{Arc, Mutex, PoisonError};

/// Queues the jobs of a batch, or finds the batch that was made before with the same idempotency key.
#[derive(Debug)]
pub(super) struct SubmitBatch {
    pub(super) new: NewBatch,
    pub(super) ids: Arc<Ids>,
    /// The id of the first try, which later tries use too.
    pub(super) tried: Mutex<Option<BatchId>>,
}

/// The result for a batch just queued.
fn accepted(batch: Batch) -> Done<SubmittedBatch> {
    let changes = batch.jobs.iter().map(|&id| Change { id, version: Some(1) }).collect();
    Done::new(SubmittedBatch::Accepted(batch), changes)
}

impl Operation for SubmitBatch {
    type Output = SubmittedBatch;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<SubmittedBatch>, SqlError> {
        let (key, body) = self.new.idempotency.clone().unzip();
        if key.is_some() {
            // Earlier versions kept the keys of batches whose jobs have all been deleted.
            let empty = "DELETE FROM batches WHERE idempotency_key = $1 \
                         AND NOT EXISTS (SELECT 1 FROM jobs WHERE batch = batches.id)";
            tx.execute(empty, values![&key]).await?;
            let sql = "SELECT id, idempotency_body FROM batches WHERE idempotency_key = $1";
            if let Some(row) = tx.optional(sql, values![&key]).await? {
                if row.optional_text("idempotency_body")? != body.as_deref() {
                    return Err(StoreError::IdempotencyConflict.into());
                }
                let JobId(id) = row.id("id")?;
                return Ok(Done::quiet(SubmittedBatch::Replayed(known(tx, BatchId(id)).await?)));
            }
        }
        let now = tx.now().await?;
        let first = || BatchId(self.ids.at(now).0);
        let id = *self.tried.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(first);
        tx.execute(
            "INSERT INTO batches (id, created_at, idempotency_key, idempotency_body, priority) \
             VALUES ($1, $2, $3, $4, $5)",
            values![id.to_string(), now, key, body, self.new.priority.get()],
        )
        .await?;
        let mut room = queue_room(tx, options).await?;
        for new in &self.new.jobs {
            let alone = NewJob { idempotency: None, priority: self.new.priority, ..new.clone() };
            place(tx, options, self.ids.at(now), &alone, Some(id), &mut room).await?;
        }
        Ok(accepted(known(tx, id).await?))
    }

    async fn done_before(&self, tx: &mut Tx<'_>) -> Result<Before<SubmittedBatch>, SqlError> {
        let tried = *self.tried.lock().unwrap_or_else(PoisonError::into_inner);
        let batch = match tried {
            Some(id) => read(tx, id).await?,
            None => None,
        };
        Ok(batch.map(accepted))
    }
}

/// The batch that was made with this key and body.
pub(super) async fn replayed(tx: &mut Tx<'_>, key: &str, body: &str) -> Result<Option<Batch>, SqlError> {
    let sql = "SELECT id FROM batches WHERE idempotency_key = $1 AND idempotency_body = $2";
    match tx.optional(sql, values![key, body]).await? {
        Some(row) => {
            let JobId(id) = row.id("id")?;
            read(tx, BatchId(id)).await
        }
        None => Ok(None),
    }
}

pub(super) async fn read(tx: &mut Tx<'_>, id: BatchId) -> Result<Option<Batch>, SqlError> {
    // One statement, so that the jobs are those of one moment.
    let rows = tx
        .all(
            "SELECT b.created_at, b.priority, j.id, j.status FROM batches b LEFT JOIN jobs j ON j.batch = b.id WHERE b.id = $1 \
             ORDER BY j.id",
            values![id.to_string()],
        )
        .await?;
    let Some(first) = rows.first() else {
        return Ok(None);
    };
    let created_at = first.time("created_at")?;
    let priority = priority(first.int("priority")?);
    let mut batch = Batch { id, created_at, priority, counts: Counts::default(), jobs: Vec::with_capacity(rows.len()) };
    for row in &rows {
        if let Some(job) = row.optional_id("id")? {
            batch.jobs.push(job);
            *batch.counts.of_mut(enum_from_sql(row.text("status")?)?) += 1;
        }
    }
    Ok(Some(batch))
}

async fn known(tx: &mut Tx<'_>, id: BatchId) -> Result<Batch, SqlError> {
    let gone = || StoreError::Database(format!("batch {id} vanished within a transaction"));
    Ok(read(tx, id).await?.ok_or_else(gone)?)
}

/// Removes a batch and its jobs. Gives the keys that no record names any more.
#[derive(Debug)]
pub(super) struct DeleteBatch(pub(super) BatchId);

impl Operation for DeleteBatch {
    type Output = Option<Vec<String>>;

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<Self::Output>, SqlError> {
        let sql = format!("SELECT id FROM batches WHERE id = $1{}", tx.either("", " FOR UPDATE"));
        if tx.optional(sql, values![self.0.to_string()]).await?.is_none() {
            return Ok(Done::quiet(None));
        }
        let batch = known(tx, self.0).await?;
        let mut keys = Vec::new();
        for &job in &batch.jobs {
            keys.extend(submit::delete(tx, job).await?.unwrap_or_default());
        }
        // Deleting the last job deletes the batch, unless it had none.
        submit::delete_empty_batch(tx, &self.0.to_string()).await?;
        let changes = batch.jobs.into_iter().map(|id| Change { id, version: None }).collect();
        Ok(Done::new(Some(keys), changes))
    }
}
