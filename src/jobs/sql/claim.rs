//! Claims: a worker takes the first jobs of the lanes that it may run, several at a time.
//!
//! SQLite has one writer, which reads the heads of the lanes and applies the event to each job. On
//! PostgreSQL one statement finds the jobs, skips rows that another claim has locked, and updates
//! them. It has the effect of [`Event::Claim`]; the test suite compares both with the state
//! machine. Claims of a group are one statement, if their scope and their lease are the same.
//!
//! A GPU simulates several models of similar size together. Its claim takes the first due job and
//! then only due jobs with the same batch key.
//!
//! An earlier transaction ends expired leases. A job that this version cannot read, because a later
//! one wrote it, fails with the reason, and the claim takes the next job.

use super::codec::{Value, enum_to_sql, until, values};
use super::end::End;
use super::error::SqlError;
use super::lease::{self, AttemptEffect};
use super::operation::{Done, Grouped, LONG_RETRY_LIMIT, Operation, RETRY_LIMIT, Results};
use super::order;
use super::read;
use super::record::{Record, select_jobs, to_record};
use super::store::Store;
use super::tx::Tx;
use super::workers::{all_unpaused, unpaused};
use crate::clock::Stopwatch;
use crate::jobs::state::{AttemptEnd, ClaimScope, Event, MAX_LEASE};
use crate::jobs::{Change, ClaimedJob, Job, JobId, Problem, StoreError, StoreOptions};
use jiff::Timestamp;
use std::collections::VecDeque;
use std::sync::Arc;
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
    let (jobs, queued) = queue(tx, scope);
    let lane = |lane| {
        values.push(Value::from(enum_to_sql(lane)));
        format!(
            "(SELECT 1 FROM {jobs} WHERE {queued} AND NOT shares AND lane = ${} \
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

/// The table with the index of jobs that a claim may take, and the condition that fits this index.
fn queue(tx: &Tx<'_>, scope: ClaimScope) -> (&'static str, &'static str) {
    if scope.is_of_short_models() {
        let queued = tx.either("status = 'queued' AND short", "(status = 'queued') IS TRUE AND short");
        (tx.either("jobs INDEXED BY jobs_short", "jobs"), queued)
    } else {
        (order::lanes(tx), "status = 'queued'")
    }
}

/// The jobs claimed so far.
#[derive(Default)]
struct Claimed {
    jobs: Vec<ClaimedJob>,
    changes: Vec<Change>,
    /// Batch key of the last job.
    batch_key: Option<String>,
}

impl From<Claimed> for Done<Vec<ClaimedJob>> {
    fn from(claimed: Claimed) -> Self {
        Self::new(claimed.jobs, claimed.changes)
    }
}

impl Claimed {
    /// Adds a job that `worker` has claimed. Returns false if this version cannot read the job,
    /// which then fails.
    async fn add(
        &mut self,
        tx: &mut Tx<'_>,
        options: &StoreOptions,
        worker: &str,
        record: Record,
    ) -> Result<bool, SqlError> {
        let Record { job, unread, batch_key, .. } = record;
        // The statement read the record before it wrote the row of the attempt.
        let job = Job { worker: Some(worker.to_owned()), ..job };
        let job = ClaimedJob { attempt: job.attempts, worker: worker.to_owned(), job };
        if let Some(why) = unread {
            self.changes.extend(fail(tx, options, &job, why).await?);
            return Ok(false);
        }
        self.changes.push(Change::of(&job.job));
        self.batch_key = batch_key;
        self.jobs.push(job);
        Ok(true)
    }
}

impl Operation for Claim {
    type Output = Vec<ClaimedJob>;

    const GROUPED: Grouped = Grouped::Claims;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Vec<ClaimedJob>>, SqlError> {
        self.complete(tx, options, Claimed::default()).await
    }

    async fn run_together(
        claims: &[Arc<Self>],
        tx: &mut Tx<'_>,
        options: &StoreOptions,
    ) -> Result<Results<Vec<ClaimedJob>>, SqlError> {
        let (claimed, none_left) = claim_together(claims, tx, options).await?;
        let mut results = Vec::with_capacity(claims.len());
        for (claim, claimed) in claims.iter().zip(claimed) {
            results.push(Ok(if none_left { claimed.into() } else { claim.complete(tx, options, claimed).await? }));
        }
        Ok(results)
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
    Ok(End::new(claimed, AttemptEnd::Failed, effect).run(tx, options).await?.changes)
}

/// Claims for several workers in one statement, where that is possible. Returns what each has
/// claimed, and true if no more jobs are due.
async fn claim_together(
    claims: &[Arc<Claim>],
    tx: &mut Tx<'_>,
    options: &StoreOptions,
) -> Result<(Vec<Claimed>, bool), SqlError> {
    let mut claimed: Vec<Claimed> = claims.iter().map(|_| Claimed::default()).collect();
    let first = &claims[0];
    let is_like_first = |claim: &Arc<Claim>| claim.scope == first.scope && claim.lease == first.lease;
    let is_possible = tx.is_postgres() && first.scope != ClaimScope::Gpu && claims.iter().all(is_like_first);
    if claims.len() == 1 || !is_possible {
        return Ok((claimed, false));
    }
    let places = || claims.iter().zip(0..).flat_map(|(claim, index)| (0..claim.limit).map(move |_| (claim, index)));
    let holders: Vec<String> = places().map(|(claim, _)| claim.worker.clone()).collect();
    let wanted = holders.len();
    let taken = first.at_once(tx, holders, None).await?;
    // None are taken if one of the workers is paused, too.
    let mut none_left = (1..wanted).contains(&taken.len());
    for ((claim, index), record) in places().zip(taken) {
        none_left &= claimed[index].add(tx, options, &claim.worker, record).await?;
    }
    Ok((claimed, none_left))
}

impl Claim {
    /// Claims what is missing from `claimed`.
    async fn complete(
        &self,
        tx: &mut Tx<'_>,
        options: &StoreOptions,
        mut claimed: Claimed,
    ) -> Result<Done<Vec<ClaimedJob>>, SqlError> {
        if self.scope == ClaimScope::Gpu {
            self.fill(tx, options, &mut claimed, 1, None).await?;
            if let Some(key) = claimed.batch_key.take() {
                self.fill(tx, options, &mut claimed, self.limit, Some(&key)).await?;
            }
        } else {
            self.fill(tx, options, &mut claimed, self.limit, None).await?;
        }
        Ok(claimed.into())
    }

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
                self.at_once(tx, vec![self.worker.clone(); wanted as usize], batch_key).await?
            } else {
                self.one_by_one(tx, options, wanted, batch_key).await?
            };
            let mut all_read = true;
            for record in taken {
                all_read &= claimed.add(tx, options, &self.worker, record).await?;
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
        let (jobs, queued) = match batch_key {
            Some(_) => ("jobs INDEXED BY jobs_claimable_by_batch_key", "status = 'queued'"),
            None => queue(tx, self.scope),
        };
        let lanes: Vec<(&str, String)> = match batch_key {
            Some(key) => vec![("batch_key", key.to_owned())],
            None => self.scope.lanes().iter().map(|lane| ("lane", enum_to_sql(lane))).collect(),
        };
        let mut queues = Vec::new();
        for (column, value) in lanes {
            let sql = format!(
                "SELECT rank, id FROM {jobs} WHERE {queued} AND NOT shares \
                 AND {column} = $1 AND (available_at <= $2 OR available_at > $3) AND {} \
                 ORDER BY rank, turn, id LIMIT $4",
                unpaused("$5")
            );
            let values = values![value, steady, until(steady, MAX_RETRY_DELAY), limit, &self.worker];
            let heads = tx.all(sql, values).await?;
            let heads = heads.iter().map(|row| Ok((row.get("rank")?, JobId(row.id("id")?))));
            queues.push(heads.collect::<Result<VecDeque<_>, SqlError>>()?);
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

    /// Claims one job for each of `holders`, which are workers, in the order in which jobs are due.
    async fn at_once(
        &self,
        tx: &mut Tx<'_>,
        holders: Vec<String>,
        batch_key: Option<&str>,
    ) -> Result<Vec<Record>, SqlError> {
        let (jobs, unpaused, limit) = (select_jobs(tx), all_unpaused("$3"), holders.len());
        let (_, queued) = queue(tx, self.scope);
        let is_due = format!(
            "{queued} AND NOT shares AND {unpaused} AND (available_at <= (SELECT now FROM moment) \
             OR available_at > (SELECT now FROM moment) + {})",
            MAX_RETRY_DELAY.as_micros()
        );
        // Limits are in the text, so that a plan made once for all values expects few rows.
        let (due, of) = match batch_key {
            // Only the index of batch keys fits: no other has this order, and IS TRUE rules out the
            // index by status.
            Some(key) => (
                format!(
                    "due AS MATERIALIZED (SELECT id, ROW_NUMBER() OVER (ORDER BY rank, turn, id) AS place FROM (\
                     SELECT rank, turn, id FROM jobs WHERE (status = 'queued') IS TRUE AND batch_key = $1 AND {is_due} \
                     ORDER BY rank, turn, id LIMIT {limit} FOR NO KEY UPDATE SKIP LOCKED) AS heads)"
                ),
                Value::from(key),
            ),
            // Repeatedly taking the better of the lanes' heads equals sorting by the largest id of
            // each lane and rank so far.
            None => (
                format!(
                    "heads AS MATERIALIZED (SELECT lanes.name, head.* FROM unnest($1::text[]) AS lanes (name) \
                     CROSS JOIN LATERAL (SELECT rank, turn, id FROM jobs WHERE lane = lanes.name AND {is_due} \
                     ORDER BY rank, turn, id LIMIT {limit} FOR NO KEY UPDATE SKIP LOCKED) AS head), \
                     due AS MATERIALIZED (SELECT id, ROW_NUMBER() OVER (ORDER BY rank, last, turn, id) AS place FROM (\
                     SELECT rank, turn, id, MAX(id) OVER (PARTITION BY name, rank ORDER BY turn, id) AS last FROM heads\
                     ) AS merged ORDER BY place LIMIT {limit})"
                ),
                Value::from(self.scope.lanes().iter().map(enum_to_sql).collect::<Vec<String>>()),
            ),
        };
        let now = Tx::NOW;
        let sql = format!(
            "WITH moment AS MATERIALIZED (SELECT COALESCE($2, {now}) AS now), {due}, \
             claimed AS (UPDATE jobs SET status = 'running', attempts = attempts + 1, \
             holder = (SELECT ($3::text[])[place] FROM due WHERE due.id = jobs.id), \
             lease_until = (SELECT now FROM moment) + $4, \
             started_at = COALESCE(started_at, (SELECT now FROM moment)), version = version + 1 \
             WHERE id = ANY (ARRAY(SELECT id FROM due)) RETURNING *), \
             begun AS (INSERT INTO attempts (job_id, attempt, worker, started_at) \
             SELECT id, attempts, holder, (SELECT now FROM moment) FROM claimed) \
             {jobs} FROM due JOIN claimed j ON j.id = due.id ORDER BY due.place"
        );
        let values = values![of, tx.known_now()?, holders, self.lease];
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
