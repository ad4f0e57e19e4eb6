//! Shared by the text formats: lines, numbers, units in comments.

use super::error::ReadError;
use super::surface::Unit;
use std::borrow::Cow;
use std::str::FromStr;

/// The lines of a file with their numbers from 1, without line ends; bytes that are not UTF-8 are replaced.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    bytes.split(|&b| b == b'\n').enumerate().map(|(i, line)| {
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        (i + 1, String::from_utf8_lossy(line))
    })
}

/// A word of the file for a message, in quotes and shortened.
pub(super) fn quoted(word: &str) -> String {
    const LONGEST: usize = 40;
    match word.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{:?}…", &word[..end]),
        None => format!("{word:?}"),
    }
}

pub(super) fn wrong(line: usize, detail: impl Into<String>) -> ReadError {
    ReadError::Line { line, detail: detail.into() }
}

/// The next word as a coordinate.
fn coordinate<'a, T: FromStr>(line: usize, words: &mut impl Iterator<Item = &'a str>) -> Result<T, ReadError> {
    let word = words.next().ok_or_else(|| wrong(line, "a coordinate is missing"))?;
    word.parse().map_err(|_| wrong(line, format!("{} is not a number", quoted(word))))
}

/// The next three words as a point.
pub(super) fn point<'a>(line: usize, words: &mut impl Iterator<Item = &'a str>) -> Result<[f64; 3], ReadError> {
    Ok([coordinate(line, words)?, coordinate(line, words)?, coordinate(line, words)?])
}

/// The next three words as a point of 32-bit floats.
pub(super) fn point_f32<'a>(line: usize, words: &mut impl Iterator<Item = &'a str>) -> Result<[f64; 3], ReadError> {
    let point: [f32; 3] = [coordinate(line, words)?, coordinate(line, words)?, coordinate(line, words)?];
    Ok(point.map(f64::from))
}

/// The unit that a comment states, for example `unit: mm`, `units = metres` or `UNITS=um`.
pub(super) fn unit(comment: &str) -> Option<Unit> {
    let mut words = comment.split(|c: char| c.is_whitespace() || "=:,;()".contains(c)).filter(|w| !w.is_empty());
    words.find(|word| word.eq_ignore_ascii_case("unit") || word.eq_ignore_ascii_case("units"))?;
    let metres = match words.next()?.to_lowercase().trim_end_matches(['.', '\0']) {
        "m" | "metre" | "metres" | "meter" | "meters" => 1.0,
        "cm" | "centimetre" | "centimetres" | "centimeter" | "centimeters" => 1e-2,
        "mm" | "millimetre" | "millimetres" | "millimeter" | "millimeters" => 1e-3,
        "um" | "µm" | "μm" | "micrometre" | "micrometres" | "micrometer" | "micrometers" | "micron" | "microns" => {
            1e-6
        }
        _ => return None,
    };
    Some(Unit::Stated(metres))
}
