//! Taking jobs in and removing them; signs of life of workers.

use super::read::{self, known_job};
use super::{json, micros, word};
use crate::generate::Output;
use crate::jobs::job::{BatchId, File, Job, JobId, NewJob};
use crate::jobs::state;
use crate::jobs::store::{StoreError, StoreOptions, Submitted, WorkerInfo};
use sqlx::{Row, SqliteConnection};
use std::time::Duration;

/// Rows of workers not seen for so long are dropped.
const FORGET_WORKERS: Duration = Duration::from_secs(24 * 60 * 60);

pub(super) async fn submit(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    id: JobId,
    new: &NewJob,
) -> Result<Submitted, StoreError> {
    if let Some((key, body)) = &new.idempotency {
        let row = sqlx::query("SELECT id, idempotency_body FROM jobs WHERE idempotency_key = ?")
            .bind(key)
            .fetch_optional(&mut *tx)
            .await?;
        if let Some(row) = row {
            if row.try_get::<&str, _>("idempotency_body")? != body {
                return Err(StoreError::IdempotencyConflict);
            }
            return Ok(Submitted::Replayed(known_job(tx, read::id(row.try_get("id")?)?).await?));
        }
    }
    let mut room = queue_room(tx, options.queue_limit).await?;
    let reused = place(tx, options, id, new, None, &mut room).await?;
    let job = known_job(tx, id).await?;
    Ok(if reused { Submitted::Reused(job) } else { Submitted::Queued(job) })
}

/// Queues a job where there is `room` for it, or takes over a finished model. Returns whether it was taken over.
pub(super) async fn place(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    id: JobId,
    new: &NewJob,
    batch: Option<BatchId>,
    room: &mut u64,
) -> Result<bool, StoreError> {
    let source = if new.reuse { reusable(tx, new).await? } else { None };
    if source.is_none() {
        *room = room.checked_sub(1).ok_or(StoreError::QueueFull { limit: options.queue_limit })?;
    }
    insert(tx, options, id, new, source.as_ref(), batch).await?;
    Ok(source.is_some())
}

/// A finished model that may stand for `new`: the first one made, where it still exists.
async fn reusable(tx: &mut SqliteConnection, new: &NewJob) -> Result<Option<Job>, StoreError> {
    // One job of each kind is enough: there may be thousands that share the same files.
    let ids: Vec<String> = sqlx::query_scalar(
        "SELECT MIN(id) FROM jobs INDEXED BY jobs_by_digest \
         WHERE status = 'succeeded' AND engine_used = engine AND digest = ? GROUP BY backend_used, outputs ORDER BY 1",
    )
    .bind(&new.digest)
    .fetch_all(&mut *tx)
    .await?;
    for id in ids {
        let job = known_job(tx, read::id(&id)?).await?;
        let same = job.backend.used.is_some_and(|used| state::same_bytes(new.backend, used));
        if same && new.outputs.iter().all(|output| job.outputs.contains(output)) {
            return Ok(Some(job));
        }
    }
    Ok(None)
}

/// How many more jobs the queue takes.
pub(super) async fn queue_room(tx: &mut SqliteConnection, limit: u64) -> Result<u64, StoreError> {
    let queued: i64 = sqlx::query_scalar(
        "SELECT COUNT(*) FROM (SELECT 1 FROM jobs INDEXED BY jobs_position WHERE status = 'queued' LIMIT ?)",
    )
    .bind(i64::try_from(limit).unwrap_or(i64::MAX))
    .fetch_one(tx)
    .await?;
    Ok(limit.saturating_sub(u64::try_from(queued).unwrap_or_default()))
}

async fn insert(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    id: JobId,
    new: &NewJob,
    source: Option<&Job>,
    batch: Option<BatchId>,
) -> Result<(), StoreError> {
    let now = micros(options.clock.now());
    let seed = i64::try_from(new.seed)
        .map_err(|_| StoreError::Database(format!("seed {} is beyond the range of records", new.seed)))?;
    let backend = source.map(|job| &job.backend);
    sqlx::query(
        "INSERT INTO jobs (id, status, preset, seed, digest, outputs, backend_requested, backend_used, device, \
         fallback, available_at, created_at, finished_at, reused_from, idempotency_key, idempotency_body, summary, \
         spec, engine, engine_used, batch) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(id.to_string())
    .bind(if source.is_some() { "succeeded" } else { "queued" })
    .bind(&new.preset)
    .bind(seed)
    .bind(&new.digest)
    .bind(json(&new.outputs))
    .bind(word(new.backend))
    .bind(backend.and_then(|backend| backend.used).map(word))
    .bind(backend.and_then(|backend| backend.device.as_ref()))
    .bind(backend.and_then(|backend| backend.fallback.as_ref()))
    .bind(now)
    .bind(now)
    .bind(source.map(|_| now))
    .bind(source.map(|job| job.id.to_string()))
    .bind(new.idempotency.as_ref().map(|(key, _)| key))
    .bind(new.idempotency.as_ref().map(|(_, body)| body))
    .bind(source.and_then(|job| job.summary.as_ref()).map(json))
    .bind(json(&new.spec))
    .bind(&new.engine)
    .bind(source.map(|job| &job.engine))
    .bind(batch.map(|batch| batch.to_string()))
    .execute(&mut *tx)
    .await?;
    for (name, value) in &new.labels {
        sqlx::query("INSERT INTO labels (job_id, name, value) VALUES (?, ?, ?)")
            .bind(id.to_string())
            .bind(name)
            .bind(value)
            .execute(&mut *tx)
            .await?;
    }
    if let Some(source) = source {
        let files = source.files.iter().filter(|file| is_wanted(&file.name, &new.outputs));
        insert_files(tx, id, files).await?;
    }
    Ok(())
}

/// Whether a file belongs to a model with these outputs: `model.<output>` only where asked for, others always.
fn is_wanted(name: &str, outputs: &[Output]) -> bool {
    match name.strip_prefix("model.").map(read::variant::<Output>) {
        Some(Ok(output)) => outputs.contains(&output),
        Some(Err(_)) | None => true,
    }
}

pub(super) async fn insert_files(
    tx: &mut SqliteConnection,
    id: JobId,
    files: impl Iterator<Item = &File>,
) -> Result<(), StoreError> {
    for (ordinal, file) in (0i64..).zip(files) {
        sqlx::query(
            "INSERT INTO files (job_id, ordinal, name, media_type, bytes, sha256, key) VALUES (?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(id.to_string())
        .bind(ordinal)
        .bind(&file.name)
        .bind(&file.media_type)
        .bind(i64::try_from(file.bytes).unwrap_or(i64::MAX))
        .bind(&file.sha256)
        .bind(&file.key)
        .execute(&mut *tx)
        .await?;
    }
    Ok(())
}

pub(super) async fn delete(tx: &mut SqliteConnection, id: JobId) -> Result<Option<Vec<String>>, StoreError> {
    let id = id.to_string();
    let keys: Vec<String> = sqlx::query_scalar(
        "SELECT DISTINCT key FROM files f WHERE job_id = ?1 \
         AND NOT EXISTS (SELECT 1 FROM files o WHERE o.key = f.key AND o.job_id <> ?1)",
    )
    .bind(&id)
    .fetch_all(&mut *tx)
    .await?;
    let deleted: Option<Option<String>> =
        sqlx::query_scalar("DELETE FROM jobs WHERE id = ? RETURNING checkpoint").bind(&id).fetch_optional(tx).await?;
    Ok(deleted.map(|checkpoint| keys.into_iter().chain(checkpoint).collect()))
}

pub(super) async fn worker_seen(tx: &mut SqliteConnection, worker: &WorkerInfo) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT OR REPLACE INTO workers (id, host, backend, device, job, jobs_done, heartbeat_at) \
         VALUES (?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(&worker.id)
    .bind(&worker.host)
    .bind(word(worker.backend))
    .bind(&worker.device)
    .bind(worker.job.map(|job| job.to_string()))
    .bind(i64::try_from(worker.jobs_done).unwrap_or(i64::MAX))
    .bind(micros(worker.heartbeat_at))
    .execute(&mut *tx)
    .await?;
    sqlx::query("DELETE FROM workers WHERE heartbeat_at < ?")
        .bind(micros(worker.heartbeat_at - FORGET_WORKERS))
        .execute(tx)
        .await?;
    Ok(())
}
