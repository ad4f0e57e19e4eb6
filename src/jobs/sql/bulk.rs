//! Changes of many jobs: a filter finds their ids first, then each call changes some of them in one
//! transaction.

use super::codec::Value;
use super::error::SqlError;
use super::lease;
use super::operation::{Done, Uncertain, are_cancelled, are_deleted};
use super::read::matching;
use super::store::Store;
use super::submit;
use super::tx::Tx;
use crate::jobs::{BulkResult, JobId, ListFilter, Status, StoreError, StoreOptions};

/// Jobs, and the status that they must still have.
type Many = (Vec<JobId>, Option<Status>);

/// Calls for many jobs.
impl Store {
    /// The ids of the jobs of a page, newest first.
    pub async fn ids(&self, filter: &ListFilter) -> Result<Vec<JobId>, StoreError> {
        let tx = &mut self.read("ids").await?;
        let mut values: Vec<Value> = Vec::new();
        let matching = matching(tx, filter, &mut values);
        let sql = format!("SELECT j.id AS id {matching} LIMIT {}", filter.limit);
        tx.all(sql, values).await?.iter().map(|row| Ok(JobId(row.id("id")?))).collect()
    }

    /// Cancels these jobs as [`Store::cancel`] does, in one transaction. Ignores jobs that have
    /// ended, do not exist, or are not in `status` (any more).
    pub async fn cancel_many(&self, ids: Vec<JobId>, status: Option<Status>) -> Result<BulkResult, StoreError> {
        const CANCELS: Uncertain<Many, BulkResult> =
            Uncertain::Recognised(|(ids, _), done, tx| Box::pin(are_cancelled(tx, ids, &done.changes)));
        self.apply("cancel_many", (ids, status), |input, tx, options| Box::pin(cancel(input, tx, options)), CANCELS)
            .await
    }

    /// Deletes these jobs as [`Store::delete`] does, in one transaction; with `status`, only jobs
    /// in that status.
    pub async fn delete_many(&self, ids: Vec<JobId>, status: Option<Status>) -> Result<BulkResult, StoreError> {
        const DELETES: Uncertain<Many, BulkResult> =
            Uncertain::Recognised(|_, done, tx| Box::pin(are_deleted(tx, &done.changes)));
        self.apply("delete_many", (ids, status), |input, tx, _| Box::pin(delete(input, tx)), DELETES).await
    }
}

/// The jobs in the order in which transactions lock them.
fn in_lock_order(ids: &[JobId]) -> Vec<JobId> {
    let mut ids = ids.to_vec();
    ids.sort_unstable();
    ids
}

async fn cancel((ids, status): &Many, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<BulkResult>, SqlError> {
    let mut all = Done::quiet(BulkResult::default());
    for id in in_lock_order(ids) {
        add(&mut all, lease::cancel(tx, options, id, *status).await?);
    }
    Ok(all)
}

async fn delete((ids, status): &Many, tx: &mut Tx<'_>) -> Result<Done<BulkResult>, SqlError> {
    let mut all = Done::quiet(BulkResult::default());
    for id in in_lock_order(ids) {
        add(&mut all, submit::delete(tx, id, *status).await?);
    }
    Ok(all)
}

/// Adds the change of one job, with its keys for removal.
fn add(all: &mut Done<BulkResult>, one: Option<Done<Vec<String>>>) {
    let Some(Done { output, changes }) = one else { return };
    all.output.jobs += 1;
    all.output.keys.extend(output);
    all.changes.extend(changes);
}
