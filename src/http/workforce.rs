//! The numbers of live workers, from which responses derive why a queued job waits.
//!
//! All requests and event streams of a process share one read of the job store per second.

use crate::clock::Stopwatch;
use crate::jobs::{Job, QueueReason, Status, Store, Workforce};
use crate::lock::Mutex;
use std::time::Duration;

/// Maximum age of the numbers in a response.
const MAX_AGE: Duration = Duration::from_secs(1);

/// Facts that a response about a job contains besides the record of the job.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct JobContext {
    /// Time after its end at which a job is removed.
    pub(super) keep: Option<Duration>,
    /// Live workers; `None` if unknown.
    pub(super) workforce: Option<Workforce>,
}

impl JobContext {
    /// Reason why no worker claims a job; `None` if the job is not queued or waits for its turn.
    pub(super) fn queue_reason(&self, job: &Job) -> Option<QueueReason> {
        if job.status != Status::Queued {
            None
        } else if job.waits_for_equal {
            Some(QueueReason::EqualModel)
        } else {
            self.workforce.and_then(|workforce| workforce.obstacle(job.backend.requested))
        }
    }
}

/// The numbers of live workers as this process last read them.
#[derive(Debug)]
pub(super) struct WorkforceCache {
    store: Store,
    /// Maximum age of the last heartbeat of a live worker.
    within: Duration,
    latest: Mutex<Option<Workforce>>,
    /// Age of `latest`. Held by the caller that reads; the others wait for its result.
    read: tokio::sync::Mutex<Option<Stopwatch>>,
}

impl WorkforceCache {
    pub(super) fn new(store: Store, within: Duration) -> Self {
        Self { store, within, latest: Mutex::default(), read: tokio::sync::Mutex::default() }
    }

    /// The numbers of live workers, read again if they are older than a second. While the job store
    /// is unavailable, the numbers that were read last; `None` if there are none.
    pub(super) async fn current(&self) -> Option<Workforce> {
        let mut read = self.read.lock().await;
        if read.as_ref().is_none_or(|age| age.elapsed() >= MAX_AGE) {
            match self.store.workforce(self.within).await {
                Ok(workforce) => *self.latest.lock() = Some(workforce),
                Err(error) => tracing::debug!(%error, "could not count the workers; responses use the last numbers"),
            }
            // After a failure too, so that callers that wait do not repeat it one after the other.
            *read = Some(Stopwatch::start());
        }
        *self.latest.lock()
    }
}
