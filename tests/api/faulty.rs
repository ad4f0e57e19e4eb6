//! A job store that is unavailable, panics in one call, and may hang in its health check.

use futures_util::future::BoxFuture;
use oviduct::jobs::{Hook, Store, StoreError, StoreOptions};
use std::sync::Arc;

/// Makes every call except `keys` fail; `list` panics.
pub(super) struct Faulty {
    /// Makes the health check of the store hang forever.
    hangs: bool,
}

impl Faulty {
    pub(super) async fn store() -> Store {
        Self { hangs: false }.over_empty().await
    }

    /// An unavailable store whose health check hangs forever.
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
                // An empty list of API keys admits every request.
                "keys" => return Ok(()),
                "list" => panic!("a fault, on purpose, with a secret"),
                "ready" if self.hangs => std::future::pending::<()>().await,
                _ => {}
            }
            Err(StoreError::Database("connection refused: secret-host:5432".into()))
        })
    }
}
