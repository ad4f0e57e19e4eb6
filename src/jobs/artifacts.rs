//! Files of models, through object_store (the only user of it).
//!
//! Invariants: a key shows either nothing or the whole file (a local file is staged beside its place, synced
//! and renamed; an object store makes an upload visible at its end); a key belongs to one attempt
//! ([`key`]), so that two attempts never write the same one; a file counts only once a job's record names it,
//! what no record names is swept away ([`Artifacts::sweep_orphans`]). A file is hashed while it goes up, and its size
//! compared once it is there.

mod s3;

use super::job::{JobId, Status};
use super::store::{Store, StoreError};
use bytes::Bytes;
use futures_util::stream::BoxStream;
use futures_util::{StreamExt, TryStreamExt};
use jiff::Timestamp;
use object_store::buffered::BufWriter;
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{GetOptions, GetRange, ObjectStore, ObjectStoreExt};
use sha2::{Digest, Sha256};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

/// Files up to this size go up in one request, greater ones in parts of it. S3 wants at least 5 MiB.
const PART: usize = 8 << 20;
/// Bytes read from a scratch file at a time.
const CHUNK: usize = 1 << 20;

/// Why the artifact store refused or failed.
#[derive(Debug, thiserror::Error)]
pub enum ArtifactError {
    /// There is no such file.
    #[error("no file has the key {key}")]
    NotFound {
        /// The key.
        key: String,
    },
    /// The range lies outside the file.
    #[error("the range lies outside the file: {0}")]
    Range(String),
    /// A scratch file could not be read.
    #[error("reading {path} failed")]
    Scratch {
        /// The file.
        path: PathBuf,
        /// Cause.
        #[source]
        source: std::io::Error,
    },
    /// The store is away, full or broken.
    #[error("the artifact store failed: {0}")]
    Store(String),
    /// The job store, asked whether a key is in use, failed.
    #[error(transparent)]
    Jobs(#[from] StoreError),
}

impl From<object_store::Error> for ArtifactError {
    fn from(error: object_store::Error) -> Self {
        match error {
            object_store::Error::NotFound { path, .. } => Self::NotFound { key: path },
            other => Self::Store(chain(&other)),
        }
    }
}

/// An error with its causes, in one line.
fn chain(error: &dyn std::error::Error) -> String {
    let mut line = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let cause_line = cause.to_string();
        if !line.contains(&cause_line) {
            line = format!("{line}: {cause_line}");
        }
        source = cause.source();
    }
    line
}

/// What was stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stored {
    /// Size.
    pub bytes: u64,
    /// SHA-256 of the bytes as they went up, lower-case hex.
    pub sha256: String,
}

/// A file, or part of one, on its way out.
pub struct Download {
    /// Size of the whole file.
    pub size: u64,
    /// The bytes that `stream` carries.
    pub range: Range<u64>,
    /// The bytes.
    pub stream: BoxStream<'static, Result<Bytes, ArtifactError>>,
}

impl std::fmt::Debug for Download {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Download").field("size", &self.size).field("range", &self.range).finish_non_exhaustive()
    }
}

/// The key of a file that an attempt makes.
#[must_use]
pub fn key(job: JobId, attempt: u32, name: &str) -> String {
    format!("models/{job}/{attempt}/{name}")
}

/// Where the files of models are kept. Clones share it.
#[derive(Clone, Debug)]
pub struct Artifacts {
    store: Arc<dyn ObjectStore>,
    /// Root on this machine's disk, where it is there.
    local: Option<PathBuf>,
    /// What signs addresses, where the store knows such.
    signing: Option<s3::Signing>,
    outage: Arc<Mutex<Option<String>>>,
}

impl Artifacts {
    /// Files under the folder `root`, which is made where there is none. A file survives the loss of power once
    /// [`Artifacts::put_file`] has returned.
    ///
    /// # Errors
    /// [`ArtifactError::Store`] where the folder cannot be made or opened.
    pub fn local(root: &Path) -> Result<Self, ArtifactError> {
        std::fs::create_dir_all(root).map_err(|e| ArtifactError::Store(format!("{}: {e}", root.display())))?;
        let store = LocalFileSystem::new_with_prefix(root)?.with_fsync(true).with_automatic_cleanup(true);
        Ok(Self { store: Arc::new(store), local: Some(root.to_owned()), signing: None, outage: Arc::default() })
    }

    /// Files in any object store.
    #[must_use]
    pub fn over(store: Arc<dyn ObjectStore>) -> Self {
        Self { store, local: None, signing: None, outage: Arc::default() }
    }

    /// Stores the file at `path` under `key`, streaming it; nothing is visible until all is.
    ///
    /// # Errors
    /// [`ArtifactError::Scratch`], [`ArtifactError::Store`]; then nothing is visible.
    pub async fn put_file(&self, key: &str, path: &Path) -> Result<Stored, ArtifactError> {
        let stored = match read_small(path).await? {
            Some((bytes, stored)) => {
                self.store.put(&Key::from(key), bytes.into()).await?;
                stored
            }
            None => self.put_in_parts(key, path).await?,
        };
        let there = self.store.head(&Key::from(key)).await?.size;
        if there != stored.bytes {
            return Err(ArtifactError::Store(format!("{} bytes went up to {key}, {there} are there", stored.bytes)));
        }
        Ok(stored)
    }

    async fn put_in_parts(&self, key: &str, path: &Path) -> Result<Stored, ArtifactError> {
        let scratch = |source| ArtifactError::Scratch { path: path.to_owned(), source };
        let mut file = tokio::fs::File::open(path).await.map_err(scratch)?;
        let mut upload = BufWriter::with_capacity(Arc::clone(&self.store), Key::from(key), PART);
        let mut hash = Sha256::new();
        let mut bytes = 0u64;
        loop {
            let mut chunk = bytes::BytesMut::with_capacity(CHUNK);
            let read = match file.read_buf(&mut chunk).await {
                Ok(read) => read,
                Err(source) => {
                    // The upload is given up; what it left is swept with the orphans where this fails too.
                    let _ = upload.abort().await;
                    return Err(scratch(source));
                }
            };
            if read == 0 {
                break;
            }
            bytes += read as u64;
            hash.update(&chunk);
            if let Err(error) = upload.put(chunk.freeze()).await {
                let _ = upload.abort().await;
                return Err(error.into());
            }
        }
        upload.shutdown().await.map_err(|error| ArtifactError::Store(chain(&error)))?;
        Ok(Stored { bytes, sha256: hex::encode(hash.finalize()) })
    }

    /// Stores bytes under `key`; nothing is visible until all is.
    ///
    /// # Errors
    /// [`ArtifactError::Store`].
    pub async fn put_bytes(&self, key: &str, bytes: Bytes) -> Result<(), ArtifactError> {
        let mut upload = BufWriter::with_capacity(Arc::clone(&self.store), Key::from(key), PART);
        if let Err(error) = upload.put(bytes).await {
            let _ = upload.abort().await;
            return Err(error.into());
        }
        upload.shutdown().await.map_err(|error| ArtifactError::Store(chain(&error)))
    }

    /// The file under `key`, or the bytes of it in `range`, cut to its end.
    ///
    /// # Errors
    /// [`ArtifactError::NotFound`]; [`ArtifactError::Range`] for a range that is empty or begins after the end.
    pub async fn get_range(&self, key: &str, range: Option<Range<u64>>) -> Result<Download, ArtifactError> {
        let location = Key::from(key);
        let range = match range {
            None => None,
            Some(range) => {
                let size = self.store.head(&location).await?.size;
                if range.start >= range.end || range.start >= size {
                    return Err(ArtifactError::Range(format!("{}..{} of {size} bytes", range.start, range.end)));
                }
                Some(range.start..range.end.min(size))
            }
        };
        let options = GetOptions { range: range.map(GetRange::Bounded), ..GetOptions::default() };
        let result = self.store.get_opts(&location, options).await?;
        let (size, range) = (result.meta.size, result.range.clone());
        Ok(Download { size, range, stream: result.into_stream().map_err(ArtifactError::from).boxed() })
    }

    /// The whole file under `key`.
    ///
    /// # Errors
    /// [`ArtifactError::NotFound`], [`ArtifactError::Store`].
    pub async fn read_all(&self, key: &str) -> Result<Bytes, ArtifactError> {
        Ok(self.store.get(&Key::from(key)).await?.bytes().await?)
    }

    /// Removes files; those that are not there are passed over.
    ///
    /// # Errors
    /// The first error, after all have been tried.
    pub async fn delete(&self, keys: &[String]) -> Result<(), ArtifactError> {
        let mut first = Ok(());
        // Some stores remove a thousand in one request.
        let locations: Vec<_> = keys.iter().map(|key| Ok(Key::from(key.as_str()))).collect();
        let mut removed = self.store.delete_stream(futures_util::stream::iter(locations).boxed());
        while let Some(result) = removed.next().await {
            match result {
                Ok(_) | Err(object_store::Error::NotFound { .. }) => {}
                Err(error) if first.is_ok() => first = Err(error.into()),
                Err(_) => {}
            }
        }
        first
    }

    /// Fails if the store cannot be reached.
    ///
    /// # Errors
    /// [`ArtifactError::Store`].
    pub async fn ready(&self) -> Result<(), ArtifactError> {
        match self.store.head(&Key::from("models/ready")).await {
            Ok(_) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Writes, and removes, a small file under `probe/`, and notes whether that worked: see [`Artifacts::outage`].
    ///
    /// # Errors
    /// [`ArtifactError::Store`].
    pub async fn check(&self) -> Result<(), ArtifactError> {
        let key = format!("probe/{}", uuid::Uuid::new_v4());
        let written = self.put_bytes(&key, Bytes::from_static(&[0; 4096])).await;
        // What stays of a probe is removed by the sweep of orphans.
        let _ = self.delete(&[key]).await;
        self.note(written)
    }

    /// The error of the latest write; `None` if it succeeded, or if there was none yet.
    #[must_use]
    pub fn outage(&self) -> Option<String> {
        self.outage.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn note<T>(&self, result: Result<T, ArtifactError>) -> Result<T, ArtifactError> {
        let outage = match &result {
            Err(ArtifactError::Store(error)) => Some(error.clone()),
            _ => None,
        };
        *self.outage.lock().unwrap_or_else(PoisonError::into_inner) = outage;
        result
    }

    /// Removes files older than `age` that no job names: left by attempts that lost their lease, or by a
    /// process that died between upload and commit. Those of an attempt that runs now stay whatever their times say: the
    /// clock that these are by may be another. Returns how many were removed.
    ///
    /// # Errors
    /// [`ArtifactError::Store`], [`ArtifactError::Jobs`]; what was removed before stays removed.
    pub async fn sweep_orphans(&self, jobs: &dyn Store, now: Timestamp, age: Duration) -> Result<u64, ArtifactError> {
        let before = now.saturating_sub(age).unwrap_or(Timestamp::MIN).as_microsecond();
        let mut removed = 0;
        let mut listing = self.store.list(Some(&Key::from("models")));
        while let Some(object) = listing.next().await {
            let object = object?;
            let key = object.location.as_ref();
            // In this order: what is committed in between is named by then.
            if object.last_modified.timestamp_micros() < before
                && !is_in_the_making(jobs, key).await?
                && !jobs.names_key(key).await?
            {
                self.delete(&[object.location.to_string()]).await?;
                removed += 1;
            }
        }
        if let Some(root) = self.local.clone() {
            let folder = root.join("models");
            let listing = tokio::task::spawn_blocking(move || staged(&folder, before)).await;
            for path in listing.map_err(|error| ArtifactError::Store(error.to_string()))? {
                let key = path.strip_prefix(&root).unwrap_or(&path).to_string_lossy().into_owned();
                if !is_in_the_making(jobs, &key).await? {
                    removed += u64::from(tokio::fs::remove_file(&path).await.is_ok());
                    if let Some(folder) = path.parent() {
                        // Fails where the folder is not empty, as it should.
                        let _ = tokio::fs::remove_dir(folder).await;
                    }
                }
            }
        }
        Ok(removed)
    }
}

/// The bytes of a file that goes up in one request, read on one trip to a thread that may block; `None` for a greater one.
async fn read_small(path: &Path) -> Result<Option<(Bytes, Stored)>, ArtifactError> {
    let from = path.to_owned();
    let read = tokio::task::spawn_blocking(move || {
        if std::fs::metadata(&from)?.len() > PART as u64 {
            return Ok(None);
        }
        let bytes = Bytes::from(std::fs::read(&from)?);
        let stored = Stored { bytes: bytes.len() as u64, sha256: hex::encode(Sha256::digest(&bytes)) };
        Ok(Some((bytes, stored)))
    });
    let read = read.await.unwrap_or_else(|error| Err(std::io::Error::other(error)));
    read.map_err(|source| ArtifactError::Scratch { path: path.to_owned(), source })
}

/// Whether the attempt that a key belongs to runs now.
async fn is_in_the_making(jobs: &dyn Store, key: &str) -> Result<bool, StoreError> {
    let mut parts = key.split('/').skip(1);
    let (job, attempt) =
        (parts.next().and_then(|id| id.parse().ok()), parts.next().and_then(|n| n.parse::<u32>().ok()));
    let (Some(job), Some(attempt)) = (job, attempt) else { return Ok(false) };
    let job = jobs.get(JobId(job)).await?;
    Ok(job.is_some_and(|job| job.status == Status::Running && job.attempts == attempt))
}

/// Uploads that were broken off, and folders without anything: object_store stages a local file as `name#number` and does
/// not list it. Removes the folders.
fn staged(folder: &Path, before_micros: i64) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let Ok(entries) = std::fs::read_dir(folder) else {
        return found;
    };
    for entry in entries.flatten() {
        let path = entry.path();
        let staged = entry
            .file_name()
            .to_str()
            .and_then(|name| name.rsplit_once('#'))
            .is_some_and(|(_, n)| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()));
        if path.is_dir() {
            found.extend(self::staged(&path, before_micros));
            // Fails where the folder is not empty, as it should.
            let _ = std::fs::remove_dir(&path);
        } else if staged && modified_micros(&entry).is_some_and(|at| at < before_micros) {
            found.push(path);
        }
    }
    found
}

fn modified_micros(entry: &std::fs::DirEntry) -> Option<i64> {
    let modified = entry.metadata().ok()?.modified().ok()?;
    Timestamp::try_from(modified).ok().map(Timestamp::as_microsecond)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fixture(bytes: usize) -> (tempfile::TempDir, Artifacts, PathBuf, Vec<u8>) {
        let dir = tempfile::tempdir().unwrap();
        let artifacts = Artifacts::local(&dir.path().join("files")).unwrap();
        let data: Vec<u8> = (0..bytes).map(|i| (i * 31 % 251) as u8).collect();
        let path = dir.path().join("scratch.bin");
        std::fs::write(&path, &data).unwrap();
        (dir, artifacts, path, data)
    }

    #[tokio::test]
    async fn a_file_comes_back_whole_and_in_ranges() {
        // Small (one request) and several parts, with a tail.
        for bytes in [0, 1000, 2 * PART + 12_345] {
            let (_dir, artifacts, path, data) = fixture(bytes);
            let stored = artifacts.put_file("models/a/1/model.glb", &path).await.unwrap();
            assert_eq!(stored, Stored { bytes: bytes as u64, sha256: hex::encode(Sha256::digest(&data)) });
            assert!(artifacts.read_all("models/a/1/model.glb").await.unwrap() == data);
            if bytes == 0 {
                continue;
            }
            let part = artifacts.get_range("models/a/1/model.glb", Some(100..900)).await.unwrap();
            assert_eq!((part.size, part.range.clone()), (bytes as u64, 100..900));
            let read: Vec<Bytes> = part.stream.try_collect().await.unwrap();
            assert!(read.concat() == data[100..900]);
            let tail = artifacts.get_range("models/a/1/model.glb", Some(bytes as u64 - 5..u64::MAX)).await.unwrap();
            assert_eq!(tail.range, bytes as u64 - 5..bytes as u64);
            for bad in [bytes as u64..bytes as u64 + 1, 5..5] {
                let error = artifacts.get_range("models/a/1/model.glb", Some(bad)).await.unwrap_err();
                assert!(matches!(error, ArtifactError::Range(_)), "{error}");
            }
        }
    }

    #[tokio::test]
    async fn a_deleted_file_is_gone_with_its_folder_and_deleting_again_is_fine() {
        let (dir, artifacts, path, _) = fixture(10);
        artifacts.put_file("models/a/1/model.glb", &path).await.unwrap();
        for _ in 0..2 {
            artifacts.delete(&["models/a/1/model.glb".into()]).await.unwrap();
        }
        let error = artifacts.read_all("models/a/1/model.glb").await.unwrap_err();
        assert!(matches!(error, ArtifactError::NotFound { .. }), "{error}");
        assert!(!dir.path().join("files/models/a").exists());
    }

    #[tokio::test]
    async fn an_upload_that_fails_shows_nothing() {
        let (dir, artifacts, path, _) = fixture(3 * PART);
        // A folder in the place of the file: the rename at the end cannot succeed.
        std::fs::create_dir_all(dir.path().join("files/models/a/1/model.glb/in-the-way")).unwrap();
        let error = artifacts.put_file("models/a/1/model.glb", &path).await.unwrap_err();
        assert!(matches!(error, ArtifactError::Store(_)), "{error}");
        let missing = artifacts.put_file("models/a/1/other", &dir.path().join("missing")).await.unwrap_err();
        assert!(matches!(missing, ArtifactError::Scratch { .. }), "{missing}");
        assert!(artifacts.read_all("models/a/1/other").await.is_err());
    }
}
