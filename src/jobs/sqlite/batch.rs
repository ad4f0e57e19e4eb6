//! Batches: jobs that are taken, read and removed together.

use super::micros;
use super::read;
use super::submit::{self, place, queue_room};
use crate::jobs::job::{BatchId, JobId, NewJob};
use crate::jobs::store::{Batch, Counts, NewBatch, StoreError, StoreOptions, SubmittedBatch};
use sqlx::{Row, SqliteConnection};

/// Queues `jobs`, which are those of `new` with their ids, or finds the batch that the key has made before.
pub(super) async fn submit(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    id: BatchId,
    new: &NewBatch,
    jobs: &[(JobId, &NewJob)],
) -> Result<SubmittedBatch, StoreError> {
    if let Some((key, body)) = &new.idempotency {
        let row = sqlx::query("SELECT id, idempotency_body FROM batches WHERE idempotency_key = ?")
            .bind(key)
            .fetch_optional(&mut *tx)
            .await?;
        if let Some(row) = row {
            if row.try_get::<&str, _>("idempotency_body")? != body {
                return Err(StoreError::IdempotencyConflict);
            }
            let JobId(id) = read::id(row.try_get("id")?)?;
            return Ok(SubmittedBatch::Replayed(known(tx, BatchId(id)).await?));
        }
    }
    sqlx::query("INSERT INTO batches (id, created_at, idempotency_key, idempotency_body) VALUES (?, ?, ?, ?)")
        .bind(id.to_string())
        .bind(micros(options.clock.now()))
        .bind(new.idempotency.as_ref().map(|(key, _)| key))
        .bind(new.idempotency.as_ref().map(|(_, body)| body))
        .execute(&mut *tx)
        .await?;
    let mut room = queue_room(tx, options.queue_limit).await?;
    for (job, new) in jobs {
        let alone = NewJob { idempotency: None, ..(*new).clone() };
        place(tx, options, *job, &alone, Some(id), &mut room).await?;
    }
    Ok(SubmittedBatch::Accepted(known(tx, id).await?))
}

pub(super) async fn read(connection: &mut SqliteConnection, id: BatchId) -> Result<Option<Batch>, StoreError> {
    // One statement, so that the jobs are those of one moment.
    let rows = sqlx::query(
        "SELECT b.created_at, j.id, j.status FROM batches b LEFT JOIN jobs j ON j.batch = b.id WHERE b.id = ? \
         ORDER BY j.id",
    )
    .bind(id.to_string())
    .fetch_all(connection)
    .await?;
    let Some(first) = rows.first() else {
        return Ok(None);
    };
    let created_at = super::timestamp(first.try_get("created_at")?)?;
    let mut batch = Batch { id, created_at, counts: Counts::default(), jobs: Vec::with_capacity(rows.len()) };
    for row in &rows {
        if let Some(job) = row.try_get::<Option<&str>, _>("id")? {
            batch.jobs.push(read::id(job)?);
            *batch.counts.of_mut(read::variant(row.try_get("status")?)?) += 1;
        }
    }
    Ok(Some(batch))
}

async fn known(tx: &mut SqliteConnection, id: BatchId) -> Result<Batch, StoreError> {
    read(tx, id).await?.ok_or_else(|| StoreError::Database(format!("batch {id} is gone within a transaction")))
}

/// Removes a batch and its jobs. Returns the jobs, and the keys that nobody names any more.
pub(super) async fn delete(
    tx: &mut SqliteConnection,
    id: BatchId,
) -> Result<Option<(Vec<JobId>, Vec<String>)>, StoreError> {
    let Some(batch) = read(tx, id).await? else {
        return Ok(None);
    };
    let mut keys = Vec::new();
    for &job in &batch.jobs {
        keys.extend(submit::delete(tx, job).await?.unwrap_or_default());
    }
    sqlx::query("DELETE FROM batches WHERE id = ?").bind(id.to_string()).execute(tx).await?;
    Ok(Some((batch.jobs, keys)))
}
