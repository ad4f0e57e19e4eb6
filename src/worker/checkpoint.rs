//! Checkpoints of an attempt: from the generating thread to the artifact store, and back to the
//! next attempt.
//!
//! A checkpoint is stored under a separate key before the record of the job names it, and the
//! previous one is removed afterwards. Therefore the record names a complete checkpoint or none at
//! any time. A lost checkpoint costs time but never a model, so no failure here ends an attempt.

use super::context::Context;
use crate::clock::Stopwatch;
use crate::jobs::artifacts::{self, ArtifactError};
use crate::jobs::scratch::drop_blocking;
use crate::jobs::{ClaimedJob, StoreError};
use crate::lock::Mutex;
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tempfile::TempPath;
use tokio::sync::Notify;

/// File name of the checkpoint from which an attempt resumes.
const NAME: &str = "resumed.checkpoint";
/// Minimum time between checkpoints, in units of the time to store one.
const STORE_TIMES: u32 = 10;
/// Number of tries to read a checkpoint before the job starts from the beginning.
const TRIES: u32 = 3;

/// Passes checkpoints from the generating thread to the task that stores them. Holds one at a time.
#[derive(Debug)]
pub(super) struct Mailbox {
    state: Mutex<MailboxState>,
    /// Time between checkpoints; `None` takes none.
    every: Option<Duration>,
    arrived: Notify,
}

#[derive(Debug)]
struct MailboxState {
    /// Time since the last checkpoint or the start.
    since: Stopwatch,
    /// A checkpoint that has not been fetched yet.
    checkpoint: Option<Saved>,
    /// True if a checkpoint is requested immediately.
    requested: bool,
    /// Time that the last checkpoint took to store.
    cost: Duration,
    /// True after the first checkpoint.
    has_taken: bool,
}

/// A checkpoint on its way to the artifact store.
#[derive(Debug)]
pub(super) enum Saved {
    /// A checkpoint in a file, which dropping this value removes.
    File(TempPath),
    Bytes(Vec<u8>),
}

impl Mailbox {
    pub(super) fn new(every: Option<Duration>) -> Self {
        let state = MailboxState {
            since: Stopwatch::start(),
            checkpoint: None,
            requested: false,
            cost: Duration::ZERO,
            has_taken: false,
        };
        Self { state: Mutex::new(state), every, arrived: Notify::new() }
    }

    /// True if checkpoints are taken at all.
    pub(super) fn is_enabled(&self) -> bool {
        self.every.is_some()
    }

    /// Requests a checkpoint at the next step, if checkpoints are taken at all.
    pub(super) fn request(&self) {
        self.state.lock().requested = self.is_enabled();
    }

    /// True if the generation should take a checkpoint at this step.
    pub(super) fn wants(&self) -> bool {
        let Some(every) = self.every else { return false };
        let state = self.state.lock();
        // A checkpoint that has not been fetched yet goes first.
        state.requested || (state.checkpoint.is_none() && state.since.elapsed() >= every.max(state.cost * STORE_TIMES))
    }

    /// Adds a checkpoint to be stored.
    pub(super) fn put(&self, checkpoint: Saved) {
        let mut state = self.state.lock();
        state.since = Stopwatch::start();
        state.checkpoint = Some(checkpoint);
        state.requested = false;
        state.has_taken = true;
        self.arrived.notify_one();
    }

    /// True if this attempt has taken a checkpoint.
    pub(super) fn has_taken(&self) -> bool {
        self.state.lock().has_taken
    }

    /// Reports the time that the last fetched checkpoint took to store.
    fn stored(&self, cost: Duration) {
        self.state.lock().cost = cost;
    }

    /// Reports that the generation starts from the beginning.
    pub(super) fn restart(&self) {
        self.state.lock().since = Stopwatch::start();
    }

    /// Waits for the next checkpoint.
    async fn next(&self) -> Saved {
        loop {
            let arrived = self.arrived.notified();
            if let Some(checkpoint) = self.state.lock().checkpoint.take() {
                return checkpoint;
            }
            arrived.await;
        }
    }
}

/// The stored checkpoints of one attempt.
pub(super) struct Checkpoints<'a> {
    context: &'a Context,
    /// Key that the record names.
    named: Option<String>,
    count: u32,
}

impl<'a> Checkpoints<'a> {
    pub(super) fn new(context: &'a Context, claimed: &ClaimedJob) -> Self {
        Self { context, named: claimed.job().checkpoint.clone(), count: 0 }
    }

    /// Copies the checkpoint of an earlier attempt to a file in `dir`.
    pub(super) async fn load(&self, dir: &Path) -> Option<PathBuf> {
        let key = self.named.as_deref()?;
        let path = dir.join(NAME);
        let mut wait = Duration::from_millis(500);
        for tries in 1..=TRIES {
            match self.context.artifacts.get_file(key, &path).await {
                Ok(()) => return Some(path),
                Err(error @ ArtifactError::NotFound { .. }) => {
                    tracing::warn!(%error, "the checkpoint no longer exists; the model starts from the beginning");
                    return None;
                }
                Err(error) => {
                    tracing::warn!(%error, tries, "could not read the checkpoint; the attempt will retry");
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
        let checkpoint = mailbox.next().await;
        let watch = Stopwatch::start();
        match self.store(claimed, checkpoint).await {
            Ok(bytes) => {
                mailbox.stored(watch.elapsed());
                self.context.options.metrics.checkpoint();
                tracing::info!(bytes, "stored a checkpoint");
            }
            // Logged once, at the start of the outage.
            Err(error @ ArtifactError::Store(_)) => self.context.storage.write_failed(&error),
            Err(error) => tracing::warn!(%error, "could not store a checkpoint; the attempt continues without it"),
        }
    }

    /// Stores a checkpoint, records its key, and returns its size in bytes.
    async fn store(&mut self, claimed: &ClaimedJob, checkpoint: Saved) -> Result<u64, ArtifactError> {
        self.count += 1;
        let name = format!("checkpoint-{}", self.count);
        let key = artifacts::key(claimed.job().id, claimed.attempt(), &name);
        let size = match checkpoint {
            Saved::File(path) => {
                let stored = self.context.artifacts.put_file(&key, &path).await;
                drop_blocking(path).await;
                stored?.bytes
            }
            Saved::Bytes(bytes) => {
                let size = bytes.len() as u64;
                self.context.artifacts.put_bytes(&key, bytes.into()).await?;
                size
            }
        };
        self.context.options.metrics.bytes_in(size);
        match self.context.store.set_checkpoint(claimed, &key).await {
            Ok(before) => {
                self.named = Some(key);
                if let Some(before) = before {
                    self.remove(before).await;
                }
                Ok(size)
            }
            Err(StoreError::Fenced) => {
                self.remove(key).await;
                Err(StoreError::Fenced.into())
            }
            // The record may name the file or not, so the file stays. If it is an orphan, the sweep
            // deletes it.
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
            tracing::warn!(%error, "could not delete an old checkpoint; the orphan sweep will delete it");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn saved() -> Saved {
        Saved::Bytes(vec![1])
    }

    #[tokio::test]
    async fn checkpoints_are_taken_when_due_or_requested() {
        let never = Mailbox::new(None);
        never.request();
        assert!(!never.wants());
        let hourly = Mailbox::new(Some(Duration::from_secs(3600)));
        assert!(!hourly.wants());
        hourly.request();
        assert!(hourly.wants());
        hourly.put(saved());
        assert!(!hourly.wants());
        assert!(matches!(hourly.next().await, Saved::Bytes(bytes) if bytes == [1]));
        let always = Mailbox::new(Some(Duration::ZERO));
        assert!(always.wants());
        always.put(saved());
        assert!(!always.wants(), "the last one has not been fetched yet");
        always.next().await;
        assert!(always.wants());
        always.stored(Duration::from_secs(60));
        assert!(!always.wants(), "storing takes a minute");
        always.request();
        assert!(always.wants());
    }
}
