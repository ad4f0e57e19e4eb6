//! The position of one stream in the published states, and the events that follow it.

use super::feed::Feed;
use super::published::Next;
use super::snapshot::{Changes, Snapshot};
use super::subscription::Subscription;
use crate::http::models::detail::Detail;
use crate::http::models::links::At;
use crate::jobs::{JobId, StoreError};
use bytes::Bytes;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// What a stream sends next.
pub(super) enum Step {
    /// These pieces; there may be none.
    Events(Vec<Bytes>),
    /// These pieces, after which the stream ends.
    Last(Vec<Bytes>),
    /// Nothing until something is published.
    Wait,
}

/// A reader of one job or of many models.
pub(in crate::http) struct Reader {
    feed: Arc<Feed>,
    wake: watch::Receiver<u64>,
    scope: Scope,
}

enum Scope {
    /// One job, and the number of its last snapshot that the client has; 0 for none.
    Job(JobId, u64),
    Models(Box<Models>),
}

struct Models {
    subscription: Subscription,
    /// Number of the last publication that the client has.
    position: u64,
    /// Cursors consist of this text and a position.
    cursor_prefix: String,
    /// The position at which the reader began, and the models whose state at that position is still
    /// to be sent; `None` once the client has all of them.
    initial: Option<(u64, VecDeque<JobId>)>,
    /// Whether the last model may have ended.
    may_be_over: bool,
}

impl Models {
    /// The id of an event at a position. A client that loses the connection during the initial
    /// states begins anew, so their cursor is 0, which is no position.
    fn cursor(&self, position: u64) -> String {
        format!("{}{}", self.cursor_prefix, if self.initial.is_some() { 0 } else { position })
    }

    /// Begins with the present states.
    async fn begin(&mut self, feed: &Feed, with_ended: bool) -> Result<(), StoreError> {
        let position = feed.lock().last();
        let ids = self.subscription.initial_ids(&feed.store, with_ended).await?;
        self.initial = Some((position, ids.into()));
        (self.position, self.may_be_over) = (position, true);
        Ok(())
    }

    async fn next(&mut self, feed: &Feed, detail: Detail) -> Result<Step, StoreError> {
        let next = feed.lock().after(self.position, &self.subscription);
        match next {
            Next::Snapshot(snapshot) => {
                let cursor = self.cursor(snapshot.number);
                let events = snapshot.events_after(self.position, &cursor, detail, At::Root);
                self.position = snapshot.number;
                self.may_be_over |= snapshot.is_last;
                return Ok(Step::Events(events));
            }
            Next::Nothing(last) => self.position = last,
            Next::Unknown => {
                self.begin(feed, true).await?;
                return Ok(Step::Events(Vec::new()));
            }
        }
        let Some((begin, ids)) = &self.initial else { return self.end(feed).await };
        let Some(&id) = ids.front() else {
            self.initial = None;
            // An id without an event: the client can resume from here.
            return Ok(Step::Events(vec![format!("id: {}\n\n", self.cursor(self.position)).into()]));
        };
        let events = self.initial_events(feed, *begin, id, detail).await?;
        self.initial.as_mut().map(|(_, ids)| ids.pop_front());
        Ok(Step::Events(events))
    }

    /// The state of one model at the position at which the reader began. A model that may change
    /// and that the feed has not read is published, and its events follow like all later ones.
    async fn initial_events(
        &self,
        feed: &Feed,
        begin: u64,
        id: JobId,
        detail: Detail,
    ) -> Result<Vec<Bytes>, StoreError> {
        let known = feed.lock().latest(id);
        let snapshot = match known {
            Some(snapshot) => snapshot,
            None => match feed.store.get(id).await? {
                Some(job) => {
                    if !job.status.is_ended() {
                        feed.offer(&job);
                    }
                    let present = || Arc::new(Snapshot::new(&job, feed.timing.keep, begin, Changes::default(), None));
                    feed.lock().latest(id).unwrap_or_else(present)
                }
                None => Arc::new(Snapshot::deleted(id, begin, None)),
            },
        };
        let events = |snapshot: &Snapshot| snapshot.events_after(0, &self.cursor(begin), detail, At::Root);
        Ok(if !snapshot.fields.as_ref().is_some_and(|fields| self.subscription.may_see(fields)) {
            // A model of another owner looks as if it did not exist.
            events(&Snapshot::deleted(id, begin, None))
        } else if snapshot.number <= begin && self.subscription.includes(&snapshot) {
            events(&snapshot)
        } else {
            Vec::new()
        })
    }

    /// The end of the stream, if all models of a finite subscription have ended.
    async fn end(&mut self, feed: &Feed) -> Result<Step, StoreError> {
        let may_be_over = self.may_be_over && self.subscription.is_finite();
        let is_over = may_be_over && !feed.lock().has_open(&self.subscription);
        let end_id = if is_over { self.subscription.end_id(&feed.store).await? } else { None };
        self.may_be_over = false;
        Ok(end_id.map_or(Step::Wait, |id| Step::Last(vec![format!("id: {id}\n\n").into()])))
    }
}

impl Reader {
    /// A reader of one job that has received nothing. The job need not exist.
    pub(in crate::http) fn of_job(feed: &Arc<Feed>, id: JobId) -> Self {
        let wake = feed.lock().follow_job(id);
        Self { feed: Arc::clone(feed), wake, scope: Scope::Job(id, 0) }
    }

    /// A reader of many models that has received everything up to the event with the id `last_id`.
    /// Begins with the present states if that id is absent or unknown; `None` if nothing will
    /// follow it.
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
        let is_unknown = matches!(feed.lock().after(position, &subscription), Next::Unknown);
        let mut models = Box::new(Models { subscription, position, cursor_prefix, initial: None, may_be_over: true });
        if is_unknown {
            models.begin(feed, last_id.is_some()).await?;
        }
        Ok(Some(Self { feed: Arc::clone(feed), wake, scope: Scope::Models(models) }))
    }

    /// Skips the state of the job that the client has, if no newer one was published.
    pub(super) fn skip(&mut self, version: u64) {
        if let Scope::Job(id, position) = &mut self.scope
            && let Some(snapshot) = self.feed.lock().latest(*id)
            && snapshot.version <= version
        {
            *position = snapshot.number;
        }
    }

    /// What the stream sends next. After an error it can be called again.
    pub(super) async fn next(&mut self, detail: Detail) -> Result<Step, StoreError> {
        self.wake.mark_unchanged();
        let (id, position) = match &mut self.scope {
            // Boxed, so that streams of one job do not reserve memory for calls of the job store.
            Scope::Models(models) => return Box::pin(models.next(&self.feed, detail)).await,
            Scope::Job(id, position) => (*id, position),
        };
        let latest = self.feed.lock().latest(id);
        let Some(snapshot) = latest.filter(|snapshot| snapshot.number > *position) else { return Ok(Step::Wait) };
        let events = snapshot.events_after(*position, &snapshot.version.to_string(), detail, At::Model);
        *position = snapshot.number;
        Ok(if snapshot.is_last { Step::Last(events) } else { Step::Events(events) })
    }

    /// Waits until something was published since the last call of [`Reader::next`].
    pub(super) async fn changed(&mut self) {
        if self.wake.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
    }

    /// Waits until the job has ended or was deleted.
    pub(in crate::http) async fn ended(&mut self) {
        while !matches!(self.next(Detail::Summary).await, Ok(Step::Last(_))) {
            self.changed().await;
        }
    }

    /// Time after which a stream reads the job store again that could not be read.
    pub(super) fn poll(&self) -> Duration {
        self.feed.timing.poll
    }
}
