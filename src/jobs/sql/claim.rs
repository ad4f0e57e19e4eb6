//! Claims: a worker takes the first jobs of the lanes that it may run, several at a time.
//!
//! SQLite has one writer, which reads the heads of the lanes and applies the event to each job. On
//! PostgreSQL one statement finds the jobs, skips rows that another claim has locked, and updates
//! them. It has the effect of [`Event::Claim`]; the test suite compares both with the state
//! machine.
//!
//! A GPU simulates several models of similar size together. Its claim takes the first due job and
//! then only due jobs with the same batch key.
//!
//! An earlier transaction ends expired leases. A job that this version cannot read, because a later
//! one wrote it, fails with the reason, and the claim takes the next job.

use super::codec::{Value, enum_to_sql, until, values};
use super::error::SqlError;
use super::lease::{self, AttemptEffect, End};
use super::operation::{Done, Grouped, LONG_RETRY_LIMIT, Operation, RETRY_LIMIT};
use super::order;
use super::read;
use super::record::{Record, select_jobs, to_record};
use super::store::Store;
use super::tx::Tx;
use super::workers::unpaused;
use crate::clock::Stopwatch;
use crate::jobs::state::{AttemptEnd, ClaimScope, Event, MAX_LEASE};
use crate::jobs::{Change, ClaimedJob, Job, JobId, Problem, StoreError, StoreOptions};
use jiff::Timestamp;
use std::collections::VecDeque;
use std::time::Duration;

/// Maximum retry delay that claims respect. A longer delay can only result from a wrong clock, so
/// such a job counts as due.
const MAX_RETRY_DELAY: Duration = Duration::from_secs(120);

/// The call that claims jobs.
impl Store {
    /// Claims up to `limit` jobs of `scope`, in the order in which they are due. Claims
    /// none while the worker or all workers are paused.
    ///
    /// Jobs of higher priority come first. Within a priority, submitters take turns, and the jobs
    /// of each submitter are claimed oldest first. For [`ClaimScope::Gpu`], the jobs after the
    /// first are due jobs with the [`batch_key`](crate::jobs::NewJob::batch_key) of the first, by
    /// priority, turn and age; without a key, there are none.
    ///
    /// The call also returns jobs whose lease has expired to their earlier place in the queue,
    /// unless the database has been available to this process for less than `lease`: then their
    /// holders may have been unable to renew. Jobs without attempts left fail instead
    /// (`attempts-exhausted`, with the history), cancelled ones end as cancelled. A job that this
    /// version cannot read fails (`spec`).
    pub async fn claim(
        &self,
        worker: &str,
        scope: ClaimScope,
        lease: Duration,
        limit: u32,
    ) -> Result<Vec<ClaimedJob>, StoreError> {
        self.before("claim").await?;
        let claim = || Claim { worker: worker.to_owned(), scope, lease, limit };
        let claimed = async {
            if self.is_busy() {
                let claimed = self.transact("claim", claim()).await?;
                if !claimed.is_empty() {
                    return Ok(claimed);
                }
            }
            let since = Stopwatch::start();
            let look = async { look(&mut self.reader().await?, worker, scope).await };
            let found = look.await.map_err(|error| self.noted(error))?;
            if since.elapsed() >= lease {
                // The database hung for so long that no worker may have been able to renew its
                // lease.
                self.note_outage();
            }
            self.note_look();
            let may_expire = self.may_expire(found.at, lease);
            if found.leases_expired && may_expire {
                // Only leases that had expired at the look, not leases that expire while an outage
                // interrupts this.
                self.expire(found.at).await?;
            } else if !found.jobs_due {
                return Ok(Vec::new());
            }
            self.transact("claim", claim()).await
        };
        let claimed = claimed.await;
        if !claimed.as_ref().is_ok_and(|jobs| !jobs.is_empty()) {
            self.note_idle();
        }
        self.after("claim", claimed)
    }
}

/// Claims up to `limit` jobs.
struct Claim {
    worker: String,
    scope: ClaimScope,
    lease: Duration,
    limit: u32,
}

/// Result of a look at the queue.
struct Look {
    /// Time of the look, by the clock of leases.
    at: Timestamp,
    leases_expired: bool,
    /// True if jobs are due and the worker is not paused.
    jobs_due: bool,
}

/// Looks for work without a writer, because usually there is none.
async fn look(tx: &mut Tx<'_>, worker: &str, scope: ClaimScope) -> Result<Look, SqlError> {
    let now = tx.steady().await?;
    let mut values = values![now, until(now, MAX_RETRY_DELAY), worker, until(now, MAX_LEASE)];
    // Not EXISTS: for EXISTS, PostgreSQL may read the table in the hope of an early match.
    let jobs = order::lanes(tx);
    let lane = |lane| {
        values.push(Value::from(enum_to_sql(lane)));
        format!(
            "(SELECT 1 FROM {jobs} WHERE status = 'queued' AND NOT shares AND lane = ${} \
             AND (available_at <= $1 OR available_at > $2) ORDER BY rank, turn, id LIMIT 1) IS NOT NULL",
            values.len()
        )
    };
    let lanes: Vec<String> = scope.lanes().iter().map(lane).collect();
    let sql = format!(
        "SELECT (SELECT 1 FROM jobs WHERE status = 'running' AND lease_until <= $1 ORDER BY lease_until LIMIT 1) \
         IS NOT NULL OR (SELECT 1 FROM jobs WHERE status = 'running' AND lease_until > $4 \
         ORDER BY lease_until DESC LIMIT 1) IS NOT NULL AS expired, ({}) AND {} AS due",
        lanes.join(" OR "),
        unpaused("$3")
    );
    let row = tx.one(sql, values).await?;
    Ok(Look { at: now, leases_expired: row.get("expired")?, jobs_due: row.get("due")? })
}

/// The jobs claimed so far.
#[derive(Default)]
struct Claimed {
    jobs: Vec<ClaimedJob>,
    changes: Vec<Change>,
    /// Batch key of the last job.
    batch_key: Option<String>,
}

impl Operation for Claim {
    type Output = Vec<ClaimedJob>;

    const GROUPED: Grouped = Grouped::Work;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Vec<ClaimedJob>>, SqlError> {
        let mut claimed = Claimed::default();
        if self.scope == ClaimScope::Gpu {
            self.fill(tx, options, &mut claimed, 1, None).await?;
            if let Some(key) = claimed.batch_key.take() {
                self.fill(tx, options, &mut claimed, self.limit, Some(&key)).await?;
            }
        } else {
            self.fill(tx, options, &mut claimed, self.limit, None).await?;
        }
        Ok(Done::new(claimed.jobs, claimed.changes))
    }

    async fn was_committed(&self, tx: &mut Tx<'_>, done: &Done<Vec<ClaimedJob>>) -> Result<bool, SqlError> {
        let until = until(tx.steady().await?, self.lease);
        let mut is_held = false;
        for ClaimedJob { job, attempt, worker } in &done.output {
            // Waits at the job's row for a commit that is still under way; an update alone would
            // not see its result.
            lease::load_for_renewal(tx, job.id).await?;
            // The lease begins again.
            let sql = "UPDATE jobs SET lease_until = $4 \
                       WHERE id = $1 AND status = 'running' AND attempts = $2 AND holder = $3";
            is_held |= tx.execute(sql, values![job.id, *attempt, worker, until]).await? > 0;
        }
        Ok(is_held)
    }

    /// Long if a commit whose response was lost may have claimed jobs: nobody else runs them until
    /// their leases expire.
    fn retry_limit(&self, is_uncertain: bool) -> Duration {
        if is_uncertain { LONG_RETRY_LIMIT } else { RETRY_LIMIT }
    }
}

/// Fails a job that this version cannot read.
async fn fail(
    tx: &mut Tx<'_>,
    options: &StoreOptions,
    claimed: &ClaimedJob,
    why: String,
) -> Result<Vec<Change>, SqlError> {
    tracing::error!(job = %claimed.job.id, why, "this version cannot read a job; the job fails");
    let problem = Problem {
        kind: "spec".into(),
        title: "This version cannot read the job".into(),
        detail: format!("{why}; a later version may have queued it"),
    };
    let effect = AttemptEffect::Failed(claimed.job.backend.clone(), problem);
    let end = End { id: claimed.job.id, fence: claimed.fence(), how: AttemptEnd::Failed, effect };
    Ok(end.run(tx, options).await?.changes)
}

impl Claim {
    /// Claims due jobs until there are `limit`, or no more are due. With a batch key, only jobs
    /// with that key.
    async fn fill(
        &self,
        tx: &mut Tx<'_>,
        options: &StoreOptions,
        claimed: &mut Claimed,
        limit: u32,
        batch_key: Option<&str>,
    ) -> Result<(), SqlError> {
        loop {
            let wanted = limit.saturating_sub(claimed.jobs.len() as u32);
            if wanted == 0 {
                return Ok(());
            }
            let taken = if tx.is_postgres() {
                self.at_once(tx, wanted, batch_key).await?
            } else {
                self.one_by_one(tx, options, wanted, batch_key).await?
            };
            let mut all_read = true;
            for Record { job, unread, batch_key, .. } in taken {
                // The statement read the record before it wrote the row of the attempt.
                let job = Job { worker: Some(self.worker.clone()), ..job };
                let job = ClaimedJob { attempt: job.attempts, worker: self.worker.clone(), job };
                if let Some(why) = unread {
                    claimed.changes.extend(fail(tx, options, &job, why).await?);
                    all_read = false;
                } else {
                    claimed.changes.push(Change::of(&job.job));
                    claimed.batch_key = batch_key;
                    claimed.jobs.push(job);
                }
            }
            if all_read {
                return Ok(());
            }
        }
    }

    async fn one_by_one(
        &self,
        tx: &mut Tx<'_>,
        options: &StoreOptions,
        limit: u32,
        batch_key: Option<&str>,
    ) -> Result<Vec<Record>, SqlError> {
        let (now, steady) = (tx.now().await?, tx.steady().await?);
        let lanes: Vec<(&str, &str, String)> = match batch_key {
            Some(key) => vec![("jobs_claimable_by_batch_key", "batch_key", key.to_owned())],
            None => {
                let lane = |lane| ("jobs_lanes", "lane", enum_to_sql(lane));
                self.scope.lanes().iter().map(lane).collect()
            }
        };
        let mut queues = Vec::new();
        for (index, column, value) in lanes {
            let sql = format!(
                "SELECT rank, id FROM jobs INDEXED BY {index} WHERE status = 'queued' AND NOT shares \
                 AND {column} = $1 AND (available_at <= $2 OR available_at > $3) AND {} \
                 ORDER BY rank, turn, id LIMIT $4",
                unpaused("$5")
            );
            let values = values![value, steady, until(steady, MAX_RETRY_DELAY), limit, &self.worker];
            let queue = tx.all(sql, values).await?;
            let queue = queue.iter().map(|row| Ok((row.get("rank")?, JobId(row.id("id")?))));
            queues.push(queue.collect::<Result<VecDeque<_>, SqlError>>()?);
        }
        let ids = due(queues, limit);
        let mut taken = Vec::with_capacity(ids.len());
        for id in ids {
            let event = Event::Claim(self.worker.clone());
            lease::apply(tx, options, id, &event, Some(until(steady, self.lease))).await?;
            let record = read::known_record(tx, id).await?;
            let sql = "INSERT INTO attempts (job_id, attempt, worker, started_at) VALUES ($1, $2, $3, $4)";
            tx.execute(sql, values![id, record.job.attempts, &self.worker, now]).await?;
            taken.push(record);
        }
        Ok(taken)
    }

    async fn at_once(&self, tx: &mut Tx<'_>, limit: u32, batch_key: Option<&str>) -> Result<Vec<Record>, SqlError> {
        let (jobs, now, unpaused) = (select_jobs(tx), tx.now().await?, unpaused("$3"));
        // Limits are in the text, so that a plan made once for all values expects few rows.
        let (due, of) = match batch_key {
            // Only the index of batch keys fits: no other has this order, and IS TRUE rules out the
            // index by status.
            Some(key) => (
                format!(
                    "due AS MATERIALIZED (SELECT id, ROW_NUMBER() OVER (ORDER BY rank, turn, id) AS place FROM (\
                     SELECT rank, turn, id FROM jobs WHERE (status = 'queued') IS TRUE AND NOT shares AND batch_key = $1 \
                     AND (available_at <= $2 OR available_at > $5) AND {unpaused} \
                     ORDER BY rank, turn, id LIMIT {limit} FOR NO KEY UPDATE SKIP LOCKED) AS heads)"
                ),
                Value::from(key),
            ),
            // Repeatedly taking the better of the lanes' heads equals sorting by the largest id of
            // each lane and rank so far.
            None => (
                format!(
                    "heads AS MATERIALIZED (SELECT lanes.name, head.* FROM unnest($1::text[]) AS lanes (name) \
                     CROSS JOIN LATERAL (SELECT rank, turn, id FROM jobs WHERE status = 'queued' \
                     AND NOT shares AND lane = lanes.name AND (available_at <= $2 OR available_at > $5) AND {unpaused} \
                     ORDER BY rank, turn, id LIMIT {limit} FOR NO KEY UPDATE SKIP LOCKED) AS head), \
                     due AS MATERIALIZED (SELECT id, ROW_NUMBER() OVER (ORDER BY rank, last, turn, id) AS place FROM (\
                     SELECT rank, turn, id, MAX(id) OVER (PARTITION BY name, rank ORDER BY turn, id) AS last FROM heads\
                     ) AS merged ORDER BY place LIMIT {limit})"
                ),
                Value::from(self.scope.lanes().iter().map(enum_to_sql).collect::<Vec<String>>()),
            ),
        };
        let sql = format!(
            "WITH {due}, \
             claimed AS (UPDATE jobs SET status = 'running', attempts = attempts + 1, holder = $3, lease_until = $4, \
             started_at = COALESCE(started_at, $2), version = version + 1 \
             WHERE id = ANY (ARRAY(SELECT id FROM due)) RETURNING *), \
             begun AS (INSERT INTO attempts (job_id, attempt, worker, started_at) \
             SELECT id, attempts, $3, $2 FROM claimed) \
             {jobs} FROM due JOIN claimed j ON j.id = due.id ORDER BY due.place"
        );
        let values = values![of, now, &self.worker, until(now, self.lease), until(now, MAX_RETRY_DELAY)];
        tx.all(sql, values).await?.iter().map(to_record).collect()
    }
}

/// The ids that are due, from lanes that are each in order: repeatedly the head of higher priority,
/// or the older one.
fn due(mut lanes: Vec<VecDeque<(i64, JobId)>>, limit: u32) -> Vec<JobId> {
    let next = || {
        let lane = lanes.iter_mut().filter(|lane| !lane.is_empty()).min_by_key(|lane| lane.front().copied())?;
        lane.pop_front().map(|(_, id)| id)
    };
    std::iter::from_fn(next).take(limit as usize).collect()
}
