//! Fuzz target for `sections.bin`.

use super::{
    ENTRY_LEN, SectionEntry, SectionsError, SectionsReader, TRAILER_LEN, Trailer, checksum, field,
    read_section_from_bytes, write_sections,
};
use crate::export::Metadata;
use crate::model::Section;
use sha2::{Digest, Sha256};
use std::io::Cursor;
use std::ops::Range;

/// Reads the bytes unchanged, and with corrected checksums, so that the fuzzer reaches the code
/// behind the checks.
pub fn sections(bytes: &[u8]) {
    file(bytes);
    let mut sealed = bytes.to_vec();
    seal(&mut sealed);
    file(&sealed);
    by_ranges(&sealed);
}

/// Checks that a readable file survives writing and reading, and that a changed bit is detected.
fn file(bytes: &[u8]) {
    let Ok((meta, sections)) = read(bytes) else { return };
    let mut written = Vec::new();
    write_sections(&sections, &meta, &mut written).expect("sections that were read can be written");
    let (meta_again, again) = read(&written).expect("what was written can be read");
    assert_eq!((meta_again, again.len()), (meta.clone(), sections.len()));
    let mut rewritten = Vec::new();
    write_sections(&again, &meta, &mut rewritten).expect("sections that were read can be written");
    assert!(written == rewritten, "other sections were read than were written");

    let bit = checksum(bytes).iter().fold(0, |bit, &b| 256 * bit + usize::from(b)) % (8 * bytes.len());
    let mut damaged = bytes.to_vec();
    damaged[bit / 8] ^= 1 << (bit % 8);
    assert!(read(&damaged).is_err(), "bit {bit} can be changed without being noticed");
}

fn read(bytes: &[u8]) -> Result<(Metadata, Vec<Section>), SectionsError> {
    let mut reader = SectionsReader::open(Cursor::new(bytes))?;
    let sections = (0..reader.len()).map(|k| reader.section(k)).collect::<Result<Vec<_>, _>>()?;
    reader.verify()?;
    let header = reader.header().clone();
    let meta = Metadata {
        preset: header.preset,
        seed: header.seed,
        digest: header.digest,
        engine: header.engine,
        length_mm: header.length_mm,
        sections: sections.len(),
    };
    Ok((meta, sections))
}

/// Reads as a client does that requests byte ranges. Sections must lie before the index.
fn by_ranges(bytes: &[u8]) {
    let Some((body, tail)) = bytes.split_last_chunk::<TRAILER_LEN>() else { return };
    let Ok(trailer) = Trailer::parse(tail, bytes.len() as u64) else { return };
    let index = usize::try_from(trailer.index_offset).expect("the index lies within the file");
    let Ok(entries) = trailer.parse_index(&body[index..]) else { return };
    for entry in &entries {
        let range = place(entry).filter(|range| range.end <= index).expect("a section lies before the index");
        let _ = read_section_from_bytes(entry, &bytes[range]);
    }
}

fn place(entry: &SectionEntry) -> Option<Range<usize>> {
    let start = usize::try_from(entry.offset).ok()?;
    Some(start..start.checked_add(entry.length as usize)?)
}

/// Corrects all checksums of a file, as far as it has the parts that they cover.
pub fn seal(bytes: &mut [u8]) {
    let Some(trailer) = bytes.len().checked_sub(TRAILER_LEN) else { return };
    let index = usize::try_from(u64::from_le_bytes(field(bytes, trailer))).ok().filter(|index| *index <= trailer);
    if let Some(index) = index {
        for at in (index..trailer).step_by(ENTRY_LEN).take_while(|at| at + ENTRY_LEN <= trailer) {
            let start = usize::try_from(u64::from_le_bytes(field(bytes, at))).ok();
            let length = u32::from_le_bytes(field(bytes, at + 8)) as usize;
            let end = start.and_then(|start| start.checked_add(length)).filter(|end| *end <= bytes.len());
            if let Some((start, end)) = start.zip(end) {
                let sum = checksum(&bytes[start..end]);
                bytes[at + 40..at + 48].copy_from_slice(&sum);
            }
        }
        let sum = checksum(&bytes[index..trailer]);
        bytes[trailer + 16..trailer + 24].copy_from_slice(&sum);
    }
    let hash = Sha256::digest(&bytes[..trailer + Trailer::HEAD]);
    bytes[trailer + Trailer::HEAD..trailer + Trailer::HEAD + 32].copy_from_slice(&hash);
}
