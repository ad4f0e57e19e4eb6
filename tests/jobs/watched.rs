//! A store that counts the heartbeats of its workers. It can also drop all notifications of changes, or be slow.

use crate::between::{Between, Eye};
use async_trait::async_trait;
use oviduct::clock::Stopwatch;
use oviduct::jobs::{Change, Store};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::{broadcast, watch};

/// Longest wait for heartbeats.
const DEADLINE: Duration = Duration::from_secs(600);

/// A store whose heartbeats are watched.
pub type Watched = Between<Heartbeats>;

pub struct Heartbeats {
    deaf: bool,
    /// Least time that each heartbeat takes.
    call: Duration,
    /// Heartbeats that have arrived.
    beats: watch::Sender<u32>,
    /// Since the start of the last heartbeat, and the least time between the starts of two.
    pace: Mutex<(Option<Stopwatch>, Duration)>,
}

impl Heartbeats {
    pub fn over(store: &Arc<dyn Store>) -> Arc<Watched> {
        Self::with(store, false, Duration::ZERO)
    }

    /// A store that notifies nobody of changes.
    pub fn deaf(store: &Arc<dyn Store>) -> Arc<Watched> {
        Self::with(store, true, Duration::ZERO)
    }

    /// A store whose heartbeats take at least `call`.
    pub fn slow(store: &Arc<dyn Store>, call: Duration) -> Arc<Watched> {
        Self::with(store, false, call)
    }

    fn with(store: &Arc<dyn Store>, deaf: bool, call: Duration) -> Arc<Watched> {
        let pace = Mutex::new((None, Duration::MAX));
        Between::new(Arc::clone(store), Self { deaf, call, beats: watch::Sender::new(0), pace })
    }

    /// Waits for so many more heartbeats to arrive. Of two heartbeats of one job, the second began after this call.
    pub async fn beats(&self, more: u32) {
        let mut beats = self.beats.subscribe();
        let enough = *beats.borrow() + more;
        let waited = tokio::time::timeout(DEADLINE, beats.wait_for(|beats| *beats >= enough)).await;
        waited.expect("no heartbeat came").unwrap();
    }

    /// Starts to measure the pace anew.
    pub fn forget_pace(&self) {
        *self.pace.lock().unwrap() = (None, Duration::MAX);
    }

    /// The least time between the starts of two heartbeats.
    pub fn pace(&self) -> Duration {
        self.pace.lock().unwrap().1
    }
}

#[async_trait]
impl Eye for Heartbeats {
    fn changes(&self, store: &dyn Store) -> broadcast::Receiver<Change> {
        if self.deaf { broadcast::channel(1).1 } else { store.changes() }
    }

    async fn before_heartbeat(&self) {
        {
            let mut pace = self.pace.lock().unwrap();
            let before = pace.0.replace(Stopwatch::start());
            pace.1 = before.map_or(pace.1, |before| pace.1.min(before.elapsed()));
        }
        tokio::time::sleep(self.call).await;
    }

    fn after_heartbeat(&self) {
        self.beats.send_modify(|beats| *beats += 1);
    }
}
