//! Tests of `sections.bin`: round trips, random access, damaged files.

use super::*;
use crate::export::tests::meta;
use crate::model::{Ring, Section, sample};
use proptest::prelude::*;
use std::io::Cursor;

fn file(sections: &[Section]) -> Vec<u8> {
    let mut out = Vec::new();
    write_sections(sections, &meta(), &mut out).unwrap();
    out
}

/// Reads all sections and verifies the file.
fn read_all(file: &[u8]) -> Result<Vec<Section>, SectionsError> {
    let mut reader = SectionsReader::open(Cursor::new(file))?;
    let sections = (0..reader.len()).map(|k| reader.section(k)).collect::<Result<_, _>>()?;
    reader.verify()?;
    Ok(sections)
}

/// Bits of points, so that NaNs can be compared.
fn bits(section: &Section) -> (u64, u64, bool, Vec<u32>) {
    let rings = [&section.inner, &section.outer];
    let words = rings.iter().flat_map(|ring| {
        let points = ring.points.iter().flatten().map(|x| x.to_bits());
        ring.ids.iter().copied().chain(points).chain([ring.len() as u32])
    });
    (section.step.to_bits(), section.z_um.to_bits(), section.added, words.collect())
}

fn samples() -> Vec<Section> {
    vec![sample::section(40, 0.0, 0.0), sample::section(0, 3.5, 105.0), sample::section(90, 10.0, 300.0)]
}

#[test]
fn sections_are_read_alone_and_in_any_order() {
    let sections = samples();
    let file = file(&sections);
    let mut reader = SectionsReader::open(Cursor::new(&file)).unwrap();
    assert_eq!(reader.header(), &SectionsHeader::from(&meta()));
    assert_eq!(reader.len(), 3);
    for k in [2, 0, 1] {
        assert_eq!(reader.section(k).unwrap(), sections[k]);
    }
    assert!(matches!(reader.section(3), Err(SectionsError::OutOfRange { k: 3, len: 3 })));
    reader.verify().unwrap();
}

#[test]
fn ranges_of_bytes_are_enough() {
    let sections = samples();
    let file = file(&sections);
    let (body, tail) = file.split_last_chunk::<TRAILER_LEN>().unwrap();
    let trailer = Trailer::parse(tail, file.len() as u64).unwrap();
    let entries = trailer.parse_index(&body[trailer.index_offset as usize..]).unwrap();
    let entry = entries[2];
    assert_eq!((entry.z_um, entry.inner, entry.outer), (300.0, 90, 90));
    let range = entry.offset as usize..entry.offset as usize + entry.length as usize;
    assert_eq!(read_section_from_bytes(&entry, &file[range]).unwrap(), sections[2]);
}

#[test]
fn a_damaged_section_leaves_the_others_readable() {
    let sections = samples();
    let mut file = file(&sections);
    let offset = SectionsReader::open(Cursor::new(&file)).unwrap().entries()[0].offset as usize;
    file[offset + 20] ^= 1;
    let mut reader = SectionsReader::open(Cursor::new(&file)).unwrap();
    assert!(matches!(reader.section(0), Err(SectionsError::Corrupt("a section"))));
    assert_eq!(reader.section(2).unwrap(), sections[2]);
    assert!(matches!(reader.verify(), Err(SectionsError::Corrupt(_))));
}

#[test]
fn other_files_and_versions_are_named() {
    assert!(matches!(read_all(b"glTF and so on, for longer than any header"), Err(SectionsError::NotSections)));
    assert!(matches!(read_all(b""), Err(SectionsError::NotSections)));
    let mut file = file(&samples());
    file[8] = 2;
    assert!(matches!(read_all(&file), Err(SectionsError::Version(2))));
}

#[test]
fn an_unfinished_file_is_refused() {
    let file = file(&samples());
    for length in [file.len() - 1, file.len() - TRAILER_LEN, file.len() - TRAILER_LEN - ENTRY_LEN] {
        assert!(matches!(read_all(&file[..length]), Err(SectionsError::Corrupt(_))), "{length}");
    }
}

#[test]
fn the_number_of_sections_need_not_be_known() {
    let mut out = Vec::new();
    write_sections(&samples(), &Metadata { sections: 0, ..meta() }, &mut out).unwrap();
    assert_eq!(out, file(&samples()));
}

#[test]
fn a_ring_without_ids_is_refused() {
    let mut section = sample::section(5, 0.0, 0.0);
    section.outer.ids.pop();
    let error = write_sections(&[section], &meta(), &mut Vec::new()).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
}

#[test]
fn a_smooth_contour_takes_less_than_raw_floats() {
    let sections = [sample::section(4000, 0.0, 0.0)];
    let raw = sections[0].particles() * 12;
    let packed = file(&sections).len();
    assert!(packed * 3 < raw * 2, "{packed} of {raw}");
}

/// A file of one section with the given bytes at `at` of its index entry, and with the correct
/// checksum of the index.
fn forged(at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut file = file(&samples()[..1]);
    let head = file.len() - TRAILER_LEN;
    let index = head - ENTRY_LEN;
    file[index + at..][..bytes.len()].copy_from_slice(bytes);
    let sum = checksum(&file[index..head]);
    file[head + 16..head + 24].copy_from_slice(&sum);
    file
}

#[test]
fn a_section_that_ends_beyond_the_greatest_offset_is_refused() {
    let file = forged(0, &(u64::MAX - 1).to_le_bytes());
    let (body, tail) = file.split_last_chunk::<TRAILER_LEN>().unwrap();
    let trailer = Trailer::parse(tail, file.len() as u64).unwrap();
    let index = trailer.parse_index(&body[trailer.index_offset as usize..]);
    assert!(matches!(index, Err(SectionsError::Corrupt("an index entry is out of bounds"))), "{index:?}");
}

#[test]
fn more_points_than_the_bytes_can_hold_are_refused_before_memory_is_taken() {
    let file = forged(12, &MAX_POINTS.to_le_bytes());
    let mut reader = SectionsReader::open(Cursor::new(&file)).unwrap();
    let length = reader.entries()[0].length as usize;
    assert!(length * (128 << 10) / 4 < 12 * MAX_POINTS as usize, "the section has {length} bytes");
    assert!(matches!(reader.section(0), Err(SectionsError::Corrupt("compressed data"))));
}

fn any_ring() -> impl Strategy<Value = Ring> {
    prop::collection::vec((any::<u32>(), prop::array::uniform2(prop::num::f32::ANY)), 0..50).prop_map(|all| {
        let (ids, points) = all.into_iter().unzip();
        Ring { ids, points }
    })
}

prop_compose! {
    fn any_section()(
        step in prop::num::f64::ANY, z_um in prop::num::f64::ANY, added: bool, inner in any_ring(), outer in any_ring(),
    ) -> Section {
        Section { step, z_um, added, inner, outer }
    }
}

proptest! {
    #[test]
    fn any_sections_survive(sections in prop::collection::vec(any_section(), 0..5)) {
        let read = read_all(&file(&sections)).unwrap();
        prop_assert_eq!(read.iter().map(bits).collect::<Vec<_>>(), sections.iter().map(bits).collect::<Vec<_>>());
    }

    #[test]
    fn any_change_is_an_error(changes in prop::collection::vec((any::<prop::sample::Index>(), 1u8..), 1..4)) {
        let original = file(&samples());
        let mut changed = original.clone();
        for (at, flip) in &changes {
            changed[at.index(original.len())] ^= flip;
        }
        prop_assume!(changed != original);
        prop_assert!(read_all(&changed).is_err());
    }

    #[test]
    fn any_cut_or_extension_is_an_error(at: prop::sample::Index, more in prop::collection::vec(any::<u8>(), 1..100)) {
        let original = file(&samples());
        prop_assert!(read_all(&original[..at.index(original.len())]).is_err());
        let extended = [original, more].concat();
        prop_assert!(read_all(&extended).is_err());
    }

    #[test]
    fn a_forged_index_never_panics(at in 0usize..ENTRY_LEN * 3 + 24, value: u8, point: prop::sample::Index) {
        // Correct checksums, so that the checks behind them run.
        let mut forged = file(&samples());
        let head = forged.len() - TRAILER_LEN;
        let index = head - 3 * ENTRY_LEN;
        forged[index + at] = value;
        let sum = checksum(&forged[index..head]);
        forged[head + 16..head + 24].copy_from_slice(&sum);
        if let Ok(mut reader) = SectionsReader::open(Cursor::new(&forged)) {
            let k = point.index(reader.len().max(1));
            let _ = reader.section(k);
        }
    }
}
