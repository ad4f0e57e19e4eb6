//! Comparison of the whole artifact store with the records of the job store. Changes nothing.

use super::artifacts::{ArtifactError, Artifacts, MODELS};
use super::job::{File, JobId};
use super::sql::Store;
use futures_util::{StreamExt, TryStreamExt, stream};

/// Number of files that one query reads.
const PAGE: u32 = 1000;
/// Number of files that are read at the same time.
const READS: usize = 4;
/// Number of consecutive files that cannot be read, after which the store counts as unavailable.
const UNREADABLE: u32 = 10;

/// Difference between the records and the artifact store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Difference {
    /// Records name a file that does not exist.
    Missing {
        /// Name of the file.
        name: String,
        /// Key of its object.
        key: String,
        /// Jobs whose records name it.
        jobs: Vec<JobId>,
    },
    /// A file is not the one that records describe, or cannot be read.
    Damaged {
        /// Name of the file.
        name: String,
        /// Key of its object.
        key: String,
        /// Jobs whose records name it.
        jobs: Vec<JobId>,
        /// The difference, or the error.
        detail: String,
    },
    /// No record names the object, and no attempt that writes it runs.
    Unknown {
        /// Key of the object.
        key: String,
    },
}

/// Number and size of the files that were read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scrubbed {
    /// Files that records name; a file of several models counts once.
    pub files: u64,
    /// Their size by the records, bytes.
    pub bytes: u64,
}

/// Reads every file that a record names and compares it with the record, then lists all files
/// without a record. Calls `found` for each difference. Models may be made and deleted meanwhile.
///
/// # Errors
/// [`ArtifactError::Jobs`]; [`ArtifactError::Store`] if the artifact store cannot be listed, or if
/// ten files one after the other cannot be read.
pub async fn scrub(
    store: &Store,
    artifacts: &Artifacts,
    mut found: impl FnMut(Difference),
) -> Result<Scrubbed, ArtifactError> {
    let mut scrubbed = Scrubbed::default();
    let (mut after, mut unreadable) = (None, 0);
    loop {
        let page = store.files_after(after.as_ref(), PAGE).await?;
        let Some(last) = page.last() else { break };
        after = Some(last.clone());
        let reads = page.into_iter().map(async |file| {
            let read = read(artifacts, &file).await;
            (file, read)
        });
        let mut reads = stream::iter(reads).buffered(READS);
        while let Some((file, read)) = reads.next().await {
            scrubbed.files += 1;
            scrubbed.bytes += file.bytes;
            let Err(error) = read else {
                unreadable = 0;
                continue;
            };
            let jobs = store.jobs_with_file(&file).await?;
            let File { name, key, .. } = file;
            let is_differing = matches!(error, ArtifactError::NotFound { .. } | ArtifactError::Damaged { .. });
            unreadable = if is_differing { 0 } else { unreadable + 1 };
            match error {
                // Deleted since the page was read.
                _ if jobs.is_empty() => {}
                ArtifactError::NotFound { .. } => found(Difference::Missing { name, key, jobs }),
                ArtifactError::Damaged { detail, .. } => found(Difference::Damaged { name, key, jobs, detail }),
                error if unreadable >= UNREADABLE => return Err(error),
                error => found(Difference::Damaged { name, key, jobs, detail: error.to_string() }),
            }
        }
    }
    let mut listing = artifacts.listing(MODELS);
    loop {
        let page = listing.next().await?;
        if page.is_empty() {
            return Ok(scrubbed);
        }
        let keys: Vec<String> = page.into_iter().map(|object| object.key).collect();
        let used = store.keys_in_use(&keys).await?;
        let unknown: Vec<String> = keys.into_iter().filter(|key| !used.contains(key)).collect();
        // Files of models that were deleted since the page was listed. Names with `#` are those of
        // interrupted uploads, which only a listing shows.
        let gone = artifacts.missing(&unknown).await?;
        for key in unknown.into_iter().filter(|key| key.contains('#') || !gone.contains(key)) {
            found(Difference::Unknown { key });
        }
    }
}

/// Reads a file to its end.
async fn read(artifacts: &Artifacts, file: &File) -> Result<(), ArtifactError> {
    artifacts.open(file, None).await?.try_for_each(async |_| Ok(())).await
}
