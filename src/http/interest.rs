//! Which models a stream of events is about.

use crate::jobs::{BatchId, Job, JobId, ListFilter, Status};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};

/// What of a model an interest is about; it never changes.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Traits {
    owner: Option<String>,
    batch: Option<BatchId>,
    labels: BTreeMap<String, String>,
}

impl Traits {
    pub(super) fn of(job: &Job) -> Self {
        Self { owner: job.owner.clone(), batch: job.batch, labels: job.labels.clone() }
    }

    /// Bytes of its texts.
    pub(super) fn bytes(&self) -> usize {
        let labels = self.labels.iter().map(|(key, value)| key.len() + value.len());
        self.owner.as_ref().map_or(0, String::len) + labels.sum::<usize>()
    }
}

/// Which models a stream is about: those that match the owner, the ids, the labels and the batch of a filter.
#[derive(Clone, Debug, Default)]
pub(super) struct Interest(ListFilter);

/// Models that a reader begins with, to be read from the store.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub(super) filter: ListFilter,
    /// Whether all pages are read, not only the first.
    pub(super) whole: bool,
    /// Whether models that have not ended are passed over, because they are in another part.
    pub(super) ended_only: bool,
}

impl Interest {
    /// The models that match `filter`, of which only the owner, ids, labels and batch count.
    pub(super) fn new(mut filter: ListFilter) -> Self {
        filter.ids.sort_unstable();
        filter.ids.dedup();
        let ListFilter { owner, ids, labels, batch, .. } = filter;
        Self(ListFilter { owner, ids, labels, batch, ..ListFilter::default() })
    }

    /// Whether it is about all models.
    pub(super) fn is_all(&self) -> bool {
        let ListFilter { owner, ids, labels, batch, .. } = &self.0;
        owner.is_none() && ids.is_empty() && labels.is_empty() && batch.is_none()
    }

    /// Whether its models all exist already, so that its stream can end.
    pub(super) fn is_finite(&self) -> bool {
        !self.0.ids.is_empty() || self.0.batch.is_some()
    }

    /// Finds its models of a status, or all.
    pub(super) fn filter(&self, status: Option<Status>, limit: u32) -> ListFilter {
        ListFilter { status, limit, ..self.0.clone() }
    }

    /// Those of its ids that are not among these.
    pub(super) fn missing(&self, found: impl Iterator<Item = JobId>) -> Vec<JobId> {
        let found: BTreeSet<_> = found.collect();
        self.0.ids.iter().filter(|id| !found.contains(id)).copied().collect()
    }

    /// Whether it is about this model. Without its traits only an interest in all models, or in ids alone, is.
    pub(super) fn includes(&self, id: JobId, traits: Option<&Traits>) -> bool {
        let ListFilter { owner, ids, labels, batch, .. } = &self.0;
        if !ids.is_empty() && ids.binary_search(&id).is_err() {
            return false;
        }
        let Some(traits) = traits else { return owner.is_none() && labels.is_empty() && batch.is_none() };
        owner.as_ref().is_none_or(|owner| traits.owner.as_ref() == Some(owner))
            && batch.is_none_or(|batch| traits.batch == Some(batch))
            && labels.iter().all(|(key, value)| traits.labels.get(key) == Some(value))
    }

    /// Tells it from others in a cursor: the cursor of another interest says nothing about its models.
    pub(super) fn name(&self) -> String {
        if self.is_all() {
            return String::new();
        }
        let digest = Sha256::digest(format!("{:?}", self.0));
        format!("-{}", hex::encode(&digest[..4]))
    }

    /// What a reader begins with: models with the ids, models of the batch, or else all that run and the newest `most` that
    /// wait, `with_ended` also those of the newest `most` that have ended.
    pub(super) fn first(&self, with_ended: bool, most: u32) -> Vec<Part> {
        let part = |status: Option<Status>, whole: bool, ended_only: bool| Part {
            filter: self.filter(status, most),
            whole,
            ended_only,
        };
        if !self.0.ids.is_empty() {
            // Whether they match the other conditions is seen then, so that one that does not is told from one that is missing.
            let filter = ListFilter { owner: self.0.owner.clone(), ids: self.0.ids.clone(), ..ListFilter::default() };
            return vec![Part { filter: ListFilter { limit: most, ..filter }, whole: true, ended_only: false }];
        }
        if self.is_finite() {
            return vec![part(None, true, false)];
        }
        let mut parts = vec![part(Some(Status::Running), true, false), part(Some(Status::Queued), false, false)];
        parts.extend(with_ended.then(|| part(None, false, true)));
        parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::samples::job;

    fn of(filter: ListFilter) -> Interest {
        Interest::new(filter)
    }

    #[test]
    fn all_conditions_must_hold() {
        let batch = BatchId(uuid::Uuid::from_u128(3));
        let labels = [("a".to_owned(), "1".to_owned()), ("b".to_owned(), "2".to_owned())];
        let job =
            Job { owner: Some("lab".into()), batch: Some(batch), labels: BTreeMap::from(labels.clone()), ..job() };
        let traits = Traits::of(&job);
        let whole = ListFilter {
            owner: Some("lab".into()),
            ids: vec![job.id],
            labels: labels.to_vec(),
            batch: Some(batch),
            ..ListFilter::default()
        };
        assert!(of(whole.clone()).includes(job.id, Some(&traits)));
        for other in [
            ListFilter { owner: Some("other".into()), ..whole.clone() },
            ListFilter { ids: vec![JobId(uuid::Uuid::nil())], ..whole.clone() },
            ListFilter { labels: vec![("a".into(), "2".into())], ..whole.clone() },
            ListFilter { batch: Some(BatchId(uuid::Uuid::nil())), ..whole.clone() },
        ] {
            assert!(!of(other.clone()).includes(job.id, Some(&traits)), "{other:?}");
            assert_ne!(of(other).name(), of(whole.clone()).name());
        }
        assert!(!of(whole).includes(job.id, None));
    }

    #[test]
    fn a_model_without_known_traits_is_of_interest_by_its_id_alone() {
        let job = job();
        assert!(of(ListFilter::default()).includes(job.id, None));
        assert!(of(ListFilter { ids: vec![job.id], ..ListFilter::default() }).includes(job.id, None));
        assert!(!of(ListFilter { owner: Some("lab".into()), ..ListFilter::default() }).includes(job.id, None));
    }
}
