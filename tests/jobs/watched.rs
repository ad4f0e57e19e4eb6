//! A store as its workers see it, under a test's eye: it counts their heartbeats. It can be one that never tells of
//! changes, as a worker on another machine sees one whose notifications are lost, or one that is slow.

use crate::between::{Between, Eye};
use async_trait::async_trait;
use oviduct::clock::Stopwatch;
use oviduct::jobs::{Change, Store};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::{broadcast, watch};

/// Longest wait for heartbeats that shall come.
const DEADLINE: Duration = Duration::from_secs(600);

/// A store whose heartbeats are watched.
pub type Watched = Between<Heartbeats>;

pub struct Heartbeats {
    deaf: bool,
    /// What each heartbeat takes at least.
    call: Duration,
    /// Heartbeats that have arrived.
    beats: watch::Sender<u32>,
    /// Since the last heartbeat was begun, and the least time between two.
    pace: Mutex<(Option<Stopwatch>, Duration)>,
}

impl Heartbeats {
    pub fn over(store: &Arc<dyn Store>) -> Arc<Watched> {
        Self::with(store, false, Duration::ZERO)
    }

    /// Never tells of changes.
    pub fn deaf(store: &Arc<dyn Store>) -> Arc<Watched> {
        Self::with(store, true, Duration::ZERO)
    }

    /// Whose heartbeats take their time.
    pub fn slow(store: &Arc<dyn Store>, call: Duration) -> Arc<Watched> {
        Self::with(store, false, call)
    }

    fn with(store: &Arc<dyn Store>, deaf: bool, call: Duration) -> Arc<Watched> {
        let pace = Mutex::new((None, Duration::MAX));
        Between::new(Arc::clone(store), Self { deaf, call, beats: watch::Sender::new(0), pace })
    }

    /// Waits for so many more heartbeats to arrive. Of two of one job the later was begun after this was called.
    pub async fn beats(&self, more: u32) {
        let mut beats = self.beats.subscribe();
        let enough = *beats.borrow() + more;
        let waited = tokio::time::timeout(DEADLINE, beats.wait_for(|beats| *beats >= enough)).await;
        waited.expect("no heartbeat came").unwrap();
    }

    /// Forgets the pace of heartbeats so far.
    pub fn forget_pace(&self) {
        *self.pace.lock().unwrap() = (None, Duration::MAX);
    }

    /// The least time between the begins of two heartbeats.
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
