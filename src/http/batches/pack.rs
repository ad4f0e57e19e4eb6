//! Archives written piece by piece: zip (stored, ZIP64 where needed) and tar.
//!
//! A packer turns entries into bytes in memory, to be taken after each write; it holds no more than what was written since.

use bytes::Bytes;
use jiff::Timestamp;
use jiff::tz::TimeZone;
use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};
use zip::write::{SimpleFileOptions, StreamWriter};
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Blocks of a tar.
const BLOCK: u64 = 512;

/// A file in an archive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    /// Path in the archive, at most 100 bytes.
    pub(super) path: String,
    /// Size.
    pub(super) bytes: u64,
    /// When it was made.
    pub(super) modified: Timestamp,
}

/// Writes an archive.
pub(super) struct Packer {
    form: Form,
    out: Buffer,
    /// Path of the current entry.
    path: String,
    /// Bytes that the current entry still needs.
    left: u64,
    /// Bytes that fill the last block of the current entry.
    padding: usize,
}

enum Form {
    Zip(Box<ZipWriter<StreamWriter<Buffer>>>),
    Tar,
}

impl Packer {
    /// An empty zip. Sizes and checksums follow each entry, so a reader needs the directory at the end.
    pub(super) fn zip() -> Self {
        let out = Buffer::default();
        Self::new(Form::Zip(Box::new(ZipWriter::new_stream(out.clone()))), out)
    }

    /// An empty tar.
    pub(super) fn tar() -> Self {
        Self::new(Form::Tar, Buffer::default())
    }

    fn new(form: Form, out: Buffer) -> Self {
        Self { form, out, path: String::new(), left: 0, padding: 0 }
    }

    /// Begins an entry; exactly its bytes must follow.
    ///
    /// # Errors
    /// If the entry before is not complete, or the format cannot hold this one.
    pub(super) fn begin(&mut self, entry: &Entry) -> io::Result<()> {
        self.end_entry()?;
        self.left = entry.bytes;
        self.path.clone_from(&entry.path);
        match &mut self.form {
            Form::Zip(zip) => {
                let time = entry.modified.to_zoned(TimeZone::UTC).datetime();
                let options = SimpleFileOptions::default()
                    .compression_method(CompressionMethod::Stored)
                    .large_file(entry.bytes >= u64::from(u32::MAX))
                    .unix_permissions(0o644)
                    .last_modified_time(DateTime::try_from(time).unwrap_or_default());
                zip.start_file(&entry.path, options)?;
            }
            Form::Tar => {
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
    /// If there are more than the entry announced.
    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let left = self.left.checked_sub(bytes.len() as u64);
        self.left = left.ok_or_else(|| io::Error::other(format!("{} has more bytes than announced", self.path)))?;
        match &mut self.form {
            Form::Zip(zip) => zip.write_all(bytes),
            Form::Tar => self.out.write_all(bytes),
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
    /// If the last entry is not complete.
    pub(super) fn finish(mut self) -> io::Result<Bytes> {
        self.end_entry()?;
        match self.form {
            Form::Zip(zip) => drop((*zip).finish()?),
            Form::Tar => self.out.write_all(&[0; 2 * BLOCK as usize])?,
        }
        Ok(self.out.take())
    }

    /// Number of bytes to be taken.
    pub(super) fn ready(&self) -> usize {
        self.out.bytes().len()
    }

    /// The bytes since the last call.
    pub(super) fn take(&mut self) -> Bytes {
        self.out.take()
    }
}

/// Bytes on their way from a writer; the zip writer keeps a clone.
#[derive(Clone, Debug, Default)]
struct Buffer(Arc<Mutex<Vec<u8>>>);

impl Buffer {
    fn bytes(&self) -> std::sync::MutexGuard<'_, Vec<u8>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self) -> Bytes {
        std::mem::take(&mut *self.bytes()).into()
    }
}

impl Write for Buffer {
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

    fn contents() -> Vec<(Entry, Vec<u8>)> {
        let file = |path: &str, len: usize| {
            let entry =
                Entry { path: path.into(), bytes: len as u64, modified: "2026-01-02T03:04:06Z".parse().unwrap() };
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

    /// Without writing 5 GiB: the headers of a large entry, and that another length than announced is an error.
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
        packer.begin(&Entry { bytes: 2, ..contents().remove(0).0 }).unwrap();
        assert!(packer.write(b"xyz").is_err());
    }
}
