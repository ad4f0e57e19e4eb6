//! A job store that counts its reads of models, can make them fail, and reports only the changes
//! that the test sends.

use super::app::App;
use futures_util::future::BoxFuture;
use oviduct::clock::Clock;
use oviduct::http::Limits;
use oviduct::jobs::{Change, Hook, Store, StoreError, StoreOptions};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use tokio::sync::broadcast;

/// State of the simulated connection to the store.
pub(super) struct Wire {
    broken: AtomicBool,
    reads: AtomicU64,
    changes: Option<broadcast::Sender<Change>>,
}

impl Wire {
    /// A service over such a store. If `changes` is given, the service learns of no other changes.
    pub(super) async fn app(limits: Limits, changes: Option<broadcast::Sender<Change>>) -> (App, Arc<Self>) {
        let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
        let options = StoreOptions { clock: clock.clone(), queue_limit: 1000, ..StoreOptions::default() };
        let wire = Arc::new(Self { broken: AtomicBool::new(false), reads: AtomicU64::new(0), changes });
        let store = Store::open_in_memory(options).await.unwrap().with_hook(Arc::<Self>::clone(&wire));
        (App::over(store, clock, limits), wire)
    }

    /// Makes reads of models fail, or succeed again.
    pub(super) fn set_broken(&self, broken: bool) {
        self.broken.store(broken, Ordering::Relaxed);
    }

    /// Number of reads of models.
    pub(super) fn reads(&self) -> u64 {
        self.reads.load(Ordering::Relaxed)
    }
}

impl Hook for Wire {
    fn before<'a>(&'a self, call: &'static str) -> BoxFuture<'a, Result<(), StoreError>> {
        Box::pin(async move {
            if call == "get" {
                self.reads.fetch_add(1, Ordering::Relaxed);
                if self.broken.load(Ordering::Relaxed) {
                    return Err(StoreError::Database("connection refused".into()));
                }
            }
            Ok(())
        })
    }

    fn changes(&self) -> Option<broadcast::Receiver<Change>> {
        self.changes.as_ref().map(broadcast::Sender::subscribe)
    }
}
