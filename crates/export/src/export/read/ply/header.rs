//! Header of a PLY file.

use super::super::error::ReadError;
use super::super::scalar::Scalar;
use super::super::surface::{Group, Surface};
use super::super::text::{first_line, quoted, unit, wrong};

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Encoding {
    Text,
    Little,
    Big,
}

pub(super) struct Property {
    /// Name in lower case.
    pub(super) name: String,
    /// Type of the number of items, if the property is a list.
    pub(super) count: Option<Scalar>,
    /// Type of the value, or of the items of a list.
    pub(super) item: Scalar,
}

pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
}

pub(super) struct Header<'a> {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Runs of triangles that comments name.
    pub(super) runs: Vec<Group>,
    /// Everything after the header.
    pub(super) body: &'a [u8],
}

/// Reads the header, and from its comments the unit of the surface.
///
/// The data of a binary file begin right after the line end of the header. The first line shows
/// whether line ends are CR alone; then a LF belongs to the data.
pub(super) fn header<'a>(bytes: &'a [u8], surface: &mut Surface) -> Result<Header<'a>, ReadError> {
    let cr_only = bytes
        .iter()
        .position(|&b| b == b'\n' || b == b'\r')
        .is_some_and(|end| bytes[end] == b'\r' && bytes.get(end + 1) != Some(&b'\n'));
    let (mut encoding, mut elements, mut runs) = (None, Vec::<Element>::new(), Vec::new());
    let (mut rest, mut number) = (Some(bytes), 0);
    while let Some(bytes) = rest {
        number += 1;
        let (raw, after) = split_line(bytes, cr_only);
        rest = after;
        let line = String::from_utf8_lossy(raw);
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 1 => {}
            _ if number == 1 => return Err(wrong(1, "the file does not begin with \"ply\"")),
            ["format", name, ..] => {
                encoding = match *name {
                    "ascii" => Some(Encoding::Text),
                    "binary_little_endian" => Some(Encoding::Little),
                    "binary_big_endian" => Some(Encoding::Big),
                    _ => return Err(wrong(number, format!("the format {} is not known", quoted(name)))),
                }
            }
            ["comment", "patch", first, count, ..]
                if let (Ok(first), Ok(count)) = (first.parse::<u32>(), count.parse::<u32>()) =>
            {
                // The name is the rest of the line, including its spaces.
                let name = line.splitn(5, ' ').nth(4).unwrap_or_default().trim();
                let first = first as usize;
                runs.push(Group { name: name.into(), triangles: first..first + count as usize });
            }
            ["comment" | "obj_info", ..] => {
                surface.unit = unit(&line).unwrap_or(surface.unit);
            }
            ["element", name, count] => {
                let Ok(count) = count.parse() else {
                    return Err(wrong(number, format!("{} is not a number of elements", quoted(count))));
                };
                elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            ["property", kind @ .., name] => {
                let types = match kind {
                    [item] => scalar(item).map(|item| (None, item)),
                    ["list", count, item] => scalar(count).map(Some).zip(scalar(item)),
                    _ => None,
                };
                let Some(((count, item), element)) = types.zip(elements.last_mut()) else {
                    let detail = format!("the property {} has no known type or no element", quoted(name));
                    return Err(wrong(number, detail));
                };
                element.properties.push(Property { name: name.to_ascii_lowercase(), count, item });
            }
            ["end_header"] => {
                let encoding = encoding.ok_or_else(|| wrong(number, "the header names no format"))?;
                return Ok(Header { encoding, elements, runs, body: rest.unwrap_or_default() });
            }
            [] => {}
            _ => return Err(wrong(number, format!("{} is not a line of a PLY header", quoted(line.trim())))),
        }
    }
    Err(wrong(number, "the header does not end"))
}

/// The first line, and what follows its end.
fn split_line(bytes: &[u8], cr_only: bool) -> (&[u8], Option<&[u8]>) {
    if !cr_only {
        let Some(end) = bytes.iter().position(|&b| b == b'\n') else { return (bytes, None) };
        return (&bytes[..end], Some(&bytes[end + 1..]));
    }
    let (line, _) = first_line(bytes);
    (line, bytes.get(line.len() + 1..))
}

fn scalar(name: &str) -> Option<Scalar> {
    Some(match name.to_ascii_lowercase().as_str() {
        "char" | "int8" => Scalar::Signed(1),
        "uchar" | "uint8" => Scalar::Unsigned(1),
        "short" | "int16" => Scalar::Signed(2),
        "ushort" | "uint16" => Scalar::Unsigned(2),
        "int" | "int32" => Scalar::Signed(4),
        "uint" | "uint32" => Scalar::Unsigned(4),
        "int64" => Scalar::Signed(8),
        "uint64" => Scalar::Unsigned(8),
        "float" | "float32" => Scalar::Float(4),
        "double" | "float64" => Scalar::Float(8),
        _ => return None,
    })
}
