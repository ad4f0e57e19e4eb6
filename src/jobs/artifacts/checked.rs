//! Comparison of a file with its record while it is read.

use super::error::ArtifactError;
use crate::jobs::File;
use bytes::Bytes;
use futures_util::stream::{self, BoxStream};
use futures_util::{StreamExt, TryStreamExt};
use sha2::{Digest, Sha256};

/// Bytes of a file as they are read.
pub type Chunks = BoxStream<'static, Result<Bytes, ArtifactError>>;

/// A file that is read to its end.
struct Reading {
    chunks: Chunks,
    /// The latest chunk, which is passed on once another chunk or the right hash has followed.
    held: Bytes,
    hash: Sha256,
    bytes: u64,
    is_over: bool,
}

/// The chunks of a whole file. Instead of its last chunk comes [`ArtifactError::Damaged`] if the
/// file does not have the size and the SHA-256 of its record, so no reader receives all bytes of a
/// damaged file.
pub(super) fn checked(chunks: Chunks, file: &File) -> Chunks {
    let file = file.clone();
    let reading = Reading { chunks, held: Bytes::new(), hash: Sha256::new(), bytes: 0, is_over: false };
    stream::try_unfold((reading, file), async |(mut reading, file)| {
        Ok(reading.next(&file).await?.map(|chunk| (chunk, (reading, file))))
    })
    .boxed()
}

impl Reading {
    async fn next(&mut self, file: &File) -> Result<Option<Bytes>, ArtifactError> {
        while !self.is_over {
            match self.chunks.try_next().await? {
                Some(chunk) => {
                    self.bytes += chunk.len() as u64;
                    if self.bytes > file.bytes {
                        return Err(damaged(file, format!("it has more than {} bytes", file.bytes)));
                    }
                    self.hash.update(&chunk);
                    let before = std::mem::replace(&mut self.held, chunk);
                    if !before.is_empty() {
                        return Ok(Some(before));
                    }
                }
                None => {
                    self.is_over = true;
                    check_size(file, self.bytes)?;
                    let found = hex::encode(self.hash.finalize_reset());
                    if found != file.sha256 {
                        return Err(damaged(file, format!("its SHA-256 is {found} instead of {}", file.sha256)));
                    }
                }
            }
        }
        Ok(Some(std::mem::take(&mut self.held)).filter(|last| !last.is_empty()))
    }
}

/// Compares the size of a stored file with its record.
pub(super) fn check_size(file: &File, bytes: u64) -> Result<(), ArtifactError> {
    if bytes == file.bytes {
        return Ok(());
    }
    Err(damaged(file, format!("it has {bytes} bytes instead of {}", file.bytes)))
}

pub(super) fn damaged(file: &File, detail: String) -> ArtifactError {
    ArtifactError::Damaged { name: file.name.clone(), key: file.key.clone(), detail }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(content: &[u8]) -> File {
        File {
            name: "model.glb".into(),
            media_type: "model/gltf-binary".into(),
            bytes: content.len() as u64,
            sha256: hex::encode(Sha256::digest(content)),
            key: "models/a/1/model.glb".into(),
            start: None,
        }
    }

    /// Reads chunks as the file with the content `recorded`. Returns the bytes that come, and the
    /// error at their end.
    async fn read(recorded: &[u8], chunks: &[&[u8]]) -> (Vec<u8>, Option<String>) {
        let chunks: Vec<_> = chunks.iter().map(|chunk| Ok(Bytes::copy_from_slice(chunk))).collect();
        let mut stream = checked(stream::iter(chunks).boxed(), &file(recorded));
        let mut read = Vec::new();
        while let Some(chunk) = stream.next().await {
            match chunk {
                Ok(chunk) => read.extend_from_slice(&chunk),
                Err(error) => return (read, Some(error.to_string())),
            }
        }
        (read, None)
    }

    #[tokio::test]
    async fn a_whole_file_comes_unchanged() {
        for chunks in [&[&b"abcdef"[..]][..], &[b"abc", b"", b"def"], &[b"a", b"bcde", b"f", b""]] {
            assert_eq!(read(b"abcdef", chunks).await, (b"abcdef".to_vec(), None));
        }
        assert_eq!(read(b"", &[]).await, (vec![], None));
    }

    #[tokio::test]
    async fn a_damaged_file_never_comes_whole() {
        for (chunks, before, reason) in [
            (&[&b"abcdeX"[..]][..], &b""[..], "SHA-256"),
            (&[b"Xbc", b"def"], b"Xbc", "SHA-256"),
            (&[b"abc", b"de"], b"abc", "5 bytes instead of 6"),
            (&[b"abc", b"def", b"g"], b"abc", "more than 6 bytes"),
            (&[], b"", "0 bytes instead of 6"),
        ] {
            let (read, error) = read(b"abcdef", chunks).await;
            let error = error.expect("it is damaged");
            assert!(read == before && error.contains(reason) && error.contains("models/a/1/model.glb"), "{error}");
        }
    }
}
