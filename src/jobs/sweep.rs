//! What is kept and what is removed: models by age and by room, files that no record names.
//!
//! Only ended jobs are ever removed. The record goes first and the files after it, so a reader sees a whole model or
//! none; a file whose removal fails is an orphan, and goes with the next sweep of those.

use super::artifacts::{ArtifactError, Artifacts};
use super::store::{Store, StoreError};
use jiff::Timestamp;
use std::time::Duration;

/// Jobs asked for at a time.
const PAGE: u32 = 100;

/// How much is kept; `None` knows no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retention {
    /// Time after its end that a job is kept.
    pub age: Option<Duration>,
    /// Bytes of all files together. Over it, the models that ended first go.
    pub bytes: Option<u64>,
}

/// What a sweep found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Swept {
    /// Jobs removed.
    pub removed: u64,
    /// Bytes of the files of all jobs that are left.
    pub stored_bytes: u64,
}

impl Retention {
    /// Removes what is too old, then what there is no room for. Several processes may sweep at a time.
    ///
    /// # Errors
    /// [`StoreError`]; what was removed before stays removed. Files that could not be removed are only logged.
    pub async fn sweep(&self, store: &dyn Store, artifacts: &Artifacts, now: Timestamp) -> Result<Swept, StoreError> {
        let mut removed = 0;
        if let Some(age) = self.age {
            let before = now.saturating_sub(age).unwrap_or(Timestamp::MIN);
            loop {
                let old = store.ended_before(before, PAGE).await?;
                for &id in &old {
                    removed += u64::from(remove(store, artifacts, id).await?);
                }
                if old.len() < PAGE as usize {
                    break;
                }
            }
        }
        let mut stored_bytes = store.stored_bytes().await?;
        while self.bytes.is_some_and(|most| stored_bytes > most) {
            let oldest = store.ended_before(Timestamp::MAX, PAGE).await?;
            if oldest.is_empty() {
                break;
            }
            for id in oldest {
                removed += u64::from(remove(store, artifacts, id).await?);
                // Jobs may share files: only the store knows what is left.
                stored_bytes = store.stored_bytes().await?;
                if self.bytes.is_none_or(|most| stored_bytes <= most) {
                    break;
                }
            }
        }
        Ok(Swept { removed, stored_bytes })
    }
}

async fn remove(store: &dyn Store, artifacts: &Artifacts, id: super::JobId) -> Result<bool, StoreError> {
    let Some(keys) = store.delete(id).await? else {
        return Ok(false);
    };
    if let Err(error) = artifacts.delete(&keys).await {
        left_behind(&error);
    }
    tracing::info!(job = %id, "removed: its time or its room is over");
    Ok(true)
}

fn left_behind(error: &ArtifactError) {
    tracing::warn!(%error, "files of a removed model are left to the sweep of orphans");
}
