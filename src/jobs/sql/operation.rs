//! Operations: what runs in one transaction.

use super::codec::{enum_from_sql, values};
use super::error::SqlError;
use super::tx::{Row, Tx};
use crate::jobs::{Change, JobId, Status, StoreOptions};
use futures_util::future::BoxFuture;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

/// Time for which the store retries most operations.
pub(super) const RETRY_LIMIT: Duration = Duration::from_secs(5);
/// Time for which the store retries operations that end an attempt, or may have begun one.
pub(super) const LONG_RETRY_LIMIT: Duration = Duration::from_secs(60);

/// The databases on which an operation shares a transaction with others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Grouped {
    Never,
    OnSqlite,
    /// On both, on PostgreSQL with other submissions.
    Submissions,
    /// On both, on PostgreSQL with other claims.
    Claims,
    /// On both, on PostgreSQL with other ends of attempts.
    Ends,
}

/// Results of operations that run together; an error is a refusal.
pub(super) type Results<T> = Vec<Result<Done<T>, SqlError>>;

/// Separates a refusal of one operation from an error that fails its whole group.
pub(super) fn or_refusal<T>(result: Result<Done<T>, SqlError>) -> Result<Result<Done<T>, SqlError>, SqlError> {
    match result {
        Ok(_) | Err(SqlError::Store(_)) => Ok(result),
        Err(error) => Err(error),
    }
}

/// A change of the database in one transaction.
pub(in crate::jobs) trait Operation: Send + Sync + 'static {
    /// Result for the caller.
    type Output: Send + Sync + 'static;

    /// The databases on which the operation shares a transaction with others. An operation that is
    /// grouped writes nothing before it fails with [`SqlError::Store`].
    const GROUPED: Grouped;

    /// Makes the change. The store calls this again if the transaction was rolled back.
    fn run(
        &self,
        tx: &mut Tx<'_>,
        options: &StoreOptions,
    ) -> impl Future<Output = Result<Done<Self::Output>, SqlError>> + Send;

    /// Makes the changes of operations in one group, in their order. An operation that fails with
    /// [`SqlError::Store`] is refused; another error fails all.
    fn run_together(
        operations: &[Arc<Self>],
        tx: &mut Tx<'_>,
        options: &StoreOptions,
    ) -> impl Future<Output = Result<Results<Self::Output>, SqlError>> + Send {
        async move {
            let mut results = Vec::with_capacity(operations.len());
            for operation in operations {
                results.push(or_refusal(operation.run(tx, options).await)?);
            }
            Ok(results)
        }
    }

    /// True if an earlier run with the result `done` was committed although the response to its
    /// commit was lost; `done` is then the result of the operation. False to run again, because the
    /// run was rolled back or because a second run has the same result. Waits for a commit that is
    /// still under way.
    fn was_committed(
        &self,
        tx: &mut Tx<'_>,
        done: &Done<Self::Output>,
    ) -> impl Future<Output = Result<bool, SqlError>> + Send;

    /// Maximum time for which the store retries this operation after transient errors.
    /// `is_uncertain` is true if an earlier run may have been committed.
    fn retry_limit(&self, _is_uncertain: bool) -> Duration {
        RETRY_LIMIT
    }
}

/// Function that makes a change from its input.
pub(super) type Run<I, T> =
    for<'a, 't> fn(&'a I, &'a mut Tx<'t>, &'a StoreOptions) -> BoxFuture<'a, Result<Done<T>, SqlError>>;

/// Function for [`Operation::was_committed`].
pub(super) type WasCommitted<I, T> =
    for<'a, 't> fn(&'a I, &'a Done<T>, &'a mut Tx<'t>) -> BoxFuture<'a, Result<bool, SqlError>>;

/// What follows if the response to a commit was lost.
pub(super) enum Uncertain<I, T> {
    /// The change runs again. Its caller cannot tell the result from that of the first run, or the
    /// call states why that does not matter.
    RunsAgain,
    /// The records show whether the change was committed.
    Recognised(WasCommitted<I, T>),
}

/// A change that consists of functions.
pub(super) struct Simple<I, T> {
    pub(super) input: I,
    pub(super) run: Run<I, T>,
    pub(super) uncertain: Uncertain<I, T>,
}

impl<I: Send + Sync + 'static, T: Send + Sync + 'static> Operation for Simple<I, T> {
    type Output = T;

    const GROUPED: Grouped = Grouped::OnSqlite;

    async fn run(&self, tx: &mut Tx<'_>, options: &StoreOptions) -> Result<Done<T>, SqlError> {
        (self.run)(&self.input, tx, options).await
    }

    async fn was_committed(&self, tx: &mut Tx<'_>, done: &Done<T>) -> Result<bool, SqlError> {
        match self.uncertain {
            Uncertain::RunsAgain => Ok(false),
            Uncertain::Recognised(was_committed) => was_committed(&self.input, done, tx).await,
        }
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

/// True if those of `jobs` that a run with these changes cancelled are cancelled.
pub(super) async fn are_cancelled(tx: &mut Tx<'_>, jobs: &[JobId], changes: &[Change]) -> Result<bool, SqlError> {
    let cancelled = changes.iter().filter(|change| jobs.contains(&change.id));
    let ids: Vec<String> = cancelled.map(|change| change.id.to_string()).collect();
    if ids.is_empty() {
        return Ok(false);
    }
    for row in locked(tx, ids).await? {
        // A job that has ended otherwise was never told to stop.
        let is_cancelled = enum_from_sql::<Status>(row.get("status")?)? == Status::Cancelled;
        if !is_cancelled && !row.get::<bool>("cancel_requested")? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Those of the jobs that exist, after all transactions that have locked them.
async fn locked(tx: &mut Tx<'_>, ids: Vec<String>) -> Result<Vec<Row>, SqlError> {
    let sql = tx.either(
        "SELECT status, cancel_requested FROM jobs WHERE id IN (SELECT value FROM json_each($1))",
        "SELECT status, cancel_requested FROM jobs WHERE id = ANY ($1) ORDER BY id FOR UPDATE",
    );
    tx.all(sql, values![ids]).await
}
