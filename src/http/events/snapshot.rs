//! The state of a job as bytes of server-sent events (WHATWG HTML, section 9.2).
//!
//! A state is serialized once, and the spec of a model once for all its states. All readers share
//! these bytes; only the lines with the name and the id of an event are written per reader.

use crate::http::fits::{Fit, FitDetail};
use crate::http::models::model::{Deleted, DeletedEvent, Detail, LinkBase, Model};
use crate::http::workforce::JobContext;
use crate::jobs::{BatchId, Job, JobId, JobKind};
use bytes::Bytes;
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::Arc;

/// End of a JSON object, and of an event.
const END: &[u8] = b"}\n\n";

/// The fields of a job by which a stream of many models selects it. They never change.
#[derive(Debug)]
pub(super) struct FilterFields {
    pub(super) kind: JobKind,
    pub(super) owner: Option<String>,
    pub(super) batch: Option<BatchId>,
    pub(super) labels: BTreeMap<String, String>,
}

/// One published state of a job.
#[derive(Debug)]
pub(super) struct Snapshot {
    pub(super) id: JobId,
    /// `None` if the job was deleted before it was read.
    pub(super) fields: Option<Arc<FilterFields>>,
    /// Version of the job; the version after its last if it was deleted.
    pub(super) version: u64,
    /// Place in the order of publication.
    pub(super) number: u64,
    /// Numbers of the first snapshot of the job, and of the latest ones that were published as
    /// `status` and as `progress` events.
    first_number: u64,
    status_number: u64,
    progress_number: u64,
    /// Whether this is the last state, because the job has ended or was deleted.
    pub(super) is_last: bool,
    /// The job as JSON without spec and section, and the end of the event.
    data: Bytes,
    /// The same with references to files relative to the stream of this job; `None` if there are no
    /// files.
    data_of_job_stream: Option<Bytes>,
    /// The member `spec`; empty for fits and deleted models.
    spec: Bytes,
    section: Option<SectionMember>,
}

/// The events by which a snapshot is published. The first snapshot of a job is always published as
/// a `status` event.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Changes {
    pub(super) status: bool,
    pub(super) progress: bool,
}

/// The member `section` of a `section` event, with the end of the event.
#[derive(Clone, Debug)]
struct SectionMember {
    index_and_step: (u32, u32),
    /// Number of the first snapshot with this section.
    number: u64,
    bytes: Bytes,
}

impl Snapshot {
    /// The state of `job`, published with `number` after `previous`.
    pub(super) fn new(job: &Job, context: &JobContext, number: u64, changes: Changes, previous: Option<&Self>) -> Self {
        let fields = previous.and_then(|previous| previous.fields.clone()).unwrap_or_else(|| {
            let (kind, owner, batch, labels) = (job.kind, job.owner.clone(), job.batch, job.labels.clone());
            Arc::new(FilterFields { kind, owner, batch, labels })
        });
        let section = job.section.as_ref().filter(|_| !job.status.is_ended()).map(|section| {
            let index_and_step = (section.index, section.step);
            let known = previous.and_then(|previous| previous.section.clone());
            known.filter(|known| known.index_and_step == index_and_step).unwrap_or_else(|| SectionMember {
                index_and_step,
                number,
                bytes: json(",\"section\":", section, END),
            })
        });
        let spec = match (previous, job.kind) {
            (Some(previous), _) => previous.spec.clone(),
            (None, JobKind::Model) => json(",\"spec\":", &job.spec, b""),
            (None, JobKind::Fit) => Bytes::new(),
        };
        Self {
            id: job.id,
            fields: Some(fields),
            version: job.version,
            number,
            first_number: previous.map_or(number, |previous| previous.first_number),
            status_number: previous.filter(|_| !changes.status).map_or(number, |previous| previous.status_number),
            progress_number: previous.filter(|_| !changes.progress).map_or(number, |previous| previous.progress_number),
            is_last: job.status.is_ended(),
            data: data(job, context, LinkBase::Root),
            data_of_job_stream: None,
            spec,
            section,
        }
    }

    /// The state of a job that was deleted after `previous`.
    pub(super) fn deleted(id: JobId, number: u64, previous: Option<&Self>) -> Self {
        Self {
            id,
            fields: previous.and_then(|previous| previous.fields.clone()),
            version: previous.map_or(0, |previous| previous.version) + 1,
            number,
            first_number: number,
            status_number: number,
            progress_number: number,
            is_last: true,
            data: json("", &DeletedEvent { id: id.0, status: Deleted::Deleted }, &END[1..]),
            data_of_job_stream: None,
            spec: Bytes::new(),
            section: None,
        }
    }

    /// Adds the data for the stream of this job, where references to files differ from those in
    /// `/events`.
    pub(super) fn for_its_stream(self, job: &Job, context: &JobContext) -> Self {
        let data_of_job_stream = (!job.files.is_empty()).then(|| data(job, context, LinkBase::Model));
        Self { data_of_job_stream, ..self }
    }

    /// The same snapshot without anything to send.
    pub(super) fn without_data(&self) -> Self {
        let fields = self.fields.clone();
        Self { fields, data: Bytes::new(), data_of_job_stream: None, spec: Bytes::new(), section: None, ..*self }
    }

    /// Whether there is anything to send.
    pub(super) fn has_data(&self) -> bool {
        !self.data.is_empty()
    }

    /// Size of its data in bytes.
    pub(super) fn bytes(&self) -> usize {
        let section = self.section.as_ref().map_or(0, |section| section.bytes.len());
        let of_job_stream = self.data_of_job_stream.as_ref().map_or(0, Bytes::len);
        self.data.len() + of_job_stream + self.spec.len() + section
    }

    /// The events for a reader that has received everything up to `position` (0: nothing), as
    /// pieces to be sent in order. `id` is the id of the events.
    pub(super) fn events_after(&self, position: u64, id: &str, detail: Detail, at: LinkBase) -> Vec<Bytes> {
        let is_known = self.first_number <= position;
        let names = [
            ("end", self.is_last && self.number > position),
            ("status", !self.is_last && self.status_number > position),
            ("progress", !self.is_last && is_known && self.progress_number > position),
            ("section", self.section.as_ref().is_some_and(|section| section.number > position)),
        ];
        let data = self.data_of_job_stream.as_ref().filter(|_| at == LinkBase::Model).unwrap_or(&self.data);
        let spec = Some(&self.spec).filter(|spec| detail == Detail::Full && !spec.is_empty());
        let mut pieces = Vec::new();
        for (name, _) in names.into_iter().filter(|(_, is_due)| *is_due) {
            pieces.push(Bytes::from(format!("event: {name}\nid: {id}\ndata: ")));
            let section = self.section.as_ref().filter(|_| name == "section");
            if spec.is_none() && section.is_none() {
                pieces.push(data.clone());
                continue;
            }
            pieces.push(data.slice(..data.len() - END.len()));
            pieces.extend(spec.cloned());
            pieces.push(section.map_or(Bytes::from_static(END), |section| section.bytes.clone()));
        }
        pieces
    }
}

/// The data of an event.
fn data(job: &Job, context: &JobContext, at: LinkBase) -> Bytes {
    match job.kind {
        JobKind::Model => json("", &Model::of(job, context, Detail::Summary, at), &END[1..]),
        JobKind::Fit => json("", &Fit::of(job, context, FitDetail::Result), &END[1..]),
    }
}

/// A value as JSON between two texts.
fn json(before: &str, value: &impl Serialize, after: &[u8]) -> Bytes {
    let mut bytes = before.as_bytes().to_vec();
    serde_json::to_writer(&mut bytes, value).expect("jobs have string keys only, and a Vec takes all bytes");
    bytes.extend_from_slice(after);
    bytes.into()
}

#[cfg(test)]
mod tests;
