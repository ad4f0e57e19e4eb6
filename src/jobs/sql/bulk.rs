//! Changes of many jobs: a filter finds their ids first, then each call changes some of them in one
//! transaction.

use super::codec::Value;
use super::error::SqlError;
use super::lease;
use super::operation::{Done, Operation};
use super::read::matching;
use super::store::Store;
use super::submit;
use super::tx::Tx;
use crate::jobs::{BulkResult, JobId, ListFilter, Status, StoreError, StoreOptions};

/// Calls for many jobs.
impl Store {
    /// The ids of the jobs of a page, newest first.
    pub async fn ids(&self, filter: &ListFilter) -> Result<Vec<JobId>, StoreError> {
        let tx = &mut self.read("ids").await?;
        let mut values: Vec<Value> = Vec::new();
        let matching = matching(tx, filter, &mut values);
        let sql = format!("SELECT j.id AS id {matching} LIMIT {}", filter.limit);
        tx.all(sql, values).await?.iter().map(|row| Ok(row.id("id")?)).collect()
    }

    /// Cancels these jobs as [`Store::cancel`] does, in one transaction. Ignores jobs that have
    /// ended, do not exist, or are not in `status` (any more).
    pub async fn cancel_many(&self, ids: Vec<JobId>, status: Option<Status>) -> Result<BulkResult, StoreError> {
        self.change("cancel_many", CancelMany(ids, status)).await
    }

    /// Deletes these jobs as [`Store::delete`] does, in one transaction; with `status`, only jobs
    /// in that status.
    pub async fn delete_many(&self, ids: Vec<JobId>, status: Option<Status>) -> Result<BulkResult, StoreError> {
        self.change("delete_many", DeleteMany(ids, status)).await
    }
}

/// The jobs in the order in which transactions lock them.
fn in_lock_order(mut ids: Vec<JobId>) -> Vec<JobId> {
    ids.sort_unstable();
    ids
}

struct CancelMany(Vec<JobId>, Option<Status>);

impl Operation for CancelMany {
    type Output = BulkResult;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<BulkResult>, SqlError> {
        let (mut result, mut changes) = (BulkResult::default(), Vec::new());
        for id in in_lock_order(self.0.clone()) {
            let Some(cancelled) = lease::cancel(tx, options, id, self.1).await? else { continue };
            result.jobs += 1;
            result.keys.extend(cancelled.checkpoint);
            changes.extend(cancelled.changes);
        }
        Ok(Done::new(result, changes))
    }
}

struct DeleteMany(Vec<JobId>, Option<Status>);

impl Operation for DeleteMany {
    type Output = BulkResult;

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<BulkResult>, SqlError> {
        let (mut result, mut changes) = (BulkResult::default(), Vec::new());
        for id in in_lock_order(self.0.clone()) {
            let Some(deleted) = submit::delete(tx, id, self.1).await? else { continue };
            result.jobs += 1;
            result.keys.extend(deleted.keys);
            changes.extend(deleted.changes);
        }
        Ok(Done::new(result, changes))
    }
}
