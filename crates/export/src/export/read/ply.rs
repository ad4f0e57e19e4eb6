//! PLY, text or binary in either byte order: elements `vertex` (x, y, z) and `face` (a list of
//! vertex indices). Other elements and properties are skipped.
//!
//! A comment such as `comment patch 0 120 inner_wall` names a run of triangles by the first
//! triangle and their number.

use super::error::ReadError;
use super::scalar::Scalar;
use super::surface::{Group, Surface};
use super::text::{lines, quoted, unit};

#[derive(Clone, Copy, Debug, PartialEq)]
enum Encoding {
    Text,
    Little,
    Big,
}

struct Property {
    name: String,
    /// Type of the number of items, if the property is a list.
    count: Option<Scalar>,
    /// Type of the value, or of the items of a list.
    item: Scalar,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    let mut surface = Surface::default();
    let (encoding, elements, begin) = header(bytes, &mut surface)?;
    let runs = std::mem::take(&mut surface.groups);
    let mut body = Body { bytes, at: begin, encoding };
    for element in &elements {
        match element.name.as_str() {
            "vertex" => vertices(&mut body, element, &mut surface)?,
            "face" => faces(&mut body, element, &mut surface)?,
            // An element without properties has no data. Its count is not bounded by the file.
            _ if element.properties.is_empty() => {}
            _ => {
                for _ in 0..element.count {
                    for property in &element.properties {
                        body.values(property, |_| {})?;
                    }
                }
            }
        }
    }
    let faces = elements.iter().filter(|element| element.name == "face");
    if faces.fold(0_usize, |sum, element| sum.saturating_add(element.count)) == surface.triangles.len() {
        surface.groups = ordered_runs(runs, surface.triangles.len());
    }
    Ok(surface)
}

/// Checks that the runs of comments follow each other within the triangles, and returns those that
/// are not empty. Otherwise returns none, since the comments are not from oviduct.
fn ordered_runs(runs: Vec<Group>, triangles: usize) -> Vec<Group> {
    let mut end = 0;
    for run in &runs {
        if run.triangles.start < end || run.triangles.end > triangles {
            return Vec::new();
        }
        end = run.triangles.end;
    }
    runs.into_iter().filter(|run| !run.triangles.is_empty()).collect()
}

fn header(bytes: &[u8], surface: &mut Surface) -> Result<(Encoding, Vec<Element>, usize), ReadError> {
    let wrong = |line: usize, detail: String| Err(ReadError::Line { line, detail });
    let (mut encoding, mut elements, mut begin) = (None, Vec::<Element>::new(), 0);
    for ((number, line), raw) in lines(bytes).zip(bytes.split(|&b| b == b'\n')) {
        begin += raw.len() + 1;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 1 => {}
            _ if number == 1 => return wrong(1, "the file does not begin with \"ply\"".to_owned()),
            ["format", name, _] => {
                encoding = match *name {
                    "ascii" => Some(Encoding::Text),
                    "binary_little_endian" => Some(Encoding::Little),
                    "binary_big_endian" => Some(Encoding::Big),
                    _ => return wrong(number, format!("the format {} is not known", quoted(name))),
                }
            }
            ["comment", "patch", first, count, ..]
                if let (Ok(first), Ok(count)) = (first.parse::<u32>(), count.parse::<u32>()) =>
            {
                // The name is the rest of the line, including its spaces.
                let name = line.splitn(5, ' ').nth(4).unwrap_or_default().trim();
                let first = first as usize;
                surface.groups.push(Group { name: name.into(), triangles: first..first + count as usize });
            }
            ["comment" | "obj_info", ..] => {
                surface.unit = unit(&line).unwrap_or(surface.unit);
            }
            ["element", name, count] => {
                let Ok(count) = count.parse() else {
                    return wrong(number, format!("{} is not a number of elements", quoted(count)));
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
                    return wrong(number, format!("the property {} has no known type or no element", quoted(name)));
                };
                element.properties.push(Property { name: (*name).to_owned(), count, item });
            }
            ["end_header"] => {
                return match encoding {
                    Some(encoding) => Ok((encoding, elements, begin.min(bytes.len()))),
                    None => wrong(number, "the header names no format".to_owned()),
                };
            }
            [] => {}
            _ => return wrong(number, format!("{} is not a line of a PLY header", quoted(line.trim()))),
        }
    }
    wrong(lines(bytes).count(), "the header does not end".to_owned())
}

fn scalar(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::Signed(1),
        "uchar" | "uint8" => Scalar::Unsigned(1),
        "short" | "int16" => Scalar::Signed(2),
        "ushort" | "uint16" => Scalar::Unsigned(2),
        "int" | "int32" => Scalar::Signed(4),
        "uint" | "uint32" => Scalar::Unsigned(4),
        "float" | "float32" => Scalar::Float(4),
        "double" | "float64" => Scalar::Float(8),
        _ => return None,
    })
}

/// Data after the header, read up to `at`.
struct Body<'a> {
    bytes: &'a [u8],
    at: usize,
    encoding: Encoding,
}

impl Body<'_> {
    fn wrong(&self, detail: impl Into<String>) -> ReadError {
        let detail = detail.into();
        match self.encoding {
            Encoding::Text => {
                let line = 1 + self.bytes[..self.at.min(self.bytes.len())].iter().filter(|&&b| b == b'\n').count();
                ReadError::Line { line, detail }
            }
            _ => ReadError::Byte { byte: self.at, detail },
        }
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64, ReadError> {
        if self.encoding == Encoding::Text {
            return self.word();
        }
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let Some(bits) = scalar.bits(rest, self.encoding == Encoding::Little) else {
            return Err(self.wrong("the file ends before its elements do"));
        };
        self.at += scalar.size();
        Ok(scalar.float(bits))
    }

    fn word(&mut self) -> Result<f64, ReadError> {
        let rest = &self.bytes[self.at..];
        let Some(skip) = rest.iter().position(|b| !b.is_ascii_whitespace()) else {
            self.at = self.bytes.len();
            return Err(self.wrong("the file ends before its elements do"));
        };
        let rest = &rest[skip..];
        let word = &rest[..rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len())];
        self.at += skip;
        let value = std::str::from_utf8(word).ok().and_then(|word| word.parse().ok());
        let value =
            value.ok_or_else(|| self.wrong(format!("{} is not a number", quoted(&String::from_utf8_lossy(word)))))?;
        self.at += word.len();
        Ok(value)
    }

    /// Reads a property and passes its value or the items of its list to `visit`.
    fn values(&mut self, property: &Property, mut visit: impl FnMut(f64)) -> Result<(), ReadError> {
        let count = property.count.map_or(Ok(1.0), |count| self.value(count))?;
        if !(count >= 0.0 && count.fract() == 0.0 && count <= f64::from(u32::MAX)) {
            return Err(self.wrong(format!("{count} is not the length of a list")));
        }
        for _ in 0..count as u32 {
            visit(self.value(property.item)?);
        }
        Ok(())
    }
}

fn vertices(body: &mut Body<'_>, element: &Element, surface: &mut Surface) -> Result<(), ReadError> {
    let axis = |property: &Property| ["x", "y", "z"].iter().position(|name| property.name == *name);
    if (0..3).any(|wanted| !element.properties.iter().any(|p| axis(p) == Some(wanted))) {
        return Err(body.wrong("the vertices have no x, y or z"));
    }
    for _ in 0..element.count {
        let mut point = [0.0; 3];
        for property in &element.properties {
            let axis = axis(property);
            body.values(property, |value| {
                if let Some(axis) = axis {
                    point[axis] = value;
                }
            })?;
        }
        surface.add_vertex(point)?;
    }
    Ok(())
}

fn faces(body: &mut Body<'_>, element: &Element, surface: &mut Surface) -> Result<(), ReadError> {
    let is_corners = |p: &Property| p.name == "vertex_indices" || p.name == "vertex_index";
    if element.count > 0 && !element.properties.iter().any(is_corners) {
        return Err(body.wrong("the faces have no list of vertices"));
    }
    let vertices = surface.positions.len();
    let mut face = Vec::new();
    for _ in 0..element.count {
        face.clear();
        let mut bad = None;
        for property in &element.properties {
            let corners = is_corners(property);
            body.values(property, |value| {
                if corners {
                    if value >= 0.0 && value < vertices as f64 && value.fract() == 0.0 {
                        face.push(value as u32);
                    } else {
                        bad = Some(value);
                    }
                }
            })?;
        }
        if let Some(bad) = bad {
            return Err(body.wrong(format!("there is no vertex {bad}")));
        }
        if face.len() < 3 {
            return Err(body.wrong("a face has fewer than three corners"));
        }
        surface.add_face(&face)?;
    }
    Ok(())
}
