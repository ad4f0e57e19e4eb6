//! The order of claims, and positions in the queue.
//!
//! Models of each backend that a request may ask for have a lane, and so have fits; a worker never
//! reads past jobs that it cannot run. Within a lane, workers claim jobs by (`rank`, `turn`, age).
//! Between lanes, the head of higher priority goes first, then the older one.
//!
//! The rank is the negated priority, so that one index in one direction has this order. A
//! submission gets its turn once, when it is queued: one after the turn of the last queued job of
//! its submitter (the owner of the job), and at least the present turn. The present turn is the
//! turn of the latest claimed job or of the first queued job. A submitter whose newest job is of an
//! earlier turn comes before the first queued job of another turn. Turns are counted within a lane
//! and a rank. Consequences:
//!
//! - Submitters take turns, however many jobs each has queued.
//! - A new submitter waits for at most one job of each other submitter, and one that has had jobs
//!   only for those that have waited for this turn.
//! - An idle submitter earns no credit.
//! - With a single submitter and one priority, jobs run oldest first.
//! - A released job keeps its rank and turn.
//!
//! Every query here reads a few ends of indexes, whatever the length of the queue. A turn takes
//! four; a position is counted, up to [`POSITIONS`].

use super::codec::{enum_to_sql, values};
use super::error::SqlError;
use super::record::Record;
use super::store::Store;
use super::tx::{Row, Tx};
use crate::jobs::{ClaimScope, Job, Lane, Priority, Status, StoreError, StoreOptions};

/// Position at which counting stops; see [`Job::MAX_QUEUE_POSITION`].
const POSITIONS: u64 = Job::MAX_QUEUE_POSITION;

/// The call for the length of the queue of a claim.
impl Store {
    /// Number of queued jobs of `scope` that may be claimed; each lane counts at most 1000.
    pub async fn count_claimable_jobs(&self, scope: ClaimScope) -> Result<u64, StoreError> {
        let tx = &mut self.read("count_claimable_jobs").await?;
        let mut jobs = 0;
        for lane in scope.lanes() {
            let sql = format!(
                "SELECT COUNT(*) AS n FROM (SELECT 1 FROM {} WHERE status = 'queued' AND NOT shares \
                 AND lane = $1 LIMIT 1000) AS lane",
                lanes(tx)
            );
            jobs += tx.one(sql, values![enum_to_sql(lane)]).await?.count::<u64>("n")?;
        }
        Ok(jobs)
    }
}

/// Rank of a priority: a higher priority has a smaller rank and is claimed earlier.
pub(super) fn rank(priority: Priority) -> i64 {
    -priority.get()
}

/// The table of jobs, read by the index of claimable jobs.
pub(super) fn lanes(tx: &Tx<'_>) -> &'static str {
    tx.either("jobs INDEXED BY jobs_lanes", "jobs")
}

/// Columns from which [`turn`] takes the turn of a job to be queued. `$1` is its lane, `$2` its
/// rank, `$3` its submitter.
///
/// Aggregates over a lane would return the same; ORDER BY with LIMIT makes the planner read the ends
/// of indexes.
pub(super) const TURN: &str = "\
    (SELECT turn FROM jobs WHERE status = 'running' AND lane = $1 AND rank = $2 \
    ORDER BY turn DESC LIMIT 1) AS running_turn, \
    (SELECT turn FROM jobs WHERE status = 'queued' AND NOT shares AND lane = $1 AND rank = $2 \
    ORDER BY turn, id LIMIT 1) AS head_turn, \
    (SELECT turn FROM jobs WHERE status = 'queued' AND NOT shares AND lane = $1 AND rank = $2 \
    AND submitter = $3 ORDER BY turn DESC LIMIT 1) AS own_turn, \
    (SELECT CASE WHEN lane = $1 AND rank = $2 THEN turn END FROM jobs \
    WHERE submitter = $3 AND submitter <> '' ORDER BY id DESC LIMIT 1) AS last_turn";

/// The turn of a job to be queued, from the columns of [`TURN`].
pub(super) fn turn(row: &Row) -> Result<i64, SqlError> {
    let (running, head): (Option<i64>, Option<i64>) = (row.get("running_turn")?, row.get("head_turn")?);
    let last: Option<i64> = row.get("last_turn")?;
    let present = match (running, head, last) {
        // Not before the turn of the first queued job but one: jobs may run for long. A submitter
        // without a job could have deleted the one of this turn.
        (Some(running), Some(head), Some(last)) => running.max(head - 1).max(last + 1),
        (running, head, _) => running.max(head).unwrap_or(0),
    };
    Ok(row.get::<Option<i64>>("own_turn")?.map_or(present, |own| present.max(own + 1)))
}

/// Query for the position of a job that is inserted: the number of jobs ahead of it, up to
/// [`POSITIONS`]. Parameters are those of the insertion.
pub(super) fn ahead(tx: &Tx<'_>) -> &'static str {
    tx.either(
        "SELECT COUNT(*) FROM (SELECT 1 FROM jobs AS a INDEXED BY jobs_lanes WHERE a.status = 'queued' \
         AND NOT a.shares AND a.lane = CASE WHEN $29 = 'fit' THEN 'fit' ELSE $7 END \
         AND (a.rank, a.turn, a.id) < ($23, $22, $1) \
         ORDER BY a.rank, a.turn, a.id LIMIT 1000) AS ahead",
        "SELECT COUNT(*) FROM (SELECT 1 FROM jobs AS a WHERE a.status = 'queued' \
         AND NOT a.shares AND a.lane = CASE WHEN $29 = 'fit' THEN 'fit' ELSE $7 END \
         AND (a.rank, a.turn, a.id) < ($23, $22, $1) \
         ORDER BY a.rank, a.turn, a.id LIMIT 1000) AS ahead",
    )
}

/// Number of jobs that the queue still accepts. Triggers keep its length, as rows to be summed.
pub(super) async fn queue_room(tx: &mut Tx<'_>, options: &StoreOptions) -> Result<u64, SqlError> {
    let length = "SELECT CAST(COALESCE(SUM(jobs), 0) AS BIGINT) AS queued FROM queue_length";
    Ok(options.queue_limit.saturating_sub(tx.one(length, vec![]).await?.count("queued")?))
}

/// Sets the positions of queued jobs, lane by lane. Each position is counted from the previous one,
/// so a page costs one pass over part of an index.
pub(super) async fn set_positions(tx: &mut Tx<'_>, records: &mut [Record]) -> Result<(), SqlError> {
    type Place = (i64, i64, String);
    const FIRST: Place = (i64::MIN, i64::MIN, String::new());
    let place = |record: &Record| (rank(record.job.priority), record.turn, record.job.id.to_string());
    let mut queued: Vec<(String, Place, &mut Job)> = records
        .iter_mut()
        .filter(|record| record.job.status == Status::Queued)
        .map(|record| {
            (enum_to_sql(Lane::of(record.job.kind, record.job.backend.requested)), place(record), &mut record.job)
        })
        .collect();
    queued.sort_unstable_by(|(a, here, _), (b, there, _)| (a, here).cmp(&(b, there)));
    let (mut lane, mut from, mut before) = (String::new(), FIRST, 0);
    for (own, here, job) in queued {
        if own != lane {
            (lane, from, before) = (own, FIRST, 0);
        }
        if before < POSITIONS {
            let sql = format!(
                "SELECT COUNT(*) AS n FROM (SELECT 1 FROM {} WHERE status = 'queued' AND NOT shares \
                 AND lane = $1 AND (rank, turn, id) >= ($2, $3, $4) AND (rank, turn, id) < ($5, $6, $7) \
                 ORDER BY rank, turn, id LIMIT 1000) AS ahead",
                lanes(tx)
            );
            let values = values![lane.clone(), from.0, from.1, from.2, here.0, here.1, here.2.clone()];
            before = POSITIONS.min(before + tx.one(sql, values).await?.count::<u64>("n")?);
        }
        job.queue_position = Some(before);
        from = here;
    }
    Ok(())
}
