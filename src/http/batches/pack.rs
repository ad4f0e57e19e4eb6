//! Writes archives as streams: zip (stored, ZIP64 where needed) and tar.
//!
//! A packer keeps its output in memory until [`Packer::take`], which callers call after each write.

use crate::lock::{Mutex, MutexGuard};
use bytes::Bytes;
use jiff::Timestamp;
use jiff::tz::TimeZone;
use std::io::{self, Write};
use std::sync::Arc;
use zip::write::{SimpleFileOptions, StreamWriter};
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Size of a block of a tar, in bytes.
const BLOCK: u64 = 512;

/// A file in an archive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ArchiveEntry {
    /// Path in the archive, at most 100 bytes.
    pub(super) path: String,
    /// Size in bytes.
    pub(super) bytes: u64,
    /// Time of the last change.
    pub(super) modified: Timestamp,
}

/// Writes an archive.
pub(super) struct Packer {
    writer: ArchiveWriter,
    out: SharedBuffer,
    /// Path of the current entry.
    path: String,
    /// Number of bytes that the current entry lacks.
    left: u64,
    /// Number of bytes after the current entry, which fill its last block.
    padding: usize,
}

enum ArchiveWriter {
    Zip(Box<ZipWriter<StreamWriter<SharedBuffer>>>),
    Tar,
}

impl Packer {
    /// A packer of a zip. Sizes and checksums follow each entry, so a reader needs the directory at
    /// the end.
    pub(super) fn zip() -> Self {
        let out = SharedBuffer::default();
        Self::new(ArchiveWriter::Zip(Box::new(ZipWriter::new_stream(out.clone()))), out)
    }

    /// A packer of a tar.
    pub(super) fn tar() -> Self {
        Self::new(ArchiveWriter::Tar, SharedBuffer::default())
    }

    fn new(writer: ArchiveWriter, out: SharedBuffer) -> Self {
        Self { writer, out, path: String::new(), left: 0, padding: 0 }
    }

    /// Begins an entry. Calls of `write` with exactly `entry.bytes` bytes must follow.
    ///
    /// # Errors
    /// Fails if the previous entry is incomplete, or if the format does not support this one.
    pub(super) fn begin(&mut self, entry: &ArchiveEntry) -> io::Result<()> {
        self.end_entry()?;
        self.left = entry.bytes;
        self.path.clone_from(&entry.path);
        match &mut self.writer {
            ArchiveWriter::Zip(zip) => {
                let time = entry.modified.to_zoned(TimeZone::UTC).datetime();
                let options = SimpleFileOptions::default()
                    .compression_method(CompressionMethod::Stored)
                    .large_file(entry.bytes >= u64::from(u32::MAX))
                    .unix_permissions(0o644)
                    .last_modified_time(DateTime::try_from(time).unwrap_or_default());
                zip.start_file(&entry.path, options)?;
            }
            ArchiveWriter::Tar => {
                let mut header = tar::Header::new_gnu();
                header.set_path(&entry.path)?;
                header.set_size(entry.bytes);
                header.set_mode(0o644);
                header.set_mtime(u64::try_from(entry.modified.as_second()).unwrap_or_default());
                header.set_cksum();
                self.out.write_all(header.as_bytes())?;
                self.padding = (entry.bytes.next_multiple_of(BLOCK) - entry.bytes) as usize;
            }
        }
        Ok(())
    }

    /// Adds bytes to the current entry.
    ///
    /// # Errors
    /// Fails if the entry announced fewer bytes.
    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let left = self.left.checked_sub(bytes.len() as u64);
        self.left = left.ok_or_else(|| io::Error::other(format!("{} has more bytes than announced", self.path)))?;
        match &mut self.writer {
            ArchiveWriter::Zip(zip) => zip.write_all(bytes),
            ArchiveWriter::Tar => self.out.write_all(bytes),
        }
    }

    fn end_entry(&mut self) -> io::Result<()> {
        if self.left > 0 {
            return Err(io::Error::other(format!("{} lacks {} of the bytes announced", self.path, self.left)));
        }
        self.out.write_all(&[0; BLOCK as usize][..std::mem::take(&mut self.padding)])
    }

    /// Ends the archive.
    ///
    /// # Errors
    /// Fails if the last entry is incomplete.
    pub(super) fn finish(mut self) -> io::Result<Bytes> {
        self.end_entry()?;
        match self.writer {
            ArchiveWriter::Zip(zip) => drop((*zip).finish()?),
            ArchiveWriter::Tar => self.out.write_all(&[0; 2 * BLOCK as usize])?,
        }
        Ok(self.out.take())
    }

    /// Number of bytes of output since the last call of `take`.
    pub(super) fn ready(&self) -> usize {
        self.out.bytes().len()
    }

    /// Output since the last call.
    pub(super) fn take(&mut self) -> Bytes {
        self.out.take()
    }
}

/// Output of a packer. The zip writer owns a clone.
#[derive(Clone, Debug, Default)]
struct SharedBuffer(Arc<Mutex<Vec<u8>>>);

impl SharedBuffer {
    fn bytes(&self) -> MutexGuard<'_, Vec<u8>> {
        self.0.lock()
    }

    fn take(&self) -> Bytes {
        std::mem::take(&mut *self.bytes()).into()
    }
}

impl Write for SharedBuffer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bytes().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Cursor, Read};

    fn contents() -> Vec<(ArchiveEntry, Vec<u8>)> {
        let file = |path: &str, len: usize| {
            let entry = ArchiveEntry {
                path: path.into(),
                bytes: len as u64,
                modified: "2026-01-02T03:04:06Z".parse().unwrap(),
            };
            (entry, (0..len).map(|i| (i % 251) as u8).collect())
        };
        vec![file("manifest.json", 700), file("a/empty", 0), file("a/block", 512), file("b/large", 100_000)]
    }

    fn packed(mut packer: Packer) -> Vec<u8> {
        let mut whole = Vec::new();
        for (entry, bytes) in contents() {
            packer.begin(&entry).unwrap();
            for chunk in bytes.chunks(999) {
                packer.write(chunk).unwrap();
                whole.extend(packer.take());
                assert_eq!(packer.ready(), 0);
            }
        }
        whole.extend(packer.finish().unwrap());
        whole
    }

    #[test]
    fn a_zip_is_read_by_its_directory() {
        let whole = packed(Packer::zip());
        let mut archive = zip::ZipArchive::new(Cursor::new(whole)).unwrap();
        assert_eq!(archive.len(), 4);
        for (i, (entry, bytes)) in contents().into_iter().enumerate() {
            let mut file = archive.by_index(i).unwrap();
            assert_eq!(file.name().unwrap(), entry.path);
            assert_eq!(file.compression(), CompressionMethod::Stored);
            assert_eq!(file.last_modified().unwrap().to_string(), "2026-01-02 03:04:06");
            let mut found = Vec::new();
            file.read_to_end(&mut found).unwrap();
            assert!(found == bytes, "{}", entry.path);
        }
    }

    #[test]
    fn a_tar_is_read_in_order() {
        let whole = packed(Packer::tar());
        assert_eq!(whole.len() % 512, 0);
        let mut archive = tar::Archive::new(whole.as_slice());
        let mut entries = archive.entries().unwrap();
        for (entry, bytes) in contents() {
            let mut file = entries.next().unwrap().unwrap();
            assert_eq!(file.path().unwrap().to_str(), Some(entry.path.as_str()));
            assert_eq!(file.header().mtime().unwrap(), entry.modified.as_second() as u64);
            let mut found = Vec::new();
            file.read_to_end(&mut found).unwrap();
            assert!(found == bytes, "{}", entry.path);
        }
        assert!(entries.next().is_none());
    }

    /// Announces 5 GiB without writing them: the headers are valid, but the missing bytes are an
    /// error.
    #[test]
    fn an_entry_has_the_size_that_it_announced() {
        for mut packer in [Packer::zip(), Packer::tar()] {
            let (mut entry, _) = contents().remove(0);
            entry.bytes = 5 << 30;
            packer.begin(&entry).unwrap();
            packer.write(b"x").unwrap();
            assert!(packer.begin(&entry).is_err());
            assert!(packer.finish().is_err());
        }
        let mut packer = Packer::tar();
        packer.begin(&ArchiveEntry { bytes: 2, ..contents().remove(0).0 }).unwrap();
        assert!(packer.write(b"xyz").is_err());
    }
}
