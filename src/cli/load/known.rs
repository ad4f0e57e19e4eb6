//! The models of a load test, which are those that it submitted.

use crate::lock::Mutex;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// A file of a model that has ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct File {
    /// Path on the service.
    pub(super) path: String,
    pub(super) bytes: u64,
}

#[derive(Debug, Default)]
struct State {
    /// Accepted models, in the order of the responses.
    ids: Vec<Arc<str>>,
    /// Accepted models that do not count, because they were due during the warm-up.
    uncounted: HashSet<Arc<str>>,
    /// The largest file of each model whose end is known.
    files: Vec<File>,
    /// Models that are known to have ended, and whether `files` has theirs.
    ended: HashMap<Arc<str>, bool>,
}

/// The models of a run.
#[derive(Debug, Default)]
pub(super) struct Known(Mutex<State>);

/// Returns the element for a random word.
fn pick<T>(all: &[T], word: u32) -> Option<&T> {
    all.get(((u64::from(word) * all.len() as u64) >> 32) as usize)
}

impl Known {
    /// Adds an accepted model.
    pub(super) fn accept(&self, id: &str, counted: bool) {
        let (mut state, id) = (self.0.lock(), Arc::<str>::from(id));
        if !counted {
            state.uncounted.insert(Arc::clone(&id));
        }
        state.ids.push(id);
    }

    /// Records the end of a model, with its largest file if it has files.
    pub(super) fn end(&self, id: &str, file: Option<File>) {
        let State { ended, files, .. } = &mut *self.0.lock();
        let has_file = ended.entry(id.into()).or_default();
        if let (Some(file), false) = (file, *has_file) {
            *has_file = true;
            files.push(file);
        }
    }

    /// Returns true if no model was accepted.
    pub(super) fn is_empty(&self) -> bool {
        self.0.lock().ids.is_empty()
    }

    /// Returns the accepted models that count, and those that do not.
    pub(super) fn ids(&self) -> (HashSet<Arc<str>>, HashSet<Arc<str>>) {
        let state = self.0.lock();
        let counted = state.ids.iter().filter(|id| !state.uncounted.contains(*id)).cloned().collect();
        (counted, state.uncounted.clone())
    }

    /// Returns a model, selected by a random word.
    pub(super) fn any(&self, word: u32) -> Option<Arc<str>> {
        pick(&self.0.lock().ids, word).cloned()
    }

    /// Returns a file, selected by a random word.
    pub(super) fn file(&self, word: u32) -> Option<File> {
        pick(&self.0.lock().files, word).cloned()
    }

    /// Returns the `place`-th newest of the models that are not known to have ended, counted from
    /// 0, or the oldest of these. The newest models run for the longest time.
    pub(super) fn open(&self, place: usize) -> Option<Arc<str>> {
        let state = self.0.lock();
        state.ids.iter().rev().filter(|id| !state.ended.contains_key(*id)).take(place + 1).last().cloned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_are_known_from_their_acceptance_to_their_end() {
        let known = Known::default();
        assert!(known.is_empty() && known.any(5).is_none() && known.open(0).is_none());
        for (id, counted) in [("a", false), ("b", true), ("c", true)] {
            known.accept(id, counted);
        }
        assert_eq!([0, u32::MAX / 2, u32::MAX].map(|word| known.any(word)), ["a", "b", "c"].map(|id| Some(id.into())));
        let (counted, uncounted) = known.ids();
        assert_eq!((counted.len(), uncounted.len()), (2, 1));
        assert_eq!([0, 1, 2, 9].map(|place| known.open(place)), ["c", "b", "a", "a"].map(|id| Some(id.into())));
        assert_eq!(known.file(0), None);
        let file = File { path: "/f".to_owned(), bytes: 3 };
        for told in [None, Some(file.clone()), Some(file.clone())] {
            known.end("c", told);
        }
        known.end("b", None);
        assert_eq!((known.file(u32::MAX), known.open(0)), (Some(file), Some("a".into())));
        assert_eq!(known.0.lock().files.len(), 1);
    }
}
