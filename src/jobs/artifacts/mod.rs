//! The artifact store: files of models in a local folder or an S3 bucket. The only user of
//! object_store.
//!
//! Invariants:
//!
//! - A key shows either nothing or the whole file. A local file is staged in the same folder,
//!   synced and renamed; an object store shows an upload once it is complete.
//! - A key belongs to one attempt ([`key()`]), so two attempts never write the same key.
//! - An object is one file, or a *pack* of small files of one attempt, which costs one write.
//! - A file is an artifact only once the record of a job names it.
//!   [`Sweeper`](super::sweep::Sweeper) removes orphans.
//! - A file is hashed while it is uploaded, and its size is compared afterwards. A recorded file
//!   that is read whole is compared with its record.
//!
//! | file | subject |
//! |---|---|
//! | `local`, `s3` | the two kinds of store |
//! | `checked` | comparison of a file with its record while it is read |
//! | `listing` | objects in pages, for sweeps |
//! | `small` | files that are written in one request, alone or in a pack |

mod checked;
mod error;
mod listing;
mod local;
mod s3;
mod small;

pub use checked::Chunks;
pub use error::ArtifactError;
pub(super) use listing::Listing;
pub use small::Stored;

use super::error::with_causes;
use super::job::{File, JobId};
use crate::availability::Availability;
use bytes::Bytes;
use checked::{check_size, checked, damaged};
use futures_util::future::BoxFuture;
use futures_util::stream::BoxStream;
use futures_util::{FutureExt, StreamExt, TryStreamExt};
use local::Root;
use object_store::buffered::BufWriter;
use object_store::path::Path as Key;
use object_store::{GetOptions, GetRange, ObjectMeta, ObjectStore, ObjectStoreExt};
use sha2::{Digest, Sha256};
use small::{PART, read_pack, read_small};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

/// Size of a read from a scratch file, bytes.
const CHUNK: usize = 1 << 20;
/// Size of the file that a check writes, bytes.
const PROBE: usize = 4096;
/// Prefix of the keys of files.
pub(super) const MODELS: &str = "models";
/// Prefix of the keys that checks write to.
pub(super) const PROBES: &str = "probe";
/// Number of concurrent requests for the existence of keys.
const HEADS: usize = 16;

/// A download of a file or a part of it.
pub struct Download {
    /// Size of the whole file, bytes.
    pub size: u64,
    /// Range of the file that `stream` contains.
    pub range: Range<u64>,
    /// The bytes.
    pub stream: Chunks,
}

impl std::fmt::Debug for Download {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Download").field("size", &self.size).field("range", &self.range).finish_non_exhaustive()
    }
}

/// The key of a file of an attempt.
#[must_use]
pub fn key(job: JobId, attempt: u32, name: &str) -> String {
    format!("{MODELS}/{job}/{attempt}/{name}")
}

/// An artifact store. Clones share it.
#[derive(Clone, Debug)]
pub struct Artifacts {
    store: Arc<dyn ObjectStore>,
    /// Root of a local folder.
    local: Option<Root>,
    /// Signer of URLs, if the store supports them.
    signing: Option<s3::Signing>,
    availability: Arc<Availability>,
}

impl Artifacts {
    /// An artifact store in the folder `root`, which is created if it does not exist. A file
    /// survives a power failure once [`Artifacts::put_file`] has returned. The root may be a
    /// symbolic link; links below it are refused.
    ///
    /// # Errors
    /// [`ArtifactError::Store`] if the folder cannot be created or opened, [`ArtifactError::Link`]
    /// if it contains a symbolic link.
    pub fn local(root: &Path) -> Result<Self, ArtifactError> {
        let (store, root) = Root::open(root)?;
        Ok(Self { local: Some(root), ..Self::over(Arc::new(store)) })
    }

    /// An artifact store in the bucket of `url`, `s3://BUCKET` or `s3://BUCKET/PREFIX`. `variables`
    /// contains its settings under the usual names: `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`,
    /// `AWS_SESSION_TOKEN`, `AWS_REGION`, `AWS_ENDPOINT_URL`, `AWS_ALLOW_HTTP`,
    /// `AWS_CHECKSUM_ALGORITHM` (sha256) and the others of object_store. Plain HTTP is allowed to a
    /// loopback address, and elsewhere with `AWS_ALLOW_HTTP=true`.
    ///
    /// # Errors
    /// [`ArtifactError::Store`] if the URL or a setting is invalid. The bucket is not contacted.
    pub fn s3(url: &str, variables: impl IntoIterator<Item = (String, String)>) -> Result<Self, ArtifactError> {
        let (store, signing) = s3::open(url, variables)?;
        Ok(Self { signing: Some(signing), ..Self::over(store) })
    }

    /// An artifact store in any object store.
    #[must_use]
    pub fn over(store: Arc<dyn ObjectStore>) -> Self {
        Self { store, local: None, signing: None, availability: Arc::default() }
    }

    /// Location of the file of `key`. Fails if it lies below a symbolic link.
    async fn location(&self, key: &str) -> Result<Key, ArtifactError> {
        if let Some(root) = self.local.clone() {
            let owned = key.to_owned();
            let checked = tokio::task::spawn_blocking(move || root.refuse_links(&owned)).await;
            checked.map_err(ArtifactError::store)??;
        }
        Ok(Key::from(key))
    }

    /// Stores the files at `paths`, which must be small, one after the other as one object under
    /// `key`. Nothing is visible until all are complete.
    ///
    /// # Errors
    /// [`ArtifactError::Scratch`], [`ArtifactError::Link`], [`ArtifactError::Store`]; then nothing
    /// is visible.
    pub async fn put_pack(&self, key: &str, paths: Vec<PathBuf>) -> Result<Vec<Stored>, ArtifactError> {
        self.noted(self.write_pack(key, paths).await)
    }

    async fn write_pack(&self, key: &str, paths: Vec<PathBuf>) -> Result<Vec<Stored>, ArtifactError> {
        let location = self.location(key).await?;
        let (bytes, stored) = read_pack(paths).await?;
        let size = bytes.len() as u64;
        self.store.put(&location, bytes.into()).await?;
        self.check_written(&location, size).await?;
        Ok(stored)
    }

    /// Compares the size of a new object with the bytes written.
    async fn check_written(&self, location: &Key, bytes: u64) -> Result<(), ArtifactError> {
        let size = self.store.head(location).await?.size;
        if size != bytes {
            let detail = format!("{location} has {size} bytes after an upload of {bytes}");
            return Err(ArtifactError::Store(detail.into()));
        }
        Ok(())
    }

    /// Stores the file at `path` under `key`, streaming it; nothing is visible until it is
    /// complete.
    ///
    /// # Errors
    /// [`ArtifactError::Scratch`], [`ArtifactError::Link`], [`ArtifactError::Store`]; then nothing
    /// is visible.
    pub async fn put_file(&self, key: &str, path: &Path) -> Result<Stored, ArtifactError> {
        self.noted(self.write_file(key, path).await)
    }

    async fn write_file(&self, key: &str, path: &Path) -> Result<Stored, ArtifactError> {
        let location = self.location(key).await?;
        let stored = match read_small(path).await? {
            Some((bytes, stored)) => {
                self.store.put(&location, bytes.into()).await?;
                stored
            }
            None => self.write_in_parts(&location, path).await?,
        };
        self.check_written(&location, stored.bytes).await?;
        Ok(stored)
    }

    async fn write_in_parts(&self, location: &Key, path: &Path) -> Result<Stored, ArtifactError> {
        let scratch = |source| ArtifactError::Scratch { path: path.to_owned(), source };
        let mut file = tokio::fs::File::open(path).await.map_err(scratch)?;
        let mut upload = BufWriter::with_capacity(Arc::clone(&self.store), location.clone(), PART);
        let mut hash = Sha256::new();
        let mut bytes = 0u64;
        loop {
            let mut chunk = bytes::BytesMut::with_capacity(CHUNK);
            let read = match file.read_buf(&mut chunk).await {
                Ok(read) => read,
                Err(source) => {
                    // If this fails too, the orphan sweep removes the parts.
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
        upload.shutdown().await.map_err(ArtifactError::store)?;
        Ok(Stored { bytes, sha256: hex::encode(hash.finalize()) })
    }

    /// Stores bytes under `key`; nothing is visible until they are complete.
    ///
    /// # Errors
    /// [`ArtifactError::Link`], [`ArtifactError::Store`].
    pub async fn put_bytes(&self, key: &str, bytes: Bytes) -> Result<(), ArtifactError> {
        self.noted(self.write_bytes(key, bytes).await)
    }

    async fn write_bytes(&self, key: &str, bytes: Bytes) -> Result<(), ArtifactError> {
        let mut upload = BufWriter::with_capacity(Arc::clone(&self.store), self.location(key).await?, PART);
        if let Err(error) = upload.put(bytes).await {
            let _ = upload.abort().await;
            return Err(error.into());
        }
        upload.shutdown().await.map_err(ArtifactError::store)
    }

    /// Opens the file under `key`, or its bytes in `range`, which may extend beyond the end.
    ///
    /// # Errors
    /// [`ArtifactError::NotFound`]; [`ArtifactError::Range`] for a range that is empty or begins
    /// after the end; [`ArtifactError::Link`], [`ArtifactError::Store`].
    pub async fn get_range(&self, key: &str, range: Option<Range<u64>>) -> Result<Download, ArtifactError> {
        let location = self.location(key).await?;
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

    /// Opens a recorded file, or its bytes in `range`. A whole file is compared with its record
    /// while it is read: the stream ends with [`ArtifactError::Damaged`] before the last bytes of a
    /// damaged file. Of a file that is read in part, only the size is compared; of one in a pack,
    /// whether the pack is long enough.
    ///
    /// # Errors
    /// [`ArtifactError::Damaged`] for another size than the recorded one; the others of
    /// [`Artifacts::get_range`].
    pub async fn open(&self, file: &File, range: Option<Range<u64>>) -> Result<Chunks, ArtifactError> {
        let range = range.filter(|range| *range != (0..file.bytes));
        let is_whole = range.is_none();
        let place = match (range, file.start) {
            (None, None) => None,
            (range, _) => Some(file.place(range.unwrap_or(0..file.bytes))),
        };
        let download = match self.get_range(&file.key, place).await {
            Err(ArtifactError::Range(detail)) => return Err(damaged(file, detail)),
            opened => opened?,
        };
        let held = match file.start {
            None => download.size,
            Some(start) => download.size.saturating_sub(start).min(file.bytes),
        };
        check_size(file, held)?;
        Ok(if is_whole { checked(download.stream, file) } else { download.stream })
    }

    /// The bytes of a recorded file in each of `ranges`, which must not be empty or extend beyond
    /// the end. One request reads all ranges of an object store with gaps below one mebibyte.
    ///
    /// # Errors
    /// [`ArtifactError::Damaged`] for a range beyond the end of the recorded file;
    /// [`ArtifactError::NotFound`], [`ArtifactError::Link`], [`ArtifactError::Store`].
    pub async fn get_ranges(&self, file: &File, ranges: &[Range<u64>]) -> Result<Vec<Bytes>, ArtifactError> {
        if let Some(outside) = ranges.iter().find(|range| range.end > file.bytes) {
            let detail = format!("bytes {}..{} of {}", outside.start, outside.end, file.bytes);
            return Err(damaged(file, detail));
        }
        let places: Vec<Range<u64>> = ranges.iter().map(|range| file.place(range.clone())).collect();
        Ok(self.store.get_ranges(&self.location(&file.key).await?, &places).await?)
    }

    /// The whole file under `key`.
    ///
    /// # Errors
    /// [`ArtifactError::NotFound`], [`ArtifactError::Link`], [`ArtifactError::Store`].
    pub async fn read_all(&self, key: &str) -> Result<Bytes, ArtifactError> {
        Ok(self.store.get(&self.location(key).await?).await?.bytes().await?)
    }

    /// Copies the whole file under `key` to `path`, which is replaced.
    ///
    /// # Errors
    /// [`ArtifactError::NotFound`], [`ArtifactError::Link`], [`ArtifactError::Store`],
    /// [`ArtifactError::Scratch`].
    pub async fn get_file(&self, key: &str, path: &Path) -> Result<(), ArtifactError> {
        let scratch = |source| ArtifactError::Scratch { path: path.to_owned(), source };
        let mut stream = self.get_range(key, None).await?.stream;
        let mut file = tokio::fs::File::create(path).await.map_err(scratch)?;
        while let Some(bytes) = stream.try_next().await? {
            file.write_all(&bytes).await.map_err(scratch)?;
        }
        file.flush().await.map_err(scratch)
    }

    /// Returns the subset of `keys` that have no file.
    ///
    /// # Errors
    /// [`ArtifactError::Link`], [`ArtifactError::Store`] if the store did not respond.
    pub async fn missing(&self, keys: &[String]) -> Result<Vec<String>, ArtifactError> {
        let looks: Vec<BoxFuture<'_, _>> = keys.iter().map(|key| self.exists(key).boxed()).collect();
        let found: Vec<bool> = futures_util::stream::iter(looks).buffered(HEADS).try_collect().await?;
        Ok(keys.iter().zip(found).filter(|(_, found)| !found).map(|(key, _)| key.clone()).collect())
    }

    async fn exists(&self, key: &str) -> Result<bool, ArtifactError> {
        match self.store.head(&self.location(key).await?).await {
            Ok(_) => Ok(true),
            Err(object_store::Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// Removes files; keys without a file are ignored.
    ///
    /// # Errors
    /// The first error, after all have been tried.
    pub async fn delete(&self, keys: &[String]) -> Result<(), ArtifactError> {
        let mut first = Ok(());
        let mut locations = Vec::with_capacity(keys.len());
        for key in keys {
            match self.location(key).await {
                Ok(location) => locations.push(Ok(location)),
                Err(error) => first = first.and(Err(error)),
            }
        }
        // S3 removes a thousand objects in one request.
        let mut removed = self.store.delete_stream(futures_util::stream::iter(locations).boxed());
        while let Some(result) = removed.next().await {
            match result {
                Ok(_) | Err(object_store::Error::NotFound { .. }) => {}
                Err(error) => first = first.and(Err(error.into())),
            }
        }
        first
    }

    /// A URL at which anyone can download the file under `key` for `time`, saved as `name`; `None`
    /// if the store does not support that.
    ///
    /// # Errors
    /// [`ArtifactError::Store`].
    pub async fn signed_url(
        &self,
        key: &str,
        name: &str,
        media_type: &str,
        time: Duration,
    ) -> Result<Option<String>, ArtifactError> {
        match &self.signing {
            Some(signing) => Ok(Some(signing.url(key, name, media_type, time).await?)),
            None => Ok(None),
        }
    }

    /// Checks the store by writing and removing a small file, and remembers the result for
    /// [`Artifacts::outage`]. Fails after 5 s. Calls within a second share one result, so probes
    /// may call this often.
    ///
    /// # Errors
    /// [`ArtifactError::Store`].
    pub async fn check(&self) -> Result<(), ArtifactError> {
        let probe = async {
            let key = format!("{PROBES}/{}", uuid::Uuid::new_v4());
            let written = self.write_bytes(&key, Bytes::from_static(&[0; PROBE])).await;
            // If this fails, the orphan sweep removes the probe.
            let _ = self.delete(&[key]).await;
            written.map_err(|error| match error {
                ArtifactError::Store(cause) => with_causes(&*cause),
                other => other.to_string(),
            })
        };
        self.availability.check(probe).await.map_err(|detail| ArtifactError::Store(detail.into()))
    }

    /// Remembers whether a write failed. Errors of another origin, such as an unreadable scratch
    /// file, change nothing.
    fn noted<T>(&self, result: Result<T, ArtifactError>) -> Result<T, ArtifactError> {
        match &result {
            Ok(_) => self.availability.note(Ok(())),
            Err(ArtifactError::Store(cause)) => self.availability.note(Err(with_causes(&**cause))),
            Err(_) => {}
        }
        result
    }

    /// Error of the latest write or check; `None` if it succeeded, or if there was none yet.
    #[must_use]
    pub fn outage(&self) -> Option<String> {
        self.availability.outage()
    }

    /// Lists all objects whose keys begin with `prefix/`. The list of a local folder includes
    /// interrupted uploads.
    pub(super) fn listing(&self, prefix: &str) -> Listing {
        match &self.local {
            Some(root) => Listing::Local(Some(root.walk(prefix))),
            // Fused, because the caller polls the stream once more after its end.
            None => Listing::Remote(self.store.list(Some(&Key::from(prefix))).fuse().boxed()),
        }
    }

    /// Names of the folders below `models/` that sort after `after`. A name may come several times.
    pub(super) async fn models_after(
        &self,
        after: &str,
    ) -> Result<BoxStream<'static, Result<String, ArtifactError>>, ArtifactError> {
        if let Some(root) = self.local.clone() {
            let after = after.to_owned();
            let names = tokio::task::spawn_blocking(move || root.folders_after(MODELS, &after)).await;
            let names = names.map_err(ArtifactError::store)?.map_err(ArtifactError::store)?;
            return Ok(futures_util::stream::iter(names).map(Ok).boxed());
        }
        let offset = Key::from(format!("{MODELS}/{after}"));
        let listed = self.store.list_with_offset(Some(&Key::from(MODELS)), &offset);
        let name = |object: ObjectMeta| object.location.parts().nth(1).map(|part| part.as_ref().to_owned());
        Ok(listed
            .map_err(ArtifactError::from)
            .try_filter_map(move |object| std::future::ready(Ok(name(object))))
            .boxed())
    }

    /// Removes objects of a [`Listing`] and returns their number.
    pub(super) async fn remove_listed(&self, keys: Vec<String>) -> Result<u64, ArtifactError> {
        match self.local.clone() {
            Some(root) => {
                let removed = tokio::task::spawn_blocking(move || root.remove(&keys)).await;
                removed.map_err(ArtifactError::store)
            }
            None => self.delete(&keys).await.map(|()| keys.len() as u64),
        }
    }
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
        // One request; several parts, the last one shorter.
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
            let file = recorded("models/a/1/model.glb", bytes as u64);
            let parts = artifacts.get_ranges(&file, &[900..950, 0..7, 7..20]).await.unwrap();
            assert!(parts == [&data[900..950], &data[..7], &data[7..20]]);
            for bad in [bytes as u64..bytes as u64 + 1, 5..5] {
                let error = artifacts.get_range("models/a/1/model.glb", Some(bad)).await.unwrap_err();
                assert!(matches!(error, ArtifactError::Range(_)), "{error}");
            }
        }
    }

    fn recorded(key: &str, bytes: u64) -> File {
        let [name, media_type, sha256] = std::array::from_fn(|_| String::new());
        File { name, media_type, bytes, sha256, key: key.to_owned(), start: None }
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
        // A folder at the place of the file: the rename at the end cannot succeed.
        std::fs::create_dir_all(dir.path().join("files/models/a/1/model.glb/in-the-way")).unwrap();
        let error = artifacts.put_file("models/a/1/model.glb", &path).await.unwrap_err();
        assert!(matches!(error, ArtifactError::Store(_)), "{error}");
        let missing = artifacts.put_file("models/a/1/other", &dir.path().join("missing")).await.unwrap_err();
        assert!(matches!(missing, ArtifactError::Scratch { .. }), "{missing}");
        assert!(artifacts.read_all("models/a/1/other").await.is_err());
    }

    #[cfg(unix)]
    #[tokio::test]
    async fn no_symbolic_link_below_the_root_is_followed() {
        use std::os::unix::fs::symlink;
        let (dir, artifacts, path, data) = fixture(10);
        let (files, outside) = (dir.path().join("files"), dir.path().join("outside"));
        std::fs::create_dir_all(outside.join("1")).unwrap();
        std::fs::write(outside.join("1/secret"), "secret").unwrap();
        artifacts.put_file("models/a/1/model.glb", &path).await.unwrap();
        symlink(&outside, files.join("models/b")).unwrap();
        symlink(outside.join("1/secret"), files.join("models/a/1/link")).unwrap();
        let is_link = |result: Result<(), ArtifactError>| {
            let error = result.unwrap_err();
            assert!(
                matches!(error, ArtifactError::Link { .. }) && error.to_string().contains("symbolic link"),
                "{error}"
            );
        };
        for key in ["models/b/1/secret", "models/a/1/link"] {
            let keys = [key.to_owned()];
            is_link(artifacts.read_all(key).await.map(drop));
            is_link(artifacts.get_range(key, None).await.map(drop));
            is_link(artifacts.get_range(key, Some(0..1)).await.map(drop));
            let file = recorded(key, 6);
            is_link(artifacts.get_ranges(&file, &[0..1, 2..3]).await.map(drop));
            is_link(artifacts.put_file(key, &path).await.map(drop));
            is_link(artifacts.put_bytes(key, Bytes::from_static(b"new")).await);
            is_link(artifacts.missing(&keys).await.map(drop));
            is_link(artifacts.delete(&keys).await);
        }
        is_link(artifacts.put_file("models/b/2/new", &path).await.map(drop));
        assert_eq!(std::fs::read(outside.join("1/secret")).unwrap(), b"secret");
        assert_eq!(std::fs::read_dir(&outside).unwrap().count(), 1, "something was written through the link");
        let mut listing = artifacts.listing(MODELS);
        let keys: Vec<String> = listing.next().await.unwrap().into_iter().map(|object| object.key).collect();
        assert_eq!(keys, ["models/a/1/model.glb"]);

        // The root itself may be a link; one at its top is found at start.
        let root = dir.path().join("root");
        symlink(&files, &root).unwrap();
        assert_eq!(Artifacts::local(&root).unwrap().read_all("models/a/1/model.glb").await.unwrap(), data);
        symlink(&outside, files.join("probe")).unwrap();
        is_link(Artifacts::local(&root).map(drop));
    }

    #[tokio::test]
    async fn a_full_store_is_noted_until_a_write_succeeds() {
        let (dir, artifacts, path, _) = fixture(10);
        assert_eq!(artifacts.outage(), None);
        std::fs::create_dir_all(dir.path().join("files/models/a/1/model.glb/in-the-way")).unwrap();
        artifacts.put_file("models/a/1/model.glb", &path).await.unwrap_err();
        assert!(artifacts.clone().outage().is_some());
        let missing = artifacts.put_file("models/a/1/other", &dir.path().join("missing")).await.unwrap_err();
        assert!(matches!(missing, ArtifactError::Scratch { .. }) && artifacts.outage().is_some());
        artifacts.check().await.unwrap();
        assert_eq!(artifacts.outage(), None);
        assert!(artifacts.listing(PROBES).next().await.unwrap().is_empty(), "a check leaves nothing");
        let keys = ["models/a/1/none".to_owned(), "models/a/2/none".to_owned()];
        assert_eq!(artifacts.missing(&keys).await.unwrap(), keys);
    }
}
