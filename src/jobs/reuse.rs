//! Reuse of finished models, only if their files still exist.
//!
//! The job store cannot ask the artifact store within a transaction. So files are looked for before the submission, and
//! keys without a file are passed to it. A model deleted after the look is no candidate any more: its record is deleted
//! before its files.

use super::artifacts::Artifacts;
use super::job::NewJob;
use super::store::{Store, StoreError};
use futures_util::future::BoxFuture;
use futures_util::{FutureExt, StreamExt, TryStreamExt};

/// Jobs looked for at a time.
const AT_A_TIME: usize = 16;

/// Sees to it that none of `jobs` reuses a model whose files are missing: fills [`NewJob::missing`]. If the artifact store
/// does not answer, clears [`NewJob::reuse`].
///
/// # Errors
/// [`StoreError`].
pub async fn exclude_missing_files(
    store: &dyn Store,
    artifacts: &Artifacts,
    jobs: &mut [NewJob],
) -> Result<(), StoreError> {
    let each: Vec<BoxFuture<'_, _>> = jobs.iter_mut().map(|new| exclude(store, artifacts, new).boxed()).collect();
    futures_util::stream::iter(each).buffer_unordered(AT_A_TIME).try_collect().await
}

async fn exclude(store: &dyn Store, artifacts: &Artifacts, new: &mut NewJob) -> Result<(), StoreError> {
    // Each round excludes the model that it found, with all that share the missing file.
    while let Some(model) = store.reusable(new).await? {
        let keys: Vec<String> = model.files.into_iter().map(|file| file.key).collect();
        match artifacts.missing(&keys).await {
            Ok(missing) if missing.is_empty() => break,
            Ok(missing) => {
                tracing::warn!(job = %model.id, ?missing, "files of a finished model are missing; it is not reused");
                new.missing.extend(missing);
            }
            Err(error) => {
                tracing::warn!(job = %model.id, %error, "the files of a finished model could not be checked; it is not reused");
                new.reuse = false;
            }
        }
    }
    Ok(())
}
