//! Claims: the heads of the lanes that a worker may run, several at a time.
//!
//! SQLite has one writer, which reads the heads and applies the event to each. On PostgreSQL one statement
//! finds them, passing over those that another claim holds just now, and takes them; it says what
//! [`Event::Claim`] says, and the suite holds both against the state machine.

use super::read::{known_job, select_jobs, to_record};
use super::{Dialect, Done, Link, Operation, Row, SqlError, Value, lease, until, values, word};
use crate::generate::Backend;
use crate::jobs::job::JobId;
use crate::jobs::state::{self, Event};
use crate::jobs::store::{Change, ClaimedJob, StoreOptions};
use jiff::Timestamp;
use std::collections::VecDeque;
use std::time::Duration;

/// Ends what has run out, then claims up to `limit` jobs.
#[derive(Debug)]
pub(super) struct Claim {
    pub(super) worker: String,
    pub(super) backend: Backend,
    pub(super) lease: Duration,
    pub(super) limit: u32,
}

/// Whether a claim would find something to do. Most do not, and then need not wait for a writer.
pub(super) async fn any_to_claim(link: &mut Link<'_>, backend: Backend) -> Result<bool, SqlError> {
    let now = link.now().await?;
    let mut values = values![now];
    // Not EXISTS: for that PostgreSQL may take to reading the table, in the hope of an early row that fits.
    let mut sql = String::from(
        "SELECT (SELECT 1 FROM jobs WHERE status = 'running' AND lease_until <= $1 ORDER BY lease_until LIMIT 1) \
         IS NOT NULL",
    );
    for lane in state::accepted(backend) {
        values.push(Value::from(word(lane)));
        sql += &format!(
            " OR (SELECT 1 FROM jobs WHERE status = 'queued' AND backend_requested = ${} AND available_at <= $1 \
             ORDER BY rank, turn, id LIMIT 1) IS NOT NULL",
            values.len()
        );
    }
    link.one(sql + " AS found", values).await?.flag("found")
}

impl Operation for Claim {
    type Output = Vec<ClaimedJob>;

    async fn run(&self, link: &mut Link<'_>, options: &StoreOptions) -> Result<Done<Vec<ClaimedJob>>, SqlError> {
        let now = link.now().await?;
        let mut changes = lease::expire(link, options, now).await?;
        let claimed = match link.dialect() {
            Dialect::Sqlite => self.one_by_one(link, options, now).await?,
            Dialect::Postgres => self.at_once(link, now).await?,
        };
        changes.extend(claimed.iter().map(|c| Change { id: c.job.id, version: Some(c.job.version) }));
        Ok(Done::new(claimed, changes))
    }
}

impl Claim {
    async fn one_by_one(
        &self,
        link: &mut Link<'_>,
        options: &StoreOptions,
        now: Timestamp,
    ) -> Result<Vec<ClaimedJob>, SqlError> {
        let mut lanes = Vec::new();
        for lane in state::accepted(self.backend) {
            let waiting = link
                .all(
                    "SELECT rank, id FROM jobs INDEXED BY jobs_queue WHERE status = 'queued' \
                     AND backend_requested = $1 AND available_at <= $2 ORDER BY rank, turn, id LIMIT $3",
                    values![word(lane), now, self.limit],
                )
                .await?;
            let waiting: Result<VecDeque<_>, SqlError> =
                waiting.iter().map(|row| Ok((row.int("rank")?, row.id("id")?))).collect();
            lanes.push(waiting?);
        }
        let ids = due(lanes, self.limit);
        let mut claimed = Vec::with_capacity(ids.len());
        for id in ids {
            let event = Event::Claim(self.worker.clone());
            lease::apply(link, options, id, &event, Some(until(now, self.lease))).await?;
            let job = known_job(link, id).await?;
            link.execute(
                "INSERT INTO attempts (job_id, attempt, worker, started_at) VALUES ($1, $2, $3, $4)",
                values![id, job.attempts, &self.worker, now],
            )
            .await?;
            claimed.push(ClaimedJob { attempt: job.attempts, worker: self.worker.clone(), job });
        }
        Ok(claimed)
    }

    async fn at_once(&self, link: &mut Link<'_>, now: Timestamp) -> Result<Vec<ClaimedJob>, SqlError> {
        // The limits stand in the text, so that a plan made once for all values counts on few rows. Taking the better
        // head of the lanes again and again is taking all by the last id of each lane and rank so far.
        let (jobs, limit) = (select_jobs(link), self.limit);
        let sql = format!(
            "WITH heads AS MATERIALIZED (SELECT lane.name, head.* FROM unnest($1::text[]) AS lane (name) \
             CROSS JOIN LATERAL (SELECT rank, turn, id FROM jobs WHERE status = 'queued' \
             AND backend_requested = lane.name AND available_at <= $2 \
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
        let values = values![lanes, now, &self.worker, until(now, self.lease)];
        let rows = link.all(sql, values).await?;
        let claimed = |row: &Row| {
            let job = to_record(row)?.job;
            Ok(ClaimedJob { attempt: job.attempts, worker: self.worker.clone(), job })
        };
        rows.iter().map(claimed).collect()
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
