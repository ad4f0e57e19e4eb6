//! Batches: jobs that are submitted, listed and deleted together.

use super::codec::{Value, enum_from_sql, json, values};
use super::delete;
use super::error::SqlError;
use super::operation::{Done, Grouped, Operation, Run, Uncertain};
use super::order::queue_room;
use super::quota;
use super::record::{owner, parse_optional, priority, select_jobs, submitter, to_record};
use super::spent;
use super::store::Store;
use super::submit::{self, look, place};
use super::tx::{Row, Tx};
use crate::jobs::job::IdGenerator;
use crate::jobs::{
    Batch, BatchFilter, BatchId, BatchPage, Change, Counts, Job, JobId, NewBatch, NewJob, StoreError, StoreOptions,
    SubmittedBatch,
};
use crate::lock::Mutex;
use std::sync::Arc;
use uuid::Uuid;

/// Maximum number of batches on a page.
const PAGE: u32 = 100;

/// Calls for batches.
impl Store {
    /// Queues all jobs of a batch in one transaction, or none ([`StoreError::QueueFull`] if there
    /// is no room for all).
    ///
    /// Each is an ordinary job; finished models are reused as by [`Store::submit`]. Ids ascend in
    /// the order of the jobs.
    pub async fn submit_batch(&self, new: NewBatch) -> Result<SubmittedBatch, StoreError> {
        self.change("submit_batch", SubmitBatch { new, ids: self.id_generator(), tried: Mutex::default() }).await
    }

    /// The batch that its owner created with this idempotency key and body.
    pub async fn replayed_batch(
        &self,
        owner: Option<&str>,
        key: &str,
        body: &str,
    ) -> Result<Option<Batch>, StoreError> {
        let tx = &mut self.read("replayed_batch").await?;
        let sql = "SELECT id FROM batches WHERE idempotency_key = $1 AND idempotency_body = $2";
        let Some(row) = tx.optional(sql, values![submit::scoped(owner, key), body]).await? else { return Ok(None) };
        Ok(read(tx, BatchId(row.id("id")?)).await?)
    }

    /// A batch by id.
    pub async fn batch(&self, id: BatchId) -> Result<Option<Batch>, StoreError> {
        Ok(read(&mut self.read("batch").await?, id).await?)
    }

    /// The jobs of a batch after `after`, in the order of the request, without their positions in
    /// the queue; at most `limit`.
    pub async fn batch_jobs(&self, id: BatchId, after: Option<JobId>, limit: u32) -> Result<Vec<Job>, StoreError> {
        let tx = &mut self.read("batch_jobs").await?;
        let jobs = select_jobs(tx);
        let sql = format!("{jobs}FROM jobs j WHERE j.batch = $1 AND j.id > $2 ORDER BY j.id LIMIT {limit}");
        let after = after.map_or_else(String::new, |id| id.to_string());
        let rows = tx.all(sql, values![id, after]).await?;
        rows.iter().map(|row| Ok(to_record(row)?.job)).collect()
    }

    /// A page of batches, newest first.
    pub async fn batches(&self, filter: &BatchFilter) -> Result<BatchPage, StoreError> {
        Ok(list(&mut self.read("batches").await?, filter).await?)
    }

    /// Deletes a batch with all its jobs in one transaction. Returns keys as [`Store::delete`]
    /// does.
    pub async fn delete_batch(&self, id: BatchId) -> Result<Option<Vec<String>>, StoreError> {
        // The batch, and the random identity of the deletion.
        type Input = (BatchId, String);
        const DELETES: Uncertain<Input, Option<Vec<String>>> =
            Uncertain::Recognised(|(id, deletion), _, tx| Box::pin(was_deleted(*id, deletion, tx)));
        let run: Run<Input, _> = |(id, deletion), tx, _| Box::pin(delete(*id, deletion, tx));
        self.apply("delete_batch", (id, Uuid::new_v4().to_string()), run, DELETES).await
    }
}

/// Queues the jobs of a batch, or finds the batch of an earlier request with the same idempotency
/// key.
struct SubmitBatch {
    new: NewBatch,
    ids: Arc<IdGenerator>,
    /// Id of the first run, which retries use too.
    tried: Mutex<Option<BatchId>>,
}

/// The result of queueing a batch.
fn accepted(batch: Batch) -> Done<SubmittedBatch> {
    let changes = batch.jobs.iter().map(|&id| Change { id, version: Some(1) }).collect();
    Done::new(SubmittedBatch::Accepted(batch), changes)
}

impl Operation for SubmitBatch {
    type Output = SubmittedBatch;

    const GROUPED: Grouped = Grouped::Never;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<SubmittedBatch>, SqlError> {
        let whose = self.new.owner.as_deref();
        quota::lock_owner(tx, whose, self.new.quota).await?;
        let (key, body) = self.new.idempotency.clone().unzip();
        let key = key.map(|key| submit::scoped(whose, &key));
        if key.is_some() {
            // Earlier versions kept the keys of batches whose jobs have all been deleted.
            let empty = "DELETE FROM batches WHERE idempotency_key = $1 \
                         AND NOT EXISTS (SELECT 1 FROM jobs WHERE batch = batches.id)";
            tx.execute(empty, values![&key]).await?;
            let sql = "SELECT id, idempotency_body FROM batches WHERE idempotency_key = $1";
            if let Some(row) = tx.optional(sql, values![&key]).await? {
                if row.get::<Option<&str>>("idempotency_body")? != body.as_deref() {
                    return Err(StoreError::IdempotencyConflict.into());
                }
                return Ok(Done::quiet(SubmittedBatch::Replayed(known(tx, BatchId(row.id("id")?)).await?)));
            }
        }
        let now = tx.now().await?;
        let is_retry = self.tried.lock().is_some();
        let id = *self.tried.lock().get_or_insert_with(|| BatchId(self.ids.next(now)));
        let sql = "INSERT INTO batches (id, created_at, idempotency_key, idempotency_body, priority, submitter, study) \
                   VALUES ($1, $2, $3, $4, $5, $6, $7)";
        let study = self.new.study.as_ref().map(json);
        tx.execute(sql, values![id, now, key, body, self.new.priority.get(), submitter(whose), study]).await?;
        if is_retry {
            spent::refuse_spent(tx, id.0).await?;
        }
        let mut room = queue_room(tx, options).await?;
        quota::check(tx, whose, self.new.quota, self.new.jobs.len() as u64).await?;
        for (index, new) in (0_u32..).zip(&self.new.jobs) {
            let owner = self.new.owner.clone();
            let alone = NewJob { idempotency: None, priority: self.new.priority, owner, ..new.clone() };
            let found = look(tx, &alone).await?;
            let place_in_batch = Some((id, Some(index)));
            place(tx, options, JobId(self.ids.next(now)), &alone, place_in_batch, &found, &mut room).await?;
        }
        Ok(accepted(known(tx, id).await?))
    }

    async fn was_committed(&self, tx: &mut Tx<'_>, done: &Done<SubmittedBatch>) -> Result<bool, SqlError> {
        // A run that found the batch of an earlier request has changed nothing.
        let id = done.output.batch().id;
        let is_own = *self.tried.lock() == Some(id);
        Ok(is_own && (is_stored(tx, id).await? || spent::is_spent(tx, id.0).await?))
    }
}

async fn read(tx: &mut Tx<'_>, id: BatchId) -> Result<Option<Batch>, SqlError> {
    // One statement, so that the result is consistent.
    let sql = "SELECT b.created_at, b.priority, b.submitter, j.id, j.status, j.batch_index FROM batches b \
               LEFT JOIN jobs j ON j.batch = b.id WHERE b.id = $1 ORDER BY j.id";
    let rows = tx.all(sql, values![id]).await?;
    let Some(first) = rows.first() else { return Ok(None) };
    let mut batch = without_jobs(id, first)?;
    // A separate query, because a join would repeat the study for each job. A study never changes.
    let study = tx.optional("SELECT study FROM batches WHERE id = $1", values![id]).await?;
    batch.study = study.map(|row| parse_optional(&row, "study")).transpose()?.flatten();
    for (row, order) in rows.iter().zip(0_u32..) {
        if let Some(job) = row.optional_id("id")? {
            batch.jobs.push(JobId(job));
            batch.places.push(submit::batch_index(row)?.unwrap_or(order));
            *batch.counts.of_mut(enum_from_sql(row.get("status")?)?) += 1;
        }
    }
    Ok(Some(batch))
}

async fn list(tx: &mut Tx<'_>, filter: &BatchFilter) -> Result<BatchPage, SqlError> {
    let limit = filter.limit.clamp(1, PAGE);
    let mut sql = "SELECT id, created_at, priority, submitter FROM batches WHERE TRUE".to_owned();
    let mut values = Vec::new();
    let mut and = |condition: &str, value: Value| {
        values.push(value);
        sql += &format!(" AND {condition} ${}", values.len());
    };
    if let Some(owner) = &filter.owner {
        and("submitter =", owner.into());
    }
    if let Some(after) = filter.created_after {
        and("id >=", JobId::least_at(after).into());
        and("created_at >=", after.into());
    }
    if let Some(before) = filter.created_before {
        and("id <", JobId::least_after(before).into());
        and("created_at <", before.into());
    }
    if let Some(before) = filter.before {
        and("id <", before.into());
    }
    sql += &format!(" ORDER BY id DESC LIMIT {}", limit + 1);
    let rows = tx.all(sql, values).await?;
    let more = rows.len() > limit as usize;
    let batch = |row: &Row| without_jobs(BatchId(row.id("id")?), row);
    let mut batches = rows.iter().take(limit as usize).map(batch).collect::<Result<Vec<_>, _>>()?;
    count(tx, &mut batches).await?;
    let next = if more { batches.last().map(|batch| batch.id) } else { None };
    Ok(BatchPage { batches, next })
}

/// The batch of a row, without its jobs and its study.
fn without_jobs(id: BatchId, row: &Row) -> Result<Batch, SqlError> {
    Ok(Batch {
        id,
        owner: owner(row)?,
        created_at: row.time("created_at")?,
        priority: priority(row.get("priority")?),
        counts: Counts::default(),
        jobs: Vec::new(),
        places: Vec::new(),
        study: None,
    })
}

/// Counts the jobs of batches by status, from an index alone.
async fn count(tx: &mut Tx<'_>, batches: &mut [Batch]) -> Result<(), SqlError> {
    let sql = format!(
        "SELECT batch, status, COUNT(*) AS n FROM jobs{}$1)) AND batch IS NOT NULL GROUP BY batch, status",
        tx.either(" INDEXED BY jobs_by_batch WHERE batch IN (SELECT value FROM json_each(", " WHERE batch = ANY ((",),
    );
    let ids: Vec<String> = batches.iter().map(|batch| batch.id.to_string()).collect();
    for row in tx.all(sql, values![ids]).await? {
        let id = BatchId(row.id("batch")?);
        if let Some(batch) = batches.iter_mut().find(|batch| batch.id == id) {
            *batch.counts.of_mut(enum_from_sql(row.get("status")?)?) = row.count("n")?;
        }
    }
    Ok(())
}

async fn known(tx: &mut Tx<'_>, id: BatchId) -> Result<Batch, SqlError> {
    read(tx, id).await?.ok_or_else(|| SqlError::Inconsistent(format!("batch {id}")))
}

/// True if the batch exists. Locks it until the transaction ends.
async fn is_stored(tx: &mut Tx<'_>, id: BatchId) -> Result<bool, SqlError> {
    let sql = format!("SELECT id FROM batches WHERE id = $1{}", tx.either("", " FOR UPDATE"));
    Ok(tx.optional(sql, values![id]).await?.is_some())
}

/// True if the deletion has taken effect. Waits for a commit that is still under way.
async fn was_deleted(id: BatchId, deletion: &str, tx: &mut Tx<'_>) -> Result<bool, SqlError> {
    Ok(!is_stored(tx, id).await? && spent::is_spent_by(tx, id.0, deletion).await?)
}

async fn delete(id: BatchId, deletion: &str, tx: &mut Tx<'_>) -> Result<Done<Option<Vec<String>>>, SqlError> {
    if !is_stored(tx, id).await? {
        return Ok(Done::quiet(None));
    }
    let (mut keys, mut changes) = (Vec::new(), Vec::new());
    for job in known(tx, id).await?.jobs {
        let Some(deleted) = delete::job(tx, job, None, deletion).await? else { continue };
        keys.extend(deleted.output);
        changes.extend(deleted.changes);
    }
    // Deleting the last job deletes the batch, unless it had none.
    delete::empty_batch(tx, id, deletion).await?;
    Ok(Done::new(Some(keys), changes))
}
