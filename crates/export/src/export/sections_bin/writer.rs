//! Writes sections one after another, the index last.

use super::payload::encode;
use super::{END_MAGIC, MAGIC, MAX_POINTS, Metadata, SectionEntry, SectionsHeader, Trailer, VERSION, checksum};
use crate::export::hashing::HashingWriter;
use crate::model::Section;
use std::io::{self, Write};

const ZSTD_LEVEL: i32 = 3;
/// Most bytes that zstd compresses at once.
const BLOCK: usize = 1 << 17;

/// Writes a sections file as a stream: [`push`](Self::push) each section, then [`finish`](Self::finish).
///
/// If it is dropped before that, no reader accepts the file.
pub struct SectionsWriter<W: Write> {
    out: HashingWriter<W>,
    entries: Vec<SectionEntry>,
    compressor: zstd::bulk::Compressor<'static>,
    raw: Vec<u8>,
}

impl<W: Write> SectionsWriter<W> {
    /// Begins a file. The number of sections in `meta` is not used: they are counted as they are written.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(out: W, meta: &Metadata) -> io::Result<Self> {
        let mut out = HashingWriter::new(out);
        let header = serde_json::to_vec(&SectionsHeader::from(meta))?;
        let length = u32::try_from(header.len()).map_err(|_| invalid("the header is too long"))?;
        out.write_all(MAGIC)?;
        out.write_all(&VERSION.to_le_bytes())?;
        out.write_all(&length.to_le_bytes())?;
        out.write_all(&header)?;
        let mut compressor = zstd::bulk::Compressor::new(ZSTD_LEVEL)?;
        // Otherwise it allocates larger memory for each section that is larger than the last.
        compressor.compress(&vec![0; BLOCK])?;
        Ok(Self { out, entries: Vec::new(), compressor, raw: Vec::new() })
    }

    /// Appends a section.
    ///
    /// # Errors
    /// Those of the output; [`io::ErrorKind::InvalidInput`] if a ring has more or fewer ids than points, or more
    /// points than the format allows (16,777,216).
    #[inline(never)] // counted by scripts/counts
    pub fn push(&mut self, section: &Section) -> io::Result<()> {
        let count = |ring: &crate::model::Ring| match u32::try_from(ring.len()) {
            Ok(n) if n <= MAX_POINTS && ring.ids.len() == ring.points.len() => Ok(n),
            Ok(n) if n <= MAX_POINTS => Err(invalid("a ring has not one id a point")),
            _ => Err(invalid("a ring has too many points")),
        };
        let (inner, outer) = (count(&section.inner)?, count(&section.outer)?);
        encode(section, &mut self.raw);
        let bytes = self.compressor.compress(&self.raw)?;
        self.entries.push(SectionEntry {
            offset: self.out.bytes(),
            length: u32::try_from(bytes.len()).map_err(|_| invalid("a section is too long"))?,
            inner,
            outer,
            added: section.added,
            step: section.step,
            z_um: section.z_um,
            checksum: checksum(&bytes),
        });
        self.out.write_all(&bytes)
    }

    /// Bytes so far.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.out.bytes()
    }

    /// Flushes the output.
    ///
    /// # Errors
    /// Those of the output.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Index and trailer: what makes a whole file of the bytes so far.
    #[must_use]
    pub fn end(&self) -> Vec<u8> {
        let mut end: Vec<u8> = self.entries.iter().flat_map(|entry| entry.to_bytes()).collect();
        let mut trailer = Trailer {
            index_offset: self.out.bytes(),
            count: self.entries.len() as u64,
            index_checksum: checksum(&end),
            sha256: [0; 32],
        };
        end.extend_from_slice(&trailer.head_bytes());
        trailer.sha256 = self.out.sha256_with(&end);
        end.extend_from_slice(&trailer.sha256);
        end.extend_from_slice(END_MAGIC);
        end
    }

    /// Writes index and trailer, flushes, and returns the output.
    ///
    /// # Errors
    /// Those of the output.
    pub fn finish(mut self) -> io::Result<W> {
        let end = self.end();
        self.out.write_all(&end)?;
        self.out.flush()?;
        Ok(self.out.finish().0)
    }
}

/// Writes all sections at once.
///
/// # Errors
/// As [`SectionsWriter`].
pub fn write_sections(sections: &[Section], meta: &Metadata, out: &mut impl Write) -> io::Result<()> {
    let mut writer = SectionsWriter::new(out, meta)?;
    for section in sections {
        writer.push(section)?;
    }
    writer.finish().map(drop)
}

fn invalid(detail: &'static str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, detail)
}
