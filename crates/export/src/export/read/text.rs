//! Parts that several readers share: lines, numbers and units of text, encodings and base64.

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

/// The bytes without a byte order mark of UTF-8.
pub(super) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// The bytes of a text without zeros and the end mark of DOS (Ctrl-Z) at its end.
pub(super) fn without_padding(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|&b| b != 0 && b != 0x1a).map_or(0, |last| last + 1);
    bytes.get(..end).unwrap_or_default()
}

/// First bytes of packed files and of texts in other encodings, with their names and what to do.
const FOREIGN: [(&[u8], &str, &str); 9] = [
    (b"\xff\xfe", "text in UTF-16", "save it as UTF-8"),
    (b"\xfe\xff", "text in UTF-16", "save it as UTF-8"),
    (b"\x1f\x8b", "a file compressed by gzip", UNPACK),
    (b"PK\x03\x04", "a ZIP archive", UNPACK),
    (b"BZh", "a file compressed by bzip2", UNPACK),
    (b"\xfd7zXZ\0", "a file compressed by xz", UNPACK),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive", UNPACK),
    (b"\x28\xb5\x2f\xfd", "a file compressed by Zstandard", UNPACK),
    (b"Rar!", "a RAR archive", UNPACK),
];
const UNPACK: &str = "unpack it first";

/// Error about a file that is packed, or text in an encoding that is not read.
pub(super) fn foreign(bytes: &[u8]) -> Option<ReadError> {
    let &(_, kind, remedy) = FOREIGN.iter().find(|(start, ..)| bytes.starts_with(start))?;
    Some(ReadError::Foreign { kind: kind.to_owned(), remedy })
}

/// Lines of a file with their numbers from 1, without line ends, which are LF, CR LF or CR. Invalid
/// UTF-8 is replaced.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    let mut rest = Some(bytes);
    (1..).map_while(move |number| {
        let bytes = rest?;
        let (line, next) = first_line(bytes);
        rest = next;
        Some((number, String::from_utf8_lossy(line)))
    })
}

/// The first line without its end, and what follows the line end, if there is one.
pub(super) fn first_line(bytes: &[u8]) -> (&[u8], Option<&[u8]>) {
    let Some(end) = bytes.iter().position(|&b| b == b'\n' || b == b'\r') else { return (bytes, None) };
    let (line, rest) = bytes.split_at(end);
    (line, Some(rest.strip_prefix(b"\r\n").unwrap_or(&rest[1..])))
}

/// Number of line ends.
pub(super) fn line_ends(bytes: &[u8]) -> usize {
    let ends = bytes.iter().filter(|&&b| b == b'\n' || b == b'\r').count();
    ends - bytes.windows(2).filter(|pair| pair == b"\r\n").count()
}

/// A word of the file for a message, in quotes and cut to 40 characters. Bytes that are not text
/// are not shown.
pub(super) fn quoted(word: &str) -> String {
    if word.contains(|c: char| c.is_control() && !c.is_whitespace() || c == char::REPLACEMENT_CHARACTER) {
        return "a word that is not text in UTF-8".to_owned();
    }
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
    number::<T>(word).ok_or_else(|| wrong(line, not_a_number(word)))
}

/// Parses a number of type `T`. Spellings of other programs for what is not a number or not finite
/// are known: `-nan(ind)`, `1.#QNAN`, `-1.#INF`.
#[inline]
pub(super) fn number<T: FromStr + Into<f64>>(word: &str) -> Option<f64> {
    word.parse().map(T::into).ok().or_else(|| not_finite(word))
}

#[cold]
fn not_finite(word: &str) -> Option<f64> {
    let magnitude = word.trim_start_matches(['+', '-']).to_ascii_lowercase();
    let named = ["nan(", "nanq", "nans", "qnan", "snan", "1.#ind", "1.#qnan", "1.#snan"];
    if named.iter().any(|start| magnitude.starts_with(start)) {
        return Some(f64::NAN);
    }
    let infinity = if word.starts_with('-') { f64::NEG_INFINITY } else { f64::INFINITY };
    magnitude.starts_with("1.#inf").then_some(infinity)
}

/// Sentence about a word that should be a number.
#[cold]
pub(super) fn not_a_number(word: &str) -> String {
    let advice = |from: &[char], to: &str| word.contains(from) && word.replace(from, to).parse::<f64>().is_ok();
    let advice = if advice(&[','], ".") {
        ": it has a decimal comma; write a decimal point"
    } else if advice(&['d', 'D'], "e") {
        ": it has a Fortran exponent; write E instead of D"
    } else {
        ""
    };
    format!("{} is not a number{advice}", quoted(word))
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
        "nm" | "nanometre" | "nanometres" | "nanometer" | "nanometers" => 1e-9,
        "in" | "inch" | "inches" => 0.0254,
        "ft" | "foot" | "feet" => 0.3048,
        _ => return None,
    };
    Some(Unit::Stated(metres))
}
