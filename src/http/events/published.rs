//! The published states of jobs, in the order of their publication.
//!
//! Each publication gets the next number, and only the latest snapshot of each job is kept. The
//! position of a reader is a number: the reader lacks the snapshots with larger numbers. A reader
//! that reads slowly therefore skips states, but never the last one of a job, and costs no memory.
//!
//! Jobs are followed while they have readers: a job with a stream of its own, and all jobs while a
//! stream of many models is open and for [`LINGER`] afterwards, so that a client that reconnects
//! receives only what it lacks. A followed job that has not ended stays known when its snapshot is
//! dropped to save memory, so that polling still finds its end.

use super::snapshot::{Changes, Snapshot};
use super::subscription::Subscription;
use crate::http::workforce::JobContext;
use crate::jobs::{BackendReport, Job, JobId, JobProgress, QueueReason, Status, Workforce};
use std::collections::{BTreeMap, HashMap};
use std::ops::Bound::{Excluded, Unbounded};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Maximum size of all snapshots, enough for about 5,000 models.
const MAX_BYTES: usize = 32 << 20;
/// Time for which all jobs are followed after the last stream of many models has closed.
const LINGER: Duration = Duration::from_secs(60);
/// Number of jobs without a stream of their own that are read per poll, divided by the number of
/// readers of many models, because each event goes to each of these readers.
const READS_PER_POLL: usize = 200;
/// Minimum number of jobs without a stream of their own that are read per poll.
const MIN_READS_PER_POLL: usize = 4;
/// Number of polls from one search for unknown models to the next.
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
struct PublishedJob {
    /// Without data if it was dropped to save memory; it is not in [`Published::order`] then.
    snapshot: Arc<Snapshot>,
    /// What the snapshot shows; `None` if the job was deleted.
    shown: Option<PublishedFields>,
    /// Time until which progress is held back.
    quiet_until: Duration,
}

impl PublishedJob {
    /// Whether the job may still change.
    fn is_open(&self) -> bool {
        self.shown.as_ref().is_some_and(|shown| !shown.status.0.is_ended())
    }

    fn is_running(&self) -> bool {
        self.shown.as_ref().is_some_and(|shown| shown.status.0 == Status::Running)
    }
}

/// The parts of a job whose changes are published: `status` as `status` events, `progress` as
/// `progress` and `section` events.
#[derive(Debug, PartialEq)]
struct PublishedFields {
    status: (Status, Option<u64>, Option<QueueReason>, u32, BackendReport, bool),
    progress: (Option<JobProgress>, Option<(u32, u32)>),
}

impl PublishedFields {
    fn new(job: &Job, context: &JobContext) -> Self {
        let (reason, backend) = (context.queue_reason(job), job.backend.clone());
        Self {
            status: (job.status, job.queue_position, reason, job.attempts, backend, job.cancel_requested),
            progress: (job.progress, job.section.as_ref().map(|section| (section.index, section.step))),
        }
    }
}

/// The first snapshot after a position.
#[derive(Debug)]
pub(super) enum NextSnapshot {
    Found(Arc<Snapshot>),
    /// There is none up to this number.
    None(u64),
    /// The position is from another process, or snapshots after the position were dropped.
    Unknown,
}

/// The published states, and the jobs to be read. All times are relative to the start of the feed.
pub(super) struct Published {
    jobs: BTreeMap<JobId, PublishedJob>,
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
    /// Jobs to be read, and the time to read them: 0 for changed jobs, later for progress that is
    /// held back.
    due: BTreeMap<JobId, Duration>,
    polled_at: Duration,
    polls_since_search: usize,
    /// The last job of the last poll. Jobs without a stream of their own are polled in turns.
    turn: JobId,
    /// Result of the last search for unknown models, oldest first; `None` before the first search.
    newest: Option<Vec<JobId>>,
    /// Live workers, as read before the jobs that are offered; `None` if unknown.
    pub(super) workforce: Option<Workforce>,
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
            workforce: None,
        }
    }
}

impl Published {
    /// Number of the last publication.
    pub(super) fn last(&self) -> u64 {
        self.last
    }

    /// The latest snapshot of a job; `None` if nothing was published or the snapshot was dropped.
    pub(super) fn latest(&self, id: JobId) -> Option<Arc<Snapshot>> {
        let snapshot = &self.jobs.get(&id)?.snapshot;
        snapshot.has_data().then(|| Arc::clone(snapshot))
    }

    /// The first snapshot after `position` that belongs to a subscription.
    pub(super) fn after(&self, position: u64, subscription: &Subscription) -> NextSnapshot {
        if !(self.floor..=self.last).contains(&position) {
            return NextSnapshot::Unknown;
        }
        let mut later = self.order.range(position + 1..).filter_map(|(_, id)| Some(&self.jobs.get(id)?.snapshot));
        let next = later.find(|snapshot| subscription.includes(snapshot));
        next.map_or(NextSnapshot::None(self.last), |snapshot| NextSnapshot::Found(Arc::clone(snapshot)))
    }

    /// Whether anything was published of a job, even if the snapshot was dropped.
    pub(super) fn knows(&self, id: JobId) -> bool {
        self.jobs.contains_key(&id)
    }

    /// Whether a job of a subscription may still change.
    pub(super) fn has_open(&self, subscription: &Subscription) -> bool {
        self.jobs.values().any(|entry| entry.is_open() && subscription.includes(&entry.snapshot))
    }

    /// Follows one job until the receiver is dropped. The next offer is published even if progress
    /// is held back, because a stream begins with the current state.
    pub(super) fn follow_job(&mut self, id: JobId) -> watch::Receiver<u64> {
        if let Some(entry) = self.jobs.get_mut(&id) {
            entry.quiet_until = Duration::ZERO;
        }
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

    /// Publishes a state of a followed job, if it differs from the published one and is not older.
    pub(super) fn offer(&mut self, job: &Job, now: Duration, timing: &FeedTiming) {
        self.offer_to(job, now, timing, false);
    }

    /// Publishes the state that a new reader of a followed job read, unless an equal or newer one
    /// is published. The reader begins with it, so that it shows nothing older than earlier
    /// responses. Other readers receive no event that is not due.
    pub(super) fn offer_to_new_reader(&mut self, job: &Job, now: Duration, timing: &FeedTiming) {
        self.offer_to(job, now, timing, true);
    }

    fn offer_to(&mut self, job: &Job, now: Duration, timing: &FeedTiming, is_for_new_reader: bool) {
        let entry = self.jobs.get(&job.id);
        let is_outdated = entry.is_some_and(|entry| entry.shown.is_none() || entry.snapshot.version > job.version);
        if is_outdated || !self.is_followed(job.id) {
            return;
        }
        let context = JobContext { keep: timing.keep, workforce: self.workforce };
        let mut shown = PublishedFields::new(job, &context);
        let mut quiet_until = entry.map_or(Duration::ZERO, |entry| entry.quiet_until);
        // If the snapshot of a watched job was dropped, the stream of the job needs another.
        let is_watched = self.watched.contains_key(&job.id);
        let entry_with_data = entry.filter(|entry| entry.snapshot.has_data());
        let last = if is_watched { entry_with_data } else { entry }.and_then(|entry| entry.shown.as_ref());
        let mut changes = Changes {
            status: last.is_none_or(|last| last.status != shown.status),
            progress: job.progress.is_some() && last.is_none_or(|last| last.progress != shown.progress),
        };
        // The end shows all progress: a later snapshot would be a second end.
        let is_held_back = changes.progress && now < quiet_until && !job.status.is_ended();
        if let Some(last) = last.filter(|_| is_held_back) {
            self.due.entry(job.id).or_insert(quiet_until);
            (changes.progress, shown.progress) = (false, last.progress);
        }
        let is_newer = entry.is_none_or(|entry| entry.snapshot.version < job.version);
        let is_awaited = is_for_new_reader && is_newer;
        if !changes.status && !changes.progress && !is_awaited {
            return;
        }
        if changes.progress {
            quiet_until = now + timing.interval;
        }
        let previous = entry_with_data.map(|entry| &*entry.snapshot);
        let snapshot = Snapshot::new(job, &context, self.last + 1, changes, previous);
        let snapshot = if is_watched { snapshot.for_its_stream(job, &context) } else { snapshot };
        self.publish(snapshot, Some(shown), quiet_until);
    }

    /// Publishes that a followed job was deleted, even if the job was never read: clients may have
    /// its id from another response.
    pub(super) fn delete(&mut self, id: JobId) {
        let entry = self.jobs.get(&id);
        if self.is_followed(id) && entry.is_none_or(|entry| entry.shown.is_some()) {
            let snapshot = Snapshot::deleted(id, self.last + 1, entry.map(|entry| &*entry.snapshot));
            self.publish(snapshot, None, Duration::ZERO);
        }
    }

    /// Adds a snapshot. If all snapshots together are too large, drops the oldest ones of jobs that
    /// neither run nor have a stream of their own.
    fn publish(&mut self, snapshot: Snapshot, shown: Option<PublishedFields>, quiet_until: Duration) {
        let (id, number) = (snapshot.id, snapshot.number);
        self.remove(id);
        self.last = number;
        self.bytes += snapshot.bytes();
        self.order.insert(number, id);
        self.jobs.insert(id, PublishedJob { snapshot: Arc::new(snapshot), shown, quiet_until });
        while self.bytes > self.max_bytes {
            let is_kept =
                |id: &JobId| self.watched.contains_key(id) || self.jobs.get(id).is_some_and(PublishedJob::is_running);
            let Some((&oldest, &id)) = self.order.range(..number).find(|(_, id)| !is_kept(id)) else { break };
            self.floor = self.floor.max(oldest);
            if let Some(entry) = self.remove(id).filter(PublishedJob::is_open) {
                let snapshot = Arc::new(entry.snapshot.without_data());
                self.jobs.insert(id, PublishedJob { snapshot, ..entry });
            }
        }
        if let Some(wake) = self.watched.get(&id) {
            wake.send_replace(number);
        }
    }

    fn remove(&mut self, id: JobId) -> Option<PublishedJob> {
        let entry = self.jobs.remove(&id)?;
        self.order.remove(&entry.snapshot.number);
        self.bytes -= entry.snapshot.bytes();
        Some(entry)
    }

    /// Makes a changed job due, if it has readers.
    pub(super) fn note_change(&mut self, id: JobId) {
        if self.is_followed(id) {
            self.due.insert(id, Duration::ZERO);
        }
    }

    /// Makes all followed jobs and a search due after reports of changes were lost.
    pub(super) fn note_loss(&mut self) {
        let open = self.jobs.iter().filter(|(_, entry)| entry.is_open()).map(|(id, _)| id);
        self.due.extend(open.chain(self.watched.keys()).map(|id| (*id, Duration::ZERO)));
        self.polls_since_search = SEARCH_POLLS;
    }

    /// Unknown ones of the newest models, which a search found, oldest first: those that were
    /// created since the last search; after the first search, all of them. Ids of several processes
    /// are not exactly in the order of creation, so a new model may be older than one that was
    /// found.
    pub(super) fn unknown_newest(&self, found: &[JobId]) -> Vec<JobId> {
        let last = self.newest.as_deref().unwrap_or_default();
        let is_new = |id: &&JobId| last.first().is_none_or(|oldest| *id > oldest) && !last.contains(id);
        found.iter().filter(is_new).filter(|id| !self.knows(**id)).copied().collect()
    }

    /// Notes the result of a search whose unknown models have been read.
    pub(super) fn note_newest(&mut self, found: Vec<JobId>) {
        self.newest = Some(found);
        self.polls_since_search = 0;
    }

    /// Makes the jobs to be polled due, if the time of a poll has passed. Returns whether to search
    /// for unknown models. `readers` is the number of readers of many models.
    pub(super) fn poll(&mut self, now: Duration, readers: usize, timing: &FeedTiming) -> bool {
        if now >= self.polled_at + timing.poll {
            self.polled_at = now;
            self.release_unread(now, readers);
            let mut polled: Vec<_> = self.watched.keys().copied().collect();
            if let Some(reads) = READS_PER_POLL.checked_div(readers) {
                let rest = self.jobs.range((Excluded(self.turn), Unbounded)).chain(&self.jobs);
                let open = rest.filter(|(_, entry)| entry.is_open()).map(|(id, _)| *id);
                polled.extend(open.take(reads.max(MIN_READS_PER_POLL)));
                self.turn = polled.last().copied().unwrap_or(self.turn);
                self.polls_since_search += 1;
            }
            self.due.extend(polled.into_iter().map(|id| (id, Duration::ZERO)));
        }
        self.follow_until.is_some() && (self.newest.is_none() || self.polls_since_search >= SEARCH_POLLS)
    }

    /// Forgets jobs that have no readers.
    fn release_unread(&mut self, now: Duration, readers: usize) {
        self.watched.retain(|_, wake| wake.receiver_count() > 0);
        if readers > 0 {
            self.follow_all(now);
        }
        if self.follow_until.is_some_and(|until| now < until) {
            return;
        }
        (self.follow_until, self.newest) = (None, None);
        self.due.retain(|id, _| self.watched.contains_key(id));
        self.jobs.retain(|id, _| self.watched.contains_key(id));
        self.order.retain(|_, id| self.jobs.contains_key(id));
        self.bytes = self.jobs.values().map(|entry| entry.snapshot.bytes()).sum();
        // The cursors of earlier readers become unknown.
        self.last += 1;
        self.floor = self.last;
    }

    /// The jobs to be read now. They stay due until [`Published::note_read`].
    pub(super) fn due_jobs(&self, now: Duration) -> Vec<JobId> {
        self.due.iter().filter(|(_, at)| **at <= now).map(|(id, _)| *id).collect()
    }

    /// Defers a job that could not be read, so that it does not delay the others.
    pub(super) fn postpone(&mut self, id: JobId, until: Duration) {
        self.due.insert(id, until);
    }

    /// Publishes the result of a read. A missing job was deleted if it is known; otherwise it may
    /// never have existed.
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
