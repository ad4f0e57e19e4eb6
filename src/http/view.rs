//! The state of a model as bytes of server-sent events (WHATWG HTML, section 9.2).
//!
//! A state is serialised once. All readers share its bytes; what differs between them is only the line with the event's
//! name and id.

use super::dto::{Deleted, DeletedEvent, Model};
use crate::jobs::{Job, JobId, Status};
use bytes::Bytes;
use serde::Serialize;
use std::time::Duration;

/// Names of events.
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

/// End of an object, and of an event.
const END: &[u8] = b"}\n\n";

/// When the events of a model were published last, as numbers in the order of publication; 0 for never.
#[derive(Clone, Copy, Debug, Default)]
struct Numbers {
    first: u64,
    last: u64,
    status: u64,
    progress: u64,
    section: u64,
}

/// One published state of a model.
#[derive(Debug)]
pub(super) struct View {
    id: JobId,
    version: u64,
    /// `None` if the model was deleted.
    status: Option<Status>,
    numbers: Numbers,
    /// The model as JSON, and the end of the event.
    model: Bytes,
    /// The member `section` that a `section` event has after the members of the model, with the end of the event.
    section: Option<((u32, u32), Bytes)>,
}

impl View {
    /// The state of `job`, published as `number` by events of these names. `before` is the view that it replaces; models
    /// are removed `keep` after their end.
    pub(super) fn of(job: &Job, keep: Option<Duration>, names: &[Name], number: u64, before: Option<&Self>) -> Self {
        let mut numbers = before.map_or(Numbers { first: number, ..Numbers::default() }, |before| before.numbers);
        numbers.last = number;
        for name in names {
            match name {
                Name::Status => numbers.status = number,
                Name::Progress => numbers.progress = number,
                Name::Section => numbers.section = number,
                Name::End => {}
            }
        }
        let section = job.section.as_ref().filter(|_| !job.status.is_ended()).map(|section| {
            let key = (section.index, section.step);
            let known = before.and_then(|before| before.section.clone()).filter(|(before, _)| *before == key);
            known.unwrap_or_else(|| {
                let mut bytes = b",\"section\":".to_vec();
                write(&mut bytes, section);
                bytes.extend_from_slice(END);
                (key, bytes.into())
            })
        });
        let mut model = Vec::new();
        write(&mut model, &Model::of(job, keep));
        model.extend_from_slice(&END[1..]);
        Self { id: job.id, version: job.version, status: Some(job.status), numbers, model: model.into(), section }
    }

    /// The last state of a deleted model.
    pub(super) fn deleted(id: JobId, number: u64, before: Option<&Self>) -> Self {
        let numbers = Numbers { first: number, last: number, ..Numbers::default() };
        let mut model = Vec::new();
        write(&mut model, &DeletedEvent { id: id.0, status: Deleted::Deleted });
        model.extend_from_slice(&END[1..]);
        let version = before.map_or(0, |before| before.version) + 1;
        Self { id, version, status: None, numbers, model: model.into(), section: None }
    }

    pub(super) fn id(&self) -> JobId {
        self.id
    }

    /// Version of the model; for a deleted one, the version after its last.
    pub(super) fn version(&self) -> u64 {
        self.version
    }

    /// `None` if the model was deleted.
    pub(super) fn status(&self) -> Option<Status> {
        self.status
    }

    /// Whether it is the last state of the model.
    pub(super) fn is_last(&self) -> bool {
        self.status.is_none_or(Status::is_ended)
    }

    /// Its place in the order of publication.
    pub(super) fn number(&self) -> u64 {
        self.numbers.last
    }

    /// Bytes that it keeps in memory.
    pub(super) fn bytes(&self) -> usize {
        self.model.len() + self.section.as_ref().map_or(0, |(_, bytes)| bytes.len())
    }

    /// The events for a reader that has everything published up to `number`, as pieces to be sent one after the other.
    /// A reader that has nothing is at 0.
    pub(super) fn events_after(&self, number: u64, id: &str) -> Vec<Bytes> {
        let Numbers { first, status, progress, section, .. } = self.numbers;
        let names = if self.is_last() {
            [Some(Name::End), None, None]
        } else if first > number {
            [Some(Name::Status), None, self.section.is_some().then_some(Name::Section)]
        } else {
            [
                (status > number).then_some(Name::Status),
                (progress > number).then_some(Name::Progress),
                (section > number && self.section.is_some()).then_some(Name::Section),
            ]
        };
        let mut pieces = Vec::new();
        for name in names.into_iter().flatten() {
            pieces.push(Bytes::from(format!("event: {}\nid: {id}\ndata: ", name.text())));
            match (&self.section, name) {
                (Some((_, section)), Name::Section) => {
                    pieces.push(self.model.slice(..self.model.len() - END.len()));
                    pieces.push(section.clone());
                }
                _ => pieces.push(self.model.clone()),
            }
        }
        pieces
    }
}

fn write(out: &mut Vec<u8>, value: &impl Serialize) {
    serde_json::to_writer(out, value).expect("a model has string keys only, and a Vec takes all bytes");
}

#[cfg(test)]
mod tests;
