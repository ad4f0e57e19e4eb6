//! `sections.bin`: all cross sections of a model, each readable separately.
//!
//! The layout suits streams and byte ranges: the writer never seeks, and the index is at the end, so that a reader with the
//! last [`TRAILER_LEN`] bytes and the index can fetch any section by one range. Every part has a checksum, and the
//! whole file a SHA-256; damaged input gives an error, never a panic or wrong data. `docs/sections-bin.md` describes the
//! format.

#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod payload;
mod reader;
mod writer;

pub use payload::read_section_from_bytes;
pub use reader::SectionsReader;
pub use writer::write_sections;

use super::Metadata;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::io;

/// Media type of the file.
pub const MEDIA_TYPE: &str = "application/vnd.oviduct.sections";

/// Version of the format that is written and read.
pub const VERSION: u32 = 1;
/// Bytes of the trailer, the last of the file.
pub const TRAILER_LEN: usize = 64;
/// Bytes of one entry of the index.
pub const ENTRY_LEN: usize = 48;

const MAGIC: &[u8; 8] = b"OVISECT\n";
const END_MAGIC: &[u8; 8] = b"OVISEND\n";
/// Most bytes of the header's JSON that a reader accepts.
const MAX_HEADER: u32 = 1 << 20;
/// Most points of a ring.
const MAX_POINTS: u32 = 1 << 24;

/// Why sections cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SectionsError {
    /// The input could not be read.
    #[error("reading sections failed")]
    Io(#[from] io::Error),
    /// The file is not a sections file.
    #[error("not a sections file")]
    NotSections,
    /// The version of the format is not supported.
    #[error("sections file of version {0}; this program reads version {VERSION}")]
    Version(u32),
    /// Truncated or changed since it was written.
    #[error("the sections file is damaged: {0}")]
    Corrupt(&'static str),
    /// There is no such section.
    #[error("section {k} of {len} does not exist")]
    OutOfRange {
        /// Requested index, from 0.
        k: usize,
        /// Sections in the file.
        len: usize,
    },
}

/// The header of a sections file: the origin of its model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SectionsHeader {
    /// Unit of points and `z`: always `um`.
    pub units: String,
    /// Version of the engine that grew it.
    pub engine: String,
    /// Name of the preset.
    pub preset: String,
    /// Seed.
    pub seed: u64,
    /// Digest of the model.
    pub digest: String,
    /// Length of the tube in millimetres.
    pub length_mm: f64,
}

impl From<&Metadata> for SectionsHeader {
    fn from(meta: &Metadata) -> Self {
        Self {
            units: "um".into(),
            engine: meta.engine.clone(),
            preset: meta.preset.clone(),
            seed: meta.seed,
            digest: meta.digest.clone(),
            length_mm: meta.length_mm,
        }
    }
}

/// Index entry of a section: its place in the file, and what is known without reading it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SectionEntry {
    /// First byte in the file.
    pub offset: u64,
    /// Bytes in the file.
    pub length: u32,
    /// Points of the inner ring.
    pub inner: u32,
    /// Points of the outer ring.
    pub outer: u32,
    /// Whether it was added to mend a slab.
    pub added: bool,
    /// Time step.
    pub step: f64,
    /// Place along the tube, micrometres.
    pub z_um: f64,
    /// First 8 bytes of the SHA-256 of its bytes in the file.
    pub checksum: [u8; 8],
}

impl SectionEntry {
    fn to_bytes(self) -> [u8; ENTRY_LEN] {
        let mut bytes = [0; ENTRY_LEN];
        bytes[0..8].copy_from_slice(&self.offset.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.length.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.inner.to_le_bytes());
        bytes[16..20].copy_from_slice(&self.outer.to_le_bytes());
        bytes[20..24].copy_from_slice(&u32::from(self.added).to_le_bytes());
        bytes[24..32].copy_from_slice(&self.step.to_le_bytes());
        bytes[32..40].copy_from_slice(&self.z_um.to_le_bytes());
        bytes[40..48].copy_from_slice(&self.checksum);
        bytes
    }

    fn from_bytes(bytes: &[u8; ENTRY_LEN]) -> Result<Self, SectionsError> {
        let flags = u32::from_le_bytes(field(bytes, 20));
        let entry = Self {
            offset: u64::from_le_bytes(field(bytes, 0)),
            length: u32::from_le_bytes(field(bytes, 8)),
            inner: u32::from_le_bytes(field(bytes, 12)),
            outer: u32::from_le_bytes(field(bytes, 16)),
            added: flags == 1,
            step: f64::from_le_bytes(field(bytes, 24)),
            z_um: f64::from_le_bytes(field(bytes, 32)),
            checksum: field(bytes, 40),
        };
        if flags > 1 || entry.inner > MAX_POINTS || entry.outer > MAX_POINTS {
            return Err(SectionsError::Corrupt("an index entry is out of bounds"));
        }
        Ok(entry)
    }
}

/// End of the file: locates the index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trailer {
    /// First byte of the index; it ends where the trailer begins.
    pub index_offset: u64,
    /// Number of sections.
    pub count: u64,
    index_checksum: [u8; 8],
    sha256: [u8; 32],
}

impl Trailer {
    /// Bytes before the hash; the hash covers them too.
    const HEAD: usize = 24;

    /// Reads the trailer from the last [`TRAILER_LEN`] bytes of a file of `file_len` bytes.
    ///
    /// # Errors
    /// [`SectionsError::NotSections`] if the bytes are no trailer, [`SectionsError::Corrupt`] if the index does not fit
    /// the file.
    pub fn parse(bytes: &[u8; TRAILER_LEN], file_len: u64) -> Result<Self, SectionsError> {
        if bytes[56..] != END_MAGIC[..] {
            return Err(SectionsError::NotSections);
        }
        let trailer = Self {
            index_offset: u64::from_le_bytes(field(bytes, 0)),
            count: u64::from_le_bytes(field(bytes, 8)),
            index_checksum: field(bytes, 16),
            sha256: field(bytes, 24),
        };
        let end = trailer
            .count
            .checked_mul(ENTRY_LEN as u64)
            .and_then(|length| length.checked_add(trailer.index_offset))
            .and_then(|end| end.checked_add(TRAILER_LEN as u64));
        if end != Some(file_len) {
            return Err(SectionsError::Corrupt("the index does not fit the file"));
        }
        Ok(trailer)
    }

    fn head_bytes(&self) -> [u8; Self::HEAD] {
        let mut bytes = [0; Self::HEAD];
        bytes[0..8].copy_from_slice(&self.index_offset.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.count.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.index_checksum);
        bytes
    }

    /// Reads the index: the bytes from [`Trailer::index_offset`] up to the trailer.
    ///
    /// # Errors
    /// [`SectionsError::Corrupt`].
    pub fn parse_index(&self, bytes: &[u8]) -> Result<Vec<SectionEntry>, SectionsError> {
        if bytes.len() as u64 != self.count * ENTRY_LEN as u64 || checksum(bytes) != self.index_checksum {
            return Err(SectionsError::Corrupt("the index"));
        }
        let (chunks, _) = bytes.as_chunks::<ENTRY_LEN>();
        let entries = chunks.iter().map(SectionEntry::from_bytes).collect::<Result<Vec<_>, _>>()?;
        let mut previous_end = None;
        for entry in &entries {
            if previous_end.is_some_and(|end| end != entry.offset) {
                return Err(SectionsError::Corrupt("the sections do not follow each other"));
            }
            let end = entry.offset.checked_add(u64::from(entry.length));
            previous_end = Some(end.ok_or(SectionsError::Corrupt("an index entry is out of bounds"))?);
        }
        if previous_end.is_some_and(|end| end != self.index_offset) {
            return Err(SectionsError::Corrupt("the sections do not end at the index"));
        }
        Ok(entries)
    }
}

/// First 8 bytes of the SHA-256.
fn checksum(bytes: &[u8]) -> [u8; 8] {
    field(&Sha256::digest(bytes), 0)
}

/// `N` bytes from `at`; they must exist.
fn field<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    bytes[at..at + N].try_into().expect("the slice has this length")
}

#[cfg(test)]
mod tests;
