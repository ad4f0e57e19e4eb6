//! Store that is unavailable, or hangs when it is checked, and panics in one call.

use futures_util::future::BoxFuture;
use oviduct::jobs::{Hook, Store, StoreError, StoreOptions};
use std::sync::Arc;

/// Makes every call fail except `keys`; `list` panics.
pub(super) struct Faulty {
    /// Makes the check of the store never end.
    hangs: bool,
}

impl Faulty {
    /// An unavailable store.
    pub(super) async fn store() -> Store {
        Self { hangs: false }.over_empty().await
    }

    /// An unavailable store whose check never ends.
    pub(super) async fn hanging_store() -> Store {
        Self { hangs: true }.over_empty().await
    }

    async fn over_empty(self) -> Store {
        Store::open_in_memory(StoreOptions::default()).await.unwrap().with_hook(Arc::new(self))
    }
}

impl Hook for Faulty {
    fn before<'a>(&'a self, call: &'static str) -> BoxFuture<'a, Result<(), StoreError>> {
        Box::pin(async move {
            match call {
                // There are no keys, so every request is admitted.
                "keys" => return Ok(()),
                "list" => panic!("a fault, on purpose, with a secret"),
                "ready" if self.hangs => std::future::pending::<()>().await,
                _ => {}
            }
            Err(StoreError::Database("connection refused: secret-host:5432".into()))
        })
    }
}
