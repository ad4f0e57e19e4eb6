//! Reuse of finished models whose files still exist.
//!
//! The job store cannot ask the artifact store within a transaction. Therefore a submission is
//! preceded by a search for missing files, and receives their keys. A model that is deleted after
//! the search is not reused, because its record is deleted before its files.

use super::artifacts::Artifacts;
use super::error::StoreError;
use super::job::NewJob;
use super::sql::Store;
use futures_util::future::BoxFuture;
use futures_util::{FutureExt, StreamExt, TryStreamExt};
use std::collections::BTreeSet;

/// Number of jobs whose files are searched for concurrently.
const CONCURRENT: usize = 16;

/// Prevents `jobs` from reusing models with missing files: fills in [`NewJob::missing`], or clears
/// [`NewJob::reuse`] if the artifact store does not respond.
///
/// # Errors
/// [`StoreError`].
pub async fn exclude_missing_files(
    store: &Store,
    artifacts: &Artifacts,
    jobs: &mut [NewJob],
) -> Result<(), StoreError> {
    let each: Vec<BoxFuture<'_, _>> = jobs.iter_mut().map(|new| exclude(store, artifacts, new).boxed()).collect();
    futures_util::stream::iter(each).buffer_unordered(CONCURRENT).try_collect().await
}

async fn exclude(store: &Store, artifacts: &Artifacts, new: &mut NewJob) -> Result<(), StoreError> {
    // Each round excludes the model that it found, and all models that share the missing file.
    while let Some(model) = store.reusable(new).await? {
        // Packed files share a key.
        let keys: BTreeSet<String> = model.files.into_iter().map(|file| file.key).collect();
        let keys = Vec::from_iter(keys);
        match artifacts.missing(&keys).await {
            Ok(missing) if missing.is_empty() => break,
            Ok(missing) => {
                tracing::warn!(job = %model.id, ?missing, "files of a finished model are missing; the model is not reused");
                new.missing.extend(missing);
            }
            Err(error) => {
                tracing::warn!(job = %model.id, %error, "could not check the files of a finished model; the model is not reused");
                new.reuse = false;
            }
        }
    }
    Ok(())
}
