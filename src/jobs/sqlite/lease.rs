//! The life of a lease: expire, claim, renew, end. Every event goes through [`State::on`].

use super::read::{self, known_job};
use super::submit::insert_files;
use super::{json, micros, word};
use crate::generate::{Backend, Progress};
use crate::jobs::job::{BackendReport, Job, JobId, LiveSection, Problem, Status};
use crate::jobs::state::{self, Event, Fence, Next, State};
use crate::jobs::store::{Attempt, Change, ClaimedJob, Directive, Finished, StoreError, StoreOptions};
use jiff::Timestamp;
use sqlx::{Row, SqliteConnection};
use std::time::Duration;

/// What an end adds to the record.
pub(super) enum Record {
    Nothing,
    Finished(Finished),
    Failed(BackendReport, Problem),
    Fault(Problem),
}

/// What a heartbeat adds to the record.
pub(super) struct Live {
    pub(super) backend: BackendReport,
    pub(super) progress: Option<Progress>,
    pub(super) section: Option<LiveSection>,
}

/// Whether a claim would find something to do.
pub(super) async fn any_to_claim(
    connection: &mut SqliteConnection,
    backend: Backend,
    now: Timestamp,
) -> Result<bool, StoreError> {
    for requested in state::accepted(backend) {
        let queued: bool = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM jobs INDEXED BY jobs_queue \
             WHERE status = 'queued' AND backend_requested = ? AND available_at <= ?)",
        )
        .bind(word(requested))
        .bind(micros(now))
        .fetch_one(&mut *connection)
        .await?;
        if queued {
            return Ok(true);
        }
    }
    Ok(sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM jobs INDEXED BY jobs_leases WHERE status = 'running' AND lease_until <= ?)",
    )
    .bind(micros(now))
    .fetch_one(connection)
    .await?)
}

/// Ends the attempts whose lease had run out at `now`; all leases where it is `None`.
pub(super) async fn expire(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    now: Option<Timestamp>,
) -> Result<Vec<Change>, StoreError> {
    let ids: Vec<String> = sqlx::query_scalar(
        "SELECT id FROM jobs INDEXED BY jobs_leases WHERE status = 'running' AND lease_until <= ? ORDER BY lease_until",
    )
    .bind(now.map_or(i64::MAX, micros))
    .fetch_all(&mut *tx)
    .await?;
    let mut changes = Vec::with_capacity(ids.len());
    for id in ids {
        let id = read::id(&id)?;
        let version = apply(tx, options, id, &Event::Expire, None).await?;
        changes.push(Change { id, version: Some(version) });
    }
    Ok(changes)
}

pub(super) async fn claim(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    worker: &str,
    backend: Backend,
    lease: Duration,
    limit: u32,
) -> Result<Vec<ClaimedJob>, StoreError> {
    let now = options.clock.now();
    // The heads of the queues of each backend, merged by age.
    let mut ids: Vec<String> = Vec::new();
    for requested in state::accepted(backend) {
        let head: Vec<String> = sqlx::query_scalar(
            "SELECT id FROM jobs INDEXED BY jobs_queue \
             WHERE status = 'queued' AND backend_requested = ? AND available_at <= ? ORDER BY id LIMIT ?",
        )
        .bind(word(requested))
        .bind(micros(now))
        .bind(limit)
        .fetch_all(&mut *tx)
        .await?;
        ids.extend(head);
    }
    ids.sort_unstable();
    ids.truncate(limit as usize);
    let mut claimed = Vec::with_capacity(ids.len());
    for id in ids {
        let id = read::id(&id)?;
        apply(tx, options, id, &Event::Claim(worker.to_owned()), Some(until(now, lease))).await?;
        let job = known_job(tx, id).await?;
        sqlx::query("INSERT INTO attempts (job_id, attempt, worker, started_at) VALUES (?, ?, ?, ?)")
            .bind(id.to_string())
            .bind(job.attempts)
            .bind(worker)
            .bind(micros(now))
            .execute(&mut *tx)
            .await?;
        claimed.push(ClaimedJob { attempt: job.attempts, worker: worker.to_owned(), job });
    }
    Ok(claimed)
}

/// Renews a lease and records what is new. Returns the version where it grew.
pub(super) async fn renew(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    id: JobId,
    fence: Fence,
    lease: Duration,
    live: &Live,
) -> Result<(Directive, Option<u64>), StoreError> {
    let Some(state) = load(tx, id).await? else {
        return Ok((Directive::Lost, None));
    };
    if state.on(&Event::Renew(fence), options.max_attempts).is_err() {
        return Ok((Directive::Lost, None));
    }
    let before = version(tx, id).await?;
    let row = sqlx::query(
        "UPDATE jobs SET lease_until = ?2, \
         version = version + (?7 OR ?8 OR backend_used IS NOT ?3 OR device IS NOT ?4 OR fallback IS NOT ?5), \
         backend_used = ?3, device = ?4, fallback = ?5, \
         progress = COALESCE(?6, progress), section = COALESCE(?9, section) \
         WHERE id = ?1 RETURNING version",
    )
    .bind(id.to_string())
    .bind(micros(until(options.clock.now(), lease)))
    .bind(live.backend.used.map(word))
    .bind(&live.backend.device)
    .bind(&live.backend.fallback)
    .bind(live.progress.as_ref().map(json))
    .bind(live.progress.is_some())
    .bind(live.section.is_some())
    .bind(live.section.as_ref().map(json))
    .fetch_one(tx)
    .await?;
    let directive = if state.cancel_requested { Directive::Cancel } else { Directive::Continue };
    let version = read::count(&row, "version")?;
    Ok((directive, (version > before).then_some(version)))
}

async fn version(tx: &mut SqliteConnection, id: JobId) -> Result<u64, StoreError> {
    let row = sqlx::query("SELECT version FROM jobs WHERE id = ?").bind(id.to_string()).fetch_one(tx).await?;
    read::count(&row, "version")
}

/// Names the newest checkpoint; returns the key that it replaces.
pub(super) async fn set_checkpoint(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    id: JobId,
    fence: Fence,
    key: &str,
) -> Result<Option<String>, StoreError> {
    let state = load(tx, id).await?.ok_or(StoreError::Fenced)?;
    state.on(&Event::Renew(fence), options.max_attempts).map_err(|_| StoreError::Fenced)?;
    let before: Option<String> =
        sqlx::query_scalar("SELECT checkpoint FROM jobs WHERE id = ?").bind(id.to_string()).fetch_one(&mut *tx).await?;
    sqlx::query("UPDATE jobs SET checkpoint = ? WHERE id = ?").bind(key).bind(id.to_string()).execute(tx).await?;
    Ok(before.filter(|before| before != key))
}

/// Ends the attempt of a claimed job.
pub(super) async fn end(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    id: JobId,
    event: &Event,
    record: Record,
) -> Result<Job, StoreError> {
    let state = load(tx, id).await?.ok_or(StoreError::Fenced)?;
    let next = state.on(event, options.max_attempts).map_err(|_| StoreError::Fenced)?;
    let mut fault = None;
    match record {
        Record::Nothing => {}
        Record::Finished(finished) => {
            sqlx::query("UPDATE jobs SET summary = ?, engine_used = ? WHERE id = ?")
                .bind(json(&finished.summary))
                .bind(&finished.engine)
                .bind(id.to_string())
                .execute(&mut *tx)
                .await?;
            set_backend(tx, id, &finished.backend).await?;
            insert_files(tx, id, finished.files.iter()).await?;
        }
        Record::Failed(backend, problem) => {
            set_backend(tx, id, &backend).await?;
            set_problem(tx, id, &problem).await?;
            fault = Some(problem);
        }
        Record::Fault(problem) => fault = Some(problem),
    }
    if let Some(problem) = fault {
        sqlx::query("UPDATE attempts SET detail = ? WHERE job_id = ? AND attempt = ?")
            .bind(format!("{}: {}", problem.kind, problem.detail))
            .bind(id.to_string())
            .bind(state.attempts)
            .execute(&mut *tx)
            .await?;
    }
    write(tx, options, id, &next, None).await?;
    known_job(tx, id).await
}

/// Cancels. Returns the job and whether that changed it.
pub(super) async fn cancel(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    id: JobId,
) -> Result<Option<(Job, bool)>, StoreError> {
    let Some(state) = load(tx, id).await? else {
        return Ok(None);
    };
    let next = state.on(&Event::Cancel, options.max_attempts).ok().filter(|next| next.state != state);
    if let Some(next) = &next {
        write(tx, options, id, next, None).await?;
    }
    Ok(Some((known_job(tx, id).await?, next.is_some())))
}

/// Applies an event of which the store knows that the job's state allows it. Returns the new version.
async fn apply(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    id: JobId,
    event: &Event,
    lease_until: Option<Timestamp>,
) -> Result<u64, StoreError> {
    let gone = || StoreError::Database(format!("job {id} changed within a transaction"));
    let state = load(tx, id).await?.ok_or_else(gone)?;
    let next = state.on(event, options.max_attempts).map_err(|_| gone())?;
    write(tx, options, id, &next, lease_until).await
}

async fn load(tx: &mut SqliteConnection, id: JobId) -> Result<Option<State>, StoreError> {
    let row = sqlx::query("SELECT status, attempts, spent, cancel_requested, holder FROM jobs WHERE id = ?")
        .bind(id.to_string())
        .fetch_optional(tx)
        .await?;
    row.map(|row| {
        Ok(State {
            status: read::variant(row.try_get("status")?)?,
            attempts: row.try_get("attempts")?,
            spent: row.try_get("spent")?,
            cancel_requested: row.try_get("cancel_requested")?,
            holder: row.try_get("holder")?,
        })
    })
    .transpose()
}

/// Writes a state down: ends the attempt that ran, then changes the record. A running job without a new
/// lease keeps the one it has.
async fn write(
    tx: &mut SqliteConnection,
    options: &StoreOptions,
    id: JobId,
    next: &Next,
    lease_until: Option<Timestamp>,
) -> Result<u64, StoreError> {
    let now = options.clock.now();
    let state = &next.state;
    if let Some(how) = next.ended {
        sqlx::query("UPDATE attempts SET ended_at = ?, outcome = ? WHERE job_id = ? AND attempt = ?")
            .bind(micros(now))
            .bind(word(how))
            .bind(id.to_string())
            .bind(state.attempts)
            .execute(&mut *tx)
            .await?;
    }
    if next.exhausted {
        let history = read::attempts(tx, id).await?;
        set_problem(tx, id, &Attempt::exhausted(&history)).await?;
    }
    if state.status == Status::Queued {
        // What the last attempt reached is gone with it.
        let wait = match next.ended {
            Some(state::AttemptEnd::Retried) => state::retry_delay(state.spent),
            _ => Duration::ZERO,
        };
        sqlx::query(
            "UPDATE jobs SET progress = NULL, section = NULL, backend_used = NULL, device = NULL, fallback = NULL, \
             available_at = ? WHERE id = ?",
        )
        .bind(micros(until(now, wait)))
        .bind(id.to_string())
        .execute(&mut *tx)
        .await?;
    }
    let row = sqlx::query(
        "UPDATE jobs SET status = ?2, attempts = ?3, spent = ?4, cancel_requested = ?5, holder = ?6, \
         lease_until = CASE WHEN ?2 = 'running' THEN COALESCE(?7, lease_until) END, \
         started_at = CASE WHEN ?2 = 'running' THEN COALESCE(started_at, ?8) ELSE started_at END, \
         finished_at = CASE WHEN ?9 THEN ?8 END, checkpoint = CASE WHEN ?9 THEN NULL ELSE checkpoint END, version = version + 1 WHERE id = ?1 RETURNING version",
    )
    .bind(id.to_string())
    .bind(word(state.status))
    .bind(state.attempts)
    .bind(state.spent)
    .bind(state.cancel_requested)
    .bind(&state.holder)
    .bind(lease_until.map(micros))
    .bind(micros(now))
    .bind(state.status.is_ended())
    .fetch_one(tx)
    .await?;
    read::count(&row, "version")
}

async fn set_backend(tx: &mut SqliteConnection, id: JobId, backend: &BackendReport) -> Result<(), StoreError> {
    sqlx::query("UPDATE jobs SET backend_used = ?, device = ?, fallback = ? WHERE id = ?")
        .bind(backend.used.map(word))
        .bind(&backend.device)
        .bind(&backend.fallback)
        .bind(id.to_string())
        .execute(tx)
        .await?;
    Ok(())
}

async fn set_problem(tx: &mut SqliteConnection, id: JobId, problem: &Problem) -> Result<(), StoreError> {
    sqlx::query("UPDATE jobs SET problem = ? WHERE id = ?")
        .bind(json(problem))
        .bind(id.to_string())
        .execute(tx)
        .await?;
    Ok(())
}

fn until(now: Timestamp, wait: Duration) -> Timestamp {
    now.saturating_add(wait).unwrap_or(Timestamp::MAX)
}
