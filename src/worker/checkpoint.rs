//! Checkpoints of an attempt: from the generating thread to the artifact store, and back to the next attempt.
//!
//! A checkpoint is stored under a key of its own before the job's record names it, and the one before is removed
//! after that: at any time the record names a complete checkpoint or none. A lost checkpoint costs time, never a model, so no
//! failure here ends an attempt.

use super::context::Context;
use crate::clock::Stopwatch;
use crate::jobs::artifacts::{self, ArtifactError};
use crate::jobs::{ClaimedJob, StoreError};
use bytes::Bytes;
use std::convert::Infallible;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;

/// Tries to read a checkpoint before the job starts from the beginning.
const TRIES: u32 = 3;

/// Passes checkpoints from the generating thread to the task that stores them. Holds one at a time.
#[derive(Debug)]
pub(super) struct Mailbox {
    state: Mutex<State>,
    /// Time between checkpoints; `None` takes none.
    every: Option<Duration>,
    arrived: Notify,
}

#[derive(Debug)]
struct State {
    /// Since the last checkpoint, or the start.
    since: Stopwatch,
    /// A checkpoint that has not been fetched yet.
    checkpoint: Option<Vec<u8>>,
    /// Whether one is wanted at once.
    requested: bool,
}

impl Mailbox {
    pub(super) fn new(every: Option<Duration>) -> Self {
        let state = State { since: Stopwatch::start(), checkpoint: None, requested: false };
        Self { state: Mutex::new(state), every, arrived: Notify::new() }
    }

    /// Whether checkpoints are taken at all.
    pub(super) fn is_enabled(&self) -> bool {
        self.every.is_some()
    }

    /// Requests a checkpoint at the next step, if checkpoints are taken at all.
    pub(super) fn request(&self) {
        self.state().requested = self.is_enabled();
    }

    /// Whether the generation is to take a checkpoint now.
    pub(super) fn wants(&self) -> bool {
        let Some(every) = self.every else { return false };
        let state = self.state();
        // One that has not been fetched yet goes first.
        state.requested || (state.checkpoint.is_none() && state.since.elapsed() >= every)
    }

    /// Leaves a checkpoint to be stored.
    pub(super) fn put(&self, bytes: Vec<u8>) {
        *self.state() = State { since: Stopwatch::start(), checkpoint: Some(bytes), requested: false };
        self.arrived.notify_one();
    }

    /// The generation starts from the beginning.
    pub(super) fn restart(&self) {
        self.state().since = Stopwatch::start();
    }

    /// Waits for the next checkpoint.
    async fn next(&self) -> Vec<u8> {
        loop {
            let arrived = self.arrived.notified();
            if let Some(bytes) = self.state().checkpoint.take() {
                return bytes;
            }
            arrived.await;
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The stored checkpoints of one attempt.
pub(super) struct Checkpoints<'a> {
    context: &'a Context,
    /// The key that the record names.
    named: Option<String>,
    count: u32,
}

impl<'a> Checkpoints<'a> {
    pub(super) fn new(context: &'a Context, claimed: &ClaimedJob) -> Self {
        Self { context, named: claimed.job().checkpoint.clone(), count: 0 }
    }

    /// The checkpoint that an earlier attempt left.
    pub(super) async fn load(&self) -> Option<Bytes> {
        let key = self.named.as_deref()?;
        let mut wait = Duration::from_millis(500);
        for tries in 1..=TRIES {
            match self.context.artifacts.read_all(key).await {
                Ok(bytes) => return Some(bytes),
                Err(error @ ArtifactError::NotFound { .. }) => {
                    tracing::warn!(%error, "the checkpoint is gone; the model is grown from the beginning");
                    return None;
                }
                Err(error) => {
                    tracing::warn!(%error, tries, "the checkpoint could not be read");
                    tokio::time::sleep(wait).await;
                    wait *= 2;
                }
            }
        }
        None
    }

    /// Stores each checkpoint as it arrives, until dropped.
    pub(super) async fn store_all(&mut self, claimed: &ClaimedJob, mailbox: &Mailbox) -> Infallible {
        loop {
            self.store_next(claimed, mailbox).await;
        }
    }

    /// Stores the next checkpoint.
    pub(super) async fn store_next(&mut self, claimed: &ClaimedJob, mailbox: &Mailbox) {
        let bytes = mailbox.next().await;
        let size = bytes.len();
        match self.store(claimed, bytes.into()).await {
            Ok(()) => {
                self.context.options.metrics.checkpoint();
                tracing::info!(bytes = size, "checkpoint stored");
            }
            // Logged once, at the start of the outage.
            Err(ArtifactError::Store(cause)) => self.context.storage.write_failed(&cause),
            Err(error) => tracing::warn!(%error, "a checkpoint was not stored"),
        }
    }

    async fn store(&mut self, claimed: &ClaimedJob, bytes: Bytes) -> Result<(), ArtifactError> {
        self.count += 1;
        let name = format!("checkpoint-{}", self.count);
        let key = artifacts::key(claimed.job().id, claimed.attempt(), &name);
        let size = bytes.len() as u64;
        self.context.artifacts.put_bytes(&key, bytes).await?;
        self.context.options.metrics.bytes_in(size);
        match self.context.store.set_checkpoint(claimed, &key).await {
            Ok(before) => {
                self.named = Some(key);
                if let Some(before) = before {
                    self.remove(before).await;
                }
                Ok(())
            }
            Err(StoreError::Fenced) => {
                self.remove(key).await;
                Err(StoreError::Fenced.into())
            }
            // The record may name it or not: the file stays, and is swept if it does not.
            Err(error) => Err(error.into()),
        }
    }

    /// Removes the checkpoint of a job that has ended.
    pub(super) async fn remove_last(self) {
        if let Some(key) = &self.named {
            self.remove(key.clone()).await;
        }
    }

    async fn remove(&self, key: String) {
        if let Err(error) = self.context.artifacts.delete(&[key]).await {
            tracing::warn!(%error, "a checkpoint that is not needed is left to the sweep");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn checkpoints_are_taken_when_due_or_requested() {
        let never = Mailbox::new(None);
        never.request();
        assert!(!never.wants());
        let hourly = Mailbox::new(Some(Duration::from_secs(3600)));
        assert!(!hourly.wants());
        hourly.request();
        assert!(hourly.wants());
        hourly.put(vec![1]);
        assert!(!hourly.wants());
        assert_eq!(hourly.next().await, [1]);
        let always = Mailbox::new(Some(Duration::ZERO));
        assert!(always.wants());
        always.put(vec![2]);
        assert!(!always.wants(), "the last one has not been fetched yet");
        assert_eq!(always.next().await, [2]);
        assert!(always.wants());
    }
}
