//! Operations: what runs in one transaction.

use super::error::SqlError;
use super::tx::Tx;
use crate::jobs::{Change, JobId, StoreOptions};
use futures_util::future::BoxFuture;
use std::future::Future;
use std::time::Duration;

/// Time for which the store retries most operations.
pub(super) const RETRY_LIMIT: Duration = Duration::from_secs(5);
/// Time for which the store retries operations that end an attempt, or may have begun one.
pub(super) const LONG_RETRY_LIMIT: Duration = Duration::from_secs(60);

/// A change of the database in one transaction.
pub(in crate::jobs) trait Operation: Send + Sync + 'static {
    /// Result for the caller.
    type Output: Send + 'static;

    /// Makes the change. The store calls this again if the transaction was rolled back.
    fn run(
        &self,
        tx: &mut Tx<'_>,
        options: &StoreOptions,
    ) -> impl Future<Output = Result<Done<Self::Output>, SqlError>> + Send;

    /// The result of an earlier run whose commit succeeded although the response was lost. `None`
    /// if no run was committed, or if running again has the same result.
    fn recover_committed(
        &self,
        _tx: &mut Tx<'_>,
    ) -> impl Future<Output = Result<Option<Done<Self::Output>>, SqlError>> + Send {
        async { Ok(None) }
    }

    /// Maximum time for which the store retries this operation after transient errors.
    fn retry_limit(&self) -> Duration {
        RETRY_LIMIT
    }
}

/// Function that makes a change from its input.
pub(super) type Run<I, T> =
    for<'a, 't> fn(&'a I, &'a mut Tx<'t>, &'a StoreOptions) -> BoxFuture<'a, Result<Done<T>, SqlError>>;

/// A change whose result is the same if it runs again after its commit.
pub(super) struct Repeatable<I, T> {
    pub(super) input: I,
    pub(super) run: Run<I, T>,
}

impl<I: Send + Sync + 'static, T: Send + 'static> Operation for Repeatable<I, T> {
    type Output = T;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<T>, SqlError> {
        (self.run)(&self.input, tx, options).await
    }
}

/// Result of an operation.
#[derive(Debug)]
pub(in crate::jobs) struct Done<T> {
    /// Result for the caller.
    pub(in crate::jobs) output: T,
    /// Changes that subscribers are notified of.
    pub(in crate::jobs) changes: Vec<Change>,
}

impl<T> Done<T> {
    pub(super) fn new(output: T, changes: Vec<Change>) -> Self {
        Self { output, changes }
    }

    /// A result without changes that subscribers need to know.
    pub(super) fn quiet(output: T) -> Self {
        Self::new(output, Vec::new())
    }
}

impl Done<Vec<JobId>> {
    /// The jobs that changed, as a result.
    pub(super) fn of_changes(changes: Vec<Change>) -> Self {
        Self::new(changes.iter().map(|change| change.id).collect(), changes)
    }
}
