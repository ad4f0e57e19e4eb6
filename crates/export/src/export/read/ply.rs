//! PLY, text or binary of either byte order: elements `vertex` (x, y, z) and `face` (a list of vertex indices);
//! other elements and properties are skipped. Comments such as `comment patch 0 120 inner_wall` name runs of triangles: the
//! first one, and how many.

use super::error::ReadError;
use super::surface::{Group, Surface};
use super::text::{lines, quoted, unit};

#[derive(Clone, Copy, Debug, PartialEq)]
enum Encoding {
    Text,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

enum Kind {
    Scalar(Scalar),
    /// Types of the count and of the items.
    List(Scalar, Scalar),
}

struct Property {
    name: String,
    kind: Kind,
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
            // Without properties, elements have no data, whatever their count.
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
        surface.groups = sound(runs, surface.triangles.len());
    }
    Ok(surface)
}

/// Runs that follow each other within the triangles; none if they do not, as comments of others may look like ours.
fn sound(runs: Vec<Group>, triangles: usize) -> Vec<Group> {
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
            ["comment", "patch", first, count, ..] if first.parse::<u32>().is_ok() && count.parse::<u32>().is_ok() => {
                // The name is the rest of the line, with its spaces.
                let name = line.splitn(5, ' ').nth(4).unwrap_or_default().trim();
                let (first, count) = (first.parse().unwrap_or(0_usize), count.parse().unwrap_or(0_usize));
                surface.groups.push(Group { name: name.into(), triangles: first..first + count });
            }
            ["comment" | "obj_info", ..] => {
                if let Some(unit) = unit(&line) {
                    surface.unit = unit;
                }
            }
            ["element", name, count] => {
                let Ok(count) = count.parse() else {
                    return wrong(number, format!("{} is not a number of elements", quoted(count)));
                };
                elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            ["property", kind @ .., name] => {
                let kind = match kind {
                    [one] => scalar(one).map(Kind::Scalar),
                    ["list", count, item] => scalar(count).zip(scalar(item)).map(|(c, i)| Kind::List(c, i)),
                    _ => None,
                };
                let Some((kind, element)) = kind.zip(elements.last_mut()) else {
                    return wrong(number, format!("the property {} has no known type or no element", quoted(name)));
                };
                element.properties.push(Property { name: (*name).to_owned(), kind });
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
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

/// The data after the header.
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
        let little = self.encoding == Encoding::Little;
        Ok(match scalar {
            Scalar::I8 => f64::from(i8::from_le_bytes(self.take(little)?)),
            Scalar::U8 => f64::from(u8::from_le_bytes(self.take(little)?)),
            Scalar::I16 => f64::from(i16::from_le_bytes(self.take(little)?)),
            Scalar::U16 => f64::from(u16::from_le_bytes(self.take(little)?)),
            Scalar::I32 => f64::from(i32::from_le_bytes(self.take(little)?)),
            Scalar::U32 => f64::from(u32::from_le_bytes(self.take(little)?)),
            Scalar::F32 => f64::from(f32::from_le_bytes(self.take(little)?)),
            Scalar::F64 => f64::from_le_bytes(self.take(little)?),
        })
    }

    /// The next bytes, in little-endian order.
    fn take<const N: usize>(&mut self, little: bool) -> Result<[u8; N], ReadError> {
        let Some(bytes) = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk::<N>()) else {
            return Err(self.wrong("the file ends before its elements do"));
        };
        self.at += N;
        let mut bytes = *bytes;
        if !little {
            bytes.reverse();
        }
        Ok(bytes)
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

    /// Reads a property, passes its value or values to `visit`, and returns their number.
    fn values(&mut self, property: &Property, mut visit: impl FnMut(f64)) -> Result<usize, ReadError> {
        match property.kind {
            Kind::Scalar(scalar) => {
                visit(self.value(scalar)?);
                Ok(1)
            }
            Kind::List(count, item) => {
                let count = self.value(count)?;
                if !(count >= 0.0 && count.fract() == 0.0 && count <= f64::from(u32::MAX)) {
                    return Err(self.wrong(format!("{count} is not the length of a list")));
                }
                for _ in 0..count as u32 {
                    visit(self.value(item)?);
                }
                Ok(count as usize)
            }
        }
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
