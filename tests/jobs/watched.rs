//! A job store whose heartbeats are counted, or delayed, or whose changes are hidden.

use futures_util::future::BoxFuture;
use oviduct::clock::Stopwatch;
use oviduct::jobs::{Change, Hook, Store, StoreError};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::{broadcast, watch};

/// Maximum wait for heartbeats.
const DEADLINE: Duration = Duration::from_secs(600);

/// Observes the heartbeats of a store.
pub struct Heartbeats {
    /// Hides all changes from subscribers.
    deaf: bool,
    /// Minimum duration of a heartbeat.
    call: Duration,
    /// Number of completed heartbeats.
    beats: watch::Sender<u32>,
    /// Time since the start of the last heartbeat, and minimum time between the starts of two.
    pace: Mutex<(Option<Stopwatch>, Duration)>,
}

impl Heartbeats {
    /// A view of the store, with the observer of its heartbeats.
    pub fn over(store: &Store) -> (Store, Arc<Self>) {
        Self::with(store, false, Duration::ZERO)
    }

    /// A view of the store that sends no notifications of changes.
    pub fn deaf(store: &Store) -> Store {
        Self::with(store, true, Duration::ZERO).0
    }

    /// A view of the store whose heartbeats take at least `call`.
    pub fn slow(store: &Store, call: Duration) -> (Store, Arc<Self>) {
        Self::with(store, false, call)
    }

    fn with(store: &Store, deaf: bool, call: Duration) -> (Store, Arc<Self>) {
        let pace = Mutex::new((None, Duration::MAX));
        let observer = Arc::new(Self { deaf, call, beats: watch::Sender::new(0), pace });
        (store.with_hook(Arc::<Self>::clone(&observer)), observer)
    }

    /// Waits until `more` heartbeats have ended. If one job sent two of them, the second began
    /// after this call.
    pub async fn beats(&self, more: u32) {
        let mut beats = self.beats.subscribe();
        let enough = *beats.borrow() + more;
        let waited = tokio::time::timeout(DEADLINE, beats.wait_for(|beats| *beats >= enough)).await;
        waited.expect("no heartbeat came").unwrap();
    }

    /// Restarts the measurement of the minimum interval.
    pub fn forget_pace(&self) {
        *self.pace.lock().unwrap() = (None, Duration::MAX);
    }

    /// Minimum time between the starts of two heartbeats.
    pub fn pace(&self) -> Duration {
        self.pace.lock().unwrap().1
    }
}

impl Hook for Heartbeats {
    fn before<'a>(&'a self, call: &'static str) -> BoxFuture<'a, Result<(), StoreError>> {
        Box::pin(async move {
            if call == "heartbeat" {
                {
                    let mut pace = self.pace.lock().unwrap();
                    let before = pace.0.replace(Stopwatch::start());
                    pace.1 = before.map_or(pace.1, |before| pace.1.min(before.elapsed()));
                }
                tokio::time::sleep(self.call).await;
            }
            Ok(())
        })
    }

    fn after(&self, call: &'static str) -> Result<(), StoreError> {
        if call == "heartbeat" {
            self.beats.send_modify(|beats| *beats += 1);
        }
        Ok(())
    }

    fn changes(&self) -> Option<broadcast::Receiver<Change>> {
        self.deaf.then(|| broadcast::channel(1).1)
    }
}
