//! Places in the queue.

use crate::jobs::state::Lane;
use crate::jobs::{Job, JobId};
use crate::lock::Mutex;

/// Place in the queue, in the order of claims within a lane.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::jobs) struct Place {
    pub(super) lane: Lane,
    pub(super) rank: i64,
    pub(super) turn: i64,
    pub(super) id: JobId,
}

/// A place of a lane that is known to be farther back than positions are counted, on PostgreSQL, so
/// that not every submission to a long queue counts the jobs ahead.
#[derive(Debug, Default)]
pub(super) struct FarPlace(Mutex<Option<(Place, i64)>>);

/// Maximum number of changes of the queue by transactions that run while jobs are counted.
const CHANGES_UNDER_WAY: i64 = 1000;

impl FarPlace {
    /// The place if it is of this lane, and the number of changes of the queue until which it is
    /// far.
    pub(super) fn get(&self, lane: Lane) -> Option<(Place, i64)> {
        self.0.lock().clone().filter(|(place, _)| place.lane == lane)
    }

    /// Notes that `place` has had this number of jobs ahead after a number of changes of the queue,
    /// each of which removes at most one job.
    pub(super) fn note(&self, place: Place, ahead: u64, changes: i64) {
        let spare = ahead as i64 - Job::MAX_QUEUE_POSITION as i64 - CHANGES_UNDER_WAY;
        if spare > 0 {
            *self.0.lock() = Some((place, changes + spare));
        }
    }
}
