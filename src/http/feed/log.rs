//! The published states of models in one order, so that a reader of all of them can be resumed.
//!
//! Each state gets the next number; the log keeps the latest state of each model. A reader is a number: what follows it is
//! what the reader lacks. So a slow reader skips to the newest state of each model, and costs no memory.
//! The log is bounded in bytes: it drops the states that were published first, except those of running models. A reader
//! behind a dropped state begins anew.

use super::super::interest::Interest;
use super::super::view::View;
use crate::jobs::{JobId, Status};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

/// Most models of one kind that a reader begins with: the newest that wait, the newest of any status.
pub(super) const FIRST: usize = 100;

/// The published states.
#[derive(Debug)]
pub(in crate::http) struct Log {
    /// Number of the last state.
    last: u64,
    /// All states after this number are known.
    floor: u64,
    views: BTreeMap<u64, Arc<View>>,
    numbers: HashMap<JobId, u64>,
    bytes: usize,
    most_bytes: usize,
}

/// What follows a number.
#[derive(Debug)]
pub(in crate::http) enum Next {
    /// This state.
    View(Arc<View>),
    /// Nothing up to this number.
    Nothing(u64),
    /// The number is of another log, or states after it were dropped.
    Unknown,
}

impl Log {
    /// An empty log of at most `most_bytes` bytes.
    pub(super) fn new(most_bytes: usize) -> Self {
        Self { last: 1, floor: 1, views: BTreeMap::new(), numbers: HashMap::new(), bytes: 0, most_bytes }
    }

    /// Number of the last state.
    pub(in crate::http) fn last(&self) -> u64 {
        self.last
    }

    /// Bytes of all states.
    #[cfg(test)]
    fn bytes(&self) -> usize {
        self.bytes
    }

    /// The latest state of a model.
    pub(in crate::http) fn view(&self, id: JobId) -> Option<&Arc<View>> {
        self.views.get(self.numbers.get(&id)?)
    }

    /// Adds a state, whose number must be the one after [`Log::last`].
    pub(super) fn insert(&mut self, view: View) -> Arc<View> {
        let view = Arc::new(view);
        self.remove(view.id());
        self.last = view.number();
        self.bytes += view.bytes();
        self.numbers.insert(view.id(), view.number());
        self.views.insert(view.number(), Arc::clone(&view));
        while self.bytes > self.most_bytes {
            let droppable = |view: &Arc<View>| view.number() < self.last && view.status() != Some(Status::Running);
            let Some(first) = self.views.values().find(|view| droppable(view)).cloned() else { break };
            self.remove(first.id());
            self.floor = self.floor.max(first.number());
        }
        view
    }

    /// Removes the state of a model; what readers lack does not change by that.
    pub(super) fn remove(&mut self, id: JobId) {
        if let Some(view) = self.numbers.remove(&id).and_then(|number| self.views.remove(&number)) {
            self.bytes -= view.bytes();
        }
    }

    /// Removes all states but those of the models in `kept`. Every reader begins anew.
    pub(in crate::http) fn clear(&mut self, kept: impl Fn(JobId) -> bool) {
        self.last += 1;
        self.floor = self.last;
        self.views.retain(|_, view| kept(view.id()));
        self.numbers.retain(|id, _| kept(*id));
        self.numbers.shrink_to_fit();
        self.bytes = self.views.values().map(|view| view.bytes()).sum();
    }

    /// The first state after `number` that is of interest.
    pub(super) fn after(&self, number: u64, interest: &Interest) -> Next {
        if !(self.floor..=self.last).contains(&number) {
            return Next::Unknown;
        }
        let mut views = self.views.range(number + 1..).map(|(_, view)| view);
        let found = views.find(|view| interest.includes(view.id(), view.traits().map(|traits| &**traits)));
        found.map_or(Next::Nothing(self.last), |view| Next::View(Arc::clone(view)))
    }

    /// The models that a reader begins with, oldest first: all that run, the newest that wait, and if `with_ended` the
    /// newest of any status.
    pub(super) fn first(&self, with_ended: bool) -> BTreeSet<JobId> {
        let of = |status: Option<Status>| {
            let views = self.views.values();
            views.filter(move |view| status.is_none() || view.status() == status).map(|view| view.id())
        };
        let newest = |ids: &mut dyn Iterator<Item = JobId>| {
            let mut ids: Vec<_> = ids.collect();
            ids.sort_unstable();
            ids.split_off(ids.len().saturating_sub(FIRST))
        };
        let mut first: BTreeSet<_> = of(Some(Status::Running)).collect();
        first.extend(newest(&mut of(Some(Status::Queued))));
        if with_ended {
            first.extend(newest(&mut of(None)));
        }
        first
    }
}

#[cfg(test)]
mod tests;
