//! Counts and hashes the bytes of a file while it is written, so that the file is not read again.

use sha2::{Digest, Sha256};
use std::io::{self, Write};

/// Size and hash of a written file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileDigest {
    /// Size, bytes.
    pub bytes: u64,
    /// SHA-256 in lower-case hex.
    pub sha256: String,
}

/// Forwards writes to another writer, and counts and hashes their bytes.
///
/// Wrap this writer in a buffer, not the inner one: hashing is fastest for large writes.
#[derive(Debug)]
pub struct HashingWriter<W> {
    inner: W,
    hash: Sha256,
    bytes: u64,
}

impl<W: Write> HashingWriter<W> {
    /// Wraps a writer.
    pub fn new(inner: W) -> Self {
        Self { inner, hash: Sha256::new(), bytes: 0 }
    }

    /// Number of bytes written so far.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// SHA-256 of the bytes written so far.
    #[must_use]
    pub fn sha256(&self) -> [u8; 32] {
        self.hash.clone().finalize().into()
    }

    /// Ends the file and returns the inner writer, without flushing it.
    #[must_use]
    pub fn finish(self) -> (W, FileDigest) {
        let digest = FileDigest { bytes: self.bytes, sha256: hex::encode(self.sha256()) };
        (self.inner, digest)
    }
}

impl<W: Write> Write for HashingWriter<W> {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(data)?;
        self.hash.update(&data[..written]);
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A writer that accepts three bytes at a time.
    struct Slow(Vec<u8>);

    impl Write for Slow {
        fn write(&mut self, data: &[u8]) -> io::Result<usize> {
            let n = data.len().min(3);
            self.0.extend_from_slice(&data[..n]);
            Ok(n)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn short_writes_are_hashed_once() {
        let mut writer = HashingWriter::new(Slow(Vec::new()));
        writer.write_all(b"abc").unwrap();
        writer.write_all(b"").unwrap();
        assert_eq!(hex::encode(writer.sha256()), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        writer.write_all(b"dbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq").unwrap();
        let (inner, digest) = writer.finish();
        assert_eq!(inner.0, b"abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq");
        assert_eq!(digest.bytes, 56);
        assert_eq!(digest.sha256, "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
    }
}
