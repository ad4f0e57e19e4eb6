//! A store whose reads can be made to fail, and are counted. Its changes can be reported by the test alone.

use super::app::App;
use super::between::{Between, Eye};
use async_trait::async_trait;
use oviduct::clock::Clock;
use oviduct::http::Limits;
use oviduct::jobs::sqlite::SqliteStore;
use oviduct::jobs::{Change, Store, StoreError, StoreOptions};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use tokio::sync::broadcast;

/// The state of the connection to the store.
pub(super) struct Wire {
    broken: AtomicBool,
    reads: AtomicU64,
    changes: Option<broadcast::Sender<Change>>,
}

impl Wire {
    /// A service over such a store. If `changes` is given, only it reports changes.
    pub(super) async fn app(limits: Limits, changes: Option<broadcast::Sender<Change>>) -> (App, Arc<Between<Self>>) {
        let clock = Clock::manual("2026-01-02T03:04:05Z".parse().unwrap());
        let options = StoreOptions { clock: clock.clone(), queue_limit: 1000, ..StoreOptions::default() };
        let store = Arc::new(SqliteStore::open_in_memory(options).await.unwrap());
        let wire = Self { broken: AtomicBool::new(false), reads: AtomicU64::new(0), changes };
        let store = Between::new(store, wire);
        (App::over(store.clone(), clock, limits), store)
    }

    /// Makes reads of models fail, or succeed again.
    pub(super) fn set_broken(&self, broken: bool) {
        self.broken.store(broken, Ordering::Relaxed);
    }

    /// How often a model was read.
    pub(super) fn reads(&self) -> u64 {
        self.reads.load(Ordering::Relaxed)
    }
}

#[async_trait]
impl Eye for Wire {
    fn changes(&self, store: &dyn Store) -> broadcast::Receiver<Change> {
        self.changes.as_ref().map_or_else(|| store.changes(), broadcast::Sender::subscribe)
    }

    fn before_get(&self) -> Result<(), StoreError> {
        self.reads.fetch_add(1, Ordering::Relaxed);
        if self.broken.load(Ordering::Relaxed) {
            return Err(StoreError::Database("connection refused".into()));
        }
        Ok(())
    }
}
