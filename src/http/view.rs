//! The state of a model as bytes of server-sent events (WHATWG HTML, section 9.2).
//!
//! A state is serialised once, and the spec of a model once for all its states. All readers share these bytes; what differs
//! between them is only the lines with the event's name and id, and whether the spec is sent.

use super::dto::{Deleted, DeletedEvent, Model};
use super::interest::Traits;
use super::models::detail::Detail;
use super::models::links::At;
use crate::jobs::{Job, JobId, Status};
use bytes::Bytes;
use serde::Serialize;
use std::sync::Arc;
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
#[derive(Clone, Debug)]
pub(super) struct View {
    id: JobId,
    version: u64,
    /// `None` if the model was deleted.
    status: Option<Status>,
    numbers: Numbers,
    /// `None` if the model was deleted before it was known.
    traits: Option<Arc<Traits>>,
    /// The model without its spec as JSON, and the end of the event.
    model: Bytes,
    /// The member `spec`, which goes after the members of the model. Empty if the model was deleted.
    spec: Bytes,
    /// The member `section` that a `section` event has after all others, with the end of the event.
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
            known.unwrap_or_else(|| (key, member(",\"section\":", section, END)))
        });
        let spec = before.map(|before| before.spec.clone()).filter(|spec| !spec.is_empty());
        let spec = spec.unwrap_or_else(|| member(",\"spec\":", &job.spec, b""));
        let model = member("", &Model::of(job, keep, Detail::Summary, At::Root), &END[1..]);
        let traits = before.and_then(|before| before.traits.clone()).or_else(|| Some(Arc::new(Traits::of(job))));
        Self { id: job.id, version: job.version, status: Some(job.status), numbers, traits, model, spec, section }
    }

    /// The same state for the stream of this model, whose URL lies elsewhere than that of the stream of all: references to
    /// files differ.
    pub(super) fn of_one(self: Arc<Self>, job: &Job, keep: Option<Duration>) -> Arc<Self> {
        if job.files.is_empty() {
            return self;
        }
        let model = member("", &Model::of(job, keep, Detail::Summary, At::Model), &END[1..]);
        Arc::new(Self { model, ..Self::clone(&self) })
    }

    /// The last state of a deleted model. `traits` are those it had, if that is known.
    pub(super) fn deleted(id: JobId, number: u64, before: Option<&Self>, traits: Option<Arc<Traits>>) -> Self {
        let numbers = Numbers { first: number, last: number, ..Numbers::default() };
        let model = member("", &DeletedEvent { id: id.0, status: Deleted::Deleted }, &END[1..]);
        let version = before.map_or(0, |before| before.version) + 1;
        Self { id, version, status: None, numbers, traits, model, spec: Bytes::new(), section: None }
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

    /// What of the model an interest is about.
    pub(super) fn traits(&self) -> Option<&Arc<Traits>> {
        self.traits.as_ref()
    }

    /// Bytes that it keeps in memory.
    pub(super) fn bytes(&self) -> usize {
        self.traits.as_ref().map_or(0, |traits| traits.bytes())
            + self.model.len()
            + self.spec.len()
            + self.section.as_ref().map_or(0, |(_, bytes)| bytes.len())
    }

    /// The events for a reader that has everything published up to `number`, as pieces to be sent one after the other.
    /// A reader that has nothing is at 0.
    pub(super) fn events_after(&self, number: u64, id: &str, detail: Detail) -> Vec<Bytes> {
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
            let spec = Some(&self.spec).filter(|spec| detail == Detail::Full && !spec.is_empty());
            let section = self.section.as_ref().filter(|_| name == Name::Section);
            if spec.is_none() && section.is_none() {
                pieces.push(self.model.clone());
                continue;
            }
            let (members, end) = (self.model.len() - END.len(), Bytes::from_static(END));
            pieces.push(self.model.slice(..members));
            pieces.extend(spec.cloned());
            pieces.push(section.map_or(end, |(_, section)| section.clone()));
        }
        pieces
    }
}

/// A value as JSON between these texts.
fn member(before: &str, value: &impl Serialize, after: &[u8]) -> Bytes {
    let mut bytes = before.as_bytes().to_vec();
    serde_json::to_writer(&mut bytes, value).expect("a model has string keys only, and a Vec takes all bytes");
    bytes.extend_from_slice(after);
    bytes.into()
}

#[cfg(test)]
mod tests;
