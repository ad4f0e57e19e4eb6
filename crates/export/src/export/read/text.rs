//! Parts that several readers share: lines, numbers and units of text, and base64.

use super::error::ReadError;
use super::surface::Unit;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use std::borrow::Cow;
use std::str::FromStr;

/// Decoder of base64 that accepts missing padding and unused bits that are not zero.
pub(super) const BASE64: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_allow_trailing_bits(true)
        .with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// Lines of a file with their numbers from 1, without line ends. Invalid UTF-8 is replaced.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    bytes.split(|&b| b == b'\n').enumerate().map(|(i, line)| {
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        (i + 1, String::from_utf8_lossy(line))
    })
}

/// A word of the file for a message, in quotes and cut to 40 characters.
pub(super) fn quoted(word: &str) -> String {
    match word.char_indices().nth(40) {
        Some((end, _)) => format!("{:?}…", &word[..end]),
        None => format!("{word:?}"),
    }
}

pub(super) fn wrong(line: usize, detail: impl Into<String>) -> ReadError {
    ReadError::Line { line, detail: detail.into() }
}

/// Parses a coordinate as a number of type `T`.
pub(super) fn coordinate<T: FromStr + Into<f64>>(line: usize, word: Option<&str>) -> Result<f64, ReadError> {
    let word = word.ok_or_else(|| wrong(line, "a coordinate is missing"))?;
    word.parse().map(T::into).map_err(|_| wrong(line, format!("{} is not a number", quoted(word))))
}

/// Unit that a comment states, for example `unit: mm`, `units = metres` or `UNITS=um`.
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
