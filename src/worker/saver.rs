//! Checkpoints of an attempt on their way to the artifact store, and back to the next attempt.
//!
//! A checkpoint is stored under a key of its own before the job's record names it, and the one before is removed
//! after that: whatever happens in between, the record names a whole checkpoint or none. Losing one costs time, never
//! a model, so no failure here ends an attempt.

use super::attempt::Context;
use super::live::Live;
use crate::jobs::artifacts::{self, ArtifactError};
use crate::jobs::{ClaimedJob, StoreError};
use bytes::Bytes;
use std::convert::Infallible;
use std::time::Duration;

/// Tries to read a checkpoint before the job begins anew.
const TRIES: u32 = 3;

/// Stores the checkpoints of one attempt.
pub(super) struct Saver<'a> {
    context: &'a Context,
    claimed: &'a ClaimedJob,
    live: &'a Live,
    /// The key that the record names.
    named: Option<String>,
    count: u32,
}

impl<'a> Saver<'a> {
    pub(super) fn new(context: &'a Context, claimed: &'a ClaimedJob, live: &'a Live) -> Self {
        Self { context, claimed, live, named: claimed.job().checkpoint.clone(), count: 0 }
    }

    /// The checkpoint that an earlier attempt left.
    pub(super) async fn load(&self) -> Option<Bytes> {
        let key = self.named.as_deref()?;
        let mut wait = Duration::from_millis(500);
        for tried in 1..=TRIES {
            match self.context.artifacts.read_all(key).await {
                Ok(bytes) => return Some(bytes),
                Err(error @ ArtifactError::NotFound { .. }) => {
                    tracing::warn!(%error, "the checkpoint is gone: the model is grown anew");
                    return None;
                }
                Err(error) => {
                    tracing::warn!(%error, tried, "the checkpoint could not be read");
                    tokio::time::sleep(wait).await;
                    wait *= 2;
                }
            }
        }
        None
    }

    /// Stores each checkpoint as it comes, until it is dropped.
    pub(super) async fn run(&mut self) -> Infallible {
        loop {
            self.save_next().await;
        }
    }

    /// Stores the next checkpoint.
    pub(super) async fn save_next(&mut self) {
        let bytes = self.live.next_checkpoint().await;
        let size = bytes.len();
        match self.save(bytes.into()).await {
            Ok(()) => {
                self.context.options.metrics.checkpoint();
                tracing::info!(bytes = size, "checkpoint stored");
            }
            Err(error) => tracing::warn!(%error, "a checkpoint was not stored"),
        }
    }

    async fn save(&mut self, bytes: Bytes) -> Result<(), ArtifactError> {
        self.count += 1;
        let name = format!("checkpoint-{}", self.count);
        let key = artifacts::key(self.claimed.job().id, self.claimed.attempt(), &name);
        let size = bytes.len() as u64;
        self.context.artifacts.put_bytes(&key, bytes).await?;
        self.context.options.metrics.bytes_in(size);
        match self.context.store.set_checkpoint(self.claimed, &key).await {
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
            // Whether it was named is not known: the file stays, and goes with the sweep if it was not.
            Err(error) => Err(error.into()),
        }
    }

    /// The key that the record names: to be removed once the job has ended.
    pub(super) fn named(&self) -> Option<String> {
        self.named.clone()
    }

    async fn remove(&self, key: String) {
        if let Err(error) = self.context.artifacts.delete(&[key]).await {
            tracing::warn!(%error, "a checkpoint that is not needed is left to the sweep");
        }
    }
}
