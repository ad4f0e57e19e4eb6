//! Hooks into the calls of a store, for tests.

use crate::jobs::{Change, StoreError};
use futures_util::future::BoxFuture;
use std::sync::Arc;
use tokio::sync::broadcast;

/// Intervenes in the calls of a [`Store`](crate::jobs::Store), for tests: observes them, delays them, makes them fail,
/// or replaces notifications. A call has the name of its method.
pub trait Hook: Send + Sync + 'static {
    /// Runs before a call. An error becomes the result of the call, which then does nothing.
    fn before<'a>(&'a self, _call: &'static str) -> BoxFuture<'a, Result<(), StoreError>> {
        Box::pin(async { Ok(()) })
    }

    /// Runs after a call that changes records, whether or not it succeeded. An error becomes the
    /// result of the call, as if the response was lost.
    ///
    /// # Errors
    /// The error to inject.
    fn after(&self, _call: &'static str) -> Result<(), StoreError> {
        Ok(())
    }

    /// True to lose the response to the commit of a call: the transaction takes effect, and the
    /// store has to find that out.
    fn loses_commit(&self, _call: &'static str) -> bool {
        false
    }

    /// Changes that subscribers receive instead of the changes of the store.
    fn changes(&self) -> Option<broadcast::Receiver<Change>> {
        None
    }
}

/// A call, for the hook of a test.
pub(super) struct Call {
    name: &'static str,
    hook: Option<Arc<dyn Hook>>,
}

impl Call {
    pub(super) fn new(name: &'static str, hook: Option<Arc<dyn Hook>>) -> Self {
        Self { name, hook }
    }

    /// True if a test loses the response to the commit of this call.
    pub(super) fn loses_commit(&self) -> bool {
        self.hook.as_ref().is_some_and(|hook| hook.loses_commit(self.name))
    }
}
