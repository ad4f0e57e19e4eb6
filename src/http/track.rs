//! Which events a change of a model makes, and which of them are held back for a while.
//!
//! Every event carries the whole current state, so a client that misses one is correct again at the next. Only `progress`
//! and `section` are ever thinned.

use super::view::Name;
use crate::jobs::{BackendReport, Job, JobProgress, Status};
use std::time::Duration;

/// What was published of one model, and when.
#[derive(Clone, Debug)]
pub(super) struct Track {
    interval: Duration,
    published: Option<Published>,
    progress_at: Option<Duration>,
    section_at: Option<Duration>,
}

#[derive(Clone, Debug, PartialEq)]
struct Published {
    state: (Status, Option<u64>, u32, BackendReport, bool),
    progress: Option<JobProgress>,
    section: Option<(u32, u32)>,
}

impl Published {
    fn of(job: &Job) -> Self {
        Self {
            state: (job.status, job.queue_position, job.attempts, job.backend.clone(), job.cancel_requested),
            progress: job.progress,
            section: job.section.as_ref().map(|s| (s.index, s.step)),
        }
    }
}

impl Track {
    /// A model of which nothing was published yet. Progress and sections are published at most once per `interval`.
    pub(super) fn new(interval: Duration) -> Self {
        Self { interval, published: None, progress_at: None, section_at: None }
    }

    /// The events due at `now` for the model's present state, and the time after which to call again if an event was held
    /// back. `now` is a time since any fixed moment.
    pub(super) fn next(&mut self, job: &Job, now: Duration) -> (Vec<Name>, Option<Duration>) {
        let present = Published::of(job);
        if job.status.is_ended() {
            self.published = Some(present);
            return (vec![Name::End], None);
        }
        let Some(before) = &mut self.published else {
            let section = present.section.map(|_| Name::Section);
            self.progress_at = present.progress.map(|_| now);
            self.section_at = section.map(|_| now);
            self.published = Some(present);
            return ([Name::Status].into_iter().chain(section).collect(), None);
        };
        let (mut names, mut again) = (Vec::new(), None::<Duration>);
        if before.state != present.state {
            names.push(Name::Status);
            before.state = present.state;
        }
        let mut thinned = |changed: bool, at: &mut Option<Duration>, name: Name| {
            let left = at.map_or(Duration::ZERO, |at| (at + self.interval).saturating_sub(now));
            let due = changed && left.is_zero();
            if due {
                *at = Some(now);
                names.push(name);
            } else if changed {
                again = Some(again.map_or(left, |a| a.min(left)));
            }
            due
        };
        let progressed = before.progress != present.progress && present.progress.is_some();
        if thinned(progressed, &mut self.progress_at, Name::Progress) {
            before.progress = present.progress;
        }
        let recorded = before.section != present.section && present.section.is_some();
        if thinned(recorded, &mut self.section_at, Name::Section) {
            before.section = present.section;
        }
        (names, again)
    }
}

#[cfg(test)]
mod tests;
