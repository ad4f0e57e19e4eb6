//! Wavefront OBJ: vertices, groups, and faces whose corners may have texture and normal indices and
//! count vertices from either end.
//!
//! Coordinates are read as f64, except in files written by oviduct. These contain the shortest
//! decimals of f32 values, and the certificate holds for the f32 values.

use super::error::ReadError;
use super::surface::Surface;
use super::text::{coordinate, lines, quoted, unit, wrong};

/// Number of bytes at the beginning of a text file that must not contain a zero.
const TEXT_PROBE: usize = 4096;

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    if bytes[..bytes.len().min(TEXT_PROBE)].contains(&0) {
        return Err(ReadError::UnknownFormat);
    }
    let mut parser = Parser::default();
    let mut continued = String::new();
    for (number, line) in lines(bytes) {
        if let Some(start) = line.strip_suffix('\\') {
            continued.push_str(start);
            continued.push(' ');
        } else if continued.is_empty() {
            parser.statement(number, &line)?;
        } else {
            continued.push_str(&line);
            parser.statement(number, &continued)?;
            continued.clear();
        }
    }
    if !continued.is_empty() {
        return Err(wrong(lines(bytes).count(), "the file ends in the middle of a line"));
    }
    let Parser { mut surface, max_vertex, line, .. } = parser;
    if max_vertex > surface.positions.len() {
        return Err(wrong(line, format!("there is no vertex {max_vertex}")));
    }
    surface.begin_group(None);
    Ok(surface)
}

#[derive(Default)]
struct Parser {
    surface: Surface,
    /// True if coordinates are f32.
    single: bool,
    /// Largest vertex number of a face so far, from 1. Faces may name vertices that follow later.
    max_vertex: usize,
    /// Line of `max_vertex`.
    line: usize,
    /// Vertices of the current face.
    corners: Vec<u32>,
}

impl Parser {
    fn statement(&mut self, number: usize, line: &str) -> Result<(), ReadError> {
        let (line, comment) = line.split_once('#').unwrap_or((line, ""));
        if !comment.is_empty() {
            self.single |= comment.trim_start().starts_with("generator: oviduct");
            self.surface.unit = unit(comment).unwrap_or(self.surface.unit);
        }
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let parse = if self.single { coordinate::<f32> } else { coordinate::<f64> };
                let mut next = || parse(number, words.next());
                self.surface.add_vertex([next()?, next()?, next()?])?;
            }
            Some("f") => self.face(number, words)?,
            Some("g" | "o") => self.surface.begin_group(Some(&words.collect::<Vec<_>>().join(" "))),
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
        if self.corners.len() < 3 {
            return Err(wrong(number, "a face has fewer than three corners"));
        }
        self.surface.add_face(&self.corners)
    }
}

/// Vertex that a corner of a face names, from 0.
fn vertex(surface: &Surface, number: usize, word: &str) -> Result<u32, ReadError> {
    let first = word.split('/').next().unwrap_or(word);
    let index: i64 = first.parse().map_err(|_| wrong(number, format!("{} is not a corner of a face", quoted(word))))?;
    let index = match index {
        0 => None,
        1.. => u32::try_from(index - 1).ok(),
        _ => u32::try_from(surface.positions.len() as i64 + index).ok(),
    };
    index.ok_or_else(|| wrong(number, format!("there is no vertex {first}")))
}
