//! Ends of attempts: a worker has finished its job, failed, or gives the job back.
//!
//! On PostgreSQL, the attempts of a group that succeeded end in one statement. It has the effect of
//! [`Event::End`] on jobs that are still held and have not been cancelled; the others end one by
//! one.

use super::codec::{enum_to_sql, json, values};
use super::error::SqlError;
use super::lease::{AttemptEffect, load, write};
use super::operation::{Done, Grouped, LONG_RETRY_LIMIT, Operation, Results, or_refusal};
use super::order;
use super::record::submitter;
use super::store::Store;
use super::submit::insert_files;
use super::tx::{Row, Tx};
use crate::jobs::state::{AttemptEnd, Event, Fence};
use crate::jobs::{BackendReport, Change, ClaimedJob, Finished, JobId, Problem, Status, StoreError, StoreOptions};
use serde_json::json as object;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Calls of a worker that end its attempt. They return the status of the job: one that was
/// cancelled in the meantime is cancelled.
impl Store {
    /// Ends the job as succeeded. Its files and its state become visible together. A job that was
    /// cancelled in the meantime ends as cancelled, without files.
    pub async fn finish(&self, claimed: ClaimedJob, finished: Finished) -> Result<Status, StoreError> {
        self.end("finish", &claimed, AttemptEnd::Succeeded, AttemptEffect::Finished(finished)).await
    }

    /// Ends the job as failed, or as cancelled if it was cancelled in the meantime.
    pub async fn fail(
        &self,
        claimed: ClaimedJob,
        backend: BackendReport,
        problem: Problem,
    ) -> Result<Status, StoreError> {
        self.end("fail", &claimed, AttemptEnd::Failed, AttemptEffect::Failed(backend, problem)).await
    }

    /// Ends the job as cancelled.
    pub async fn cancelled(&self, claimed: ClaimedJob) -> Result<Status, StoreError> {
        self.end("cancelled", &claimed, AttemptEnd::Cancelled, AttemptEffect::None).await
    }

    /// Returns the job to its place in the queue; the attempt does not count. The row of the
    /// attempt records the problem, if there is one, as `kind: detail`. A job that was cancelled in
    /// the meantime ends as cancelled.
    pub async fn release(&self, claimed: ClaimedJob, problem: Option<Problem>) -> Result<(), StoreError> {
        let effect = problem.map_or(AttemptEffect::None, AttemptEffect::Fault);
        self.end("release", &claimed, AttemptEnd::Released, effect).await.map(drop)
    }

    /// Returns a fit to the queue, behind the first fit of another submitter; the attempt does not
    /// count.
    pub async fn yield_turn(&self, claimed: ClaimedJob) -> Result<(), StoreError> {
        self.end("yield_turn", &claimed, AttemptEnd::Released, AttemptEffect::Yielded).await.map(drop)
    }

    /// True if another fit should have the turn of a running one: a queued fit of higher priority,
    /// or one of another submitter with the same priority.
    pub async fn fit_waits(&self, running: &ClaimedJob) -> Result<bool, StoreError> {
        let tx = &mut self.read("fit_waits").await?;
        let waits = |condition: &str| {
            format!(
                "(SELECT 1 FROM jobs{} WHERE status = 'queued' AND NOT shares AND lane = 'fit' AND {condition} \
                 LIMIT 1) IS NOT NULL",
                tx.either(" INDEXED BY jobs_queue_by_submitter", "")
            )
        };
        let sql = format!("SELECT {} OR {} AS waits", waits("rank < $1"), waits("rank = $1 AND submitter <> $2"));
        let job = running.job();
        let values = values![order::rank(job.priority), submitter(job.owner.as_deref())];
        Ok(tx.one(sql, values).await?.get("waits")?)
    }

    /// Queues the job again after a transient error; the attempt counts. The job is due again after
    /// a delay (1 s, doubled for each counted attempt). After the last attempt it fails
    /// (`attempts-exhausted`, with the history).
    pub async fn retry(&self, claimed: ClaimedJob, problem: Problem) -> Result<Status, StoreError> {
        self.end("retry", &claimed, AttemptEnd::Retried, AttemptEffect::Fault(problem)).await
    }

    async fn end(
        &self,
        call: &'static str,
        claimed: &ClaimedJob,
        how: AttemptEnd,
        effect: AttemptEffect,
    ) -> Result<Status, StoreError> {
        self.change(call, End::new(claimed, how, effect)).await
    }
}

/// Gives a job the turn after the first queued job of another submitter in its lane, if there is
/// one and it is later than its own.
const YIELD: &str = "UPDATE jobs SET turn = CASE WHEN other.turn >= jobs.turn THEN other.turn + 1 ELSE jobs.turn END \
    FROM (SELECT o.turn FROM jobs j JOIN jobs o ON o.lane = j.lane AND o.rank = j.rank AND o.submitter <> j.submitter \
    WHERE j.id = $1 AND o.status = 'queued' AND NOT o.shares ORDER BY o.turn, o.id LIMIT 1) AS other \
    WHERE jobs.id = $1";

/// Ends the attempt of a claimed job.
pub(super) struct End {
    id: JobId,
    fence: Fence,
    how: AttemptEnd,
    effect: AttemptEffect,
    /// True once a run may have ended the attempt without a response.
    is_tried: AtomicBool,
}

impl Operation for End {
    type Output = Status;

    const GROUPED: Grouped = Grouped::Ends;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Status>, SqlError> {
        let id = self.id;
        let (state, version) = load(tx, id).await?.ok_or(StoreError::Fenced)?;
        let Ok(next) = state.on(&Event::End(self.fence.clone(), self.how), options.max_attempts) else {
            let is_done = self.is_tried.load(Ordering::Relaxed) && self.has_ended(tx).await?;
            let change = Change { id, version: Some(version) };
            return if is_done { Ok(Done::new(state.status, vec![change])) } else { Err(StoreError::Fenced.into()) };
        };
        let is_cancelled = next.ended == Some(AttemptEnd::Cancelled);
        let fault = match &self.effect {
            AttemptEffect::Failed(_, problem) | AttemptEffect::Fault(problem) => Some(problem),
            AttemptEffect::None | AttemptEffect::Finished(_) | AttemptEffect::Yielded => None,
        };
        if let AttemptEffect::Finished(finished) = &self.effect
            && !is_cancelled
        {
            insert_files(tx, id, finished.files.iter()).await?;
        }
        if let Some(problem) = fault {
            let sql = "UPDATE attempts SET detail = $3 WHERE job_id = $1 AND attempt = $2";
            let detail = format!("{}: {}", problem.kind, problem.detail);
            tx.execute(sql, values![id, state.attempts, detail]).await?;
        }
        let effect = if is_cancelled { &AttemptEffect::None } else { &self.effect };
        let changes = write(tx, id, &next, effect, None).await?;
        if matches!(self.effect, AttemptEffect::Yielded) && next.state.status == Status::Queued {
            tx.execute(YIELD, values![id]).await?;
        }
        Ok(Done::new(next.state.status, changes))
    }

    async fn run_together(
        ends: &[Arc<Self>],
        tx: &mut Tx<'_>,
        options: &StoreOptions,
    ) -> Result<Results<Status>, SqlError> {
        let mut succeeded = if tx.is_postgres() { succeed_together(tx, ends).await? } else { HashMap::new() };
        let mut results = Vec::with_capacity(ends.len());
        for end in ends {
            let ended = if end.finished().is_some() { succeeded.remove(&end.id) } else { None };
            results.push(match ended {
                Some(change) => Ok(Done::new(Status::Succeeded, vec![change])),
                None => or_refusal(end.run(tx, options).await)?,
            });
        }
        Ok(results)
    }

    /// Long, because the finished model would be lost. The fence protects the job in the meantime.
    fn retry_limit(&self, _is_uncertain: bool) -> Duration {
        LONG_RETRY_LIMIT
    }

    async fn was_committed(&self, tx: &mut Tx<'_>, _done: &Done<Status>) -> Result<bool, SqlError> {
        // Waits at the job's row for a commit that is still under way.
        load(tx, self.id).await?;
        self.has_ended(tx).await
    }
}

impl End {
    pub(super) fn new(claimed: &ClaimedJob, how: AttemptEnd, effect: AttemptEffect) -> Self {
        Self { id: claimed.job.id, fence: claimed.fence(), how, effect, is_tried: AtomicBool::new(false) }
    }

    /// True if an earlier run has ended the attempt. Only the holder ends its attempt, and only
    /// once; as cancelled if the job was cancelled.
    async fn has_ended(&self, tx: &mut Tx<'_>) -> Result<bool, SqlError> {
        let Fence { attempt, worker } = &self.fence;
        let sql = "SELECT 1 AS done FROM attempts \
                   WHERE job_id = $1 AND attempt = $2 AND worker = $3 AND outcome IN ($4, 'cancelled')";
        Ok(tx.optional(sql, values![self.id, *attempt, worker, enum_to_sql(self.how)]).await?.is_some())
    }

    /// The result of an attempt that succeeded.
    fn finished(&self) -> Option<&Finished> {
        match &self.effect {
            AttemptEffect::Finished(finished) => Some(finished),
            _ => None,
        }
    }
}

/// Ends those of `ends` that succeeded, by one statement of PostgreSQL that is a transaction by
/// itself. Returns the changes by job. Attempts that are no longer held, and jobs that were
/// cancelled or that other jobs wait for, are left to [`Operation::run`].
async fn succeed_together(tx: &mut Tx<'_>, ends: &[Arc<End>]) -> Result<HashMap<JobId, Change>, SqlError> {
    let attempt = |end: &Arc<End>| {
        let Finished { backend, files, summary, engine } = end.finished()?;
        end.is_tried.store(true, Ordering::Relaxed);
        Some(object!({
            "id": end.id, "attempt": end.fence.attempt, "worker": end.fence.worker, "summary": json(summary),
            "engine": engine, "backend": backend.used, "device": backend.device, "fallback": backend.fallback,
            "files": files,
        }))
    };
    let attempts: Vec<_> = ends.iter().filter_map(attempt).collect();
    if attempts.is_empty() {
        return Ok(HashMap::new());
    }
    let sql = "SELECT * FROM end_jobs($1::json, $2)";
    let rows = tx.all_alone(sql, values![object!(attempts).to_string(), tx.known_now()?]).await?;
    let change = |row: &Row| {
        let id = JobId(row.id("ended_id")?);
        Ok((id, Change { id, version: Some(row.count("ended_version")?) }))
    };
    rows.iter().map(change).collect()
}
