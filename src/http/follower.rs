//! The task that keeps the [`Feed`] up to date.
//!
//! It follows the store's notices of changes, and reads each changed model that has readers once. A notice may get
//! lost: with the process that should have sent it, on a lost connection, in an overrun of the channel. So the task also
//! reads watched models again from time to time, and looks for models that it does not know. What this costs does not grow
//! with the number of readers.

use super::feed::{All, Feed, Pace};
use crate::jobs::{Change, JobId, Store, StoreError};
use std::ops::Bound::{Excluded, Unbounded};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::broadcast;
use tokio_util::sync::CancellationToken;

/// Models that are read again per poll although no change was reported. Divided by the number of readers of all models,
/// since each event goes to each of them, but not below [`LEAST`].
const READS: usize = 200;
/// Models that are read again per poll in any case.
const LEAST: usize = 4;
/// Polls after which unknown models are looked for.
const SEARCH: usize = 8;

/// A feed that a task keeps up to date until `shutdown` is cancelled.
pub(super) fn start(store: Store, pace: Pace, shutdown: CancellationToken) -> Arc<Feed> {
    let changes = Some(store.changes());
    let feed = Arc::new(Feed::new(store, pace));
    tokio::spawn(Follower { feed: Arc::clone(&feed), changes, polls: Polls::default() }.run(shutdown));
    feed
}

/// When models were read again, and which.
#[derive(Default)]
struct Polls {
    /// Age of the feed at the last poll.
    at: Duration,
    /// Polls since unknown models were looked for.
    count: usize,
    /// The model that was read last, of those that are read in turn.
    last: Option<JobId>,
}

/// The task that keeps a feed up to date.
struct Follower {
    feed: Arc<Feed>,
    /// `None` once the store reports no more changes.
    changes: Option<broadcast::Receiver<Change>>,
    polls: Polls,
}

impl Follower {
    async fn run(mut self, shutdown: CancellationToken) {
        loop {
            let pause = self.pause();
            let changes = &mut self.changes;
            let notice = async {
                match changes {
                    Some(changes) => changes.recv().await,
                    None => std::future::pending().await,
                }
            };
            let pause = async {
                match pause {
                    Some(pause) => tokio::time::sleep(pause).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                received = notice => match received {
                    Err(broadcast::error::RecvError::Closed) => self.changes = None,
                    Err(broadcast::error::RecvError::Lagged(_)) => self.missed(),
                    Ok(change) => self.note(change),
                },
                () = self.feed.wake.notified() => {}
                () = pause => {}
                () = shutdown.cancelled() => return,
            }
            self.feed.begin_round();
            self.poll();
            tokio::select! {
                () = self.work() => {}
                () = shutdown.cancelled() => return,
            }
            self.feed.finish_round();
        }
    }

    /// Time until something is due; `None` if nothing will be.
    fn pause(&self) -> Option<Duration> {
        let state = self.feed.lock();
        let poll = (state.follows_all() || !state.watched.is_empty()).then(|| self.polls.at + self.feed.pace.poll);
        let lingering = match state.all {
            All::Until(end) => Some(end),
            All::No | All::Readers(_) => None,
        };
        let next = [poll, lingering, state.later.values().min().copied()].into_iter().flatten().min()?;
        let now = self.feed.age.elapsed();
        Some(if state.due.is_empty() { next.saturating_sub(now) } else { Duration::ZERO })
    }

    fn note(&self, change: Change) {
        let mut state = self.feed.lock();
        if change.version.is_none() {
            state.deleted(change.id);
            let last = state.log.last();
            drop(state);
            self.feed.announce(last);
        } else if state.wants(change.id) {
            state.make_due(change.id);
        }
    }

    /// Notices were lost: any model may have changed.
    fn missed(&self) {
        let mut state = self.feed.lock();
        let all: Vec<_> = state.tracks.keys().chain(state.watched.keys()).copied().collect();
        all.into_iter().for_each(|id| state.make_due(id));
        state.search = state.follows_all();
    }

    /// Notes what changed meanwhile.
    fn catch_up(&mut self) {
        loop {
            let received = self.changes.as_mut().map(broadcast::Receiver::try_recv);
            match received {
                Some(Ok(change)) => self.note(change),
                Some(Err(broadcast::error::TryRecvError::Lagged(_))) => self.missed(),
                Some(Err(broadcast::error::TryRecvError::Closed)) => self.changes = None,
                Some(Err(broadcast::error::TryRecvError::Empty)) | None => return,
            }
        }
    }

    /// Makes due what was held back long enough, and once per poll what shall be read again.
    fn poll(&mut self) {
        let now = self.feed.age.elapsed();
        let mut guard = self.feed.lock();
        let state = &mut *guard;
        let held_back: Vec<_> = state.later.extract_if(.., |_, at| *at <= now).map(|(id, _)| id).collect();
        held_back.into_iter().for_each(|id| state.make_due(id));
        if matches!(state.all, All::Until(end) if end <= now) {
            state.all = All::No;
            state.loaded = false;
            state.search = false;
            let watched = &state.watched;
            state.log.clear(|id| watched.contains_key(&id));
            state.tracks.retain(|id, _| watched.contains_key(id));
            state.later.retain(|id, _| watched.contains_key(id));
            state.ended.retain(|id| watched.contains_key(id));
            tracing::debug!("all models are no longer followed");
        }
        if now < self.polls.at + self.feed.pace.poll {
            return;
        }
        self.polls.at = now;
        let watched: Vec<_> = state.watched.keys().copied().collect();
        watched.into_iter().for_each(|id| state.make_due(id));
        if let All::Readers(readers) = state.all {
            let after = self.polls.last.map_or(Unbounded, Excluded);
            let rest = state.tracks.range((after, Unbounded)).chain(&state.tracks).map(|(id, _)| *id);
            let turn: Vec<_> = rest.take((READS / readers).max(LEAST).min(state.tracks.len())).collect();
            self.polls.last = turn.last().copied();
            turn.into_iter().for_each(|id| state.make_due(id));
            self.polls.count += 1;
            if self.polls.count >= SEARCH {
                state.search = true;
            }
        }
    }

    /// Reads what is due. If the store fails, the rest waits for the time of a poll.
    async fn work(&mut self) {
        loop {
            self.catch_up();
            let (due, search) = {
                let mut state = self.feed.lock();
                let due = state.due.pop_front();
                if let Some(id) = due {
                    state.is_due.remove(&id);
                }
                (due, due.is_none() && std::mem::take(&mut state.search))
            };
            let result = match due {
                Some(id) => self.read(id).await,
                None if search => {
                    self.polls.count = 0;
                    self.feed.search().await
                }
                None => return,
            };
            if let Err(error) = result {
                tracing::warn!(%error, "event streams wait: the job store could not be read");
                self.put_back(due, search);
                tokio::time::sleep(self.feed.pace.poll).await;
                return;
            }
        }
    }

    fn put_back(&self, due: Option<JobId>, search: bool) {
        let mut state = self.feed.lock();
        due.into_iter().for_each(|id| state.make_due(id));
        state.search |= search;
    }

    async fn read(&self, id: JobId) -> Result<(), StoreError> {
        if !self.feed.lock().wants(id) {
            return Ok(());
        }
        match self.feed.store.get(id).await? {
            Some(job) => self.feed.offer(&job),
            None => {
                let mut state = self.feed.lock();
                // A model that never existed is not reported as deleted.
                if state.knows(id) || state.log.view(id).is_some() {
                    state.deleted(id);
                }
                let last = state.log.last();
                drop(state);
                self.feed.announce(last);
            }
        }
        Ok(())
    }
}
