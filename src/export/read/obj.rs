//! Wavefront OBJ: vertices, faces (with or without texture and normal indices, counted from either end), groups.

use super::text::{lines, point, unit, wrong};
use super::{ReadError, Surface};

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut surface = Surface::default();
    let mut continued = String::new();
    // Faces may name vertices that come later; the last line that did so is remembered.
    let mut greatest = (0, 0);
    for (number, line) in lines(bytes) {
        if let Some(start) = line.strip_suffix('\\') {
            continued.push_str(start);
            continued.push(' ');
            continue;
        }
        if continued.is_empty() {
            statement(&mut surface, number, &line, &mut greatest)?;
        } else {
            continued.push_str(&line);
            statement(&mut surface, number, &continued, &mut greatest)?;
            continued.clear();
        }
    }
    if !continued.is_empty() {
        return Err(wrong(lines(bytes).count(), "the file ends in the middle of a line"));
    }
    if greatest.0 > surface.positions.len() {
        return Err(wrong(greatest.1, format!("there is no vertex {}", greatest.0)));
    }
    surface.begin_group(None);
    Ok(surface)
}

fn statement(surface: &mut Surface, number: usize, line: &str, greatest: &mut (usize, usize)) -> Result<(), ReadError> {
    let (line, comment) = line.split_once('#').unwrap_or((line, ""));
    if let Some(unit) = unit(comment) {
        surface.unit = unit;
    }
    let mut words = line.split_ascii_whitespace();
    match words.next() {
        Some("v") => {
            if surface.positions.len() >= u32::MAX as usize {
                return Err(wrong(number, "there are more vertices than 32 bits can count"));
            }
            surface.positions.push(point(number, &mut words)?);
        }
        Some("f") => {
            let (mut face, mut count) = ([0u32; 4], 0);
            let mut more = Vec::new();
            for word in words {
                let index = vertex(surface, number, word)?;
                if index as usize >= greatest.0 {
                    *greatest = (index as usize + 1, number);
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
            if more.is_empty() {
                surface.add_face(&face[..count]);
            } else {
                surface.add_face(&more);
            }
        }
        Some("g" | "o") => surface.begin_group(Some(&words.collect::<Vec<_>>().join(" "))),
        _ => {}
    }
    Ok(())
}

/// The vertex that a corner of a face names, from 0.
fn vertex(surface: &Surface, number: usize, word: &str) -> Result<u32, ReadError> {
    let first = word.split('/').next().unwrap_or(word);
    let index: i64 = first.parse().map_err(|_| wrong(number, format!("{word:?} is not a corner of a face")))?;
    let index = match index {
        0 => None,
        1.. => u32::try_from(index - 1).ok(),
        _ => u32::try_from(surface.positions.len() as i64 + index).ok(),
    };
    index.ok_or_else(|| wrong(number, format!("there is no vertex {first}")))
}
