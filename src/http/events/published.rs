//! The published states of jobs, in the order of their publication.
//!
//! Each publication gets the next number, and only the latest snapshot of each job is kept. The
//! position of a reader is a number: the reader lacks the snapshots with larger numbers. A slow
//! reader therefore skips to the newest state of each job and costs no memory.
//!
//! Jobs are followed while they have readers: a job with a stream of its own, and all jobs while a
//! stream of many models is open and for [`LINGER`] afterwards, so that a client that reconnects
//! receives only what it lacks.

use super::snapshot::{Changes, Snapshot};
use super::subscription::Subscription;
use crate::jobs::{BackendReport, Job, JobId, JobProgress, Status};
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Maximum size of all snapshots: those of some five thousand models.
const MAX_BYTES: usize = 32 << 20;
/// Time for which all jobs are followed after the last stream of many models has closed.
const LINGER: Duration = Duration::from_secs(60);
/// Jobs that are read per poll although no change was reported, divided by the number of readers of
/// many models, because each event goes to each of them.
const READS: usize = 200;
/// Minimum of the same.
const MIN_READS: usize = 4;
/// Polls from one search for unknown models to the next.
const SEARCH_POLLS: usize = 8;

/// Times that govern publication.
#[derive(Clone, Copy, Debug)]
pub(in crate::http) struct FeedTiming {
    /// Minimum time between two `progress` or `section` events of one job.
    pub(in crate::http) interval: Duration,
    /// Time after which a followed job is read although no change was reported.
    pub(in crate::http) poll: Duration,
    /// Time after its end at which a job is removed.
    pub(in crate::http) keep: Option<Duration>,
}

/// The latest publication of a job.
#[derive(Debug)]
struct Entry {
    snapshot: Arc<Snapshot>,
    /// What the snapshot shows; `None` if the job was deleted.
    shown: Option<Shown>,
    /// Time until which progress is held back.
    quiet_until: Duration,
}

impl Entry {
    /// Whether the job may still change.
    fn is_open(&self) -> bool {
        self.shown.as_ref().is_some_and(|shown| !shown.status.0.is_ended())
    }

    fn is_running(&self) -> bool {
        self.shown.as_ref().is_some_and(|shown| shown.status.0 == Status::Running)
    }
}

/// The parts of a job whose changes are published: as `status` events, and as `progress` and
/// `section` events.
#[derive(Debug, PartialEq)]
struct Shown {
    status: (Status, Option<u64>, u32, BackendReport, bool),
    progress: (Option<JobProgress>, Option<(u32, u32)>),
}

impl Shown {
    fn new(job: &Job) -> Self {
        Self {
            status: (job.status, job.queue_position, job.attempts, job.backend.clone(), job.cancel_requested),
            progress: (job.progress, job.section.as_ref().map(|section| (section.index, section.step))),
        }
    }
}

/// What follows a position.
#[derive(Debug)]
pub(super) enum Next {
    Snapshot(Arc<Snapshot>),
    /// Nothing up to this number.
    Nothing(u64),
    /// The position is of another process, or snapshots after it were dropped.
    Unknown,
}

/// The published states, and the jobs to be read. All times count from one moment.
pub(super) struct Published {
    jobs: BTreeMap<JobId, Entry>,
    order: BTreeMap<u64, JobId>,
    /// Number of the last publication.
    last: u64,
    /// Positions below it are unknown.
    floor: u64,
    bytes: usize,
    max_bytes: usize,
    /// Jobs that have a stream of their own; the receivers are the readers.
    watched: HashMap<JobId, watch::Sender<u64>>,
    /// Time until which all jobs are followed; `None` if they are not.
    follow_until: Option<Duration>,
    /// Jobs to be read, and when: changed ones now, those whose progress is held back later.
    due: BTreeMap<JobId, Duration>,
    polled_at: Duration,
    polls_since_search: usize,
    /// The job that was polled last. Jobs without a stream of their own are polled in turns.
    turn: JobId,
    /// The newest model at the last search; `None` before the first one.
    newest: Option<JobId>,
}

impl Default for Published {
    fn default() -> Self {
        Self {
            jobs: BTreeMap::new(),
            order: BTreeMap::new(),
            last: 1,
            floor: 1,
            bytes: 0,
            max_bytes: MAX_BYTES,
            watched: HashMap::new(),
            follow_until: None,
            due: BTreeMap::new(),
            polled_at: Duration::ZERO,
            polls_since_search: 0,
            turn: JobId(uuid::Uuid::nil()),
            newest: None,
        }
    }
}

impl Published {
    /// Number of the last publication.
    pub(super) fn last(&self) -> u64 {
        self.last
    }

    /// The latest snapshot of a job.
    pub(super) fn latest(&self, id: JobId) -> Option<Arc<Snapshot>> {
        Some(Arc::clone(&self.jobs.get(&id)?.snapshot))
    }

    /// The first snapshot after `position` that belongs to a subscription.
    pub(super) fn after(&self, position: u64, subscription: &Subscription) -> Next {
        if !(self.floor..=self.last).contains(&position) {
            return Next::Unknown;
        }
        let mut later = self.order.range(position + 1..).filter_map(|(_, id)| Some(&self.jobs.get(id)?.snapshot));
        let next = later.find(|snapshot| subscription.includes(snapshot));
        next.map_or(Next::Nothing(self.last), |snapshot| Next::Snapshot(Arc::clone(snapshot)))
    }

    /// Whether a job of a subscription may still change.
    pub(super) fn has_open(&self, subscription: &Subscription) -> bool {
        self.jobs.values().any(|entry| entry.is_open() && subscription.includes(&entry.snapshot))
    }

    /// Follows one job until the receiver is dropped.
    pub(super) fn follow_job(&mut self, id: JobId) -> watch::Receiver<u64> {
        self.watched.entry(id).or_default().subscribe()
    }

    /// Follows all jobs while there are readers of many models.
    pub(super) fn follow_all(&mut self, now: Duration) {
        self.follow_until = Some(now + LINGER);
    }

    /// Whether a job has readers.
    pub(super) fn is_followed(&self, id: JobId) -> bool {
        self.follow_until.is_some() || self.watched.contains_key(&id)
    }

    /// Publishes what is new in this state of a job. Ignores states that are older than the
    /// published one.
    pub(super) fn offer(&mut self, job: &Job, now: Duration, timing: &FeedTiming) {
        let entry = self.jobs.get(&job.id);
        let is_outdated = entry.is_some_and(|entry| entry.shown.is_none() || entry.snapshot.version > job.version);
        if is_outdated || !self.is_followed(job.id) {
            return;
        }
        let mut shown = Shown::new(job);
        let mut quiet_until = entry.map_or(now + timing.interval, |entry| entry.quiet_until);
        let last = entry.and_then(|entry| entry.shown.as_ref());
        let mut changes = Changes { status: true, progress: false };
        if let Some(last) = last {
            changes = Changes { status: last.status != shown.status, progress: last.progress != shown.progress };
            if changes.progress && now < quiet_until {
                self.due.entry(job.id).or_insert(quiet_until);
                (changes.progress, shown.progress) = (false, last.progress);
            }
        }
        if !changes.status && !changes.progress {
            return;
        }
        if changes.progress {
            quiet_until = now + timing.interval;
        }
        let previous = entry.map(|entry| &*entry.snapshot);
        let snapshot = Snapshot::new(job, timing.keep, self.last + 1, changes, previous);
        let is_watched = self.watched.contains_key(&job.id);
        let snapshot = if is_watched { snapshot.for_its_stream(job, timing.keep) } else { snapshot };
        self.publish(snapshot, Some(shown), quiet_until);
    }

    /// Publishes that a job was deleted. Clients may know a job that was never read from elsewhere.
    pub(super) fn delete(&mut self, id: JobId) {
        let entry = self.jobs.get(&id);
        if self.is_followed(id) && entry.is_none_or(|entry| entry.shown.is_some()) {
            let snapshot = Snapshot::deleted(id, self.last + 1, entry.map(|entry| &*entry.snapshot));
            self.publish(snapshot, None, Duration::ZERO);
        }
    }

    /// Adds a snapshot. While there is no room, drops the oldest ones of jobs that neither run nor
    /// have a stream of their own.
    fn publish(&mut self, snapshot: Snapshot, shown: Option<Shown>, quiet_until: Duration) {
        let (id, number) = (snapshot.id, snapshot.number);
        self.remove(id);
        self.last = number;
        self.bytes += snapshot.bytes();
        self.order.insert(number, id);
        self.jobs.insert(id, Entry { snapshot: Arc::new(snapshot), shown, quiet_until });
        while self.bytes > self.max_bytes {
            let is_kept =
                |id: &JobId| self.watched.contains_key(id) || self.jobs.get(id).is_some_and(Entry::is_running);
            let Some((&oldest, &id)) = self.order.range(..number).find(|(_, id)| !is_kept(id)) else { break };
            self.remove(id);
            self.floor = self.floor.max(oldest);
        }
        if let Some(wake) = self.watched.get(&id) {
            wake.send_replace(number);
        }
    }

    fn remove(&mut self, id: JobId) {
        if let Some(entry) = self.jobs.remove(&id) {
            self.order.remove(&entry.snapshot.number);
            self.bytes -= entry.snapshot.bytes();
        }
    }

    /// Makes a changed job due, if it has readers.
    pub(super) fn note_change(&mut self, id: JobId) {
        if self.is_followed(id) {
            self.due.insert(id, Duration::ZERO);
        }
    }

    /// Makes all followed jobs and a search due, because reports of changes were lost.
    pub(super) fn note_loss(&mut self) {
        let open = self.jobs.iter().filter(|(_, entry)| entry.is_open()).map(|(id, _)| id);
        self.due.extend(open.chain(self.watched.keys()).map(|id| (*id, Duration::ZERO)));
        self.polls_since_search = SEARCH_POLLS;
    }

    /// Notes the models that a search found, oldest first. Makes due those that are newer than the
    /// last search. Readers begin with the models of the first search by themselves.
    pub(super) fn note_newest(&mut self, found: &[JobId]) {
        let nil = JobId(uuid::Uuid::nil());
        let newest = found.last().copied().unwrap_or(nil);
        let last = self.newest.replace(newest).unwrap_or(newest);
        self.due.extend(found.iter().filter(|id| **id > last).map(|id| (*id, Duration::ZERO)));
        self.polls_since_search = 0;
    }

    /// Makes due, once per poll, the jobs to be polled. Returns whether unknown models are to be
    /// searched for. `readers`: number of readers of many models.
    pub(super) fn poll(&mut self, now: Duration, readers: usize, timing: &FeedTiming) -> bool {
        if now >= self.polled_at + timing.poll {
            self.polled_at = now;
            self.release_unread(now, readers);
            let mut polled: Vec<_> = self.watched.keys().copied().collect();
            if readers > 0 {
                let rest = self.jobs.range(self.turn..).skip(1).chain(&self.jobs);
                let open = rest.filter(|(_, entry)| entry.is_open()).map(|(id, _)| *id);
                polled.extend(open.take((READS / readers).max(MIN_READS)));
                self.turn = polled.last().copied().unwrap_or(self.turn);
                self.polls_since_search += 1;
            }
            self.due.extend(polled.into_iter().map(|id| (id, Duration::ZERO)));
        }
        self.follow_until.is_some() && (self.newest.is_none() || self.polls_since_search >= SEARCH_POLLS)
    }

    /// Ends the following of jobs that have lost their readers.
    fn release_unread(&mut self, now: Duration, readers: usize) {
        self.watched.retain(|_, wake| wake.receiver_count() > 0);
        if readers > 0 {
            self.follow_all(now);
        }
        if self.follow_until.is_some_and(|until| now < until) {
            return;
        }
        (self.follow_until, self.newest) = (None, None);
        self.jobs.retain(|id, _| self.watched.contains_key(id));
        self.order.retain(|_, id| self.jobs.contains_key(id));
        self.bytes = self.jobs.values().map(|entry| entry.snapshot.bytes()).sum();
        // The cursors of earlier readers become unknown.
        self.last += 1;
        self.floor = self.last;
    }

    /// A job to be read now. It stays due until [`Published::note_read`].
    pub(super) fn next_due(&self, now: Duration) -> Option<JobId> {
        self.due.iter().find(|(_, at)| **at <= now).map(|(id, _)| *id)
    }

    /// Defers a job that could not be read, so that the others are read even if it never can be.
    pub(super) fn postpone(&mut self, id: JobId, until: Duration) {
        self.due.insert(id, until);
    }

    /// Publishes what was read: the job, or that there is none. A job that was never known may not
    /// have existed.
    pub(super) fn note_read(&mut self, id: JobId, job: Option<&Job>, now: Duration, timing: &FeedTiming) {
        self.due.remove(&id);
        match job {
            Some(job) => self.offer(job, now, timing),
            None if self.jobs.contains_key(&id) => self.delete(id),
            None => {}
        }
    }

    /// Time until a job or a poll is due.
    pub(super) fn pause(&self, now: Duration, timing: &FeedTiming) -> Duration {
        let poll = self.polled_at + timing.poll;
        self.due.values().min().map_or(poll, |at| poll.min(*at)).saturating_sub(now)
    }
}

#[cfg(test)]
mod tests;
