//! `sections.bin`: all cross sections of a model, each readable separately.
//!
//! The layout suits streams and byte ranges. The writer never seeks, and the index is at the end. A
//! reader fetches the last [`TRAILER_LEN`] bytes and the index, and then any section with one range
//! request.
//!
//! Every part has a checksum, and the whole file a SHA-256. Damaged input results in an error,
//! never in a panic or wrong data. `docs/sections-bin.md` describes the format.

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
use super::chunks::join;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::io;

/// Media type of the file.
pub const MEDIA_TYPE: &str = "application/vnd.oviduct.sections";

/// Version of the format that is written and read.
pub const VERSION: u32 = 1;
/// Size of the trailer at the end of the file, bytes.
pub const TRAILER_LEN: usize = 64;
/// Size of an entry of the index, bytes.
pub const ENTRY_LEN: usize = 48;

const MAGIC: &[u8; 8] = b"OVISECT\n";
const END_MAGIC: &[u8; 8] = b"OVISEND\n";
/// Maximum size of the header's JSON that a reader accepts, bytes.
const MAX_HEADER: u32 = 1 << 20;
/// Maximum number of points of a ring.
const MAX_POINTS: u32 = 1 << 24;

/// Reason why sections cannot be read.
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
    /// The file was truncated or changed after it was written.
    #[error("the sections file is damaged: {0}")]
    Corrupt(&'static str),
    /// The file has no section with this index.
    #[error("section {k} of {len} does not exist")]
    OutOfRange {
        /// Requested index, from 0.
        k: usize,
        /// Number of sections in the file.
        len: usize,
    },
}

/// The header of a sections file: the origin of its model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SectionsHeader {
    /// Unit of points and `z`: always `um`.
    pub units: String,
    /// Version of the engine that grew the model.
    pub engine: String,
    /// Name of the preset.
    pub preset: String,
    /// Seed of the model.
    pub seed: u64,
    /// Digest of the model.
    pub digest: String,
    /// Length of the tube, millimetres.
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

/// Index entry of a section: its location in the file, and properties known without reading it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SectionEntry {
    /// First byte in the file.
    pub offset: u64,
    /// Number of bytes in the file.
    pub length: u32,
    /// Number of points of the inner ring.
    pub inner: u32,
    /// Number of points of the outer ring.
    pub outer: u32,
    /// True if the section was added to mend a slab.
    pub added: bool,
    /// Time step of the section.
    pub step: f64,
    /// Position along the tube, micrometres.
    pub z_um: f64,
    /// First 8 bytes of the SHA-256 of the section's bytes in the file.
    pub checksum: [u8; 8],
}

impl SectionEntry {
    fn to_bytes(self) -> [u8; ENTRY_LEN] {
        let numbers = [self.length, self.inner, self.outer, u32::from(self.added)].map(u32::to_le_bytes);
        let [step, z_um] = [self.step, self.z_um].map(f64::to_le_bytes);
        join([&self.offset.to_le_bytes()[..], numbers.as_flattened(), &step, &z_um, &self.checksum])
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

/// End of the file, which locates the index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trailer {
    /// First byte of the index, which ends where the trailer begins.
    pub index_offset: u64,
    /// Number of sections.
    pub count: u64,
    index_checksum: [u8; 8],
    sha256: [u8; 32],
}

impl Trailer {
    /// Size of the part before the hash, which the hash covers, bytes.
    const HEAD: usize = 24;

    /// Reads the trailer from the last [`TRAILER_LEN`] bytes of a file of `file_len` bytes.
    ///
    /// # Errors
    /// [`SectionsError::NotSections`] if the bytes are not a trailer, [`SectionsError::Corrupt`] if
    /// the index does not fit the file.
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
        join([self.index_offset.to_le_bytes(), self.count.to_le_bytes(), self.index_checksum])
    }

    /// Parses the index: the bytes from [`Trailer::index_offset`] to the trailer.
    ///
    /// # Errors
    /// [`SectionsError::Corrupt`] if the bytes are not the index of this file.
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

/// First 8 bytes of the SHA-256 of `bytes`.
fn checksum(bytes: &[u8]) -> [u8; 8] {
    field(&Sha256::digest(bytes), 0)
}

/// The `N` bytes at `at`, which must exist.
fn field<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    bytes[at..at + N].try_into().expect("the slice has this length")
}

#[cfg(test)]
mod tests;
