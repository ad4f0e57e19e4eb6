//! The position of one stream in the published states, and the events that follow it.

use super::feed::Feed;
use super::published::NextSnapshot;
use super::snapshot::{Changes, Snapshot};
use super::subscription::Subscription;
use crate::http::models::model::{Detail, LinkBase};
use crate::http::workforce::JobContext;
use crate::jobs::{JobId, StoreError};
use bytes::Bytes;
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Initial states per read of the job store. A slow client holds them in memory.
const INITIAL_PAGE: usize = 20;

/// The next thing that a stream does.
pub(super) enum StreamStep {
    /// Send these pieces, possibly none.
    Events(Vec<Bytes>),
    /// Send these pieces and end.
    Last(Vec<Bytes>),
    /// Wait for a publication.
    Wait,
}

/// A reader of one job or of many models.
pub(in crate::http) struct Reader {
    feed: Arc<Feed>,
    wake: watch::Receiver<u64>,
    scope: ReaderScope,
}

enum ReaderScope {
    /// One job, and the number of its last snapshot that the client has; 0 for none.
    Job(JobId, u64),
    Models(Box<ModelsReader>),
}

/// The position of a reader of many models.
struct ModelsReader {
    subscription: Subscription,
    /// Number of the last publication that the client has.
    position: u64,
    /// Cursors consist of this text and a position.
    cursor_prefix: String,
    /// The models whose initial states are still to be sent; `None` once all were sent.
    initial: Option<VecDeque<JobId>>,
    /// Numbers of the initial states that were published after `position`.
    sent: HashMap<JobId, u64>,
    /// Whether the last model may have ended.
    may_be_over: bool,
}

impl ModelsReader {
    /// The id of an event at `position`. A client that loses the connection during the initial
    /// states begins anew, so their cursor is 0, which is no position.
    fn cursor(&self, position: u64) -> String {
        format!("{}{}", self.cursor_prefix, if self.initial.is_some() { 0 } else { position })
    }

    /// Begins with the current states.
    async fn begin(&mut self, feed: &Feed, with_ended: bool) -> Result<(), StoreError> {
        let position = feed.lock().last();
        let ids = self.subscription.initial_ids(&feed.store, with_ended).await?;
        self.initial = Some(ids.into());
        self.sent.clear();
        (self.position, self.may_be_over) = (position, true);
        Ok(())
    }

    async fn next(&mut self, feed: &Feed, detail: Detail) -> Result<StreamStep, StoreError> {
        if let Some(ids) = &self.initial {
            let ids: Vec<JobId> = ids.iter().take(INITIAL_PAGE).copied().collect();
            return Ok(StreamStep::Events(self.initial_events(feed, ids, detail).await?));
        }
        let next = feed.lock().after(self.position, &self.subscription);
        match next {
            NextSnapshot::Found(snapshot) => {
                let last = self.sent.remove(&snapshot.id).unwrap_or(self.position);
                let events = snapshot.events_after(last, &self.cursor(snapshot.number), detail, LinkBase::Root);
                self.position = snapshot.number;
                self.may_be_over |= snapshot.is_last;
                Ok(StreamStep::Events(events))
            }
            NextSnapshot::None(last) => {
                self.position = last;
                let end_id = if self.may_be_over { self.end_id(feed).await? } else { None };
                self.may_be_over = false;
                Ok(end_id.map_or(StreamStep::Wait, |id| StreamStep::Last(vec![format!("id: {id}\n\n").into()])))
            }
            NextSnapshot::Unknown => {
                self.begin(feed, true).await?;
                Ok(StreamStep::Events(Vec::new()))
            }
        }
    }

    /// The states of `ids`, the first models in `initial`. Publishes models that have not ended and
    /// that the feed does not know. After the last initial state comes an id without an event, so
    /// that the client can resume from there.
    async fn initial_events(&mut self, feed: &Feed, ids: Vec<JobId>, detail: Detail) -> Result<Vec<Bytes>, StoreError> {
        let known: Vec<_> = {
            let published = feed.lock();
            ids.iter().map(|id| published.latest(*id)).collect()
        };
        let unknown = ids.iter().zip(&known).filter(|(_, known)| known.is_none()).map(|(id, _)| *id).collect();
        let read = feed.read(unknown).await?;
        let (cursor, number) = (self.cursor(0), self.position);
        // Jobs that have not ended are published instead.
        let context = JobContext { keep: feed.timing.keep, workforce: None };
        let mut pieces = Vec::new();
        for (&id, known) in ids.iter().zip(known) {
            let job = read.iter().find(|job| job.id == id);
            // The feed will publish the end of a job that it knows, which would then be sent twice.
            if let Some(job) = job.filter(|job| !job.status.is_ended() || feed.lock().knows(job.id)) {
                feed.offer(job).await;
            }
            let snapshot = feed.lock().latest(id).or(known).unwrap_or_else(|| {
                Arc::new(match job {
                    Some(job) => Snapshot::new(job, &context, number, Changes::default(), None),
                    None => Snapshot::deleted(id, number, None),
                })
            });
            if snapshot.number > self.position {
                self.sent.insert(id, snapshot.number);
            }
            if !snapshot.fields.as_ref().is_some_and(|fields| self.subscription.may_see(fields)) {
                // For the caller, a model of another owner does not exist.
                pieces.extend(Snapshot::deleted(id, number, None).events_after(0, &cursor, detail, LinkBase::Root));
            } else if self.subscription.includes(&snapshot) {
                pieces.extend(snapshot.events_after(0, &cursor, detail, LinkBase::Root));
            }
        }
        let initial = self.initial.get_or_insert_default();
        initial.drain(..ids.len());
        if initial.is_empty() {
            self.initial = None;
            pieces.push(format!("id: {}\n\n", self.cursor(self.position)).into());
        }
        Ok(pieces)
    }

    /// The id of the last event, if all models of a finite subscription have ended.
    async fn end_id(&self, feed: &Feed) -> Result<Option<String>, StoreError> {
        let has_ended = self.subscription.is_finite() && !feed.lock().has_open(&self.subscription);
        if has_ended { self.subscription.end_id(&feed.store).await } else { Ok(None) }
    }
}

impl Reader {
    /// A reader of one job that has received nothing. The job need not exist.
    pub(in crate::http) fn of_job(feed: &Arc<Feed>, id: JobId) -> Self {
        let wake = feed.lock().follow_job(id);
        Self { feed: Arc::clone(feed), wake, scope: ReaderScope::Job(id, 0) }
    }

    /// A reader of many models that has received everything up to the event with the id `last_id`.
    /// If the id is absent or unknown, the reader begins with the current states. Returns `None` if
    /// no event will follow the id.
    pub(super) async fn of_models(
        feed: &Arc<Feed>,
        subscription: Subscription,
        last_id: Option<&str>,
    ) -> Result<Option<Self>, StoreError> {
        if subscription.is_finite()
            && let Some(last_id) = last_id.filter(|id| id.starts_with("over"))
            && subscription.end_id(&feed.store).await?.as_deref() == Some(last_id)
        {
            return Ok(None);
        }
        let wake = feed.follow_all();
        feed.catch_up().await;
        let cursor_prefix = format!("{}-{}-", feed.name, subscription.digest());
        let position = last_id.and_then(|id| id.strip_prefix(&cursor_prefix)?.parse().ok()).unwrap_or(0);
        let next = feed.lock().after(position, &subscription);
        let (initial, sent) = (None, HashMap::new());
        let mut models =
            Box::new(ModelsReader { subscription, position, cursor_prefix, initial, sent, may_be_over: true });
        match next {
            NextSnapshot::Unknown => models.begin(feed, last_id.is_some()).await?,
            NextSnapshot::None(_) if models.end_id(feed).await?.is_some() => return Ok(None),
            NextSnapshot::Found(_) | NextSnapshot::None(_) => {}
        }
        Ok(Some(Self { feed: Arc::clone(feed), wake, scope: ReaderScope::Models(models) }))
    }

    /// Skips the state of the job that the client has, if no newer one was published.
    pub(super) fn skip(&mut self, version: u64) {
        if let ReaderScope::Job(id, position) = &mut self.scope
            && let Some(snapshot) = self.feed.lock().latest(*id)
            && snapshot.version <= version
        {
            *position = snapshot.number;
        }
    }

    /// The next step of the stream. Can be called again after an error.
    pub(super) async fn next(&mut self, detail: Detail) -> Result<StreamStep, StoreError> {
        self.wake.mark_unchanged();
        let (id, position) = match &mut self.scope {
            // Boxed, so that streams of one job do not reserve memory for calls of the job store.
            ReaderScope::Models(models) => return Box::pin(models.next(&self.feed, detail)).await,
            ReaderScope::Job(id, position) => (*id, position),
        };
        let latest = self.feed.lock().latest(id);
        let Some(snapshot) = latest.filter(|snapshot| snapshot.number > *position) else { return Ok(StreamStep::Wait) };
        let events = snapshot.events_after(*position, &snapshot.version.to_string(), detail, LinkBase::Model);
        *position = snapshot.number;
        Ok(if snapshot.is_last { StreamStep::Last(events) } else { StreamStep::Events(events) })
    }

    /// Waits until something was published since the last call of [`Reader::next`].
    pub(super) async fn changed(&mut self) {
        if self.wake.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
    }

    /// Waits until the job has ended or was deleted.
    pub(in crate::http) async fn ended(&mut self) {
        while !matches!(self.next(Detail::Summary).await, Ok(StreamStep::Last(_))) {
            self.changed().await;
        }
    }

    /// Time after which a stream retries a failed read of the job store.
    pub(super) fn poll(&self) -> Duration {
        self.feed.timing.poll
    }
}
