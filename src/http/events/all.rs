//! The stream of all models: what the feed tells of, and below it a net for what was never told.
//!
//! A notice of a change may get lost: with the process that should have sent it, on a lost connection, in an overrun of
//! the feed. So the models that the stream has told of are read again in turn, and now and then those that it does not
//! know are looked for. What this costs is bounded for the process, not for each stream.

use super::super::sse::{self, Name, Track};
use super::{Closed, Out, newest, store_failed};
use crate::jobs::{Job, JobId};
use axum::response::sse::Event;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound::{Excluded, Unbounded};
use std::time::Duration;
use tokio::sync::watch;

/// Models that all streams together read again within the time of a poll, where each reads no less than [`LEAST`].
const READS: usize = 200;
/// Models that a stream reads again within the time of a poll in any case.
const LEAST: usize = 4;
/// Polls after which a stream looks for models that it does not know; more where more streams are open.
const SEARCH: usize = 8;
/// Ended models that a stream remembers.
const ENDED: usize = 1000;

/// What a client knows that opens a stream.
pub(super) enum Begin {
    /// Nothing that is of use; whoever was here before is told of ended models too.
    Anew { with_ended: bool },
    /// All up to this number of the feed, but not these models, which changed since.
    Resumed(u64, BTreeSet<JobId>),
}

/// Follows all models; `present` are those there were when `head` was the feed's last number.
pub(super) async fn follow(
    out: Out,
    present: Vec<Job>,
    begin: Begin,
    head: u64,
    mut watch: watch::Receiver<u64>,
) -> Result<(), Closed> {
    out.send(Event::default().comment("connected")).await?;
    let mut all = All::new(out);
    let mut number = match begin {
        Begin::Anew { with_ended } => {
            for job in &present {
                if with_ended || !job.status.is_ended() {
                    // Whoever breaks off here begins anew: 0 is never a number of the feed.
                    all.tell(job, 0).await?;
                } else {
                    all.know(job);
                }
            }
            head
        }
        Begin::Resumed(number, changed) => {
            present.iter().filter(|job| !changed.contains(&job.id)).for_each(|job| all.know(job));
            number
        }
    };
    drop(present);
    loop {
        watch.mark_unchanged();
        match all.out.state.feed.since(number) {
            Some(changes) => {
                if let Some((last, _)) = changes.last() {
                    number = *last;
                }
                all.due.extend(changes.into_iter().map(|(number, id)| (id, number)));
            }
            None => {
                number = all.out.state.feed.head();
                let tracked: Vec<_> = all.tracks.keys().copied().collect();
                all.due.extend(tracked.into_iter().map(|id| (id, number)));
                all.search(number).await?;
            }
        }
        all.look_again(number).await?;
        let again = all.tell_due(number).await?;
        let change = async {
            if watch.changed().await.is_err() {
                std::future::pending::<()>().await;
            }
        };
        let poll = all.out.state.limits.event_poll;
        all.out.pause(change, again.map_or(poll, |again| again.min(poll))).await?;
    }
}

/// What a stream of all models keeps.
struct All {
    out: Out,
    /// The models that have not ended, as far as they were told.
    tracks: BTreeMap<JobId, Track>,
    /// The newest of those whose end was told.
    ended: BTreeSet<JobId>,
    /// Models of which something is still to be told, with the number of their change.
    due: BTreeMap<JobId, u64>,
    /// The model that was read again last, as one of a turn.
    read_last: Option<JobId>,
    /// When models were read again last, as an age of the stream.
    read_at: Duration,
    /// How often models were read again since others were looked for.
    turns: usize,
}

impl All {
    fn new(out: Out) -> Self {
        let (tracks, ended, due) = (BTreeMap::new(), BTreeSet::new(), BTreeMap::new());
        Self { out, tracks, ended, due, read_last: None, read_at: Duration::ZERO, turns: 0 }
    }

    /// The client has this state of the model, or does without.
    fn know(&mut self, job: &Job) {
        if job.status.is_ended() {
            self.set_ended(job.id);
        } else {
            self.tracks.insert(job.id, Track::knowing(self.out.state.limits.event_interval, job));
        }
    }

    fn set_ended(&mut self, id: JobId) {
        self.tracks.remove(&id);
        self.ended.insert(id);
        while self.ended.len() > ENDED {
            self.ended.pop_first();
        }
    }

    /// Once in the time of a poll: some of the models told of become due, in turn; now and then, unknown ones too.
    async fn look_again(&mut self, number: u64) -> Result<(), Closed> {
        let now = self.out.age.elapsed();
        if now < self.read_at + self.out.state.limits.event_poll {
            return Ok(());
        }
        self.read_at = now;
        let streams = self.out.state.open_streams().max(1);
        let after = self.read_last.map_or(Unbounded, Excluded);
        let rest = self.tracks.range((after, Unbounded)).chain(&self.tracks).map(|(id, _)| *id);
        let turn: Vec<_> = rest.take((READS / streams).max(LEAST).min(self.tracks.len())).collect();
        self.read_last = turn.last().copied();
        for id in turn {
            self.due.entry(id).or_insert(number);
        }
        self.turns += 1;
        if self.turns >= SEARCH.max(streams) {
            self.search(number).await?;
        }
        Ok(())
    }

    /// Models of which nothing was told become due.
    async fn search(&mut self, number: u64) -> Result<(), Closed> {
        self.turns = 0;
        match newest(&self.out.state).await {
            Ok(jobs) => {
                for id in jobs.iter().map(|job| job.id) {
                    if !self.tracks.contains_key(&id) && !self.ended.contains(&id) {
                        self.due.entry(id).or_insert(number);
                    }
                }
                Ok(())
            }
            Err(error) => store_failed(&self.out, &error).await,
        }
    }

    /// Tells what is due now; `number` is the last change of the feed that is in `due`. Returns after how long to
    /// come again for what was held back.
    async fn tell_due(&mut self, number: u64) -> Result<Option<Duration>, Closed> {
        let mut order: Vec<_> = self.due.iter().map(|(id, number)| (*number, *id)).collect();
        order.sort_unstable();
        let mut again: Option<Duration> = None;
        let mut held_back: Option<u64> = None;
        for (at, &(own, id)) in order.iter().enumerate() {
            // What a client that resumes here still lacks begins with the least change that is due besides.
            let least = held_back.or_else(|| order.get(at + 1).map(|(number, _)| *number));
            let cursor = least.map_or(number, |least| least - 1);
            let later = match self.out.state.store.get(id).await {
                Ok(Some(job)) => self.tell(&job, cursor).await?,
                Ok(None) => {
                    self.tracks.remove(&id);
                    self.out.send(sse::deleted(id, &self.out.state.feed.cursor(cursor))).await?;
                    None
                }
                Err(error) => {
                    store_failed(&self.out, &error).await?;
                    return Ok(Some(Duration::ZERO));
                }
            };
            match later {
                None => {
                    self.due.remove(&id);
                }
                Some(later) => {
                    again = Some(again.map_or(later, |a| a.min(later)));
                    held_back = held_back.or(Some(own));
                }
            }
        }
        Ok(again)
    }

    async fn tell(&mut self, job: &Job, cursor: u64) -> Result<Option<Duration>, Closed> {
        if job.status.is_ended() && self.ended.contains(&job.id) {
            return Ok(None);
        }
        let fresh = self.out.track();
        let (names, again) = self.tracks.entry(job.id).or_insert(fresh).next(job, self.out.age.elapsed());
        if names.contains(&Name::End) {
            self.set_ended(job.id);
        }
        for name in names {
            self.out
                .send(sse::event(name, job, &self.out.state.feed.cursor(cursor), self.out.state.limits.keep))
                .await?;
        }
        Ok(again)
    }
}
