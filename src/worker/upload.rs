//! Files of an attempt on their way from its scratch folder to the artifact store.

use super::attempt::Context;
use super::live::Live;
use crate::clock::Stopwatch;
use crate::generate::Outcome;
use crate::jobs::fault::Injected;
use crate::jobs::{ClaimedJob, File, artifacts};
use futures_util::future::join_all;
use std::path::Path;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Why the files are not in the artifact store.
#[derive(Debug, thiserror::Error)]
pub(super) enum UploadError {
    /// The store stayed away, full or broken through all tries.
    #[error("{name}: {cause} (tried {tries} times)")]
    Storage { name: String, cause: String, tries: u32 },
    /// A test broke it.
    #[error(transparent)]
    Injected(#[from] Injected),
}

/// The files of an outcome as the job's record will name them. Keys belong to this attempt alone.
pub(super) fn files(claimed: &ClaimedJob, outcome: &Outcome) -> Vec<File> {
    outcome
        .files
        .iter()
        .map(|file| File {
            name: file.name.clone(),
            media_type: file.media_type.clone(),
            bytes: file.bytes,
            sha256: file.sha256.clone(),
            key: artifacts::key(claimed.job().id, claimed.attempt(), &file.name),
        })
        .collect()
}

/// Stores `files` from `dir`, all at the same time. Each is tried a few times with doubled waits; what arrives must have the
/// size and the checksum that the generator told. When it comes back none of them is on its way any more; `stop` makes that
/// soon.
pub(super) async fn upload(
    context: &Context,
    live: &Live,
    files: &[File],
    dir: &Path,
    stop: &CancellationToken,
) -> Result<(), UploadError> {
    live.storing();
    let watch = Stopwatch::start();
    context.options.faults.point("store").await?;
    context.options.faults.point("before-upload").await?;
    // Where one gives up, the others need no further try.
    let stop = stop.child_token();
    let put = async |file| {
        let put = put_patiently(context, file, dir, &stop).await;
        put.inspect_err(|_| stop.cancel())
    };
    let failed = join_all(files.iter().map(put)).await.into_iter().filter_map(Result::err).max_by_key(|f| f.tries);
    if let Some(Failed { name, cause, tries }) = failed {
        return Err(UploadError::Storage { name, cause, tries });
    }
    context.options.faults.point("after-upload").await?;
    context.options.metrics.stage("store", watch.seconds());
    context.options.metrics.bytes_in(files.iter().map(|file| file.bytes).sum());
    Ok(())
}

/// A file that could not be stored.
struct Failed {
    name: String,
    cause: String,
    tries: u32,
}

async fn put_patiently(context: &Context, file: &File, dir: &Path, stop: &CancellationToken) -> Result<(), Failed> {
    let mut wait = context.options.storage_wait;
    let tries = context.options.storage_tries.max(1);
    for tried in 1..=tries {
        let Err(cause) = put(context, file, &dir.join(&file.name)).await else { break };
        tracing::warn!(file = file.key, %cause, tried, "storing a file failed");
        let waits = tried < tries && stop.run_until_cancelled(tokio::time::sleep(wait)).await.is_some();
        if !waits {
            return Err(Failed { name: file.name.clone(), cause, tries: tried });
        }
        wait = (wait * 2).min(Duration::from_secs(30));
    }
    Ok(())
}

async fn put(context: &Context, file: &File, path: &Path) -> Result<(), String> {
    let stored = context.artifacts.put_file(&file.key, path).await.map_err(|error| error.to_string())?;
    if stored.bytes == file.bytes && stored.sha256 == file.sha256 {
        Ok(())
    } else {
        Err(format!("{} bytes with sha256 {} went up, not what was written", stored.bytes, stored.sha256))
    }
}

/// Removes files that no record will name. What cannot be removed now goes with the sweep of orphans.
pub(super) async fn remove(context: &Context, files: &[File]) {
    let keys: Vec<String> = files.iter().map(|file| file.key.clone()).collect();
    if let Err(error) = context.artifacts.delete(&keys).await {
        tracing::warn!(%error, "files of a broken attempt are left to the sweep");
    }
}
