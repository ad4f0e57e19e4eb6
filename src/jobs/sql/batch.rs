//! Batches: jobs that are taken, read and removed together.

use super::order::queue_room;
use super::read::priority;
use super::submit::{self, Ids, place};
use super::{Before, Done, Link, Operation, SqlError, values, variant};
use crate::jobs::job::{BatchId, JobId, NewJob};
use crate::jobs::store::{Batch, Change, Counts, NewBatch, StoreError, StoreOptions, SubmittedBatch};
use std::sync::{Arc, Mutex, PoisonError};

/// Queues the jobs of a batch, or finds the batch that the key has made before.
#[derive(Debug)]
pub(super) struct SubmitBatch {
    pub(super) new: NewBatch,
    pub(super) ids: Arc<Ids>,
    /// The id under which it is tried.
    pub(super) tried: Mutex<Option<BatchId>>,
}

/// What others are to be told of a batch just taken.
fn accepted(batch: Batch) -> Done<SubmittedBatch> {
    let changes = batch.jobs.iter().map(|&id| Change { id, version: Some(1) }).collect();
    Done::new(SubmittedBatch::Accepted(batch), changes)
}

impl Operation for SubmitBatch {
    type Output = SubmittedBatch;

    async fn run(&self, link: &mut Link<'_>, options: &StoreOptions) -> Result<Done<SubmittedBatch>, SqlError> {
        let (key, body) = self.new.idempotency.clone().unzip();
        if key.is_some() {
            // Versions before this one kept the keys of batches whose jobs are all gone.
            let empty = "DELETE FROM batches WHERE idempotency_key = $1 \
                         AND NOT EXISTS (SELECT 1 FROM jobs WHERE batch = batches.id)";
            link.execute(empty, values![&key]).await?;
            let sql = "SELECT id, idempotency_body FROM batches WHERE idempotency_key = $1";
            if let Some(row) = link.optional(sql, values![&key]).await? {
                if row.optional_text("idempotency_body")? != body.as_deref() {
                    return Err(StoreError::IdempotencyConflict.into());
                }
                let JobId(id) = row.id("id")?;
                return Ok(Done::quiet(SubmittedBatch::Replayed(known(link, BatchId(id)).await?)));
            }
        }
        let now = link.now().await?;
        let first = || BatchId(self.ids.at(now).0);
        let id = *self.tried.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(first);
        link.execute(
            "INSERT INTO batches (id, created_at, idempotency_key, idempotency_body, priority) \
             VALUES ($1, $2, $3, $4, $5)",
            values![id.to_string(), now, key, body, self.new.priority.get()],
        )
        .await?;
        let mut room = queue_room(link, options).await?;
        for new in &self.new.jobs {
            let alone = NewJob { idempotency: None, priority: self.new.priority, ..new.clone() };
            place(link, options, self.ids.at(now), &alone, Some(id), &mut room).await?;
        }
        Ok(accepted(known(link, id).await?))
    }

    async fn done_before(&self, link: &mut Link<'_>) -> Result<Before<SubmittedBatch>, SqlError> {
        let tried = *self.tried.lock().unwrap_or_else(PoisonError::into_inner);
        let batch = match tried {
            Some(id) => read(link, id).await?,
            None => None,
        };
        Ok(batch.map(accepted))
    }
}

/// The batch that this key made with this body.
pub(super) async fn replayed(link: &mut Link<'_>, key: &str, body: &str) -> Result<Option<Batch>, SqlError> {
    let sql = "SELECT id FROM batches WHERE idempotency_key = $1 AND idempotency_body = $2";
    match link.optional(sql, values![key, body]).await? {
        Some(row) => {
            let JobId(id) = row.id("id")?;
            read(link, BatchId(id)).await
        }
        None => Ok(None),
    }
}

pub(super) async fn read(link: &mut Link<'_>, id: BatchId) -> Result<Option<Batch>, SqlError> {
    // One statement, so that the jobs are those of one moment.
    let rows = link
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
            *batch.counts.of_mut(variant(row.text("status")?)?) += 1;
        }
    }
    Ok(Some(batch))
}

async fn known(link: &mut Link<'_>, id: BatchId) -> Result<Batch, SqlError> {
    let gone = || StoreError::Database(format!("batch {id} is gone within a transaction"));
    Ok(read(link, id).await?.ok_or_else(gone)?)
}

/// Removes a batch and its jobs. Gives the keys that nobody names any more.
#[derive(Debug)]
pub(super) struct DeleteBatch(pub(super) BatchId);

impl Operation for DeleteBatch {
    type Output = Option<Vec<String>>;

    async fn run(&self, link: &mut Link<'_>, _: &StoreOptions) -> Result<Done<Self::Output>, SqlError> {
        let sql = format!("SELECT id FROM batches WHERE id = $1{}", link.either("", " FOR UPDATE"));
        if link.optional(sql, values![self.0.to_string()]).await?.is_none() {
            return Ok(Done::quiet(None));
        }
        let batch = known(link, self.0).await?;
        let mut keys = Vec::new();
        for &job in &batch.jobs {
            keys.extend(submit::delete(link, job).await?.unwrap_or_default());
        }
        // It is gone with its last job, but where it had none.
        submit::delete_empty_batch(link, &self.0.to_string()).await?;
        let changes = batch.jobs.into_iter().map(|id| Change { id, version: None }).collect();
        Ok(Done::new(Some(keys), changes))
    }
}
