//! Writer of a sections file: the sections one after another, then the index.

use super::payload::encode;
use super::{END_MAGIC, MAGIC, MAX_POINTS, Metadata, SectionEntry, SectionsHeader, Trailer, VERSION, checksum};
use crate::export::hashing::HashingWriter;
use crate::model::{Ring, Section};
use std::io::{self, Write};

const ZSTD_LEVEL: i32 = 3;
/// Maximum size of a block of zstd, bytes.
const BLOCK: usize = 1 << 17;

/// Writes all sections. The number of sections in `meta` is ignored.
///
/// # Errors
/// Returns any error of writing to `out`, and [`io::ErrorKind::InvalidInput`] if the numbers of ids
/// and points of a ring differ, or a ring has more points than the format allows (16,777,216).
pub fn write_sections(sections: &[Section], meta: &Metadata, out: &mut impl Write) -> io::Result<()> {
    let mut out = HashingWriter::new(out);
    let header = serde_json::to_vec(&SectionsHeader::from(meta))?;
    let length = u32::try_from(header.len()).map_err(|_| invalid("the header is too long"))?;
    out.write_all(MAGIC)?;
    out.write_all(&VERSION.to_le_bytes())?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(&header)?;
    let mut compressor = zstd::bulk::Compressor::new(ZSTD_LEVEL)?;
    // Allocates all memory now. Otherwise each section that is larger than all before reallocates
    // it.
    compressor.compress(&vec![0; BLOCK])?;
    let (mut index, mut raw) = (Vec::new(), Vec::new());
    for section in sections {
        let (inner, outer) = (points(&section.inner)?, points(&section.outer)?);
        encode(section, &mut raw);
        let bytes = compressor.compress(&raw)?;
        let entry = SectionEntry {
            offset: out.bytes(),
            length: u32::try_from(bytes.len()).map_err(|_| invalid("a section is too long"))?,
            inner,
            outer,
            added: section.added,
            step: section.step,
            z_um: section.z_um,
            checksum: checksum(&bytes),
        };
        index.extend_from_slice(&entry.to_bytes());
        out.write_all(&bytes)?;
    }
    let trailer = Trailer {
        index_offset: out.bytes(),
        count: sections.len() as u64,
        index_checksum: checksum(&index),
        sha256: [0; 32],
    };
    out.write_all(&index)?;
    out.write_all(&trailer.head_bytes())?;
    let sha256 = out.sha256();
    out.write_all(&sha256)?;
    out.write_all(END_MAGIC)?;
    out.flush()
}

/// Checked number of points of a ring.
fn points(ring: &Ring) -> io::Result<u32> {
    match u32::try_from(ring.len()) {
        Ok(n) if n <= MAX_POINTS && ring.ids.len() == ring.points.len() => Ok(n),
        Ok(n) if n <= MAX_POINTS => Err(invalid("a ring has not one id a point")),
        _ => Err(invalid("a ring has too many points")),
    }
}

fn invalid(detail: &'static str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, detail)
}
