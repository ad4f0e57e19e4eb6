//! What is kept and what is removed: models by age and by room, files that no record names.
//!
//! Only ended jobs are ever removed. The record goes first and the files after it, so a reader sees a whole model or
//! none; a file whose removal fails is an orphan, and goes with the next sweep of those.

use super::artifacts::{ArtifactError, Artifacts};
use super::store::{Store, StoreError};
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
    /// Bytes of the files of all jobs that are left, where there is a limit to them.
    pub stored_bytes: Option<u64>,
}

impl Retention {
    /// Removes what is too old, then what there is no room for; how old is by the store's clock. Several processes may sweep
    /// at a time.
    ///
    /// # Errors
    /// [`StoreError`]; what was removed before stays removed. Files that could not be removed are only logged.
    pub async fn sweep(&self, store: &dyn Store, artifacts: &Artifacts) -> Result<Swept, StoreError> {
        let mut swept = Swept::default();
        if let Some(age) = self.age {
            // An age of nothing is the least that there is.
            let age = age.max(Duration::from_micros(1));
            loop {
                let old = store.ended_before(age, PAGE).await?;
                for &id in &old {
                    swept.removed += u64::from(remove(store, artifacts, id).await?.is_some());
                }
                if old.len() < PAGE as usize {
                    break;
                }
            }
        }
        if let Some(most) = self.bytes {
            // Summed once; what is removed is taken off.
            let mut stored = store.stored_bytes().await?;
            'all: while stored > most {
                let oldest = store.ended_before(Duration::ZERO, PAGE).await?;
                if oldest.is_empty() {
                    break;
                }
                for id in oldest {
                    let freed = remove(store, artifacts, id).await?;
                    swept.removed += u64::from(freed.is_some());
                    stored = stored.saturating_sub(freed.unwrap_or_default());
                    if stored <= most {
                        break 'all;
                    }
                }
            }
            swept.stored_bytes = Some(stored);
        }
        Ok(swept)
    }
}

/// Removes a model; gives the bytes of the files that no other has, `None` where somebody else has removed it.
async fn remove(store: &dyn Store, artifacts: &Artifacts, id: super::JobId) -> Result<Option<u64>, StoreError> {
    // One that has ended does not change any more.
    let files = store.get(id).await?.map(|job| job.files).unwrap_or_default();
    let Some(keys) = store.delete(id).await? else {
        return Ok(None);
    };
    if let Err(error) = artifacts.delete(&keys).await {
        left_behind(&error);
    }
    tracing::info!(job = %id, "removed: its time or its room is over");
    Ok(Some(files.iter().filter(|file| keys.contains(&file.key)).map(|file| file.bytes).sum()))
}

fn left_behind(error: &ArtifactError) {
    tracing::warn!(%error, "files of a removed model are left to the sweep of orphans");
}
