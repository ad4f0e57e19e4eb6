//! Wavefront OBJ: vertices, faces (with or without texture and normal indices, counted from either end), groups.
//!
//! Coordinates are read as f64, except in files that oviduct wrote: there they are the shortest decimals of f32 values, and
//! the certified surface is that of these values.

use super::error::ReadError;
use super::surface::Surface;
use super::text::{lines, point, point_f32, quoted, unit, wrong};

/// Bytes at the beginning of a file that must not contain a zero: a file that does is not text.
const LOOK: usize = 4096;

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    if bytes[..bytes.len().min(LOOK)].contains(&0) {
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
    let Parser { mut surface, greatest, line, .. } = parser;
    if greatest > surface.positions.len() {
        return Err(wrong(line, format!("there is no vertex {greatest}")));
    }
    surface.begin_group(None);
    Ok(surface)
}

#[derive(Default)]
struct Parser {
    surface: Surface,
    /// Whether coordinates are 32-bit floats.
    single: bool,
    /// The greatest vertex number of a face so far, from 1, and its line: faces may name vertices that come later.
    greatest: usize,
    line: usize,
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
                let point = if self.single { point_f32(number, &mut words)? } else { point(number, &mut words)? };
                self.surface.add_vertex(point)?;
            }
            Some("f") => self.face(number, words)?,
            Some("g" | "o") => {
                let mut name = words.next().unwrap_or_default().to_owned();
                for word in words {
                    name.push(' ');
                    name.push_str(word);
                }
                self.surface.begin_group(Some(&name));
            }
            _ => {}
        }
        Ok(())
    }

    fn face<'a>(&mut self, number: usize, words: impl Iterator<Item = &'a str>) -> Result<(), ReadError> {
        let (mut face, mut count) = ([0u32; 4], 0);
        let mut more = Vec::new();
        for word in words {
            let index = vertex(&self.surface, number, word)?;
            if index as usize >= self.greatest {
                (self.greatest, self.line) = (index as usize + 1, number);
            }
            if count < face.len() {
                face[count] = index;
            } else {
                if more.is_empty() {
                    more.extend(face);
                }
                more.push(index);
            }
            count += 1;
        }
        if count < 3 {
            return Err(wrong(number, "a face has fewer than three corners"));
        }
        self.surface.add_face(if more.is_empty() { &face[..count] } else { &more })
    }
}

/// The vertex that a corner of a face names, from 0.
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
