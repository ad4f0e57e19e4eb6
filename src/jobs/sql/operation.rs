//! What runs in one transaction.

use super::error::SqlError;
use super::tx::Tx;
use crate::jobs::store::{Change, StoreOptions};
use std::future::Future;
use std::time::Duration;

/// How long most operations are tried again.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);
/// The same for those that end an attempt, or may have begun one.
pub(super) const LONG_PATIENCE: Duration = Duration::from_secs(60);

/// Something done in one transaction.
pub(in crate::jobs) trait Operation: Send + Sync + 'static {
    /// What the caller gets.
    type Output: Send + 'static;

    /// Does it. Is called again if the transaction was rolled back.
    fn run(
        &self,
        tx: &mut Tx<'_>,
        options: &StoreOptions,
    ) -> impl Future<Output = Result<Done<Self::Output>, SqlError>> + Send;

    /// The result of an earlier run whose commit succeeded although its answer was lost. `None` if no run was committed, or
    /// if running again leads to the same result.
    fn done_before(&self, _tx: &mut Tx<'_>) -> impl Future<Output = Result<Before<Self::Output>, SqlError>> + Send {
        async { Ok(None) }
    }

    /// How long it is tried again after errors that may pass.
    fn patience(&self) -> Duration {
        PATIENCE
    }
}

/// The result of an operation.
#[derive(Debug)]
pub(in crate::jobs) struct Done<T> {
    /// What the caller gets.
    pub(in crate::jobs) output: T,
    /// What subscribers are notified of.
    pub(in crate::jobs) changes: Vec<Change>,
}

/// The result of an earlier run, if that was committed.
pub(in crate::jobs) type Before<T> = Option<Done<T>>;

impl<T> Done<T> {
    pub(super) fn new(output: T, changes: Vec<Change>) -> Self {
        Self { output, changes }
    }

    /// Nothing that subscribers need to know.
    pub(super) fn quiet(output: T) -> Self {
        Self::new(output, Vec::new())
    }
}
