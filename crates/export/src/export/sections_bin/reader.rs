//! Reader of a sections file with random access.

use super::{
    MAGIC, MAX_HEADER, SectionEntry, SectionsError, SectionsHeader, TRAILER_LEN, Trailer, VERSION, field,
    read_section_from_bytes,
};
use crate::export::hashing::HashingWriter;
use crate::model::Section;
use std::io::{self, Read, Seek, SeekFrom};

/// An open sections file. The index is in memory; sections are read on request.
pub struct SectionsReader<R> {
    input: R,
    header: SectionsHeader,
    entries: Vec<SectionEntry>,
    trailer: Trailer,
    file_len: u64,
}

impl<R: Read + Seek> SectionsReader<R> {
    /// Reads header, trailer and index.
    ///
    /// # Errors
    /// Any [`SectionsError`] except [`SectionsError::OutOfRange`]. Damage to a section is detected
    /// when the section is read, or by [`verify`](Self::verify).
    pub fn open(mut input: R) -> Result<Self, SectionsError> {
        let file_len = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(0))?;
        let mut start = [0; 16];
        read_or(&mut input, &mut start, SectionsError::NotSections)?;
        if start[..8] != MAGIC[..] {
            return Err(SectionsError::NotSections);
        }
        let version = u32::from_le_bytes(field(&start, 8));
        if version != VERSION {
            return Err(SectionsError::Version(version));
        }
        let header_len = u32::from_le_bytes(field(&start, 12));
        if header_len > MAX_HEADER {
            return Err(SectionsError::Corrupt("the header"));
        }
        let mut header = vec![0; header_len as usize];
        read_or(&mut input, &mut header, SectionsError::Corrupt("the header"))?;
        let header = serde_json::from_slice(&header).map_err(|_| SectionsError::Corrupt("the header"))?;
        let sections_start = 16 + u64::from(header_len);

        let trailer_start =
            file_len.checked_sub(TRAILER_LEN as u64).ok_or(SectionsError::Corrupt("the file is cut off"))?;
        input.seek(SeekFrom::Start(trailer_start))?;
        let mut bytes = [0; TRAILER_LEN];
        read_or(&mut input, &mut bytes, SectionsError::Corrupt("the file is cut off"))?;
        let trailer = Trailer::parse(&bytes, file_len).map_err(|error| match error {
            SectionsError::NotSections => SectionsError::Corrupt("the file is cut off"),
            other => other,
        })?;
        // The trailer fits the length of the file, so this allocates at most as much as the file
        // has.
        let mut index = vec![0; (trailer_start - trailer.index_offset) as usize];
        input.seek(SeekFrom::Start(trailer.index_offset))?;
        read_or(&mut input, &mut index, SectionsError::Corrupt("the index"))?;
        let entries = trailer.parse_index(&index)?;
        let first = entries.first().map_or(trailer.index_offset, |entry| entry.offset);
        if first != sections_start {
            return Err(SectionsError::Corrupt("the sections do not follow the header"));
        }
        Ok(Self { input, header, entries, trailer, file_len })
    }

    /// Header of the file.
    #[must_use]
    pub fn header(&self) -> &SectionsHeader {
        &self.header
    }

    /// Number of sections.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// True if the file has no sections.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Index entries in the order of writing.
    #[must_use]
    pub fn entries(&self) -> &[SectionEntry] {
        &self.entries
    }

    /// Reads section `k`, from 0. Only the bytes of this section are read.
    ///
    /// # Errors
    /// [`SectionsError::OutOfRange`], [`SectionsError::Corrupt`] or [`SectionsError::Io`].
    pub fn section(&mut self, k: usize) -> Result<Section, SectionsError> {
        let entry = *self.entries.get(k).ok_or(SectionsError::OutOfRange { k, len: self.entries.len() })?;
        let mut bytes = vec![0; entry.length as usize];
        self.input.seek(SeekFrom::Start(entry.offset))?;
        read_or(&mut self.input, &mut bytes, SectionsError::Corrupt("a section"))?;
        read_section_from_bytes(&entry, &bytes)
    }

    /// Reads the whole file and checks its SHA-256.
    ///
    /// # Errors
    /// [`SectionsError::Corrupt`] if any byte changed after the file was written.
    pub fn verify(&mut self) -> Result<(), SectionsError> {
        self.input.seek(SeekFrom::Start(0))?;
        let hashed = self.file_len - (TRAILER_LEN - Trailer::HEAD) as u64;
        let mut hash = HashingWriter::new(io::sink());
        if io::copy(&mut self.input.by_ref().take(hashed), &mut hash)? < hashed {
            return Err(SectionsError::Corrupt("the file is cut off"));
        }
        if hash.sha256() == self.trailer.sha256 { Ok(()) } else { Err(SectionsError::Corrupt("the hash of the file")) }
    }
}

/// Fills `bytes`. Returns the error `short` if the input ends too early.
fn read_or(input: &mut impl Read, bytes: &mut [u8], short: SectionsError) -> Result<(), SectionsError> {
    input.read_exact(bytes).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => short,
        _ => SectionsError::Io(error),
    })
}
