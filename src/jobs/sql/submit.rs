//! Taking jobs in and removing them.

use super::order::{queue_room, rank, submitter, turn};
use super::read::{self, known_job};
use super::{Before, Done, Link, Operation, SqlError, Value, json, values, variant, word};
use crate::generate::Output;
use crate::jobs::job::{BatchId, File, Job, JobId, NewJob};
use crate::jobs::state;
use crate::jobs::store::{Change, StoreError, StoreOptions, Submitted};
use jiff::Timestamp;
use std::sync::{Arc, Mutex, PoisonError};

/// Makes ids of jobs: each greater than all that this process made before, also within one millisecond.
#[derive(Debug)]
pub(super) struct Ids(Mutex<uuid::ContextV7>);

impl Ids {
    pub(super) fn new() -> Self {
        Self(Mutex::new(uuid::ContextV7::new()))
    }

    pub(super) fn at(&self, now: Timestamp) -> JobId {
        let seconds = u64::try_from(now.as_second()).unwrap_or_default();
        let nanos = u32::try_from(now.subsec_nanosecond()).unwrap_or_default();
        let context = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        JobId(uuid::Uuid::new_v7(uuid::Timestamp::from_unix(&*context, seconds, nanos)))
    }
}

/// Queues a job, or finds an earlier one.
#[derive(Debug)]
pub(super) struct Submit {
    pub(super) new: NewJob,
    pub(super) ids: Arc<Ids>,
    /// The id under which it is tried.
    pub(super) tried: Mutex<Option<JobId>>,
}

impl Operation for Submit {
    type Output = Submitted;

    async fn run(&self, link: &mut Link<'_>, options: &StoreOptions) -> Result<Done<Submitted>, SqlError> {
        let new = &self.new;
        if let Some((key, body)) = &new.idempotency {
            let sql = "SELECT id, idempotency_body FROM jobs WHERE idempotency_key = $1";
            if let Some(row) = link.optional(sql, values![key]).await? {
                if row.text("idempotency_body")? != body {
                    return Err(StoreError::IdempotencyConflict.into());
                }
                return Ok(Done::quiet(Submitted::Replayed(known_job(link, row.id("id")?).await?)));
            }
        }
        let mut room = queue_room(link, options).await?;
        // The same at every try: a commit that is still under way is met at the primary key.
        let now = link.now().await?;
        let id = *self.tried.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(|| self.ids.at(now));
        let reused = place(link, options, id, new, None, &mut room).await?;
        let job = known_job(link, id).await?;
        let change = Change { id, version: Some(job.version) };
        let submitted = if reused { Submitted::Reused(job) } else { Submitted::Queued(job) };
        Ok(Done::new(submitted, vec![change]))
    }

    async fn done_before(&self, link: &mut Link<'_>) -> Result<Before<Submitted>, SqlError> {
        let tried = *self.tried.lock().unwrap_or_else(PoisonError::into_inner);
        let job = match tried {
            Some(id) => read::job(link, id).await?,
            None => None,
        };
        Ok(job.map(|job| {
            let change = Change { id: job.id, version: Some(job.version) };
            let submitted = match job.reused_from {
                Some(_) => Submitted::Reused(job),
                None => Submitted::Queued(job),
            };
            Done::new(submitted, vec![change])
        }))
    }
}

/// The job that this key made with this body.
pub(super) async fn replayed(link: &mut Link<'_>, key: &str, body: &str) -> Result<Option<Job>, SqlError> {
    let sql = "SELECT id FROM jobs WHERE idempotency_key = $1 AND idempotency_body = $2";
    match link.optional(sql, values![key, body]).await? {
        Some(row) => read::job(link, row.id("id")?).await,
        None => Ok(None),
    }
}

/// Queues a job where there is `room` for it, or takes over a finished model. Returns whether it was taken over.
pub(super) async fn place(
    link: &mut Link<'_>,
    options: &StoreOptions,
    id: JobId,
    new: &NewJob,
    batch: Option<BatchId>,
    room: &mut u64,
) -> Result<bool, SqlError> {
    let source = if new.reuse { reusable(link, new).await? } else { None };
    if source.is_none() {
        *room = room.checked_sub(1).ok_or(StoreError::QueueFull { limit: options.queue_limit })?;
    }
    insert(link, id, new, source.as_ref(), batch).await?;
    Ok(source.is_some())
}

/// A finished model that may stand for `new`: the first one made, where it still exists. It stays until this
/// transaction has named its files. Its preset is the same, for that is written in the files, although the digest
/// tells specifications apart and not the names that they were asked for by.
async fn reusable(link: &mut Link<'_>, new: &NewJob) -> Result<Option<Job>, SqlError> {
    // One job of each kind is enough: there may be thousands that share the same files.
    let sql = format!(
        "SELECT MIN(id) AS id FROM jobs{} WHERE status = 'succeeded' AND engine_used = engine AND digest = $1 \
         AND preset = $2 GROUP BY backend_used, outputs ORDER BY 1",
        link.either(" INDEXED BY jobs_by_digest", ""),
    );
    for row in link.all(sql, values![&new.digest, &new.preset]).await? {
        let id = row.id("id")?;
        let sql = format!("SELECT id FROM jobs WHERE id = $1{}", link.either("", " FOR KEY SHARE"));
        if link.optional(sql, values![id]).await?.is_none() {
            continue;
        }
        let job = known_job(link, id).await?;
        let same = job.backend.used.is_some_and(|used| state::same_bytes(new.backend, used));
        if same && new.outputs.iter().all(|output| job.outputs.contains(output)) {
            return Ok(Some(job));
        }
    }
    Ok(None)
}

async fn insert(
    link: &mut Link<'_>,
    id: JobId,
    new: &NewJob,
    source: Option<&Job>,
    batch: Option<BatchId>,
) -> Result<(), SqlError> {
    let now = link.now().await?;
    let seed = i64::try_from(new.seed)
        .map_err(|_| StoreError::Database(format!("seed {} is beyond the range of records", new.seed)))?;
    let turn = if source.is_some() { 0 } else { turn(link, new).await? };
    let backend = source.map(|job| &job.backend);
    link.execute(
        "INSERT INTO jobs (id, status, preset, seed, digest, outputs, backend_requested, backend_used, device, \
         fallback, available_at, created_at, finished_at, reused_from, idempotency_key, idempotency_body, summary, \
         spec, engine, engine_used, batch, submitter, turn, rank, trace) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, 0, $11, $12, $13, $14, $15, $16, $17, $18, $19, $20, $21, \
         $22, $23, $24)",
        values![
            id,
            if source.is_some() { "succeeded" } else { "queued" },
            &new.preset,
            seed,
            &new.digest,
            json(&new.outputs),
            word(new.backend),
            backend.and_then(|backend| backend.used).map(word),
            backend.and_then(|backend| backend.device.clone()),
            backend.and_then(|backend| backend.fallback.clone()),
            now,
            source.map(|_| now),
            source.map(|job| job.id.to_string()),
            new.idempotency.as_ref().map(|(key, _)| key.clone()),
            new.idempotency.as_ref().map(|(_, body)| body.clone()),
            source.and_then(|job| job.summary.as_ref()).map(json),
            json(&new.spec),
            &new.engine,
            source.map(|job| job.engine.clone()),
            batch.map(|batch| batch.to_string()),
            submitter(new),
            turn,
            rank(new.priority),
            new.trace.clone(),
        ],
    )
    .await?;
    let labels = new.labels.iter().map(|(name, value)| values![id, name, value]);
    insert_rows(link, "INSERT INTO labels (job_id, name, value) VALUES ", labels.collect()).await?;
    if let Some(source) = source {
        insert_files(link, id, source.files.iter().filter(|file| is_wanted(&file.name, &new.outputs))).await?;
    }
    Ok(())
}

/// Whether a file belongs to a model with these outputs: `model.<output>` only where asked for, others always.
fn is_wanted(name: &str, outputs: &[Output]) -> bool {
    match name.strip_prefix("model.").map(variant::<Output>) {
        Some(Ok(output)) => outputs.contains(&output),
        Some(Err(_)) | None => true,
    }
}

pub(super) async fn insert_files(
    link: &mut Link<'_>,
    id: JobId,
    files: impl Iterator<Item = &File>,
) -> Result<(), SqlError> {
    let row = |(ordinal, file): (u64, &File)| {
        values![id, ordinal, &file.name, &file.media_type, file.bytes, &file.sha256, &file.key]
    };
    let sql = "INSERT INTO files (job_id, ordinal, name, media_type, bytes, sha256, key) VALUES ";
    insert_rows(link, sql, (0..).zip(files).map(row).collect()).await
}

/// Inserts rows in one statement.
async fn insert_rows(link: &mut Link<'_>, sql: &'static str, rows: Vec<Vec<Value>>) -> Result<(), SqlError> {
    if rows.is_empty() {
        return Ok(());
    }
    let mut n = 0;
    let places: Vec<String> = rows
        .iter()
        .map(|row| {
            let places: Vec<String> = row
                .iter()
                .map(|_| {
                    n += 1;
                    format!("${n}")
                })
                .collect();
            format!("({})", places.join(", "))
        })
        .collect();
    link.execute(format!("{sql}{}", places.join(", ")), rows.into_iter().flatten().collect()).await?;
    Ok(())
}

/// Removes a record. Gives the keys that no other names.
#[derive(Debug)]
pub(super) struct Delete(pub(super) JobId);

impl Operation for Delete {
    type Output = Option<Vec<String>>;

    async fn run(&self, link: &mut Link<'_>, _: &StoreOptions) -> Result<Done<Self::Output>, SqlError> {
        let keys = delete(link, self.0).await?;
        let change = Change { id: self.0, version: None };
        let changes = if keys.is_some() { vec![change] } else { vec![] };
        Ok(Done::new(keys, changes))
    }
}

pub(super) async fn delete(link: &mut Link<'_>, id: JobId) -> Result<Option<Vec<String>>, SqlError> {
    // The batch before the job, as whoever removes a whole batch does; which one it is never changes.
    let batch = match link.optional("SELECT batch FROM jobs WHERE id = $1", values![id]).await? {
        None => return Ok(None),
        Some(row) => row.optional_text("batch")?.map(str::to_owned),
    };
    if let Some(batch) = &batch {
        let sql = format!("SELECT id FROM batches WHERE id = $1{}", link.either("", " FOR UPDATE"));
        link.optional(sql, values![batch]).await?;
    }
    // Who is about to name its files too comes before or after, not between.
    let sql = format!("SELECT id FROM jobs WHERE id = $1{}", link.either("", " FOR UPDATE"));
    if link.optional(sql, values![id]).await?.is_none() {
        return Ok(None);
    }
    let rows = link
        .all(
            "SELECT DISTINCT key FROM files f WHERE job_id = $1 \
                 AND NOT EXISTS (SELECT 1 FROM files o WHERE o.key = f.key AND o.job_id <> $1)",
            values![id],
        )
        .await?;
    let mut keys = rows.iter().map(|row| row.text("key").map(str::to_owned)).collect::<Result<Vec<_>, _>>()?;
    let gone = link.one("DELETE FROM jobs WHERE id = $1 RETURNING checkpoint", values![id]).await?;
    keys.extend(gone.optional_text("checkpoint")?.map(str::to_owned));
    if let Some(batch) = &batch {
        delete_empty_batch(link, batch).await?;
    }
    Ok(Some(keys))
}

/// A batch goes with its last job, and its key with it.
pub(super) async fn delete_empty_batch(link: &mut Link<'_>, batch: &String) -> Result<(), SqlError> {
    let sql = "DELETE FROM batches WHERE id = $1 AND NOT EXISTS (SELECT 1 FROM jobs WHERE batch = $1)";
    link.execute(sql, values![batch]).await?;
    Ok(())
}
