//! Which events a change of a model makes, and how they look on the wire (WHATWG server-sent events).
//!
//! Every event carries the whole current state, so leaving one out never leaves a client wrong for longer than to
//! the next one; only `progress` and `section` are ever left out.

use super::dto::{Deleted, DeletedEvent, Model, ModelEvent};
use crate::generate::Progress;
use crate::jobs::{BackendReport, Job, JobId, Status};
use axum::response::sse::Event;
use std::time::Duration;

/// Kinds of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Name {
    Status,
    Progress,
    Section,
    End,
}

impl Name {
    fn text(self) -> &'static str {
        match self {
            Self::Status => "status",
            Self::Progress => "progress",
            Self::Section => "section",
            Self::End => "end",
        }
    }
}

/// An event of `job` with the given id; models are kept so long after their end.
pub(super) fn event(name: Name, job: &Job, id: &str, keep: Option<Duration>) -> Event {
    let section = job.section.clone().filter(|_| name == Name::Section);
    let data = ModelEvent { model: Model::of(job, keep), section };
    write(name, &data, id)
}

/// The last event of a deleted model.
pub(super) fn deleted(model: JobId, id: &str) -> Event {
    write(Name::End, &DeletedEvent { id: model.0, status: Deleted::Deleted }, id)
}

fn write(name: Name, data: &impl serde::Serialize, id: &str) -> Event {
    let data = serde_json::to_string(data).expect("a model has string keys only");
    Event::default().event(name.text()).id(id).data(data)
}

/// What a stream has told of one model, and when.
#[derive(Clone, Debug)]
pub(super) struct Track {
    interval: Duration,
    told: Option<Told>,
    progress_at: Option<Duration>,
    section_at: Option<Duration>,
}

#[derive(Clone, Debug, PartialEq)]
struct Told {
    state: (Status, Option<u64>, u32, BackendReport, bool),
    progress: Option<Progress>,
    section: Option<(u32, u32)>,
}

impl Told {
    fn of(job: &Job) -> Self {
        Self {
            state: (job.status, job.queue_position, job.attempts, job.backend.clone(), job.cancel_requested),
            progress: job.progress,
            section: job.section.as_ref().map(|s| (s.index, s.step)),
        }
    }
}

impl Track {
    /// A model of which nothing was told yet.
    pub(super) fn new(interval: Duration) -> Self {
        Self { interval, told: None, progress_at: None, section_at: None }
    }

    /// A model of which this state is known to the client.
    pub(super) fn knowing(interval: Duration, job: &Job) -> Self {
        Self { told: Some(Told::of(job)), ..Self::new(interval) }
    }

    /// The events due at `now` for the model's present state, and after how long to ask again where one was held
    /// back. `now` is the age of the stream.
    pub(super) fn next(&mut self, job: &Job, now: Duration) -> (Vec<Name>, Option<Duration>) {
        let told = Told::of(job);
        if job.status.is_ended() {
            self.told = Some(told);
            return (vec![Name::End], None);
        }
        let Some(before) = &mut self.told else {
            let section = told.section.map(|_| Name::Section);
            self.progress_at = told.progress.map(|_| now);
            self.section_at = section.map(|_| now);
            self.told = Some(told);
            return ([Name::Status].into_iter().chain(section).collect(), None);
        };
        let (mut names, mut again) = (Vec::new(), None::<Duration>);
        if before.state != told.state {
            names.push(Name::Status);
            before.state = told.state;
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
        if thinned(before.progress != told.progress && told.progress.is_some(), &mut self.progress_at, Name::Progress) {
            before.progress = told.progress;
        }
        if thinned(before.section != told.section && told.section.is_some(), &mut self.section_at, Name::Section) {
            before.section = told.section;
        }
        (names, again)
    }
}

#[cfg(test)]
mod tests;
