//! A reader of many models, for a stream of their events.
//!
//! It begins with the present state of models: a reader of all with those that the feed knows, one of some models with pages
//! of the job store. Then it gets each state that is published. A reader of a finite set of models ends with the last of them.

use super::feed::{AllReader, Next};
use super::interest::{Interest, Part, Traits};
use super::models::detail::Detail;
use super::view::View;
use crate::jobs::{Job, JobId, StoreError};
use bytes::Bytes;
use std::collections::VecDeque;
use std::time::Duration;

/// What comes next.
pub(super) enum Step {
    /// These pieces; there may be none.
    Pieces(Vec<Bytes>),
    /// Nothing until something changes.
    Wait,
    /// Nothing more: all models have ended.
    Over,
}

/// The states that a reader begins with.
enum First {
    /// Of these models, which the feed knows.
    Known(VecDeque<JobId>),
    /// Of the models in these parts.
    Parts(VecDeque<Part>),
    /// Sent.
    Done,
    /// Sent, as all else: its models have ended, and the client knows.
    Over,
}

/// A reader of many models.
pub(super) struct Many {
    reader: AllReader,
    interest: Interest,
    /// What cursors of this reader begin with.
    name: String,
    first: First,
    /// The client has everything up to this number, apart from the states in `first`.
    number: u64,
    /// Whether its models may all have ended since that was checked.
    check: bool,
}

impl Many {
    /// A reader that goes on after the event with the id `last`; if that is unknown, it begins with ended models too.
    pub(super) async fn new(reader: AllReader, interest: Interest, last: Option<&str>) -> Result<Self, StoreError> {
        let name = format!("{}{}-", reader.name(), interest.name());
        let number = last.and_then(|cursor| cursor.strip_prefix(&name)?.parse().ok());
        let mut many = Self { reader, interest, name, first: First::Done, number: number.unwrap_or(0), check: true };
        if let Some(models) = last.and_then(|last| last.strip_prefix(&many.over_prefix()))
            && many.interest.is_finite()
            && many.reader.ended(&many.interest).await?.as_deref() == Some(models)
        {
            many.first = First::Over;
        } else if matches!(many.reader.after(many.number, &many.interest), Next::Unknown) {
            // 0 is never a number of the feed.
            many.begin(last.is_some());
        }
        Ok(many)
    }

    fn begin(&mut self, with_ended: bool) {
        self.check = true;
        (self.first, self.number) = if self.interest.is_all() {
            let (ids, number) = self.reader.first(with_ended);
            (First::Known(ids), number)
        } else {
            let (parts, number) = self.reader.first_of(&self.interest, with_ended);
            (First::Parts(parts.into()), number)
        };
    }

    /// Whether its models have all ended, and the client knows.
    pub(super) fn is_over(&self) -> bool {
        match self.first {
            First::Over => true,
            First::Done => self.reader.is_over(&self.interest, self.number),
            First::Known(_) | First::Parts(_) => false,
        }
    }

    /// What comes next. Fails if the store fails, and can be called again then.
    pub(super) async fn next(&mut self, detail: Detail) -> Result<Step, StoreError> {
        // A client that breaks off among the first states begins anew.
        let begun = self.cursor(0);
        match &mut self.first {
            First::Known(ids) => {
                let Some(id) = ids.pop_front() else { return Ok(self.begun()) };
                let events = self.reader.view(id).map(|view| view.events_after(0, &begun, detail));
                Ok(Step::Pieces(events.unwrap_or_default()))
            }
            First::Parts(parts) => {
                let Some(part) = parts.front() else { return Ok(self.begun()) };
                let page = self.reader.page(&part.filter).await?;
                let mut part = part.clone();
                parts.pop_front();
                let missing = self.interest.missing(page.jobs.iter().map(|job| job.id));
                if let (true, Some(next)) = (part.whole, page.next) {
                    part.filter.before = Some(next);
                    parts.push_front(part.clone());
                }
                let wanted = |job: &&Job| {
                    let passed_over = part.ended_only && !job.status.is_ended();
                    !passed_over && self.interest.includes(job.id, Some(&Traits::of(job)))
                };
                let mut pieces = Vec::new();
                // Oldest first, as they would have been reported.
                for job in page.jobs.iter().rev().filter(wanted) {
                    if let Some(view) = self.reader.state_of(job, self.number) {
                        pieces.extend(view.events_after(0, &begun, detail));
                    }
                }
                for id in missing {
                    pieces.extend(View::deleted(id, self.number, None, None).events_after(0, &begun, detail));
                }
                Ok(Step::Pieces(pieces))
            }
            First::Done => Ok(match self.reader.after(self.number, &self.interest) {
                Next::View(view) => {
                    let pieces = view.events_after(self.number, &self.cursor(view.number()), detail);
                    self.number = view.number();
                    self.check |= view.is_last();
                    Step::Pieces(pieces)
                }
                Next::Nothing(number) => {
                    self.number = number;
                    let ended = match self.check && self.is_over() {
                        true => self.reader.ended(&self.interest).await?,
                        false => None,
                    };
                    self.check = false;
                    match ended {
                        Some(models) => {
                            self.first = First::Over;
                            Step::Pieces(vec![format!("id: {}{models}\n\n", self.over_prefix()).into()])
                        }
                        None => Step::Wait,
                    }
                }
                Next::Unknown => {
                    self.begin(true);
                    Step::Pieces(Vec::new())
                }
            }),
            First::Over => Ok(Step::Over),
        }
    }

    /// The end of the first states: an id without an event, from which the client can go on.
    fn begun(&mut self) -> Step {
        self.first = First::Done;
        Step::Pieces(vec![format!("id: {}\n\n", self.cursor(self.number)).into()])
    }

    /// The id of events after which a client goes on at `number`.
    fn cursor(&self, number: u64) -> String {
        format!("{}{number}", self.name)
    }

    /// What the last id of a stream that has ended begins with. It means the same in every process, so that a client that a
    /// load balancer sends to another one learns there that nothing follows.
    fn over_prefix(&self) -> String {
        format!("over{}-", self.interest.name())
    }

    /// Waits until something is published.
    pub(super) async fn changed(&mut self) {
        self.reader.changed().await;
    }

    /// How often the store is asked again after a failure.
    pub(super) fn poll(&self) -> Duration {
        self.reader.poll()
    }
}
