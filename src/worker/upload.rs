//! Moves the files of an attempt from its scratch directory to the artifact store.

use super::context::Context;
use super::progress::AttemptSink;
use super::verdict;
use crate::clock::Stopwatch;
use crate::generate::FileOutput;
use crate::jobs::artifacts::{self, ArtifactError};
use crate::jobs::fault::Injected;
use crate::jobs::{ClaimedJob, File};
use futures_util::future::join_all;
use std::path::Path;
use tokio_util::sync::CancellationToken;

/// How long an upload is retried while the artifact store is unavailable, in units of [`super::PoolOptions::storage_wait`].
const PATIENCE: u32 = 60;
/// Longest wait between two tries, in the same units.
const LONGEST_WAIT: u32 = 5;

/// Why the files are not in the artifact store.
#[derive(Debug, thiserror::Error)]
pub(super) enum UploadError {
    /// The artifact store refused a file through all tries.
    #[error("{name}: {cause} (tried {tries} times)")]
    Store { name: String, cause: String, tries: u32 },
    /// A file in scratch cannot be read because of the state of the disk.
    #[error("{0}")]
    Scratch(String),
    /// A file in scratch is not what the generator wrote.
    #[error("{0}")]
    Damaged(String),
    /// A test injected a fault.
    #[error(transparent)]
    Injected(#[from] Injected),
}

/// Files that were made, as the job's record will name them. Keys belong to this attempt alone.
pub(super) fn files(claimed: &ClaimedJob, outputs: &[FileOutput]) -> Vec<File> {
    outputs
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

/// Stores `files` from `dir` concurrently. While the artifact store is unavailable, each is retried for about a minute. The
/// stored size and checksum must be those that the generator reported. When this returns, no file is being written any
/// more; `stop` makes it give up at the next wait.
pub(super) async fn upload(
    context: &Context,
    sink: &AttemptSink,
    files: &[File],
    dir: &Path,
    stop: &CancellationToken,
) -> Result<(), UploadError> {
    sink.storing();
    let watch = Stopwatch::start();
    context.options.faults.point("store").await?;
    context.options.faults.point("before-upload").await?;
    // Once one file has failed, the others need no further try.
    let stop = stop.child_token();
    let put = async |file| {
        let put = put_with_retries(context, file, dir, &stop).await;
        put.inspect_err(|_| stop.cancel())
    };
    let failed = join_all(files.iter().map(put)).await.into_iter().filter_map(Result::err);
    // A file that was stopped by another has fewer tries than that one.
    let tries = |error: &UploadError| if let UploadError::Store { tries, .. } = error { *tries } else { u32::MAX };
    if let Some(error) = failed.max_by_key(tries) {
        return Err(error);
    }
    context.storage.upload_succeeded();
    context.options.faults.point("after-upload").await?;
    context.options.metrics.stage("store", watch.seconds());
    context.options.metrics.bytes_in(files.iter().map(|file| file.bytes).sum());
    Ok(())
}

async fn put_with_retries(
    context: &Context,
    file: &File,
    dir: &Path,
    stop: &CancellationToken,
) -> Result<(), UploadError> {
    let unit = context.options.storage_wait;
    let (mut wait, since) = (unit / 2, Stopwatch::start());
    for tries in 1.. {
        let error = match context.artifacts.put_file(&file.key, &dir.join(&file.name)).await {
            Ok(stored) if stored.bytes == file.bytes && stored.sha256 == file.sha256 => break,
            Ok(stored) => {
                let detail = format!("{}: read {} bytes with SHA-256 {}", file.name, stored.bytes, stored.sha256);
                return Err(UploadError::Damaged(format!("{detail}, not the {} bytes written", file.bytes)));
            }
            Err(ArtifactError::Scratch { path, source }) => {
                let detail = format!("reading {} failed: {source}", path.display());
                let is_disk = verdict::is_storage_fault(&source);
                return Err(if is_disk { UploadError::Scratch(detail) } else { UploadError::Damaged(detail) });
            }
            Err(error) => error.to_string(),
        };
        tracing::debug!(file = file.key, error, tries, "a file was not stored");
        if tries == 1 {
            context.storage.write_failed(&error);
        }
        let retries = since.elapsed() + wait < unit * PATIENCE;
        if !retries || stop.run_until_cancelled(tokio::time::sleep(wait)).await.is_none() {
            return Err(UploadError::Store { name: file.name.clone(), cause: error, tries });
        }
        wait = (wait * 2).min(unit * LONGEST_WAIT);
    }
    Ok(())
}

/// Removes files that no record will name. Those that cannot be removed now are left to the sweep of orphans.
pub(super) async fn remove(context: &Context, files: &[File]) {
    let keys: Vec<String> = files.iter().map(|file| file.key.clone()).collect();
    if let Err(error) = context.artifacts.delete(&keys).await {
        tracing::warn!(%error, "files of a failed attempt are left to the sweep");
    }
}
