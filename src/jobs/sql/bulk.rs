//! Many jobs in one transaction: those of a filter are found first, then cancelled or removed some at a time.

use super::codec::Value;
use super::error::SqlError;
use super::lease;
use super::operation::{Done, Operation};
use super::read::matching;
use super::submit;
use super::tx::Tx;
use crate::jobs::job::{JobId, Status};
use crate::jobs::store::{Applied, ListFilter, StoreOptions};

/// Ids of the jobs of a page, newest first.
pub(super) async fn ids(tx: &mut Tx<'_>, filter: &ListFilter) -> Result<Vec<JobId>, SqlError> {
    let mut values: Vec<Value> = Vec::new();
    let matching = matching(tx, filter, &mut values);
    let sql = format!("SELECT j.id AS id {matching} LIMIT {}", filter.limit);
    tx.all(sql, values).await?.iter().map(|row| row.id("id")).collect()
}

/// The jobs in the order in which transactions lock them.
fn ordered(mut ids: Vec<JobId>) -> Vec<JobId> {
    ids.sort_unstable();
    ids
}

/// Cancels those of the jobs that have not ended; with a status, those that are in it.
#[derive(Debug)]
pub(super) struct CancelMany(pub(super) Vec<JobId>, pub(super) Option<Status>);

impl Operation for CancelMany {
    type Output = Applied;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<Applied>, SqlError> {
        let (mut applied, mut changes) = (Applied::default(), Vec::new());
        for id in ordered(self.0.clone()) {
            let Some(cancelled) = lease::cancel(tx, options, id, self.1).await? else { continue };
            applied.jobs += 1;
            applied.keys.extend(cancelled.checkpoint);
            changes.extend(cancelled.changes);
        }
        Ok(Done::new(applied, changes))
    }
}

/// Removes the jobs; with a status, those that are in it.
#[derive(Debug)]
pub(super) struct DeleteMany(pub(super) Vec<JobId>, pub(super) Option<Status>);

impl Operation for DeleteMany {
    type Output = Applied;

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<Applied>, SqlError> {
        let (mut applied, mut changes) = (Applied::default(), Vec::new());
        for id in ordered(self.0.clone()) {
            let Some(deleted) = submit::delete(tx, id, self.1).await? else { continue };
            applied.jobs += 1;
            applied.keys.extend(deleted.keys);
            changes.extend(deleted.changes);
        }
        Ok(Done::new(applied, changes))
    }
}
