//! Files that are written in one request, alone or one after the other in a pack. A pack costs one
//! write to disk, whatever the number of its files.

use super::error::ArtifactError;
use bytes::Bytes;
use sha2::{Digest, Sha256};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Maximum size of a file that is uploaded in one request, and of the parts of larger files, bytes.
/// S3 requires 5 MiB or more.
pub(super) const PART: usize = 8 << 20;

/// Result of an upload.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stored {
    /// Size of the file.
    pub bytes: u64,
    /// SHA-256 of the uploaded bytes, lower-case hex.
    pub sha256: String,
}

impl Stored {
    pub(super) fn of(bytes: &[u8]) -> Self {
        Self { bytes: bytes.len() as u64, sha256: hex::encode(Sha256::digest(bytes)) }
    }
}

/// Reads small files one after the other, in one blocking task.
pub(super) async fn read_pack(paths: Vec<PathBuf>) -> Result<(Bytes, Vec<Stored>), ArtifactError> {
    let read = tokio::task::spawn_blocking(move || {
        let (mut pack, mut stored) = (Vec::new(), Vec::with_capacity(paths.len()));
        for path in paths {
            let start = pack.len();
            let read = std::fs::File::open(&path).and_then(|mut file| file.read_to_end(&mut pack));
            if let Err(source) = read {
                return Err(ArtifactError::Scratch { path, source });
            }
            stored.push(Stored::of(&pack[start..]));
        }
        Ok((Bytes::from(pack), stored))
    });
    read.await.map_err(ArtifactError::store)?
}

/// Reads a file that is uploaded in one request, in one blocking task; `None` for a larger file.
pub(super) async fn read_small(path: &Path) -> Result<Option<(Bytes, Stored)>, ArtifactError> {
    let from = path.to_owned();
    let read = tokio::task::spawn_blocking(move || {
        if std::fs::metadata(&from)?.len() > PART as u64 {
            return Ok(None);
        }
        let bytes = Bytes::from(std::fs::read(&from)?);
        let stored = Stored::of(&bytes);
        Ok(Some((bytes, stored)))
    });
    let read = read.await.unwrap_or_else(|error| Err(std::io::Error::other(error)));
    read.map_err(|source| ArtifactError::Scratch { path: path.to_owned(), source })
}
