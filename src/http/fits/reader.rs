//! The events of one fit.
//!
//! Fits are few and change once a second, so each reader asks the store when it reports a change; models have the
//! [`feed`](crate::http::feed).

use super::shape::{Fit, Parts};
use crate::http::Limits;
use crate::http::dto::{Deleted, DeletedEvent};
use crate::jobs::{Change, Job, JobId, Status, Store, StoreError};
use bytes::Bytes;
use serde::Serialize;
use std::time::Duration;
use tokio::sync::broadcast::{self, error::RecvError};

/// A reader of one fit.
pub(in crate::http) struct FitReader {
    id: JobId,
    store: Store,
    changes: broadcast::Receiver<Change>,
    /// Time after which the fit is read again although no change was reported.
    poll: Duration,
    keep: Option<Duration>,
    /// What the client has: version and place in the queue, and the status.
    sent: Option<(u64, Option<u64>, Status)>,
    /// Whether the fit is to be read.
    due: bool,
}

impl FitReader {
    /// A reader of the fit of `job`; `known`: whether the client has this state.
    pub(super) fn new(
        store: &Store,
        changes: broadcast::Receiver<Change>,
        limits: &Limits,
        job: &Job,
        known: bool,
    ) -> Self {
        let sent = known.then_some((job.version, job.queue_position, job.status));
        let (store, poll, keep) = (store.clone(), limits.event_poll, limits.keep);
        Self { id: job.id, store, changes, poll, keep, sent, due: true }
    }

    /// The next event, and whether it is the last; `None` if nothing is new.
    pub(in crate::http) async fn next(&mut self) -> Result<Option<(Bytes, bool)>, StoreError> {
        if !std::mem::take(&mut self.due) {
            return Ok(None);
        }
        let read = self.store.get(self.id).await;
        self.due = read.is_err();
        Ok(match read? {
            None => {
                let gone = DeletedEvent { id: self.id.0, status: Deleted::Deleted };
                Some((event("end", "deleted", &gone), true))
            }
            Some(job) => self.news(&job),
        })
    }

    fn news(&mut self, job: &Job) -> Option<(Bytes, bool)> {
        let state = (job.version, job.queue_position, job.status);
        let before = self.sent.replace(state);
        if before == Some(state) {
            return None;
        }
        let name = match before {
            _ if job.status.is_ended() => "end",
            Some((_, _, status)) if status == job.status => "progress",
            _ => "status",
        };
        let fit = Fit::of(job, self.keep, Parts::Result);
        Some((event(name, &job.version.to_string(), &fit), job.status.is_ended()))
    }

    /// Waits until the fit may have changed.
    pub(in crate::http) async fn changed(&mut self) {
        let Self { id, changes, .. } = self;
        let noticed = async {
            loop {
                match changes.recv().await {
                    Ok(change) if change.id == *id => return,
                    Ok(_) => {}
                    Err(RecvError::Lagged(_)) => return,
                    Err(RecvError::Closed) => std::future::pending().await,
                }
            }
        };
        tokio::select! {
            () = noticed => {}
            () = tokio::time::sleep(self.poll) => {}
        }
        self.due = true;
    }
}

fn event(name: &str, id: &str, data: &impl Serialize) -> Bytes {
    let data = serde_json::to_string(data).expect("a fit has string keys only");
    Bytes::from(format!("event: {name}\nid: {id}\ndata: {data}\n\n"))
}
