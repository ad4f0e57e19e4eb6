//! Claims: the heads of the lanes that a worker may run, several at a time.
//!
//! SQLite has one writer, which reads the heads and applies the event to each. On PostgreSQL one statement
//! finds them, passing over those that another claim holds just now, and takes them; it says what
//! [`Event::Claim`] says, and the suite holds both against the state machine.
//!
//! Leases that have run out are ended before, in a transaction of their own. A record that this version cannot read (a later
//! one wrote it) fails, and says so, and the one behind it is claimed.

use super::lease::{self, End, Record as Ending};
use super::read::{self, Record, select_jobs, to_record};
use super::{Dialect, Done, Link, Operation, SqlError, Value, until, values, word};
use crate::generate::Backend;
use crate::jobs::job::{JobId, Problem};
use crate::jobs::state::{self, Event};
use crate::jobs::store::{Change, ClaimedJob, StoreOptions};
use std::collections::VecDeque;
use std::time::Duration;

/// No job waits longer before it may be tried again. One that would was put there by a clock that was wrong: it is due.
const LONGEST_DELAY: Duration = Duration::from_secs(120);

/// Claims up to `limit` jobs.
#[derive(Debug)]
pub(super) struct Claim {
    pub(super) worker: String,
    pub(super) backend: Backend,
    pub(super) lease: Duration,
    pub(super) limit: u32,
}

/// What a claim would find.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    /// Leases that have run out.
    pub(super) expired: bool,
    /// Jobs that are due.
    pub(super) due: bool,
}

/// Looks whether there is something to do. Mostly there is not, and then nobody need wait for a writer.
pub(super) async fn look(link: &mut Link<'_>, backend: Backend) -> Result<Found, SqlError> {
    let now = link.steady().await?;
    let mut values = values![now, until(now, LONGEST_DELAY)];
    // Not EXISTS: for that PostgreSQL may take to reading the table, in the hope of an early row that fits.
    let lane = |lane| {
        values.push(Value::from(word(lane)));
        format!(
            "(SELECT 1 FROM jobs WHERE status = 'queued' AND backend_requested = ${} \
             AND (available_at <= $1 OR available_at > $2) ORDER BY rank, turn, id LIMIT 1) IS NOT NULL",
            values.len()
        )
    };
    let lanes: Vec<String> = state::accepted(backend).iter().map(lane).collect();
    let sql = format!(
        "SELECT (SELECT 1 FROM jobs WHERE status = 'running' AND lease_until <= $1 ORDER BY lease_until LIMIT 1) \
         IS NOT NULL AS expired, {} AS due",
        lanes.join(" OR ")
    );
    let row = link.one(sql, values).await?;
    Ok(Found { expired: row.flag("expired")?, due: row.flag("due")? })
}

impl Operation for Claim {
    type Output = Vec<ClaimedJob>;

    async fn run(&self, link: &mut Link<'_>, options: &StoreOptions) -> Result<Done<Vec<ClaimedJob>>, SqlError> {
        let (mut claimed, mut changes) = (Vec::new(), Vec::new());
        loop {
            let limit = self.limit - claimed.len() as u32;
            let taken = match link.dialect() {
                Dialect::Sqlite => self.one_by_one(link, options, limit).await?,
                Dialect::Postgres => self.at_once(link, limit).await?,
            };
            let mut all_read = true;
            for Record { job, unread, .. } in taken {
                let job = ClaimedJob { attempt: job.attempts, worker: self.worker.clone(), job };
                if let Some(why) = unread {
                    changes.extend(fail(link, options, &job, why).await?);
                    all_read = false;
                } else {
                    changes.push(Change { id: job.job.id, version: Some(job.job.version) });
                    claimed.push(job);
                }
            }
            if all_read || claimed.len() >= self.limit as usize {
                return Ok(Done::new(claimed, changes));
            }
        }
    }
}

/// Ends a job that this version cannot read.
async fn fail(
    link: &mut Link<'_>,
    options: &StoreOptions,
    claimed: &ClaimedJob,
    why: String,
) -> Result<Vec<Change>, SqlError> {
    tracing::error!(job = %claimed.job.id, why, "a job that this version cannot read fails");
    let problem = Problem {
        kind: "spec".into(),
        title: "This version cannot read the job".into(),
        detail: format!("{why}; a later version may have queued it"),
    };
    let record = Ending::Failed(claimed.job.backend.clone(), problem);
    let end = End { id: claimed.job.id, fence: claimed.fence(), event: Event::Fail(claimed.fence()), record };
    Ok(end.run(link, options).await?.changes)
}

impl Claim {
    async fn one_by_one(
        &self,
        link: &mut Link<'_>,
        options: &StoreOptions,
        limit: u32,
    ) -> Result<Vec<Record>, SqlError> {
        let (now, steady) = (link.now().await?, link.steady().await?);
        let mut lanes = Vec::new();
        for lane in state::accepted(self.backend) {
            let waiting = link
                .all(
                    "SELECT rank, id FROM jobs INDEXED BY jobs_queue WHERE status = 'queued' \
                     AND backend_requested = $1 AND (available_at <= $2 OR available_at > $3) \
                     ORDER BY rank, turn, id LIMIT $4",
                    values![word(lane), steady, until(steady, LONGEST_DELAY), limit],
                )
                .await?;
            let waiting: Result<VecDeque<_>, SqlError> =
                waiting.iter().map(|row| Ok((row.int("rank")?, row.id("id")?))).collect();
            lanes.push(waiting?);
        }
        let ids = due(lanes, limit);
        let mut taken = Vec::with_capacity(ids.len());
        for id in ids {
            let event = Event::Claim(self.worker.clone());
            lease::apply(link, options, id, &event, Some(until(steady, self.lease))).await?;
            let record = read::known_record(link, id).await?;
            link.execute(
                "INSERT INTO attempts (job_id, attempt, worker, started_at) VALUES ($1, $2, $3, $4)",
                values![id, record.job.attempts, &self.worker, now],
            )
            .await?;
            taken.push(record);
        }
        Ok(taken)
    }

    async fn at_once(&self, link: &mut Link<'_>, limit: u32) -> Result<Vec<Record>, SqlError> {
        // The limits stand in the text, so that a plan made once for all values counts on few rows. Taking the better
        // head of the lanes again and again is taking all by the last id of each lane and rank so far.
        let (jobs, now) = (select_jobs(link), link.now().await?);
        let sql = format!(
            "WITH heads AS MATERIALIZED (SELECT lane.name, head.* FROM unnest($1::text[]) AS lane (name) \
             CROSS JOIN LATERAL (SELECT rank, turn, id FROM jobs WHERE status = 'queued' \
             AND backend_requested = lane.name AND (available_at <= $2 OR available_at > $5) \
             ORDER BY rank, turn, id LIMIT {limit} FOR UPDATE SKIP LOCKED) AS head), \
             due AS MATERIALIZED (SELECT id, ROW_NUMBER() OVER (ORDER BY rank, last, turn, id) AS place FROM (\
             SELECT rank, turn, id, MAX(id) OVER (PARTITION BY name, rank ORDER BY turn, id) AS last FROM heads\
             ) AS merged ORDER BY place LIMIT {limit}), \
             claimed AS (UPDATE jobs SET status = 'running', attempts = attempts + 1, holder = $3, lease_until = $4, \
             started_at = COALESCE(started_at, $2), version = version + 1 \
             WHERE id = ANY (ARRAY(SELECT id FROM due)) RETURNING *), \
             begun AS (INSERT INTO attempts (job_id, attempt, worker, started_at) \
             SELECT id, attempts, $3, $2 FROM claimed) \
             {jobs} FROM due JOIN claimed j ON j.id = due.id ORDER BY due.place"
        );
        let lanes: Vec<String> = state::accepted(self.backend).iter().map(word).collect();
        let values = values![lanes, now, &self.worker, until(now, self.lease), until(now, LONGEST_DELAY)];
        link.all(sql, values).await?.iter().map(to_record).collect()
    }
}

/// The ids that are due, of lanes each in its order: from the head of higher priority, or else the older one, on.
fn due(mut lanes: Vec<VecDeque<(i64, JobId)>>, limit: u32) -> Vec<JobId> {
    let next = || {
        let lane = lanes.iter_mut().filter(|lane| !lane.is_empty()).min_by_key(|lane| lane.front().copied())?;
        lane.pop_front().map(|(_, id)| id)
    };
    std::iter::from_fn(next).take(limit as usize).collect()
}
