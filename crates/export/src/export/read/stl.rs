//! STL, text or binary. The format has no shared vertices: each triangle has its own three.
//!
//! Coordinates are 32-bit floats in both forms. Each solid of a text file is a group. Only binary
//! files written by oviduct have groups: the attributes of their triangles are patch numbers.

use super::error::ReadError;
use super::patches::Patches;
use super::surface::Surface;
use super::text::{coordinate, quoted, unit, wrong};
use std::borrow::Cow;

const HEADER: usize = 80;
const RECORD: usize = 50;

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    let count = bytes.get(HEADER..HEADER + 4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    let expected = count.map(|count| HEADER as u64 + 4 + u64::from(count) * RECORD as u64);
    // Some binary files begin with `solid`, as text files do; only their length is reliable.
    if expected == Some(bytes.len() as u64) {
        return binary(bytes);
    }
    if bytes.trim_ascii_start().starts_with(b"solid") {
        return text(bytes);
    }
    let detail = match expected {
        Some(expected) => format!(
            "this is not STL: a text file begins with `solid`, and a binary file with this header has {expected} bytes \
             instead of {}",
            bytes.len()
        ),
        None => "the file is too short for the header of a binary file".to_owned(),
    };
    Err(ReadError::Byte { byte: bytes.len().min(HEADER), detail })
}

fn binary(bytes: &[u8]) -> Result<Surface, ReadError> {
    let (header, records) = bytes.split_at(HEADER + 4);
    let unit = unit(&String::from_utf8_lossy(&header[..HEADER])).unwrap_or_default();
    let mut surface = Surface { unit, ..Surface::default() };
    let has_patches = header.starts_with(b"oviduct ");
    let mut patches = Patches::default();
    for record in records.chunks_exact(RECORD) {
        let (floats, _) = record[12..48].as_chunks::<4>();
        let corner = |k: usize| [0, 1, 2].map(|axis| f64::from(f32::from_le_bytes(floats[3 * k + axis])));
        add(&mut surface, [corner(0), corner(1), corner(2)])?;
        let attribute = i64::from(record[48]) | i64::from(record[49]) << 8;
        if has_patches && attribute > 0 {
            let first = surface.triangles.len() - 1;
            patches.add(&mut surface, first, attribute - 1);
        }
    }
    Ok(surface)
}

/// Reads a sequence of words. Line ends matter only for names, which extend to the end of the line.
fn text(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut surface = Surface::default();
    let mut words = Words::new(bytes);
    let (mut facets, mut ended) = (0_u64, false);
    while let Some(word) = words.next() {
        match word {
            "solid" => {
                let name = words.rest_of_line();
                surface.unit = unit(&name).unwrap_or(surface.unit);
                ended = false;
                surface.begin_group(Some(name.trim()));
            }
            "endsolid" => {
                words.rest_of_line();
                ended = true;
            }
            "facet" => {
                words.expect("normal")?;
                words.point()?;
                words.expect("outer")?;
                words.expect("loop")?;
                let mut corners = [[0.0; 3]; 3];
                for corner in &mut corners {
                    words.expect("vertex")?;
                    *corner = words.point()?;
                }
                words.expect("endloop")?;
                words.expect("endfacet")?;
                add(&mut surface, corners)?;
                facets += 1;
            }
            word => {
                return Err(wrong(words.line, format!("{} instead of a facet or the end of the solid", quoted(word))));
            }
        }
    }
    if !ended {
        return Err(wrong(words.line, format!("the file ends after {facets} facets, without the end of the solid")));
    }
    surface.begin_group(None);
    Ok(surface)
}

/// Splits a text into words.
struct Words<'a> {
    rest: &'a [u8],
    /// Line of the last word, from 1.
    line: usize,
}

impl<'a> Words<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, line: 1 }
    }

    /// Returns the next word. A word that is not UTF-8 is replaced by one that no rule accepts.
    fn next(&mut self) -> Option<&'a str> {
        let begin = self.rest.iter().position(|b| !b.is_ascii_whitespace())?;
        self.line += self.rest[..begin].iter().filter(|&&b| b == b'\n').count();
        let rest = &self.rest[begin..];
        let (word, rest) = rest.split_at(rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len()));
        self.rest = rest;
        Some(std::str::from_utf8(word).unwrap_or("\u{fffd}"))
    }

    fn rest_of_line(&mut self) -> Cow<'a, str> {
        let end = self.rest.iter().position(|&b| b == b'\n').unwrap_or(self.rest.len());
        let (line, rest) = self.rest.split_at(end);
        self.rest = rest;
        String::from_utf8_lossy(line)
    }

    fn expect(&mut self, keyword: &str) -> Result<(), ReadError> {
        match self.next() {
            Some(word) if word == keyword => Ok(()),
            Some(word) => Err(wrong(self.line, format!("{} instead of {keyword:?}", quoted(word)))),
            None => Err(wrong(self.line, format!("the file ends before {keyword:?}"))),
        }
    }

    fn point(&mut self) -> Result<[f64; 3], ReadError> {
        let mut point = [0.0; 3];
        for x in &mut point {
            let word = self.next();
            *x = coordinate::<f32>(self.line, word)?;
        }
        Ok(point)
    }
}

fn add(surface: &mut Surface, corners: [[f64; 3]; 3]) -> Result<(), ReadError> {
    let first = surface.positions.len() as u32;
    for corner in corners {
        surface.add_vertex(corner)?;
    }
    surface.add_face(&[first, first + 1, first + 2])
}
