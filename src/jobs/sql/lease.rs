//! Leases: expiry, renewal, cancellation. Every event goes through [`JobState::on`].

use super::codec::{enum_from_sql, enum_to_sql, json, until, values};
use super::error::SqlError;
use super::operation::{Done, Run, Simple, Uncertain, are_cancelled};
use super::read;
use super::share;
use super::store::Store;
use super::tx::Tx;
use super::upkeep::free_all;
use crate::jobs::state::{self, AttemptEnd, Event, Fence, JobState, MAX_LEASE, Next};
use crate::jobs::{
    Attempt, BackendReport, Change, ClaimedJob, Directive, Finished, Job, JobId, JobProgress, LiveSection, Problem,
    Status, StoreError, StoreOptions,
};
use jiff::Timestamp;
use std::time::Duration;

/// Maximum number of leases that one transaction ends.
const EXPIRED: u32 = 1000;

/// Calls of a worker for the job that it holds, and cancellation.
impl Store {
    /// Renews the lease and records progress. Only new progress or a new backend increases the
    /// version and notifies others.
    pub async fn heartbeat(
        &self,
        claimed: &ClaimedJob,
        lease: Duration,
        backend: &BackendReport,
        progress: Option<&JobProgress>,
        section: Option<&LiveSection>,
    ) -> Result<Directive, StoreError> {
        let (id, fence, backend) = (claimed.job.id, claimed.fence(), backend.clone());
        let (progress, section) = (progress.copied(), section.cloned());
        let renewal = Renewal { id, fence, lease, backend, progress, section };
        // The second run raises the version once more, which costs readers one read.
        let run: Run<_, _> = |renewal, tx, options| Box::pin(renew(renewal, tx, options));
        self.apply("heartbeat", renewal, run, Uncertain::RunsAgain).await
    }

    /// Records `key` as the latest checkpoint, from which the next attempt resumes. Returns the key
    /// that it replaces, for removal from the artifact store.
    ///
    /// Fails with [`StoreError::Fenced`] if the lease was lost. The version does not grow. The key
    /// outlives the attempt; the end of the job removes it from the record.
    pub async fn set_checkpoint(&self, claimed: &ClaimedJob, key: &str) -> Result<Option<String>, StoreError> {
        let input = (claimed.job.id, claimed.fence(), key.to_owned());
        type Input = (JobId, Fence, String);
        const NAMES: Uncertain<Input, Option<String>> =
            Uncertain::Recognised(|(id, _, key), _, tx| Box::pin(names_checkpoint(*id, key, tx)));
        let run: Run<Input, _> = |(id, fence, key), tx, options| Box::pin(set_checkpoint(*id, fence, key, tx, options));
        self.apply("set_checkpoint", input, run, NAMES).await
    }

    /// Cancels a job: a queued job ends immediately; a running job is asked to stop; a job that has
    /// ended stays unchanged. If this call ends the job, [`Job::checkpoint`] is the key that its
    /// record named until then, for removal from the artifact store.
    pub async fn cancel(&self, id: JobId) -> Result<Option<Job>, StoreError> {
        const CANCELS: Uncertain<JobId, Option<Job>> =
            Uncertain::Recognised(|id, done, tx| Box::pin(are_cancelled(tx, std::slice::from_ref(id), &done.changes)));
        self.apply("cancel", id, |id, tx, options| Box::pin(cancel_one(*id, tx, options)), CANCELS).await
    }

    /// Ends the attempts that an earlier process left running, and frees its locks of upkeep tasks;
    /// to be called at the start of the only process that uses the store, before any worker. Each
    /// attempt counts as one whose worker vanished. Returns the jobs.
    pub async fn recover(&self) -> Result<Vec<JobId>, StoreError> {
        let run: Run<_, _> = |(), tx, _| Box::pin(free_all(tx));
        self.transact("recover", Simple { input: (), run, uncertain: Uncertain::RunsAgain }).await?;
        let mut jobs = Vec::new();
        loop {
            let expired = self.expire(Timestamp::MAX).await?;
            if expired.is_empty() {
                return Ok(jobs);
            }
            jobs.extend(expired);
        }
    }

    /// Ends attempts whose lease ended at `before` or earlier. Returns some of their jobs, none if
    /// none are left.
    pub(super) async fn expire(&self, before: Timestamp) -> Result<Vec<JobId>, StoreError> {
        let run: Run<_, _> = |before, tx, options| Box::pin(expire(*before, tx, options));
        // The second run ends other attempts. Streams find the jobs of the first by polling.
        self.transact("expire", Simple { input: before, run, uncertain: Uncertain::RunsAgain }).await
    }
}

/// Ends attempts whose lease ended at `before` or earlier, or ends later than any lease can because
/// the clock was set back, at most [`EXPIRED`] of each. Returns their jobs.
async fn expire(before: Timestamp, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Vec<JobId>>, SqlError> {
    // Skips rows that another transaction is writing.
    let far = until(tx.steady().await?, MAX_LEASE);
    let mut changes = Vec::new();
    for (condition, limit) in [("<= $1 ORDER BY lease_until", before), ("> $1 ORDER BY lease_until DESC", far)] {
        let sql = format!(
            "SELECT id FROM jobs{} WHERE status = 'running' AND lease_until {condition} LIMIT {EXPIRED}{}",
            tx.either(" INDEXED BY jobs_leases", ""),
            tx.either("", " FOR UPDATE SKIP LOCKED"),
        );
        for row in tx.all(sql, values![limit]).await? {
            changes.extend(apply(tx, options, JobId(row.id("id")?), &Event::Expire, None).await?);
        }
    }
    Ok(Done::of_changes(changes))
}

/// Progress of an attempt that a heartbeat records.
struct Renewal {
    id: JobId,
    fence: Fence,
    lease: Duration,
    backend: BackendReport,
    progress: Option<JobProgress>,
    section: Option<LiveSection>,
}

/// Renews a lease and records progress.
async fn renew(renewal: &Renewal, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Directive>, SqlError> {
    let Renewal { id, fence, lease, backend, progress, section } = renewal;
    let Some((state, before)) = load_for_renewal(tx, *id).await? else { return Ok(Done::quiet(Directive::Lost)) };
    if state.on(&Event::Renew(fence.clone()), options.max_attempts).is_err() {
        return Ok(Done::quiet(Directive::Lost));
    }
    let now = tx.steady().await?;
    let sql = "UPDATE jobs SET lease_until = $2, \
               version = version + CASE WHEN $7 OR $8 OR backend_used IS DISTINCT FROM $3 \
               OR device IS DISTINCT FROM $4 OR fallback IS DISTINCT FROM $5 THEN 1 ELSE 0 END, \
               backend_used = $3, device = $4, fallback = $5, \
               progress = COALESCE($6, progress), section = COALESCE($9, section) \
               WHERE id = $1 RETURNING version";
    let values = values![
        *id,
        until(now, *lease),
        backend.used.map(enum_to_sql),
        &backend.device,
        &backend.fallback,
        progress.as_ref().map(json),
        progress.is_some(),
        section.is_some(),
        section.as_ref().map(json),
    ];
    let version = tx.one(sql, values).await?.count("version")?;
    let directive = if state.cancel_requested { Directive::Cancel } else { Directive::Continue };
    let change = Change { id: *id, version: Some(version) };
    Ok(Done::new(directive, if version > before { vec![change] } else { vec![] }))
}

/// Records the key of the latest checkpoint. Returns the key that it replaces.
async fn set_checkpoint(
    id: JobId,
    fence: &Fence,
    key: &String,
    tx: &mut Tx<'_>,
    options: &StoreOptions,
) -> Result<Done<Option<String>>, SqlError> {
    let (state, _) = load_for_renewal(tx, id).await?.ok_or(StoreError::Fenced)?;
    state.on(&Event::Renew(fence.clone()), options.max_attempts).map_err(|_| StoreError::Fenced)?;
    let before = named_checkpoint(tx, id).await?;
    tx.execute("UPDATE jobs SET checkpoint = $2 WHERE id = $1", values![id, key]).await?;
    Ok(Done::quiet(before.filter(|before| before != key)))
}

/// True if the record of the job names this checkpoint.
async fn names_checkpoint(id: JobId, key: &str, tx: &mut Tx<'_>) -> Result<bool, SqlError> {
    let is_stored = load_for_renewal(tx, id).await?.is_some();
    Ok(is_stored && named_checkpoint(tx, id).await?.as_deref() == Some(key))
}

async fn named_checkpoint(tx: &mut Tx<'_>, id: JobId) -> Result<Option<String>, SqlError> {
    tx.one("SELECT checkpoint FROM jobs WHERE id = $1", values![id]).await?.get("checkpoint")
}

async fn cancel_one(id: JobId, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Option<Job>>, SqlError> {
    let cancelled = cancel(tx, options, id, None).await?;
    let Some(job) = read::job(tx, id).await? else { return Ok(Done::quiet(None)) };
    let Some(Done { output, changes }) = cancelled else { return Ok(Done::quiet(Some(job))) };
    // The record no longer names the checkpoint; the caller removes its file.
    let job = Job { checkpoint: job.checkpoint.clone().or(output.into_iter().next()), ..job };
    Ok(Done::new(Some(job), changes))
}

/// Cancels a job; with `status`, only if it is in that status. Returns the key of the checkpoint if
/// the cancellation ended the job; `None` if nothing changes or the job does not exist.
pub(super) async fn cancel(
    tx: &mut Tx<'_>,
    options: &StoreOptions,
    id: JobId,
    status: Option<Status>,
) -> Result<Option<Done<Vec<String>>>, SqlError> {
    let found = load(tx, id).await?.filter(|(state, _)| status.is_none_or(|status| status == state.status));
    let Some((state, _)) = found else { return Ok(None) };
    let Some(next) = state.on(&Event::Cancel, options.max_attempts).ok().filter(|next| next.state != state) else {
        return Ok(None);
    };
    let checkpoint = if next.state.status.is_ended() { named_checkpoint(tx, id).await? } else { None };
    let changes = write(tx, id, &next, &AttemptEffect::None, None).await?;
    Ok(Some(Done::new(checkpoint.into_iter().collect(), changes)))
}

/// Applies an event that the state of the job is known to allow.
pub(super) async fn apply(
    tx: &mut Tx<'_>,
    options: &StoreOptions,
    id: JobId,
    event: &Event,
    lease_until: Option<Timestamp>,
) -> Result<Vec<Change>, SqlError> {
    let changed = || SqlError::Inconsistent(format!("job {id}"));
    let (state, _) = load(tx, id).await?.ok_or_else(changed)?;
    let next = state.on(event, options.max_attempts).map_err(|_| changed())?;
    write(tx, id, &next, &AttemptEffect::None, lease_until).await
}

/// The state and version of a job, locked until the transaction ends.
pub(super) async fn load(tx: &mut Tx<'_>, id: JobId) -> Result<Option<(JobState, u64)>, SqlError> {
    load_locked(tx, id, " FOR UPDATE").await
}

/// The state and version for a change that does not end the job. The weaker lock lets submissions
/// proceed that will wait for the job.
pub(super) async fn load_for_renewal(tx: &mut Tx<'_>, id: JobId) -> Result<Option<(JobState, u64)>, SqlError> {
    load_locked(tx, id, " FOR NO KEY UPDATE").await
}

async fn load_locked(tx: &mut Tx<'_>, id: JobId, lock: &'static str) -> Result<Option<(JobState, u64)>, SqlError> {
    let sql = format!(
        "SELECT status, attempts, spent, cancel_requested, holder, version FROM jobs WHERE id = $1{}",
        tx.either("", lock),
    );
    let row = tx.optional(sql, values![id]).await?;
    row.map(|row| {
        let state = JobState {
            status: enum_from_sql(row.get("status")?)?,
            attempts: row.count("attempts")?,
            spent: row.count("spent")?,
            cancel_requested: row.get("cancel_requested")?,
            holder: row.get("holder")?,
        };
        Ok((state, row.count("version")?))
    })
    .transpose()
}

/// Data that the end of an attempt adds to the records of the job and the attempt.
pub(super) enum AttemptEffect {
    None,
    Finished(Finished),
    Failed(BackendReport, Problem),
    /// Problem of the attempt alone.
    Fault(Problem),
    /// The job goes behind the first job of another submitter in its lane.
    Yielded,
}

/// Writes a state: ends the attempt that ran, then updates the record of the job and the records of
/// jobs that waited for its end. A running job keeps its lease unless `lease_until` is a new one.
pub(super) async fn write(
    tx: &mut Tx<'_>,
    id: JobId,
    next: &Next,
    effect: &AttemptEffect,
    lease_until: Option<Timestamp>,
) -> Result<Vec<Change>, SqlError> {
    let now = tx.now().await?;
    let state = &next.state;
    if let Some(how) = next.ended {
        let sql = "UPDATE attempts SET ended_at = $3, outcome = $4 WHERE job_id = $1 AND attempt = $2";
        tx.execute(sql, values![id, state.attempts, now, enum_to_sql(how)]).await?;
    }
    let (mut summary, mut engine, mut backend, mut problem) = (None, None, None, None);
    match effect {
        AttemptEffect::Finished(finished) => {
            (summary, engine) = (Some(json(&finished.summary)), Some(finished.engine.clone()));
            backend = Some(&finished.backend);
        }
        AttemptEffect::Failed(report, cause) => (backend, problem) = (Some(report), Some(json(cause))),
        AttemptEffect::None | AttemptEffect::Fault(_) | AttemptEffect::Yielded => {}
    }
    if next.exhausted {
        problem = Some(json(&Attempt::exhausted(&read::attempts(tx, id).await?)));
    }
    let available = match next.ended {
        Some(AttemptEnd::Retried) => until(tx.steady().await?, state::retry_delay(state.spent)).as_microsecond(),
        // Immediately, even if the clock is set back.
        _ => 0,
    };
    // The progress and the backend of an attempt end with it if the job returns to the queue.
    let sql = "UPDATE jobs SET status = $2, attempts = $3, spent = $4, cancel_requested = $5, holder = $6, \
               lease_until = CASE WHEN $2 = 'running' THEN COALESCE($7, lease_until) END, \
               started_at = CASE WHEN $2 = 'running' THEN COALESCE(started_at, $8) ELSE started_at END, \
               finished_at = CASE WHEN $9 THEN $8 END, \
               checkpoint = CASE WHEN $9 THEN NULL ELSE checkpoint END, \
               available_at = CASE WHEN $2 = 'queued' THEN $10 ELSE available_at END, \
               progress = CASE WHEN $2 = 'queued' THEN NULL ELSE progress END, \
               section = CASE WHEN $2 = 'running' THEN section END, \
               summary = COALESCE($11, summary), engine_used = COALESCE($12, engine_used), \
               problem = COALESCE($13, problem), \
               backend_used = CASE WHEN $2 = 'queued' THEN NULL WHEN $14 THEN $15 ELSE backend_used END, \
               device = CASE WHEN $2 = 'queued' THEN NULL WHEN $14 THEN $16 ELSE device END, \
               fallback = CASE WHEN $2 = 'queued' THEN NULL WHEN $14 THEN $17 ELSE fallback END, \
               version = version + 1 WHERE id = $1 RETURNING version";
    let JobState { status, attempts, spent, cancel_requested, holder } = state;
    let values = values![
        id,
        status.name(),
        *attempts,
        *spent,
        *cancel_requested,
        holder,
        lease_until,
        now,
        status.is_ended(),
        available,
        summary,
        engine,
        problem,
        backend.is_some(),
        backend.and_then(|report| report.used).map(enum_to_sql),
        backend.and_then(|report| report.device.clone()),
        backend.and_then(|report| report.fallback.clone()),
    ];
    let mut changes = vec![Change { id, version: Some(tx.one(sql, values).await?.count("version")?) }];
    if state.status.is_ended() {
        changes.extend(share::settle(tx, id, state.status).await?);
    } else if state.status == Status::Queued {
        changes.extend(share::promote_more_urgent(tx, id).await?);
    }
    Ok(changes)
}
