//! STL, text or binary. The format has no shared vertices: each triangle has its own three.
//!
//! Coordinates are 32-bit floats in binary files and in text files of models, whose first solid has
//! the name of a patch. Other text files are read as 64-bit floats. Normals are not used. Each
//! solid of a text file is a group. Only binary files written by oviduct have groups: the
//! attributes of their triangles are patch numbers.

mod words;

use super::error::ReadError;
use super::patches::Patches;
use super::polygons::Polygons;
use super::surface::Surface;
use super::text::{first_line, foreign, quoted, unit, without_mark, without_padding, wrong};
use crate::model::PatchKind;
use words::Words;

const HEADER: usize = 80;
/// Bytes before the first triangle of a binary file: the header and the number of triangles.
const START: usize = HEADER + 4;
const RECORD: usize = 50;
/// Number of bytes at the beginning of a text file that must not contain a zero. It includes the
/// number of triangles of a binary file, which contains a zero unless it is above 16 million.
const TEXT_PROBE: usize = 1024;

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    let stated = bytes.get(HEADER..START).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes);
    let length = stated.map(|stated| START as u64 + u64::from(stated) * RECORD as u64);
    // Some binary files begin with `solid`, as text files do; only their length is reliable.
    if length == Some(bytes.len() as u64) {
        return binary(bytes);
    }
    let text = without_padding(without_mark(bytes));
    if text.trim_ascii().is_empty() {
        return Ok(Surface::default());
    }
    if let Some(error) = foreign(bytes) {
        return Err(error);
    }
    if is_solid(text) && !text[..text.len().min(TEXT_PROBE)].contains(&0) {
        return self::text(text);
    }
    let (Some(stated), Some(length)) = (stated, length) else {
        let detail = "this is not STL: it does not begin with `solid`, as a text file does, and is too short for the \
                      header of a binary file";
        return Err(ReadError::Byte { byte: bytes.len(), detail: detail.to_owned() });
    };
    if let Some(word) = first_word(&bytes[..START]) {
        let detail = format!("this is not STL: the text begins with {} instead of `solid`", quoted(word));
        return Err(wrong(1, detail));
    }
    let found = (bytes.len() - START) / RECORD;
    match usize::try_from(length) {
        Ok(length) if length < bytes.len() && (stated > 0 || found == 0) => {
            let mut surface = binary(&bytes[..length])?;
            let rest = bytes.len() - length;
            surface.note(format!("{rest} bytes after the last of {stated} triangles are passed over"));
            Ok(surface)
        }
        _ => {
            let why = if stated == 0 { "its number of triangles was never written" } else { "the file was cut off" };
            let detail = format!(
                "this is not STL, or {why}: a text file begins with `solid`; as a binary file it states {stated} \
                 triangles and has the bytes of {found}"
            );
            Err(ReadError::Byte { byte: HEADER, detail })
        }
    }
}

/// True if the first word, after lines that begin with `#`, is `solid`.
fn is_solid(text: &[u8]) -> bool {
    let mut text = text.trim_ascii_start();
    while text.starts_with(b"#") {
        text = text[first_line(text).0.len()..].trim_ascii_start();
    }
    text.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
}

/// First word of bytes that are printable text.
fn first_word(bytes: &[u8]) -> Option<&str> {
    let is_text = bytes.iter().all(|b| b.is_ascii_graphic() || b.is_ascii_whitespace());
    str::from_utf8(bytes).ok().filter(|_| is_text)?.split_ascii_whitespace().next()
}

fn binary(bytes: &[u8]) -> Result<Surface, ReadError> {
    let (header, records) = bytes.split_at(START);
    let unit = unit(&String::from_utf8_lossy(&header[..HEADER])).unwrap_or_default();
    let mut surface = Surface { unit, ..Surface::default() };
    let has_patches = header.starts_with(b"oviduct ");
    let mut patches = Patches::default();
    for record in records.chunks_exact(RECORD) {
        let (floats, _) = record[12..48].as_chunks::<4>();
        let corner = |k: usize| [0, 1, 2].map(|axis| f64::from(f32::from_le_bytes(floats[3 * k + axis])));
        let first = surface.positions.len() as u32;
        for k in 0..3 {
            surface.add_vertex(corner(k))?;
        }
        surface.add_face(&[first, first + 1, first + 2])?;
        let attribute = i64::from(record[48]) | i64::from(record[49]) << 8;
        if has_patches && attribute > 0 {
            let first = surface.triangles.len() - 1;
            patches.add(&mut surface, first, ("patch", attribute - 1));
        }
    }
    Ok(surface)
}

/// Lines that some programs add, and that do not change the surface.
const PASSED_OVER: [&str; 5] = ["color", "colour", "attribute", "attributes", "material"];

/// Reads a sequence of words in any case. Line ends matter only for names, which extend to the end
/// of the line.
fn text(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut reader = TextReader {
        words: Words::new(bytes),
        surface: Surface::default(),
        polygons: Polygons::default(),
        single: false,
        corners: Vec::new(),
        facets: 0,
    };
    let mut ended = false;
    while let Some(word) = reader.words.next() {
        let keyword = word.to_ascii_lowercase();
        match keyword.as_str() {
            "solid" => {
                let name = reader.words.name();
                reader.surface.unit = unit(&name).unwrap_or(reader.surface.unit);
                reader.single |= reader.facets == 0 && PatchKind::named(name.trim()).is_some();
                reader.surface.begin_group(Some(name.trim()));
                ended = false;
            }
            "endsolid" | "end" if keyword == "endsolid" || reader.words.next_is("solid") => {
                reader.words.name();
                ended = true;
            }
            "facet" => reader.facet()?,
            keyword if PASSED_OVER.contains(&keyword) || word.starts_with('#') => reader.words.pass_line(),
            _ if ended && !reader.words.has_facets() => {
                reader.surface.note("text after the last solid is passed over");
                break;
            }
            _ => {
                let detail = format!("{} instead of a facet or the end of the solid", quoted(word));
                return Err(wrong(reader.words.line(), detail));
            }
        }
    }
    let TextReader { words, mut surface, polygons, facets, .. } = reader;
    if !ended {
        let detail = format!("the end is missing: the file stops after facet {facets}, before `endsolid`");
        return Err(wrong(words.line(), detail));
    }
    surface.begin_group(None);
    polygons.split(&mut surface, |line| format!("line {line}"))?;
    Ok(surface)
}

struct TextReader<'a> {
    words: Words<'a>,
    surface: Surface,
    polygons: Polygons,
    /// True if coordinates are f32.
    single: bool,
    /// Vertices of the current facet.
    corners: Vec<u32>,
    facets: u64,
}

impl TextReader<'_> {
    /// Reads a facet after its first word.
    fn facet(&mut self) -> Result<(), ReadError> {
        let line = self.words.line();
        self.words.expect("normal")?;
        for _ in 0..3 {
            // Normals are not used, so a word may be any spelling of a number that is none.
            match self.words.next() {
                Some(word) if !word.eq_ignore_ascii_case("outer") => {}
                Some(_) => return Err(wrong(self.words.line(), "a component of the normal is missing")),
                None => return Err(self.words.ended("the normal ends")),
            }
        }
        while self.words.next_is_any(&PASSED_OVER) {
            self.words.pass_line();
        }
        if !self.words.next_is("outerloop") {
            self.words.expect("outer")?;
            self.words.expect("loop")?;
        }
        self.corners.clear();
        while self.words.next_is("vertex") {
            let point = self.words.point(self.single)?;
            self.corners.push(self.surface.positions.len() as u32);
            self.surface.add_vertex(point)?;
        }
        self.words.expect_end("loop")?;
        while self.words.next_is_any(&PASSED_OVER) {
            self.words.pass_line();
        }
        self.words.expect_end("facet")?;
        self.facets += 1;
        match self.corners.len() {
            3 => self.surface.add_face(&self.corners),
            0..3 => {
                let detail = format!("a facet has {} vertices instead of three", self.corners.len());
                Err(wrong(line, detail))
            }
            _ => {
                self.surface.note("facets with more than three vertices are split into triangles");
                self.polygons.add(&mut self.surface, &self.corners, line as u64)
            }
        }
    }
}
