//! Moves the files of an attempt from its scratch directory to the artifact store.

use super::context::Context;
use super::progress::AttemptSink;
use crate::clock::Stopwatch;
use crate::generate::FileOutput;
use crate::jobs::artifacts::{self, ArtifactError, Stored};
use crate::jobs::fault::Injected;
use crate::jobs::{ClaimedJob, File};
use futures_util::future::join_all;
use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};
use tokio_util::sync::CancellationToken;

/// Maximum time for which an upload is retried, in units of [`super::PoolOptions::storage_wait`].
const RETRY_LIMIT: u32 = 60;
/// Maximum wait between two retries, in the same units.
const MAX_WAIT: u32 = 5;
/// Maximum size of a file that is stored in the pack of its attempt, bytes. A write to disk or a
/// request takes longer than to copy so many bytes.
const SMALL: u64 = 256 << 10;
/// Name of the pack of an attempt, in its key.
const PACK: &str = "pack";

/// Reason why the files of an attempt are not in the artifact store.
#[derive(Debug, thiserror::Error)]
pub(super) enum UploadError {
    /// The artifact store refused a file at every retry.
    #[error("{name}: {source} (tried {tries} times)")]
    Store { name: String, source: ArtifactError, tries: u32 },
    /// A scratch file cannot be read.
    #[error("reading {} failed: {source}", .path.display())]
    Unreadable { path: PathBuf, source: io::Error },
    /// A scratch file differs from the file that the generator wrote.
    #[error("{name}: read {} bytes with SHA-256 {}, not the {written} bytes written", .read.bytes, .read.sha256)]
    Damaged { name: String, read: Stored, written: u64 },
    /// A test injected a fault.
    #[error(transparent)]
    Injected(#[from] Injected),
}

/// The output files as the record of the job will name them. Their keys belong to this attempt
/// alone. Several small files share the key of a pack.
pub(super) fn files(claimed: &ClaimedJob, outputs: &[FileOutput]) -> Vec<File> {
    let is_small = |file: &FileOutput| (1..=SMALL).contains(&file.bytes);
    let packs = outputs.iter().filter(|file| is_small(file)).count() > 1;
    let mut end = 0;
    let mut file = |file: &FileOutput| {
        let start = (packs && is_small(file)).then_some(end);
        if start.is_some() {
            end += file.bytes;
        }
        let object = if start.is_some() { PACK } else { &file.name };
        File {
            name: file.name.clone(),
            media_type: file.media_type.clone(),
            bytes: file.bytes,
            sha256: file.sha256.clone(),
            key: artifacts::key(claimed.job().id, claimed.attempt(), object),
            start,
        }
    };
    outputs.iter().map(&mut file).collect()
}

/// Stores `files` from `dir` concurrently. Each upload is retried for about a minute while the
/// artifact store is unavailable. The stored size and checksum must equal those that the generator
/// reported. No upload is in progress when this function returns; `stop` makes it give up at the
/// next wait.
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
    // Once one object has failed, the others are not retried.
    let stop = stop.child_token();
    let put = async |files: &[&File]| {
        let put = put_with_retries(context, files, dir, &stop).await;
        put.inspect_err(|_| stop.cancel())
    };
    let (packed, alone): (Vec<&File>, Vec<&File>) = files.iter().partition(|file| file.start.is_some());
    let objects = alone.chunks(1).chain(packed.chunks(packed.len().max(1)));
    let failed = join_all(objects.map(put)).await.into_iter().filter_map(Result::err);
    // The object that failed first has the most tries.
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

/// Stores the files of one object: a file alone, or those of the pack in their order.
async fn put_with_retries(
    context: &Context,
    files: &[&File],
    dir: &Path,
    stop: &CancellationToken,
) -> Result<(), UploadError> {
    let unit = context.options.storage_wait;
    let key = &files[0].key;
    let (mut wait, since) = (unit / 2, Stopwatch::start());
    for tries in 1.. {
        let put = match files {
            [file] => context.artifacts.put_file(key, &dir.join(&file.name)).await.map(|stored| vec![stored]),
            _ => context.artifacts.put_pack(key, files.iter().map(|file| dir.join(&file.name)).collect()).await,
        };
        let error = match put {
            Ok(stored) => {
                let differs =
                    |(file, read): &(&&File, Stored)| (file.bytes, &file.sha256) != (read.bytes, &read.sha256);
                return match files.iter().zip(stored).find(differs) {
                    None => Ok(()),
                    Some((file, read)) => {
                        Err(UploadError::Damaged { name: file.name.clone(), read, written: file.bytes })
                    }
                };
            }
            Err(ArtifactError::Scratch { path, source }) => return Err(UploadError::Unreadable { path, source }),
            Err(error) => error,
        };
        tracing::debug!(key, %error, tries, "could not store an object");
        if tries == 1 {
            context.storage.write_failed(&error);
        }
        let retries = since.elapsed() + wait < unit * RETRY_LIMIT;
        if !retries || stop.run_until_cancelled(tokio::time::sleep(wait)).await.is_none() {
            return Err(UploadError::Store { name: files[0].name.clone(), source: error, tries });
        }
        wait = (wait * 2).min(unit * MAX_WAIT);
    }
    Ok(())
}

/// Removes files that no record will name. The orphan sweep deletes files that cannot be removed.
pub(super) async fn remove(context: &Context, files: &[File]) {
    remove_keys(context, keys_of(files)).await;
}

/// Removes files of an attempt that no longer holds its job, except those that are in use. Another
/// attempt has the same number and keys if the database lost the claim of this one, as in a
/// fail-over to an asynchronous replica.
pub(super) async fn remove_unused(context: &Context, files: &[File]) {
    let mut keys = keys_of(files);
    match context.store.keys_in_use(&keys).await {
        Ok(used) => keys.retain(|key| !used.contains(key)),
        Err(error) => {
            tracing::warn!(%error, "could not find out whether the files of a lost attempt are in use; \
                the orphan sweep will delete them if not");
            return;
        }
    }
    remove_keys(context, keys).await;
}

/// The keys of the objects of files; that of a pack comes once.
fn keys_of(files: &[File]) -> Vec<String> {
    let keys: BTreeSet<String> = files.iter().map(|file| file.key.clone()).collect();
    keys.into_iter().collect()
}

async fn remove_keys(context: &Context, keys: Vec<String>) {
    if let Err(error) = context.artifacts.delete(&keys).await {
        tracing::warn!(%error, "could not delete the files of a failed attempt; the orphan sweep will delete them");
    }
}
