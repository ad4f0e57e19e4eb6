//! The models that a stream of `/events` selects.

use super::snapshot::{FilterFields, Snapshot};
use crate::jobs::{JobId, JobKind, ListFilter, Status, Store, StoreError};
use sha2::{Digest, Sha256};
use std::collections::HashSet;

/// Number of queued models, and of ended ones, among the initial events of a stream without `ids`
/// and `batch`.
const INITIAL_MAX: u32 = 100;
/// Ids per query.
const PAGE: u32 = 1000;

/// The models that match the owner, the ids, the labels and the batch of a filter.
#[derive(Clone, Debug, Default)]
pub(super) struct Subscription(ListFilter);

impl Subscription {
    pub(super) fn new(filter: ListFilter) -> Self {
        let ListFilter { owner, mut ids, labels, batch, .. } = filter;
        ids.sort_unstable();
        ids.dedup();
        Self(ListFilter { owner, ids, labels, batch, ..ListFilter::default() })
    }

    /// Whether its stream ends with its models.
    pub(super) fn is_finite(&self) -> bool {
        !self.0.ids.is_empty() || self.0.batch.is_some()
    }

    /// Whether a job makes a model that the owner may see.
    pub(super) fn may_see(&self, fields: &FilterFields) -> bool {
        fields.kind == JobKind::Model && (self.0.owner.is_none() || self.0.owner == fields.owner)
    }

    /// Whether a job is one of its models. A job that was deleted before it was read has unknown
    /// fields, so it belongs only to a subscription that selects by ids at most.
    pub(super) fn includes(&self, snapshot: &Snapshot) -> bool {
        let ListFilter { owner, ids, labels, batch, .. } = &self.0;
        if !ids.is_empty() && ids.binary_search(&snapshot.id).is_err() {
            return false;
        }
        let Some(fields) = &snapshot.fields else { return owner.is_none() && labels.is_empty() && batch.is_none() };
        self.may_see(fields)
            && (batch.is_none() || *batch == fields.batch)
            && labels.iter().all(|(key, value)| fields.labels.get(key) == Some(value))
    }

    /// Distinguishes its cursors from those of other subscriptions.
    pub(super) fn digest(&self) -> String {
        hex::encode(&Sha256::digest(format!("{:?}", self.0))[..4])
    }

    /// The models of its initial events: first the running and the queued ones, then the others,
    /// and the ids without a model. If it is not finite, the others are the newest ended ones, and
    /// only `with_ended`.
    pub(super) async fn initial_ids(&self, store: &Store, with_ended: bool) -> Result<Vec<JobId>, StoreError> {
        let max = (!self.is_finite()).then_some(INITIAL_MAX);
        let mut ids = self.ids(store, Some(Status::Running), None).await?;
        ids.extend(self.ids(store, Some(Status::Queued), max).await?);
        if self.is_finite() || with_ended {
            ids.extend(self.ids(store, None, max).await?);
        }
        ids.extend(&self.0.ids);
        let mut seen = HashSet::new();
        ids.retain(|id| seen.insert(*id));
        Ok(ids)
    }

    /// The newest models, oldest first.
    pub(super) async fn newest_ids(&self, store: &Store) -> Result<Vec<JobId>, StoreError> {
        self.ids(store, None, Some(INITIAL_MAX)).await
    }

    /// Its newest models of one status or of any, oldest first; without `max` all of them.
    async fn ids(&self, store: &Store, status: Option<Status>, max: Option<u32>) -> Result<Vec<JobId>, StoreError> {
        let limit = max.unwrap_or(PAGE);
        let mut filter = ListFilter { status, limit, ..self.0.clone() };
        let mut ids = Vec::new();
        loop {
            let page = store.ids(&filter).await?;
            filter.before = page.last().copied();
            ids.extend(&page);
            if max.is_some() || page.len() < limit as usize {
                break;
            }
        }
        ids.reverse();
        Ok(ids)
    }

    /// The id of the last event of its stream, if all its models have ended. Every process forms
    /// the same id, so a client that reconnects to another process learns there that nothing
    /// follows. The number of models changes if one is deleted, and the newest model if one is
    /// added, as the retry of a model adds one to its batch.
    pub(super) async fn end_id(&self, store: &Store) -> Result<Option<String>, StoreError> {
        for status in [Status::Queued, Status::Running] {
            if !self.ids(store, Some(status), Some(1)).await?.is_empty() {
                return Ok(None);
            }
        }
        let ids = self.ids(store, None, None).await?;
        let newest = ids.last().map_or_else(|| "none".to_owned(), ToString::to_string);
        Ok(Some(format!("over-{}-{}-{newest}", self.digest(), ids.len())))
    }
}

#[cfg(test)]
mod tests {
    use super::super::samples::job;
    use super::super::snapshot::Changes;
    use super::*;
    use crate::http::workforce::JobContext;
    use crate::jobs::{BatchId, Job};
    use std::collections::BTreeMap;
    use uuid::Uuid;

    fn snapshot(job: &Job) -> Snapshot {
        Snapshot::new(job, &JobContext::default(), 1, Changes::default(), None)
    }

    #[test]
    fn all_conditions_must_hold() {
        let batch = BatchId(Uuid::from_u128(3));
        let labels = [("a".to_owned(), "1".to_owned()), ("b".to_owned(), "2".to_owned())];
        let job =
            Job { owner: Some("lab".into()), batch: Some(batch), labels: BTreeMap::from(labels.clone()), ..job() };
        let whole = ListFilter {
            owner: Some("lab".into()),
            ids: vec![job.id],
            labels: labels.to_vec(),
            batch: Some(batch),
            ..ListFilter::default()
        };
        let subscription = Subscription::new(whole.clone());
        assert!(subscription.includes(&snapshot(&job)));
        for other in [
            ListFilter { owner: Some("other".into()), ..whole.clone() },
            ListFilter { ids: vec![JobId(Uuid::nil())], ..whole.clone() },
            ListFilter { labels: vec![("a".into(), "2".into())], ..whole.clone() },
            ListFilter { batch: Some(BatchId(Uuid::nil())), ..whole.clone() },
        ] {
            let other = Subscription::new(other);
            assert!(!other.includes(&snapshot(&job)), "{other:?}");
            assert_ne!(other.digest(), subscription.digest());
        }
        assert!(!subscription.includes(&Snapshot::deleted(job.id, 1, None)));
        assert!(subscription.includes(&Snapshot::deleted(job.id, 1, Some(&snapshot(&job)))));
    }

    #[test]
    fn fits_belong_to_no_subscription() {
        let fit = Job { kind: JobKind::Fit, ..job() };
        assert!(!Subscription::default().includes(&snapshot(&fit)));
    }

    #[test]
    fn a_model_with_unknown_fields_is_selected_by_its_id_alone() {
        let deleted = Snapshot::deleted(job().id, 1, None);
        let includes = |filter| Subscription::new(filter).includes(&deleted);
        assert!(includes(ListFilter::default()));
        assert!(includes(ListFilter { ids: vec![job().id], ..ListFilter::default() }));
        assert!(!includes(ListFilter { owner: Some("lab".into()), ..ListFilter::default() }));
    }

    #[test]
    fn the_order_of_ids_does_not_change_the_cursor() {
        let [a, b] = [1, 2].map(|n| JobId(Uuid::from_u128(n)));
        let of = |ids: [JobId; 2]| Subscription::new(ListFilter { ids: ids.to_vec(), ..ListFilter::default() });
        assert_eq!(of([a, b]).digest(), of([b, a]).digest());
    }
}
