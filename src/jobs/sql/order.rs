//! The order in which jobs are claimed, and places in it.
//!
//! Each backend that can be asked for has a lane of its own, so that a worker never reads past jobs that it
//! cannot run. Within a lane, jobs are claimed by (`turn`, age). A submission gets its turn once: one after the last
//! queued job of its submitter, but not before the lane's present turn (that of the job claimed last, or of the
//! head of the queue). So submitters take turns however many jobs each has queued, one that comes new waits for one
//! turn of each other, one that was away saves nothing up, and with a single submitter the order is that of
//! age. A job that is given back keeps its turn. Between lanes the older head goes first.
//!
//! Everything here reads a few ends of indexes, whatever the length of the queue: a turn, three; a position is
//! counted, but not beyond [`POSITIONS`].

use super::read::Record;
use super::{Link, SqlError, values, word};
use crate::jobs::job::{NewJob, Status};
use crate::jobs::store::StoreOptions;

/// Positions in the queue are exact up to this one; whoever is further back is told this one.
const POSITIONS: u64 = 1000;

/// The turn of a job that is about to be queued.
pub(super) async fn turn(link: &mut Link<'_>, new: &NewJob) -> Result<i64, SqlError> {
    // An aggregate over a lane would do; ORDER BY with LIMIT leaves the planner no choice but the end of the index.
    let row = link
        .one(
            "SELECT (SELECT turn FROM jobs WHERE status = 'running' AND backend_requested = $1 \
             ORDER BY turn DESC LIMIT 1) AS running, \
             (SELECT turn FROM jobs WHERE status = 'queued' AND backend_requested = $1 \
             ORDER BY turn, id LIMIT 1) AS head, \
             (SELECT turn FROM jobs WHERE status = 'queued' AND backend_requested = $1 AND submitter = $2 \
             ORDER BY turn DESC LIMIT 1) AS own",
            values![word(new.backend), submitter(new)],
        )
        .await?;
    let present = row.optional_int("running")?.max(row.optional_int("head")?).unwrap_or(0);
    Ok(row.optional_int("own")?.map_or(present, |own| present.max(own + 1)))
}

/// Who submits, as it is stored: nobody in particular is one submitter.
pub(super) fn submitter(new: &NewJob) -> String {
    new.submitter.clone().unwrap_or_default()
}

/// How many more jobs the queue takes. Its length is kept by triggers; where transactions of several connections run
/// at a time, as rows to be summed, which are put together here where they grow many.
pub(super) async fn queue_room(link: &mut Link<'_>, options: &StoreOptions) -> Result<u64, SqlError> {
    const MANY: u64 = 256;
    let row = link
        .one("SELECT CAST(COALESCE(SUM(jobs), 0) AS BIGINT) AS queued, COUNT(*) AS parts FROM queue_length", vec![])
        .await?;
    if row.count::<u64>("parts")? > MANY {
        link.execute(
            "WITH parts AS (DELETE FROM queue_length WHERE ctid = ANY (ARRAY(\
             SELECT ctid FROM queue_length FOR UPDATE SKIP LOCKED)) RETURNING jobs) \
             INSERT INTO queue_length (jobs) SELECT COALESCE(SUM(jobs), 0) FROM parts",
            vec![],
        )
        .await?;
    }
    Ok(options.queue_limit.saturating_sub(row.count("queued")?))
}

/// Sets the position in the queue of those that wait, by lane: each is counted on from the one before it, so that a
/// page costs one pass over a part of an index.
pub(super) async fn set_positions(link: &mut Link<'_>, records: &mut [Record]) -> Result<(), SqlError> {
    let mut queued: Vec<(String, i64, &mut _)> = records
        .iter_mut()
        .filter(|record| record.job.status == Status::Queued)
        .map(|record| (word(record.job.backend.requested), record.turn, &mut record.job))
        .collect();
    queued.sort_unstable_by(|(a, at, x), (b, bt, y)| (a, at, x.id).cmp(&(b, bt, y.id)));
    let (mut lane, mut from, mut before) = (String::new(), (i64::MIN, String::new()), 0);
    for (backend, turn, job) in queued {
        if backend != lane {
            (lane, from, before) = (backend, (i64::MIN, String::new()), 0);
        }
        let here = (turn, job.id.to_string());
        if before < POSITIONS {
            let row = link
                .one(
                    "SELECT COUNT(*) AS n FROM (SELECT 1 FROM jobs WHERE status = 'queued' AND backend_requested = $1 \
                     AND (turn, id) >= ($2, $3) AND (turn, id) < ($4, $5) ORDER BY turn, id LIMIT 1000) AS ahead",
                    values![lane.clone(), from.0, from.1, here.0, here.1.clone()],
                )
                .await?;
            before = POSITIONS.min(before + row.count::<u64>("n")?);
        }
        job.queue_position = Some(before);
        from = here;
    }
    Ok(())
}
