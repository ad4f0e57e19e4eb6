//! Leases: expiry, renewal, the end of an attempt, cancelling. Every event goes through [`State::on`].

use super::codec::{enum_from_sql, enum_to_sql, json, until, values};
use super::error::SqlError;
use super::operation::{Before, Done, LONG_PATIENCE, Operation};
use super::read::{self, known_job};
use super::share;
use super::submit::insert_files;
use super::tx::Tx;
use crate::jobs::job::{BackendReport, Job, JobId, JobProgress, LiveSection, Problem, Status};
use crate::jobs::state::{self, AttemptEnd, Event, Fence, Next, State};
use crate::jobs::store::{Attempt, Change, Directive, Finished, StoreError, StoreOptions};
use jiff::Timestamp;
use std::time::Duration;

/// Most leases that are ended in one transaction.
const EXPIRED: u32 = 1000;

/// Ends attempts whose lease ended at `before` or earlier, at most [`EXPIRED`] of them. Gives their jobs.
#[derive(Debug)]
pub(in crate::jobs) struct Expire {
    pub(in crate::jobs) before: Timestamp,
}

impl Operation for Expire {
    type Output = Vec<JobId>;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Vec<JobId>>, SqlError> {
        let changes = expire(tx, options, self.before).await?;
        Ok(Done::new(changes.iter().map(|change| change.id).collect(), changes))
    }
}

async fn expire(tx: &mut Tx<'_>, options: &StoreOptions, before: Timestamp) -> Result<Vec<Change>, SqlError> {
    // Rows that another transaction is writing are left to it.
    let sql = format!(
        "SELECT id FROM jobs{} WHERE status = 'running' AND lease_until <= $1 ORDER BY lease_until LIMIT {EXPIRED}{}",
        tx.either(" INDEXED BY jobs_leases", ""),
        tx.either("", " FOR UPDATE SKIP LOCKED"),
    );
    let rows = tx.all(sql, values![before]).await?;
    let mut changes = Vec::with_capacity(rows.len());
    for row in &rows {
        let id = row.id("id")?;
        changes.extend(apply(tx, options, id, &Event::Expire, None).await?);
    }
    Ok(changes)
}

/// Renews a lease and records progress.
#[derive(Debug)]
pub(super) struct Renew {
    pub(super) id: JobId,
    pub(super) fence: Fence,
    pub(super) lease: Duration,
    pub(super) backend: BackendReport,
    pub(super) progress: Option<JobProgress>,
    pub(super) section: Option<LiveSection>,
}

impl Operation for Renew {
    type Output = Directive;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Directive>, SqlError> {
        let Some((state, before)) = load_for_renewal(tx, self.id).await? else {
            return Ok(Done::quiet(Directive::Lost));
        };
        if state.on(&Event::Renew(self.fence.clone()), options.max_attempts).is_err() {
            return Ok(Done::quiet(Directive::Lost));
        }
        let now = tx.steady().await?;
        let row = tx
            .one(
                "UPDATE jobs SET lease_until = $2, \
                 version = version + CASE WHEN $7 OR $8 OR backend_used IS DISTINCT FROM $3 \
                 OR device IS DISTINCT FROM $4 OR fallback IS DISTINCT FROM $5 THEN 1 ELSE 0 END, \
                 backend_used = $3, device = $4, fallback = $5, \
                 progress = COALESCE($6, progress), section = COALESCE($9, section) \
                 WHERE id = $1 RETURNING version",
                values![
                    self.id,
                    until(now, self.lease),
                    self.backend.used.map(enum_to_sql),
                    &self.backend.device,
                    &self.backend.fallback,
                    self.progress.as_ref().map(json),
                    self.progress.is_some(),
                    self.section.is_some(),
                    self.section.as_ref().map(json),
                ],
            )
            .await?;
        let directive = if state.cancel_requested { Directive::Cancel } else { Directive::Continue };
        let version = row.count("version")?;
        let change = Change { id: self.id, version: Some(version) };
        Ok(Done::new(directive, if version > before { vec![change] } else { vec![] }))
    }
}

/// Records the key of the newest checkpoint. Gives the key that it replaces.
#[derive(Debug)]
pub(super) struct SetCheckpoint {
    pub(super) id: JobId,
    pub(super) fence: Fence,
    pub(super) key: String,
}

impl Operation for SetCheckpoint {
    type Output = Option<String>;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Option<String>>, SqlError> {
        let (state, _) = load_for_renewal(tx, self.id).await?.ok_or(StoreError::Fenced)?;
        state.on(&Event::Renew(self.fence.clone()), options.max_attempts).map_err(|_| StoreError::Fenced)?;
        let before = named_checkpoint(tx, self.id).await?;
        tx.execute("UPDATE jobs SET checkpoint = $2 WHERE id = $1", values![self.id, &self.key]).await?;
        Ok(Done::quiet(before.filter(|before| *before != self.key)))
    }
}

async fn named_checkpoint(tx: &mut Tx<'_>, id: JobId) -> Result<Option<String>, SqlError> {
    let row = tx.one("SELECT checkpoint FROM jobs WHERE id = $1", values![id]).await?;
    Ok(row.optional_text("checkpoint")?.map(str::to_owned))
}

/// What the end of an attempt adds to the record.
#[derive(Debug)]
pub(super) enum Record {
    Nothing,
    Finished(Finished),
    Failed(BackendReport, Problem),
    Fault(Problem),
}

/// Ends the attempt of a claimed job by `event`.
#[derive(Debug)]
pub(super) struct End {
    pub(super) id: JobId,
    pub(super) fence: Fence,
    pub(super) event: Event,
    pub(super) record: Record,
}

impl Operation for End {
    type Output = Job;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Job>, SqlError> {
        let id = self.id;
        let (state, _) = load(tx, id).await?.ok_or(StoreError::Fenced)?;
        let next = state.on(&self.event, options.max_attempts).map_err(|_| StoreError::Fenced)?;
        let mut fault = None;
        match &self.record {
            Record::Nothing => {}
            Record::Finished(finished) => {
                tx.execute(
                    "UPDATE jobs SET summary = $2, engine_used = $3 WHERE id = $1",
                    values![id, json(&finished.summary), &finished.engine],
                )
                .await?;
                set_backend(tx, id, &finished.backend).await?;
                insert_files(tx, id, finished.files.iter()).await?;
            }
            Record::Failed(backend, problem) => {
                set_backend(tx, id, backend).await?;
                set_problem(tx, id, problem).await?;
                fault = Some(problem);
            }
            Record::Fault(problem) => fault = Some(problem),
        }
        if let Some(problem) = fault {
            tx.execute(
                "UPDATE attempts SET detail = $3 WHERE job_id = $1 AND attempt = $2",
                values![id, state.attempts, format!("{}: {}", problem.kind, problem.detail)],
            )
            .await?;
        }
        let changes = write(tx, id, &next, None).await?;
        Ok(Done::new(known_job(tx, id).await?, changes))
    }

    /// The computed model is worth a long wait; the fence holds whatever happens meanwhile.
    fn patience(&self) -> Duration {
        LONG_PATIENCE
    }

    async fn done_before(&self, tx: &mut Tx<'_>) -> Result<Before<Job>, SqlError> {
        // Waits at the job's row for a commit that is still under way.
        load(tx, self.id).await?;
        // Only the holder ends its attempt with these events, and only once.
        let how = match self.event {
            Event::Finish(_) => AttemptEnd::Succeeded,
            Event::Fail(_) => AttemptEnd::Failed,
            Event::Stopped(_) => AttemptEnd::Cancelled,
            Event::Release(_) => AttemptEnd::Released,
            Event::Retry(_) => AttemptEnd::Retried,
            Event::Cancel | Event::Claim(_) | Event::Expire | Event::Renew(_) => return Ok(None),
        };
        let done = tx
            .optional(
                "SELECT 1 AS done FROM attempts WHERE job_id = $1 AND attempt = $2 AND worker = $3 AND outcome = $4",
                values![self.id, self.fence.attempt, &self.fence.worker, enum_to_sql(how)],
            )
            .await?;
        let job = match done {
            Some(_) => read::job(tx, self.id).await?,
            None => None,
        };
        Ok(job.map(|job| {
            let change = Change { id: job.id, version: Some(job.version) };
            Done::new(job, vec![change])
        }))
    }
}

/// Cancels. Gives the job, if it exists.
#[derive(Debug)]
pub(super) struct Cancel(pub(super) JobId);

impl Operation for Cancel {
    type Output = Option<Job>;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Option<Job>>, SqlError> {
        let id = self.0;
        let cancelled = cancel(tx, options, id, None).await?;
        let Some(job) = read::job(tx, id).await? else { return Ok(Done::quiet(None)) };
        let Some(Cancelled { changes, checkpoint }) = cancelled else { return Ok(Done::quiet(Some(job))) };
        // The record no longer names the checkpoint; the caller removes its file.
        let job = Job { checkpoint: job.checkpoint.clone().or(checkpoint), ..job };
        Ok(Done::new(Some(job), changes))
    }
}

/// A job that was cancelled just now, or asked to stop.
#[derive(Debug)]
pub(super) struct Cancelled {
    pub(super) changes: Vec<Change>,
    /// The checkpoint that its record named, if it has ended by this.
    pub(super) checkpoint: Option<String>,
}

/// Cancels a job, if it is in `status` or that is `None`. `None` if that changes nothing, or there is no such job.
pub(super) async fn cancel(
    tx: &mut Tx<'_>,
    options: &StoreOptions,
    id: JobId,
    status: Option<Status>,
) -> Result<Option<Cancelled>, SqlError> {
    let found = load(tx, id).await?.filter(|(state, _)| status.is_none_or(|status| status == state.status));
    let Some((state, _)) = found else { return Ok(None) };
    let Some(next) = state.on(&Event::Cancel, options.max_attempts).ok().filter(|next| next.state != state) else {
        return Ok(None);
    };
    let checkpoint = if next.state.status.is_ended() { named_checkpoint(tx, id).await? } else { None };
    let changes = write(tx, id, &next, None).await?;
    Ok(Some(Cancelled { changes, checkpoint }))
}

/// Applies an event that the job's state is known to allow.
pub(super) async fn apply(
    tx: &mut Tx<'_>,
    options: &StoreOptions,
    id: JobId,
    event: &Event,
    lease_until: Option<Timestamp>,
) -> Result<Vec<Change>, SqlError> {
    let gone = || StoreError::Database(format!("job {id} changed within a transaction"));
    let (state, _) = load(tx, id).await?.ok_or_else(gone)?;
    let next = state.on(event, options.max_attempts).map_err(|_| gone())?;
    write(tx, id, &next, lease_until).await
}

/// The state and version of a job, locked until the transaction ends.
async fn load(tx: &mut Tx<'_>, id: JobId) -> Result<Option<(State, u64)>, SqlError> {
    load_locked(tx, id, " FOR UPDATE").await
}

/// The same for what does not end the job: submissions that will wait for it are not waited for.
pub(super) async fn load_for_renewal(tx: &mut Tx<'_>, id: JobId) -> Result<Option<(State, u64)>, SqlError> {
    load_locked(tx, id, " FOR NO KEY UPDATE").await
}

async fn load_locked(tx: &mut Tx<'_>, id: JobId, lock: &'static str) -> Result<Option<(State, u64)>, SqlError> {
    let sql = format!(
        "SELECT status, attempts, spent, cancel_requested, holder, version FROM jobs WHERE id = $1{}",
        tx.either("", lock),
    );
    let row = tx.optional(sql, values![id]).await?;
    row.map(|row| {
        let state = State {
            status: enum_from_sql(row.text("status")?)?,
            attempts: row.count("attempts")?,
            spent: row.count("spent")?,
            cancel_requested: row.flag("cancel_requested")?,
            holder: row.optional_text("holder")?.map(str::to_owned),
        };
        Ok((state, row.count("version")?))
    })
    .transpose()
}

/// Writes a state: ends the attempt that ran, then updates the record, and those of jobs that waited for its end. A running
/// job keeps its lease unless `lease_until` gives a new one.
async fn write(
    tx: &mut Tx<'_>,
    id: JobId,
    next: &Next,
    lease_until: Option<Timestamp>,
) -> Result<Vec<Change>, SqlError> {
    let now = tx.now().await?;
    let state = &next.state;
    if let Some(how) = next.ended {
        tx.execute(
            "UPDATE attempts SET ended_at = $3, outcome = $4 WHERE job_id = $1 AND attempt = $2",
            values![id, state.attempts, now, enum_to_sql(how)],
        )
        .await?;
    }
    if next.exhausted {
        let history = read::attempts(tx, id).await?;
        set_problem(tx, id, &Attempt::exhausted(&history)).await?;
    }
    if state.status == Status::Queued {
        // The progress of an attempt is lost with it.
        let available = match next.ended {
            Some(AttemptEnd::Retried) => until(tx.steady().await?, state::retry_delay(state.spent)).as_microsecond(),
            // At once, even if the clock is set back.
            _ => 0,
        };
        tx.execute(
            "UPDATE jobs SET progress = NULL, section = NULL, backend_used = NULL, device = NULL, fallback = NULL, \
             available_at = $2 WHERE id = $1",
            values![id, available],
        )
        .await?;
    }
    let row = tx
        .one(
            "UPDATE jobs SET status = $2, attempts = $3, spent = $4, cancel_requested = $5, holder = $6, \
             lease_until = CASE WHEN $2 = 'running' THEN COALESCE($7, lease_until) END, \
             started_at = CASE WHEN $2 = 'running' THEN COALESCE(started_at, $8) ELSE started_at END, \
             finished_at = CASE WHEN $9 THEN $8 END, \
             checkpoint = CASE WHEN $9 THEN NULL ELSE checkpoint END, version = version + 1 WHERE id = $1 RETURNING version",
            values![
                id,
                enum_to_sql(state.status),
                state.attempts,
                state.spent,
                state.cancel_requested,
                &state.holder,
                lease_until,
                now,
                state.status.is_ended(),
            ],
        )
        .await?;
    let mut changes = vec![Change { id, version: Some(row.count("version")?) }];
    if state.status.is_ended() {
        changes.extend(share::settle(tx, id, state.status).await?);
    } else if state.status == Status::Queued {
        changes.extend(share::promote_more_urgent(tx, id).await?);
    }
    Ok(changes)
}

async fn set_backend(tx: &mut Tx<'_>, id: JobId, backend: &BackendReport) -> Result<(), SqlError> {
    let values = values![id, backend.used.map(enum_to_sql), &backend.device, &backend.fallback];
    tx.execute("UPDATE jobs SET backend_used = $2, device = $3, fallback = $4 WHERE id = $1", values).await?;
    Ok(())
}

async fn set_problem(tx: &mut Tx<'_>, id: JobId, problem: &Problem) -> Result<(), SqlError> {
    tx.execute("UPDATE jobs SET problem = $2 WHERE id = $1", values![id, json(problem)]).await?;
    Ok(())
}
