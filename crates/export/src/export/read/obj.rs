//! Wavefront OBJ: vertices, groups, and faces whose corners may have texture and normal indices and
//! count vertices from either end.
//!
//! Coordinates are read as f64, except in files written by oviduct. These contain the shortest
//! decimals of f32 values, and the certificate holds for the f32 values.

mod names;

use super::error::ReadError;
use super::polygons::Polygons;
use super::surface::Surface;
use super::text::{coordinate, lines, quoted, unit, without_mark, without_padding, wrong};
use names::{Kind, Names};

/// Number of bytes at the beginning of a text file that must not contain a zero.
const TEXT_PROBE: usize = 4096;

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    let bytes = without_padding(without_mark(bytes));
    if bytes[..bytes.len().min(TEXT_PROBE)].contains(&0) {
        return Err(ReadError::UnknownFormat);
    }
    let mut parser = Parser::default();
    let mut continued = String::new();
    let mut last = 0;
    for (number, line) in lines(bytes) {
        last = number;
        match continues(&line) {
            Some(start) => {
                continued.push_str(start);
                continued.push(' ');
            }
            None if continued.is_empty() => parser.statement(number, &line)?,
            None => {
                continued.push_str(&line);
                parser.statement(number, &continued)?;
                continued.clear();
            }
        }
    }
    if !continued.is_empty() {
        return Err(wrong(last, "the file ends in the middle of a line"));
    }
    parser.finish()
}

/// The line without the `\` by which it continues on the next line.
///
/// A comment ends with its line. A `\` at the end of a name, such as a folder, belongs to the name.
fn continues(line: &str) -> Option<&str> {
    let start = line.trim_end().strip_suffix('\\')?;
    let belongs_to_name = !start.ends_with(|c: char| c.is_ascii_whitespace()) && has_name(line);
    let in_comment = without_comment(line).0.len() < line.len();
    (!in_comment && !belongs_to_name).then_some(start)
}

fn has_name(line: &str) -> bool {
    line.split_ascii_whitespace().next().is_some_and(|word| NAMED.contains(&word))
}

/// The line without its comment, and the comment without the `#`. A `#` may belong to a name, or to
/// a number such as `1.#QNAN`.
fn without_comment(line: &str) -> (&str, &str) {
    let has_name = has_name(line);
    let belongs_to_word = |before: &str| match has_name {
        true => !before.ends_with(|c: char| c.is_ascii_whitespace()),
        false => before.ends_with("1."),
    };
    let begin = line.match_indices('#').map(|(at, _)| at).find(|&at| !belongs_to_word(&line[..at]));
    begin.map_or((line, ""), |at| (&line[..at], &line[at + 1..]))
}

/// Statements that end with a name.
const NAMED: [&str; 8] = ["g", "o", "usemtl", "mtllib", "usemap", "maplib", "shadow_obj", "trace_obj"];

/// Elements that are not read.
const PASSED_OVER: [&str; 4] = ["points", "lines", "free-form curves and surfaces", "calls of other files"];

#[derive(Default)]
struct Parser {
    surface: Surface,
    names: Names,
    polygons: Polygons,
    /// True if coordinates are f32.
    single: bool,
    /// Largest vertex number of a face so far, from 1. Faces may name vertices that follow later.
    max_vertex: usize,
    /// Line of `max_vertex`.
    line: usize,
    /// Vertices of the current face.
    corners: Vec<u32>,
    /// Numbers of elements of each kind of [`PASSED_OVER`].
    passed_over: [u64; 4],
}

impl Parser {
    fn statement(&mut self, number: usize, line: &str) -> Result<(), ReadError> {
        let (line, comment) = without_comment(line);
        if !comment.is_empty() {
            self.single |= comment.trim_start().starts_with("generator: oviduct");
            self.surface.unit = unit(comment).unwrap_or(self.surface.unit);
        }
        let mut words = line.split_ascii_whitespace();
        let now = self.surface.triangles.len();
        let mut name =
            |kind| self.names.begin(kind, now, &line.split_ascii_whitespace().skip(1).collect::<Vec<_>>().join(" "));
        match words.next() {
            Some("v") => {
                let parse = if self.single { coordinate::<f32> } else { coordinate::<f64> };
                let mut next = || parse(number, words.next());
                self.surface.add_vertex([next()?, next()?, next()?])?;
            }
            Some("f" | "fo") => self.face(number, words)?,
            Some("g") => name(Kind::Group),
            Some("o") => name(Kind::Object),
            Some("usemtl") => name(Kind::Material),
            Some("p") => self.passed_over[0] += 1,
            Some("l") => self.passed_over[1] += 1,
            Some("curv" | "curv2" | "surf") => self.passed_over[2] += 1,
            Some("call") => self.passed_over[3] += 1,
            _ => {}
        }
        Ok(())
    }

    fn face<'a>(&mut self, number: usize, words: impl Iterator<Item = &'a str>) -> Result<(), ReadError> {
        self.corners.clear();
        for word in words {
            let index = vertex(&self.surface, number, word)?;
            if index as usize >= self.max_vertex {
                (self.max_vertex, self.line) = (index as usize + 1, number);
            }
            self.corners.push(index);
        }
        self.polygons.add(&mut self.surface, &self.corners, number as u64)
    }

    fn finish(self) -> Result<Surface, ReadError> {
        let Self { mut surface, names, polygons, max_vertex, line, passed_over, .. } = self;
        if max_vertex > surface.positions.len() {
            let detail = format!("there is no vertex {max_vertex}; the file has {}", surface.positions.len());
            return Err(wrong(line, detail));
        }
        surface.groups = names.groups(surface.triangles.len());
        polygons.split(&mut surface, |line| format!("line {line}"))?;
        for (count, kind) in passed_over.into_iter().zip(PASSED_OVER) {
            if count > 0 {
                surface.note(format!("{kind} ({count}) are passed over"));
            }
        }
        Ok(surface)
    }
}

/// Vertex that a corner of a face names, from 0.
fn vertex(surface: &Surface, number: usize, word: &str) -> Result<u32, ReadError> {
    let first = word.split('/').next().unwrap_or(word);
    let index: i64 = first.parse().map_err(|_| wrong(number, format!("{} is not a corner of a face", quoted(word))))?;
    let index = match index {
        0 => None,
        1.. => u32::try_from(index - 1).ok(),
        _ => u32::try_from((surface.positions.len() as i64).saturating_add(index)).ok(),
    };
    index.ok_or_else(|| wrong(number, format!("there is no vertex {first}")))
}
