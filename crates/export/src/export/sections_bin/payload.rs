//! Compressed form of the points and ids of a section.
//!
//! A section is encoded as six planes of 32-bit numbers: ids, x and y of the inner ring, then of
//! the outer ring. Each plane is transformed before compression:
//!
//! 1. The bits of each number are replaced by their difference from the previous number.
//! 2. Differences are folded, so that small differences of either sign become small numbers.
//! 3. All first bytes are stored, then all second bytes, and so on.
//!
//! Neighbours lie micrometres apart, so most high bytes are zero.

use super::{SectionEntry, SectionsError, checksum};
use crate::model::{Ring, Section};

/// Size of a point before compression (id, x, y), bytes.
const POINT_LEN: usize = 12;
const PLANE_BYTES: usize = 4;
/// Maximum expansion of a compressed byte: a block of zstd has at least 4 bytes and expands to at
/// most 128 KiB.
const EXPANSION: usize = (128 << 10) / 4;

/// Encodes both rings into `raw`, replacing its contents.
pub(super) fn encode(section: &Section, raw: &mut Vec<u8>) {
    raw.clear();
    for ring in [&section.inner, &section.outer] {
        push_plane(raw, ring.len(), ring.ids.iter().copied());
        for axis in 0..2 {
            push_plane(raw, ring.len(), ring.points.iter().map(|p| p[axis].to_bits()));
        }
    }
}

fn push_plane(raw: &mut Vec<u8>, n: usize, values: impl Iterator<Item = u32>) {
    let start = raw.len();
    raw.resize(start + n * PLANE_BYTES, 0);
    let plane = &mut raw[start..];
    let mut previous = 0u32;
    for (i, value) in values.enumerate() {
        let difference = value.wrapping_sub(previous).cast_signed();
        previous = value;
        let folded = ((difference << 1) ^ (difference >> 31)).cast_unsigned();
        for (k, byte) in folded.to_le_bytes().into_iter().enumerate() {
            plane[k * n + i] = byte;
        }
    }
}

/// Decodes a plane of `n` numbers.
fn plane_values(plane: &[u8], n: usize) -> impl Iterator<Item = u32> + '_ {
    let mut previous = 0u32;
    (0..n).map(move |i| {
        let folded = u32::from_le_bytes([plane[i], plane[n + i], plane[2 * n + i], plane[3 * n + i]]);
        let difference = (folded >> 1) ^ (folded & 1).wrapping_neg();
        previous = previous.wrapping_add(difference);
        previous
    })
}

/// Decodes a section from its [`SectionEntry::length`] bytes at [`SectionEntry::offset`].
///
/// # Errors
/// [`SectionsError::Corrupt`] if `bytes` are not the bytes of the entry.
pub fn read_section_from_bytes(entry: &SectionEntry, bytes: &[u8]) -> Result<Section, SectionsError> {
    if bytes.len() as u64 != u64::from(entry.length) || checksum(bytes) != entry.checksum {
        return Err(SectionsError::Corrupt("a section"));
    }
    let counts = [entry.inner as usize, entry.outer as usize];
    let expected = POINT_LEN * (counts[0] + counts[1]);
    // Checked before memory is allocated, because the count may be wrong.
    if expected > bytes.len() * EXPANSION {
        return Err(SectionsError::Corrupt("compressed data"));
    }
    let raw = zstd::bulk::decompress(bytes, expected).map_err(|_| SectionsError::Corrupt("compressed data"))?;
    if raw.len() != expected {
        return Err(SectionsError::Corrupt("a section is too short"));
    }
    let (inner, outer) = raw.split_at(POINT_LEN * counts[0]);
    Ok(Section {
        step: entry.step,
        z_um: entry.z_um,
        added: entry.added,
        inner: decode_ring(inner, counts[0]),
        outer: decode_ring(outer, counts[1]),
    })
}

fn decode_ring(raw: &[u8], n: usize) -> Ring {
    let (ids, points) = raw.split_at(n * PLANE_BYTES);
    let (x, y) = points.split_at(n * PLANE_BYTES);
    let coordinates = plane_values(x, n).zip(plane_values(y, n));
    Ring {
        ids: plane_values(ids, n).collect(),
        points: coordinates.map(|(x, y)| [f32::from_bits(x), f32::from_bits(y)]).collect(),
    }
}
