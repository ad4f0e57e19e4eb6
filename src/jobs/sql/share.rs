//! Shared growth: equal requests wait for one growth.
//!
//! A submission that allows reuse waits for an equal job that is queued or running, instead of
//! growing the same model again. The flag `shares` of the waiting job hides it from claims. The
//! waiting job ends in the transaction that ends its partner:
//!
//! - The partner succeeds: waiting jobs succeed as reuses of its files.
//! - It fails: waiting jobs fail with the same problem, because the same request would fail again.
//! - It is cancelled or deleted, or does not have the files that they want: the first waiting job
//!   is queued, and the others wait for that one.
//!
//! The partner is not recorded: jobs are equal if their digest, preset, owner and requested backend
//! are. A job waits only for a partner that has all its outputs and that will not be claimed after
//! jobs less urgent than the waiting job. If a running partner returns to the queue behind such
//! jobs, a more urgent waiting job is queued instead.
//!
//! On PostgreSQL a submission locks its partner, so that the partner does not end unnoticed. The
//! lock (`FOR KEY SHARE`) conflicts with the lock that ends an attempt (`FOR UPDATE`), but not with
//! the locks of claims and heartbeats (`FOR NO KEY UPDATE`).

use super::codec::{enum_to_sql, json, values};
use super::error::SqlError;
use super::operation::{Done, Uncertain};
use super::order::rank;
use super::read::known_job;
use super::record::{outputs_from_sql, submitter};
use super::store::Store;
use super::tx::{Row, Tx};
use crate::generate::Outputs;
use crate::jobs::state;
use crate::jobs::{Change, Job, JobId, NewJob, Status, StoreError};

/// Maximum number of equal jobs that a submission considers as partners.
const CANDIDATES: usize = 16;

/// The call for stranded jobs.
impl Store {
    /// Queues stranded jobs again: jobs that wait for an equal job although that job has ended.
    /// This happens if an older version, which does not know shared growth, ended it. Returns the
    /// queued jobs.
    pub async fn queue_stranded(&self) -> Result<Vec<JobId>, StoreError> {
        // The second run finds none. Streams find the jobs by polling.
        self.apply("queue_stranded", (), |(), tx, _| Box::pin(queue_stranded(tx)), Uncertain::RunsAgain).await
    }
}

/// Serialises equal submissions, so that of several at the same time one waits for another. Batches
/// take no such lock: they would hold one for each job, for a long time.
pub(super) async fn lock_digest(tx: &mut Tx<'_>, new: &NewJob) -> Result<(), SqlError> {
    if new.reuse { tx.lock_text(&new.digest).await } else { Ok(()) }
}

/// True if there is a partner for `new` to wait for. The partner does not end before the
/// transaction.
pub(super) async fn in_flight(tx: &mut Tx<'_>, new: &NewJob) -> Result<bool, SqlError> {
    if !new.reuse {
        return Ok(false);
    }
    let sql = format!(
        "SELECT id, outputs FROM jobs{} WHERE finished_at IS NULL AND NOT shares AND digest = $1 AND preset = $2 \
         AND submitter = $3 AND backend_requested = $4 AND NOT cancel_requested AND (status = 'running' OR rank <= $5) \
         ORDER BY id LIMIT {CANDIDATES}",
        tx.either(" INDEXED BY jobs_in_flight", ""),
    );
    let (owner, backend) = (submitter(new.owner.as_deref()), enum_to_sql(new.backend));
    for row in tx.all(sql, values![&new.digest, &new.preset, owner, backend, rank(new.priority)]).await? {
        if !includes(row.get("outputs")?, &new.outputs) {
            continue;
        }
        // Checks again the conditions that may have changed.
        let sql = format!(
            "SELECT id FROM jobs WHERE id = $1 AND finished_at IS NULL AND NOT cancel_requested \
             AND (status = 'running' OR rank <= $2){}",
            tx.either("", " FOR KEY SHARE")
        );
        if tx.optional(sql, values![JobId(row.id("id")?), rank(new.priority)]).await?.is_some() {
            return Ok(true);
        }
    }
    Ok(false)
}

/// True if the outputs of a record include all of `wanted`.
fn includes(outputs: &str, wanted: &Outputs) -> bool {
    let (outputs, unread) = outputs_from_sql(outputs);
    unread.is_none() && outputs.include(wanted)
}

/// The clauses from FROM that select the jobs `f` that wait for jobs like `l`, whose id is `$1`.
fn waiting(tx: &Tx<'_>) -> String {
    format!(
        "FROM jobs l {} jobs f{} ON f.digest = l.digest AND f.preset = l.preset AND f.submitter = l.submitter \
         AND f.backend_requested = l.backend_requested WHERE l.id = $1 AND f.finished_at IS NULL AND f.shares \
         AND f.status = 'queued'",
        tx.either("CROSS JOIN", "JOIN"),
        tx.either(" INDEXED BY jobs_sharing", ""),
    )
}

/// Ends or queues the jobs that wait for a job that has ended. No job waits for a waiting job.
pub(super) async fn settle(tx: &mut Tx<'_>, id: JobId, ended: Status) -> Result<Vec<Change>, SqlError> {
    if ended == Status::Cancelled {
        return promote(tx, id).await;
    }
    let sql = format!("SELECT DISTINCT f.outputs {} AND NOT l.shares", waiting(tx));
    let groups = tx.all(sql, values![id]).await?;
    if groups.is_empty() {
        return Ok(Vec::new());
    }
    let job = known_job(tx, id).await?;
    if ended == Status::Failed {
        return fail(tx, &job).await;
    }
    let own_engine = "SELECT id FROM jobs WHERE id = $1 AND engine_used = engine";
    let same = job.backend.used.is_some_and(|used| state::same_bytes(job.backend.requested, used))
        && tx.optional(own_engine, values![id]).await?.is_some();
    let mut changes = Vec::new();
    for group in groups {
        let outputs = group.get("outputs")?;
        let (wanted, unread) = outputs_from_sql(outputs);
        if same && unread.is_none() && job.outputs.include(&wanted) {
            changes.extend(succeed(tx, &job, outputs, &wanted).await?);
        }
    }
    changes.extend(promote(tx, id).await?);
    Ok(changes)
}

/// Ends waiting jobs with these outputs as reuses of the files of `job`.
async fn succeed(tx: &mut Tx<'_>, job: &Job, outputs: &str, wanted: &Outputs) -> Result<Vec<Change>, SqlError> {
    let sql = format!(
        "UPDATE jobs SET status = 'succeeded', version = version + 1, finished_at = $2, reused_from = $1, summary = $3, \
         engine_used = engine, backend_used = $4, device = $5, fallback = $6 WHERE id IN (SELECT f.id {} \
         AND f.outputs = $7) AND status = 'queued' RETURNING id, version",
        waiting(tx)
    );
    let backend = &job.backend;
    let values = values![
        job.id.to_string(),
        tx.now().await?,
        job.summary.as_ref().map(json),
        backend.used.map(enum_to_sql),
        &backend.device,
        &backend.fallback,
        outputs,
    ];
    let rows = tx.all(sql, values).await?;
    let names = job.files.iter().map(|file| &file.name).filter(|name| wanted.want(name));
    let sql = format!(
        "INSERT INTO files (job_id, ordinal, name, media_type, bytes, sha256, key, start) \
         SELECT j.id, o.ordinal, o.name, o.media_type, o.bytes, o.sha256, o.key, o.start \
         FROM files o CROSS JOIN jobs j \
         WHERE o.job_id = $1 AND o.name {in_list}$2)) AND j.id {in_list}$3))",
        in_list = tx.either("IN (SELECT value FROM json_each(", "= ANY (("),
    );
    let ids = rows.iter().map(|row| row.get("id")).collect::<Result<Vec<String>, _>>()?;
    tx.execute(sql, values![job.id, names.cloned().collect::<Vec<String>>(), ids]).await?;
    rows.iter().map(to_change).collect()
}

/// Fails the jobs that wait for `job`.
async fn fail(tx: &mut Tx<'_>, job: &Job) -> Result<Vec<Change>, SqlError> {
    let sql = format!(
        "UPDATE jobs SET status = 'failed', version = version + 1, finished_at = $2, problem = $3, \
         backend_used = $4, device = $5, fallback = $6 WHERE id IN (SELECT f.id {}) AND status = 'queued' \
         RETURNING id, version",
        waiting(tx)
    );
    let backend = &job.backend;
    let values = values![
        job.id,
        tx.now().await?,
        job.problem.as_ref().map(json),
        backend.used.map(enum_to_sql),
        &backend.device,
        &backend.fallback,
    ];
    tx.all(sql, values).await?.iter().map(to_change).collect()
}

/// Queues the first of the jobs that wait for `id`. The others then wait for that one.
pub(super) async fn promote(tx: &mut Tx<'_>, id: JobId) -> Result<Vec<Change>, SqlError> {
    queue_first(tx, id, "").await
}

/// Queues the first of the jobs that wait for `id`, which has returned to the queue, if the waiting
/// job is more urgent.
pub(super) async fn promote_more_urgent(tx: &mut Tx<'_>, id: JobId) -> Result<Vec<Change>, SqlError> {
    queue_first(tx, id, "AND f.rank < l.rank").await
}

async fn queue_first(tx: &mut Tx<'_>, id: JobId, condition: &str) -> Result<Vec<Change>, SqlError> {
    let first = format!("SELECT f.id {} AND NOT l.shares {condition} ORDER BY f.rank, f.id LIMIT 1", waiting(tx));
    while let Some(row) = tx.optional(first.clone(), values![id]).await? {
        // If the job was cancelled in the meantime, the next one is queued.
        let sql = "UPDATE jobs SET shares = FALSE, version = version + 1 \
                   WHERE id = $1 AND finished_at IS NULL RETURNING id, version";
        if let Some(row) = tx.optional(sql, values![JobId(row.id("id")?)]).await? {
            return Ok(vec![to_change(&row)?]);
        }
    }
    Ok(Vec::new())
}

/// Queues one of each group of equal jobs that are stranded; the others wait for it.
async fn queue_stranded(tx: &mut Tx<'_>) -> Result<Done<Vec<JobId>>, SqlError> {
    let sql = "UPDATE jobs SET shares = FALSE, version = version + 1 WHERE id IN (SELECT id FROM (\
               SELECT f.id, ROW_NUMBER() OVER (PARTITION BY f.digest, f.preset, f.submitter, f.backend_requested \
               ORDER BY f.rank, f.id) AS place FROM jobs f WHERE f.finished_at IS NULL AND f.shares \
               AND f.status = 'queued' AND NOT EXISTS (SELECT 1 FROM jobs l WHERE l.digest = f.digest \
               AND l.preset = f.preset AND l.submitter = f.submitter AND l.backend_requested = f.backend_requested \
               AND l.finished_at IS NULL AND NOT l.shares)) AS stranded WHERE place = 1) \
               AND status = 'queued' RETURNING id, version";
    let rows = tx.all(sql, values![]).await?;
    Ok(Done::of_changes(rows.iter().map(to_change).collect::<Result<_, _>>()?))
}

fn to_change(row: &Row) -> Result<Change, SqlError> {
    Ok(Change { id: JobId(row.id("id")?), version: Some(row.count("version")?) })
}
