//! STL, text or binary. The format has no shared vertices: each triangle brings its three.

use super::text::{lines, point, unit, wrong};
use super::{ReadError, Surface};

const HEADER: usize = 80;
const RECORD: usize = 50;

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    if bytes.len() / RECORD > u32::MAX as usize / 3 {
        let detail = "there are more corners than 32 bits can count".to_owned();
        return Err(ReadError::Byte { byte: bytes.len(), detail });
    }
    let count = bytes.get(HEADER..HEADER + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    let expected = count.map(|count| HEADER as u64 + 4 + u64::from(count) * RECORD as u64);
    // Binary files may begin with the word that text files begin with; their length tells them apart.
    if expected == Some(bytes.len() as u64) {
        return Ok(binary(bytes));
    }
    if bytes.trim_ascii_start().starts_with(b"solid") {
        return text(bytes);
    }
    let detail = match expected {
        Some(expected) => format!("a binary file of so many triangles has {expected} bytes, not {}", bytes.len()),
        None => "the file is too short for the header of a binary file".to_owned(),
    };
    Err(ReadError::Byte { byte: bytes.len().min(HEADER), detail })
}

fn binary(bytes: &[u8]) -> Surface {
    let (header, records) = bytes.split_at(HEADER + 4);
    let mut surface = Surface::default();
    if let Some(unit) = unit(&String::from_utf8_lossy(&header[..HEADER])) {
        surface.unit = unit;
    }
    for record in records.chunks_exact(RECORD) {
        let (floats, _) = record[12..48].as_chunks::<4>();
        let corner = |k: usize| [0, 1, 2].map(|axis| f64::from(f32::from_le_bytes(floats[3 * k + axis])));
        add(&mut surface, [corner(0), corner(1), corner(2)]);
    }
    surface
}

fn text(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut surface = Surface::default();
    let (mut corners, mut count) = ([[0.0; 3]; 3], 0);
    let (mut last, mut ended) = (0, false);
    for (number, line) in lines(bytes) {
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("solid") => {
                if let Some(unit) = unit(&line) {
                    surface.unit = unit;
                }
                ended = false;
                surface.begin_group(Some(&words.collect::<Vec<_>>().join(" ")));
            }
            Some("vertex") => {
                let corner = point(number, &mut words)?;
                *corners.get_mut(count).ok_or_else(|| wrong(number, "a facet has more than three corners"))? = corner;
                count += 1;
            }
            Some("endloop") => {
                if count != 3 {
                    return Err(wrong(number, format!("a facet has {count} corners instead of three")));
                }
                add(&mut surface, corners);
                count = 0;
            }
            Some("endsolid") => ended = true,
            Some("facet" | "outer" | "endfacet") | None => {}
            Some(word) => return Err(wrong(number, format!("{word:?} is no keyword of STL"))),
        }
        last = number;
    }
    if count != 0 || !ended {
        return Err(wrong(last, "the file ends before its solid does"));
    }
    surface.begin_group(None);
    Ok(surface)
}

fn add(surface: &mut Surface, corners: [[f64; 3]; 3]) {
    let first = surface.positions.len() as u32;
    surface.positions.extend(corners);
    surface.triangles.push([first, first + 1, first + 2]);
}
