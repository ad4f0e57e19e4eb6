//! The states of models as they change, published once for all readers.
//!
//! A state that is offered to the feed is compared with the published one; [`Track`] decides which events are due, and
//! readers share the bytes of the new [`View`]. `follower.rs` offers what it reads from the store.
//!
//! Without a reader of all models, only models are read that have a reader of their own. The states of all models are kept
//! for [`LINGER`] after the last reader of all has gone, so that a client that reconnects gets only what it lacks.

mod log;

use super::interest::{Interest, Part, Traits};
use super::track::Track;
use super::view::{Name, View};
use crate::clock::Stopwatch;
use crate::jobs::{Job, JobId, JobKind, ListFilter, Page, Status, Store, StoreError};
use log::Log;
pub(super) use log::Next;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Notify, watch};
use uuid::Uuid;

/// Most bytes of published states. Some five thousand models.
const MOST_BYTES: usize = 32 << 20;
/// Ended models that are remembered, so that their end is published once.
const ENDED: usize = 1000;
/// Time for which all models are followed after the last reader of all has gone.
const LINGER: Duration = Duration::from_secs(60);

/// How often, and how much.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// Least time between two progress events, or two section events, of one model.
    pub(super) interval: Duration,
    /// Time after which a watched model is read again although no change was reported.
    pub(super) poll: Duration,
    /// Time after its end at which a model is removed.
    pub(super) keep: Option<Duration>,
}

/// The states of models as they change.
pub(super) struct Feed {
    name: String,
    pub(super) store: Store,
    pub(super) pace: Pace,
    /// Times of the feed are counted from its start.
    pub(super) age: Stopwatch,
    state: Mutex<State>,
    last: watch::Sender<u64>,
    /// Wakes the follower.
    pub(super) wake: Notify,
    loading: tokio::sync::Mutex<()>,
    rounds: watch::Sender<Rounds>,
}

/// Rounds of the follower. In each it publishes all changes that were reported before the round began.
#[derive(Clone, Copy, Debug, Default)]
struct Rounds {
    begun: u64,
    finished: u64,
}

/// Whether all models are followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum All {
    No,
    /// The number of readers.
    Readers(usize),
    /// There is no reader left; all models are followed until this age of the feed.
    Until(Duration),
}

/// A model that has not ended.
pub(super) struct Tracked {
    track: Track,
    /// Kept here too, because the log may drop its state.
    traits: Option<Arc<Traits>>,
}

pub(super) struct Watched {
    readers: usize,
    view: watch::Sender<Option<Arc<View>>>,
}

pub(super) struct State {
    pub(super) log: Log,
    /// Models that have not ended.
    pub(super) tracks: BTreeMap<JobId, Tracked>,
    /// The newest models whose end was published.
    pub(super) ended: BTreeSet<JobId>,
    /// The newest jobs that make no model.
    others: BTreeSet<JobId>,
    pub(super) watched: HashMap<JobId, Watched>,
    pub(super) all: All,
    /// Whether the models that a reader of all begins with were read.
    pub(super) loaded: bool,
    pub(super) due: VecDeque<JobId>,
    /// The members of `due`.
    pub(super) is_due: HashSet<JobId>,
    /// Models with an event that was held back, and the age of the feed at which it is due.
    pub(super) later: BTreeMap<JobId, Duration>,
    /// Whether unknown models are to be looked for.
    pub(super) search: bool,
}

impl State {
    /// Whether all models are followed.
    pub(super) fn follows_all(&self) -> bool {
        self.all != All::No
    }

    /// Whether a model has a reader.
    pub(super) fn wants(&self, id: JobId) -> bool {
        self.follows_all() || self.watched.contains_key(&id)
    }

    /// Schedules a read of a model.
    pub(super) fn make_due(&mut self, id: JobId) {
        if self.is_due.insert(id) {
            self.due.push_back(id);
        }
    }

    /// Publishes a state; gives it to the readers of this model as `of_one` makes it.
    fn publish(&mut self, view: View, of_one: impl FnOnce(Arc<View>) -> Arc<View>) {
        let view = self.log.insert(view);
        if let Some(tracked) = self.tracks.get_mut(&view.id()) {
            tracked.traits = view.traits().cloned();
        }
        if let Some(watched) = self.watched.get(&view.id()) {
            watched.view.send_replace(Some(of_one(view)));
        }
    }

    /// Publishes what is new in this state of a model; older states than the published one are passed over.
    pub(super) fn offer(&mut self, job: &Job, now: Duration, pace: Pace) {
        if job.kind != JobKind::Model {
            self.note_other(job.id);
            return;
        }
        let before = self.log.view(job.id).cloned();
        let stale = before.as_ref().is_some_and(|view| view.version() > job.version);
        if !self.wants(job.id) || stale {
            return;
        }
        if self.ended.contains(&job.id) {
            // The end is published once; but a later reader of this model must get it.
            let unseen = self.watched.get(&job.id).filter(|watched| watched.view.borrow().is_none());
            if let Some(watched) = unseen.filter(|_| job.status.is_ended()) {
                let end = Arc::new(View::of(job, pace.keep, &[Name::End], self.log.last(), None));
                watched.view.send_replace(Some(end.of_one(job, pace.keep)));
            }
            return;
        }
        let new = || Tracked { track: Track::new(pace.interval), traits: None };
        let (names, again) = self.tracks.entry(job.id).or_insert_with(new).track.next(job, now);
        match again {
            Some(again) => self.later.insert(job.id, now + again),
            None => self.later.remove(&job.id),
        };
        if job.status.is_ended() {
            self.forget(job.id);
            self.ended.insert(job.id);
            if self.ended.len() > ENDED {
                self.ended.pop_first();
            }
        }
        if !names.is_empty() {
            let view = View::of(job, pace.keep, &names, self.log.last() + 1, before.as_deref());
            self.publish(view, |view| view.of_one(job, pace.keep));
        }
    }

    /// Remembers the newest jobs that make no model, so that their end is not taken for that of a model.
    fn note_other(&mut self, id: JobId) {
        self.others.insert(id);
        if self.others.len() > ENDED {
            self.others.pop_first();
        }
    }

    /// Publishes that a model was deleted.
    pub(super) fn deleted(&mut self, id: JobId) {
        if self.others.remove(&id) {
            return;
        }
        let before = self.log.view(id).cloned();
        if self.wants(id) && before.as_ref().is_none_or(|view| view.status().is_some()) {
            let traits = before.as_ref().and_then(|view| view.traits().cloned());
            let traits = traits.or_else(|| self.tracks.get(&id)?.traits.clone());
            self.forget(id);
            self.ended.remove(&id);
            self.publish(View::deleted(id, self.log.last() + 1, before.as_deref(), traits), |view| view);
        }
    }

    /// Whether anything was published of a model that was not deleted.
    pub(super) fn knows(&self, id: JobId) -> bool {
        self.tracks.contains_key(&id) || self.ended.contains(&id)
    }

    fn forget(&mut self, id: JobId) {
        self.tracks.remove(&id);
        self.later.remove(&id);
    }
}

/// A reader of one model.
pub(super) struct ModelReader {
    feed: Arc<Feed>,
    id: JobId,
    view: watch::Receiver<Option<Arc<View>>>,
}

impl ModelReader {
    /// The latest state; `None` before the model was read first.
    pub(super) fn view(&mut self) -> Option<Arc<View>> {
        self.view.borrow_and_update().clone()
    }

    /// Waits until there is another state.
    pub(super) async fn changed(&mut self) {
        if self.view.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
    }

    /// Waits until the model has ended or was deleted.
    pub(super) async fn ended(&mut self) {
        if self.view.wait_for(|view| view.as_ref().is_some_and(|view| view.is_last())).await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}

impl Drop for ModelReader {
    fn drop(&mut self) {
        let mut state = self.feed.lock();
        let Some(watched) = state.watched.get_mut(&self.id) else { return };
        watched.readers -= 1;
        if watched.readers == 0 {
            state.watched.remove(&self.id);
            if !state.follows_all() {
                state.forget(self.id);
                state.ended.remove(&self.id);
                state.log.remove(self.id);
            }
        }
    }
}

/// A reader of all models, or of those of an interest.
pub(super) struct AllReader {
    feed: Arc<Feed>,
    last: watch::Receiver<u64>,
}

impl AllReader {
    /// The first state after `number` that is of interest.
    pub(super) fn after(&mut self, number: u64, interest: &Interest) -> Next {
        self.last.mark_unchanged();
        self.feed.lock().log.after(number, interest)
    }

    /// The models that a reader of all begins with, oldest first, and the number from which it goes on.
    pub(super) fn first(&self, with_ended: bool) -> (VecDeque<JobId>, u64) {
        let state = self.feed.lock();
        (state.log.first(with_ended).into_iter().collect(), state.log.last())
    }

    /// What a reader of some models begins with, and the number from which it goes on.
    pub(super) fn first_of(&self, interest: &Interest, with_ended: bool) -> (Vec<Part>, u64) {
        (interest.first(with_ended, log::FIRST as u32), self.feed.lock().log.last())
    }

    /// Reads a page of the models that a reader begins with.
    pub(super) async fn page(&self, filter: &ListFilter) -> Result<Page, StoreError> {
        self.feed.store.list(filter).await
    }

    /// The state of a model just read, for a reader that begins at `number`; `None` if it gets that state as one after
    /// `number`. A model that has not ended is followed from now on.
    pub(super) fn state_of(&self, job: &Job, number: u64) -> Option<Arc<View>> {
        // The end of a model that is followed is published, or it would be sent now and once more when the feed finds it.
        if !job.status.is_ended() || self.feed.lock().tracks.contains_key(&job.id) {
            self.feed.offer(job);
        }
        let known = self.view(job.id);
        match known {
            Some(view) if view.number() > number => None,
            Some(view) if view.version() >= job.version => Some(view),
            _ => Some(Arc::new(View::of(job, self.feed.pace.keep, &[], number, None))),
        }
    }

    /// Whether a reader at `number` has the end of all models of a finite interest. They are all followed, if it began with
    /// them.
    pub(super) fn is_over(&self, interest: &Interest, number: u64) -> bool {
        let state = self.feed.lock();
        let mut open = state.tracks.iter();
        interest.is_finite()
            && !open.any(|(id, tracked)| interest.includes(*id, tracked.traits.as_deref()))
            && matches!(state.log.after(number, interest), Next::Nothing(_))
    }

    /// Describes the models of a finite interest, in every process alike, if all have ended: their number and the newest.
    pub(super) async fn ended(&self, interest: &Interest) -> Result<Option<String>, StoreError> {
        let store = &self.feed.store;
        for status in [Status::Queued, Status::Running] {
            if !store.ids(&interest.filter(Some(status), 1)).await?.is_empty() {
                return Ok(None);
            }
        }
        let (mut count, mut newest) = (0, String::new());
        let mut filter = interest.filter(None, 1000);
        loop {
            let ids = store.ids(&filter).await?;
            let (Some(first), Some(last)) = (ids.first(), ids.last()) else { break };
            if count == 0 {
                newest = format!("-{first}");
            }
            count += ids.len();
            filter.before = Some(*last);
        }
        Ok(Some(format!("{count}{newest}")))
    }

    /// How often the store is asked again.
    pub(super) fn poll(&self) -> Duration {
        self.feed.pace.poll
    }

    /// The latest state of a model.
    pub(super) fn view(&self, id: JobId) -> Option<Arc<View>> {
        self.feed.lock().log.view(id).cloned()
    }

    /// Waits until a state is published after the last call of [`AllReader::after`].
    pub(super) async fn changed(&mut self) {
        if self.last.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
    }

    /// Name of this feed, for cursors.
    pub(super) fn name(&self) -> &str {
        &self.feed.name
    }
}

impl Drop for AllReader {
    fn drop(&mut self) {
        let mut state = self.feed.lock();
        state.all = match state.all {
            All::Readers(readers) if readers > 1 => All::Readers(readers - 1),
            _ => All::Until(self.feed.age.elapsed() + LINGER),
        };
    }
}

impl Feed {
    /// A feed that nothing is published in.
    pub(super) fn new(store: Store, pace: Pace) -> Self {
        let state = State {
            log: Log::new(MOST_BYTES),
            tracks: BTreeMap::new(),
            ended: BTreeSet::new(),
            others: BTreeSet::new(),
            watched: HashMap::new(),
            all: All::No,
            loaded: false,
            due: VecDeque::new(),
            is_due: HashSet::new(),
            later: BTreeMap::new(),
            search: false,
        };
        Self {
            name: Uuid::new_v4().simple().to_string()[..12].to_owned(),
            store,
            pace,
            age: Stopwatch::start(),
            last: watch::Sender::new(state.log.last()),
            state: Mutex::new(state),
            wake: Notify::new(),
            loading: tokio::sync::Mutex::new(()),
            rounds: watch::Sender::new(Rounds::default()),
        }
    }

    /// The follower begins a round.
    pub(super) fn begin_round(&self) {
        self.rounds.send_modify(|rounds| rounds.begun += 1);
    }

    /// The follower has finished its round.
    pub(super) fn finish_round(&self) {
        self.rounds.send_modify(|rounds| rounds.finished = rounds.begun);
    }

    /// Waits until the changes are published that were reported before this call; at most for the time of a poll.
    async fn caught_up(&self) {
        let mut rounds = self.rounds.subscribe();
        let begun = rounds.borrow().begun;
        self.wake.notify_one();
        let finished = rounds.wait_for(|rounds| rounds.finished > begun);
        if !matches!(tokio::time::timeout(self.pace.poll, finished).await, Ok(Ok(_))) {
            tracing::debug!("an event stream begins with states that may be old");
        }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Watches one model from now on; does not check that it exists.
    pub(super) fn watch(self: &Arc<Self>, id: JobId) -> ModelReader {
        let mut state = self.lock();
        let present = state.log.view(id).cloned();
        let watched =
            state.watched.entry(id).or_insert_with(|| Watched { readers: 0, view: watch::Sender::new(present) });
        watched.readers += 1;
        let view = watched.view.subscribe();
        drop(state);
        self.wake.notify_one();
        ModelReader { feed: Arc::clone(self), id, view }
    }

    /// Schedules a read of a watched model.
    pub(super) fn read_soon(&self, id: JobId) {
        self.lock().make_due(id);
        self.wake.notify_one();
    }

    /// Publishes what is new in this state of a watched model.
    pub(super) fn offer(&self, job: &Job) {
        let mut state = self.lock();
        state.offer(job, self.age.elapsed(), self.pace);
        let last = state.log.last();
        drop(state);
        self.announce(last);
    }

    /// Wakes the readers of all models; `last` is the number of the last state.
    pub(super) fn announce(&self, last: u64) {
        self.last.send_if_modified(|number| std::mem::replace(number, last) != last);
    }

    /// Follows all models from now on; reads those that a reader begins with, unless that was done before.
    pub(super) async fn follow(self: &Arc<Self>) -> Result<AllReader, StoreError> {
        let one_at_a_time = self.loading.lock().await;
        let loaded = {
            let mut state = self.lock();
            state.all = match state.all {
                All::Readers(readers) => All::Readers(readers + 1),
                All::No | All::Until(_) => All::Readers(1),
            };
            state.loaded
        };
        let reader = AllReader { feed: Arc::clone(self), last: self.last.subscribe() };
        if !loaded {
            self.search().await?;
            self.lock().loaded = true;
        }
        drop(one_at_a_time);
        self.caught_up().await;
        Ok(reader)
    }

    /// The jobs of which nothing was published.
    fn unknown(&self, mut jobs: Vec<Job>) -> impl Iterator<Item = Job> {
        let state = self.lock();
        jobs.retain(|job| !state.knows(job.id));
        jobs.into_iter()
    }

    /// Publishes the models that a reader begins with and that are not known: all that run, the newest that wait, and the
    /// newest of any status.
    pub(super) async fn search(&self) -> Result<(), StoreError> {
        let mut found = BTreeMap::new();
        for status in [Some(Status::Running), Some(Status::Queued), None] {
            let mut filter = ListFilter { status, limit: log::FIRST as u32, ..ListFilter::default() };
            loop {
                let page = self.store.list(&filter).await?;
                found.extend(self.unknown(page.jobs).map(|job| (job.id, job)));
                filter.before = page.next.filter(|_| status == Some(Status::Running));
                if filter.before.is_none() {
                    break;
                }
            }
        }
        // Oldest first, as they would have been reported.
        found.values().for_each(|job| self.offer(job));
        Ok(())
    }
}

#[cfg(test)]
mod tests;
