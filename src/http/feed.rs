//! The changes of all models in one order, so that a stream of all of them can be resumed.
//!
//! Each change gets the next number of a sequence; the log keeps the last one of each model, for the newest
//! [`KEPT`] models. A cursor is the log's name and a number of it. The log lives as long as the process: a cursor of
//! another process, or one older than the log reaches, is answered with the state of everything.

use crate::jobs::{Change, JobId};
use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::{broadcast, watch};
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

/// Models whose last change is kept.
const KEPT: usize = 10_000;

/// The changes of all models.
pub(super) struct Feed {
    name: String,
    log: Mutex<Log>,
    head: watch::Sender<u64>,
}

struct Log {
    /// Number of the last change.
    head: u64,
    /// Changes after this number are all known.
    floor: u64,
    by_number: BTreeMap<u64, JobId>,
    by_model: HashMap<JobId, u64>,
}

impl Log {
    fn new() -> Self {
        Self { head: 1, floor: 1, by_number: BTreeMap::new(), by_model: HashMap::new() }
    }

    fn record(&mut self, id: JobId, kept: usize) {
        self.head += 1;
        if let Some(old) = self.by_model.insert(id, self.head) {
            self.by_number.remove(&old);
        }
        self.by_number.insert(self.head, id);
        while self.by_number.len() > kept {
            if let Some((number, id)) = self.by_number.pop_first() {
                self.by_model.remove(&id);
                self.floor = number;
            }
        }
    }

    /// Changes were lost: nothing before now is known for sure.
    fn forget(&mut self) {
        self.head += 1;
        self.floor = self.head;
        self.by_number.clear();
        self.by_model.clear();
    }

    fn since(&self, number: u64) -> Option<Vec<(u64, JobId)>> {
        (self.floor..=self.head)
            .contains(&number)
            .then(|| self.by_number.range(number + 1..).map(|(n, id)| (*n, *id)).collect())
    }
}

impl Feed {
    /// Follows `changes` in a task until they end or `shutdown` is cancelled.
    pub(super) fn follow(mut changes: broadcast::Receiver<Change>, shutdown: CancellationToken) -> Arc<Self> {
        let name = Uuid::new_v4().simple().to_string()[..12].to_owned();
        let feed = Arc::new(Self { name, log: Mutex::new(Log::new()), head: watch::Sender::new(1) });
        let follower = Arc::clone(&feed);
        tokio::spawn(async move {
            loop {
                let received = tokio::select! {
                    received = changes.recv() => received,
                    () = shutdown.cancelled() => return,
                };
                match received {
                    Ok(change) => follower.lock().record(change.id, KEPT),
                    Err(broadcast::error::RecvError::Lagged(_)) => follower.lock().forget(),
                    Err(broadcast::error::RecvError::Closed) => return,
                }
                let head = follower.lock().head;
                follower.head.send_replace(head);
            }
        });
        feed
    }

    fn lock(&self) -> MutexGuard<'_, Log> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of the last change.
    pub(super) fn head(&self) -> u64 {
        self.lock().head
    }

    /// Tells of each new change.
    pub(super) fn watch(&self) -> watch::Receiver<u64> {
        self.head.subscribe()
    }

    /// The last change of each model that changed after `number`, in order; `None` where the log does not reach back.
    pub(super) fn since(&self, number: u64) -> Option<Vec<(u64, JobId)>> {
        self.lock().since(number)
    }

    /// Whether the model may have changed after `number`.
    pub(super) fn changed_since(&self, id: JobId, number: u64) -> bool {
        let log = self.lock();
        log.floor > number || log.by_model.get(&id).is_some_and(|&last| last > number)
    }

    /// Resolves when the model changes after `number`; never where no more changes are told.
    pub(super) async fn changed(&self, id: JobId, watch: &mut watch::Receiver<u64>, number: u64) {
        loop {
            watch.mark_unchanged();
            if self.changed_since(id, number) {
                return;
            }
            if watch.changed().await.is_err() {
                return std::future::pending().await;
            }
        }
    }

    /// The cursor of `number`.
    pub(super) fn cursor(&self, number: u64) -> String {
        format!("{}-{number}", self.name)
    }

    /// The number of a cursor of this log.
    pub(super) fn number(&self, cursor: &str) -> Option<u64> {
        cursor.strip_prefix(&self.name)?.strip_prefix('-')?.parse().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn id(n: u8) -> JobId {
        JobId(Uuid::from_u128(u128::from(n)))
    }

    #[test]
    fn a_number_beyond_the_log_is_not_known() {
        let mut log = Log::new();
        assert_eq!(log.since(1), Some(vec![]));
        assert_eq!(log.since(0), None);
        assert_eq!(log.since(2), None);
        log.record(id(1), 9);
        log.forget();
        assert_eq!(log.since(2), None);
        assert_eq!(log.since(log.head), Some(vec![]));
    }

    proptest! {
        #[test]
        fn the_log_tells_each_changed_model_once_or_nothing(
            changes in prop::collection::vec(0u8..6, 0..40), from in 0usize..40, kept in 1usize..6,
        ) {
            let mut log = Log::new();
            let mut heads = vec![log.head];
            for &c in &changes {
                log.record(id(c), kept);
                heads.push(log.head);
            }
            let from = from.min(changes.len());
            let mut want: Vec<JobId> = changes[from..].iter().map(|&c| id(c)).collect();
            want.sort();
            want.dedup();
            if let Some(got) = log.since(heads[from]) {
                prop_assert!(got.is_sorted_by_key(|(n, _)| *n));
                let mut got: Vec<JobId> = got.into_iter().map(|(_, id)| id).collect();
                got.sort();
                prop_assert_eq!(got, want);
            } else {
                prop_assert!(want.len() > kept);
            }
            prop_assert!(log.by_model.len() <= kept && log.by_model.len() == log.by_number.len());
        }
    }

    #[tokio::test]
    async fn cursors_belong_to_one_log() {
        let (sender, receiver) = broadcast::channel(4);
        let feed = Feed::follow(receiver, CancellationToken::new());
        let other = Feed::follow(sender.subscribe(), CancellationToken::new());
        assert_eq!(feed.number(&feed.cursor(7)), Some(7));
        for bad in [other.cursor(7), String::new(), "7".into(), feed.cursor(7) + "x"] {
            assert_eq!(feed.number(&bad), None, "{bad}");
        }
    }

    #[tokio::test]
    async fn lost_changes_are_admitted() {
        let (sender, receiver) = broadcast::channel(2);
        for n in 0..5 {
            sender.send(Change { id: id(n), version: Some(1) }).unwrap();
        }
        let feed = Feed::follow(receiver, CancellationToken::new());
        let mut watch = feed.watch();
        while feed.since(feed.head()).is_none() || feed.head() < 4 {
            watch.changed().await.unwrap();
        }
        assert_eq!(feed.since(1), None);
        assert!(feed.changed_since(id(0), 1));
    }
}
