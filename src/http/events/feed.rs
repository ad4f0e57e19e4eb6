//! Publication of the changes of jobs, once for all event streams of a process.
//!
//! The job store reports changes, and the feed reads each changed job that has readers once. A
//! report is lost if its sender dies, if a connection breaks, or if the channel overflows. The feed
//! therefore also reads followed jobs periodically and searches for unknown models. The number of
//! readers does not change the cost.

use super::published::{FeedTiming, Published};
use super::subscription::Subscription;
use crate::clock::Stopwatch;
use crate::http::workforce::WorkforceCache;
use crate::jobs::{Change, Job, JobId, ListFilter, Store, StoreError};
use crate::lock::{Mutex, MutexGuard};
use futures_util::FutureExt;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::broadcast::{self, error::RecvError, error::TryRecvError};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

/// The published states of jobs, with the means to wait for new ones.
pub(in crate::http) struct Feed {
    /// Distinguishes the cursors of this process from those of others.
    pub(super) name: String,
    pub(super) store: Store,
    workforce: Arc<WorkforceCache>,
    pub(super) timing: FeedTiming,
    age: Stopwatch,
    /// Number of panics of the task that publishes changes.
    panics: AtomicU64,
    published: Mutex<Published>,
    /// Number of the last publication; the receivers are the readers of many models.
    last: watch::Sender<u64>,
    /// Unread reports of changes. Locked while changes are published.
    reports: tokio::sync::Mutex<broadcast::Receiver<Change>>,
}

impl Feed {
    /// A feed whose task publishes changes until `shutdown` is cancelled.
    pub(in crate::http) fn start(
        store: Store,
        workforce: Arc<WorkforceCache>,
        timing: FeedTiming,
        shutdown: CancellationToken,
    ) -> Arc<Self> {
        let published = Published::default();
        let feed = Arc::new(Self {
            name: Uuid::new_v4().simple().to_string()[..12].to_owned(),
            reports: tokio::sync::Mutex::new(store.changes()),
            store,
            workforce,
            timing,
            age: Stopwatch::start(),
            panics: AtomicU64::new(0),
            last: watch::Sender::new(published.last()),
            published: Mutex::new(published),
        });
        let follower = Arc::clone(&feed);
        tokio::spawn(async move {
            tokio::select! {
                () = follower.follow_after_panics() => {}
                () = shutdown.cancelled() => {}
            }
        });
        feed
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Published> {
        self.published.lock()
    }

    /// Applies `change` to the published states, and wakes the readers of many models if there is a
    /// new snapshot.
    fn update(&self, change: impl FnOnce(&mut Published)) {
        let mut published = self.lock();
        change(&mut published);
        let last = published.last();
        drop(published);
        self.last.send_if_modified(|number| std::mem::replace(number, last) != last);
    }

    /// Publishes the state with which a new reader of a job begins.
    pub(in crate::http) async fn offer(&self, job: &Job) {
        self.count_workers().await;
        self.update(|published| published.offer_to_new_reader(job, self.age.elapsed(), &self.timing));
    }

    /// Notes the live workers, from which the states derive why jobs wait.
    async fn count_workers(&self) {
        let workforce = self.workforce.current().await;
        self.lock().workforce = workforce;
    }

    /// Publishes a state of a job after [`Feed::count_workers`].
    fn offer_counted(&self, job: &Job) {
        self.update(|published| published.offer(job, self.age.elapsed(), &self.timing));
    }

    /// Follows all jobs from this call on, until the receiver is dropped and some time has passed.
    pub(super) fn follow_all(&self) -> watch::Receiver<u64> {
        let wake = self.last.subscribe();
        self.lock().follow_all(self.age.elapsed());
        wake
    }

    /// Publishes the changes that the job store reported before this call. Gives up after the time
    /// of a poll; later events then correct the states.
    pub(super) async fn catch_up(&self) {
        let published = tokio::time::timeout(self.timing.poll, self.publish_changes()).await;
        if !matches!(published, Ok(Ok(()))) {
            tracing::debug!("could not read all changed jobs; an event stream may begin with outdated states");
        }
    }

    /// Reads a followed job and publishes what is new.
    pub(in crate::http) async fn refresh(&self, id: JobId) {
        self.lock().note_change(id);
        self.catch_up().await;
    }

    /// Reads these models. The result lacks those that do not exist.
    pub(super) async fn read(&self, ids: Vec<JobId>) -> Result<Vec<Job>, StoreError> {
        if ids.is_empty() {
            return Ok(Vec::new());
        }
        let filter = ListFilter { limit: ids.len() as u32, ids, ..ListFilter::default() };
        Ok(self.store.list(&filter).await?.jobs)
    }

    /// Publishes changes as they are reported. Continues after a panic: streams would stay open and
    /// silent.
    async fn follow_after_panics(&self) {
        while AssertUnwindSafe(self.follow()).catch_unwind().await.is_err() {
            tracing::error!("the publication of changes panicked; it is restarted, and event streams continue");
            self.panics.fetch_add(1, Ordering::Relaxed);
            // Reports may have been lost.
            self.lock().note_loss();
            tokio::time::sleep(self.timing.poll).await;
        }
    }

    /// Number of panics of the task since the last call.
    pub(in crate::http) fn take_panics(&self) -> u64 {
        self.panics.swap(0, Ordering::Relaxed)
    }

    /// Publishes changes as they are reported.
    async fn follow(&self) {
        let mut wake = self.store.changes();
        loop {
            let pause = self.lock().pause(self.age.elapsed(), &self.timing);
            tokio::select! {
                report = wake.recv() => if let Err(RecvError::Closed) = report { return },
                () = tokio::time::sleep(pause) => {}
            }
            // The call below publishes all reports that have arrived.
            wake = wake.resubscribe();
            if let Err(error) = self.publish_changes().await {
                tracing::warn!(%error, "could not read the job store; event streams wait for the next attempt");
                tokio::time::sleep(self.timing.poll).await;
            }
        }
    }

    /// Publishes the changes that were reported, held back or are found by polling.
    async fn publish_changes(&self) -> Result<(), StoreError> {
        let mut reports = self.reports.lock().await;
        self.note(&mut reports);
        if self.lock().poll(self.age.elapsed(), self.last.receiver_count(), &self.timing) {
            let newest = Subscription::default().newest_ids(&self.store).await?;
            let unknown = self.lock().unknown_newest(&newest);
            // One query, because a request for a stream waits for it.
            let mut models = self.read(unknown).await?;
            models.sort_by_key(|model| model.id);
            self.count_workers().await;
            models.iter().for_each(|model| self.offer_counted(model));
            self.lock().note_newest(newest);
        }
        let due = self.lock().due_jobs(self.age.elapsed());
        if !due.is_empty() {
            self.count_workers().await;
        }
        for id in due {
            let read = self.store.get(id).await;
            if read.is_err() {
                self.lock().postpone(id, self.age.elapsed() + 2 * self.timing.poll);
            }
            let job = read?;
            self.update(|published| published.note_read(id, job.as_ref(), self.age.elapsed(), &self.timing));
            // Otherwise the channel of reports could overflow during many reads.
            self.note(&mut reports);
        }
        Ok(())
    }

    /// Notes all reports that have arrived.
    fn note(&self, reports: &mut broadcast::Receiver<Change>) {
        loop {
            match reports.try_recv() {
                Ok(Change { id, version: None }) => self.update(|published| published.delete(id)),
                Ok(Change { id, .. }) => self.lock().note_change(id),
                Err(TryRecvError::Lagged(_)) => self.lock().note_loss(),
                Err(TryRecvError::Empty | TryRecvError::Closed) => return,
            }
        }
    }
}
