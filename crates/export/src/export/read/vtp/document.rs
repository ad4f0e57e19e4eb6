//! The XML of a VTP file: where its arrays are.
//!
//! The document ends at the appended data, which need not be text. Nothing that a document type declares is used: references to
//! its entities are refused where they matter.

use super::super::error::ReadError;
use super::super::limits;
use super::super::text::{quoted, wrong};
use super::array::{Appended, Array, File, Kind, Place};
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use quick_xml::reader::Reader;
use std::borrow::Cow;
use std::cell::Cell;
use std::fmt::Display;

/// What is read of a file.
pub(super) struct Document<'a> {
    pub(super) file: File<'a>,
    pub(super) pieces: Vec<Piece<'a>>,
    pub(super) units: Option<Box<Array<'a>>>,
    pub(super) patch_names: Option<Box<Array<'a>>>,
}

/// A piece, with the numbers that it states.
#[derive(Default)]
pub(super) struct Piece<'a> {
    pub(super) points: u64,
    pub(super) verts: u64,
    pub(super) lines: u64,
    pub(super) polys: u64,
    pub(super) strips: u64,
    pub(super) points_array: Option<Box<Array<'a>>>,
    pub(super) polys_arrays: Cells<'a>,
    pub(super) strips_arrays: Cells<'a>,
    /// Cell data of this name.
    pub(super) patch: Option<Box<Array<'a>>>,
}

#[derive(Default)]
pub(super) struct Cells<'a> {
    pub(super) connectivity: Option<Box<Array<'a>>>,
    pub(super) offsets: Option<Box<Array<'a>>>,
}

/// Parts of a document that hold arrays.
#[derive(Clone, Copy, PartialEq)]
enum Section {
    Fields,
    CellData,
    Points,
    Polys,
    Strips,
}

impl Section {
    fn of(name: &str) -> Option<Self> {
        Some(match name {
            "FieldData" => Self::Fields,
            "CellData" => Self::CellData,
            "Points" => Self::Points,
            "Polys" => Self::Polys,
            "Strips" => Self::Strips,
            _ => return None,
        })
    }
}

pub(super) fn parse(bytes: &[u8]) -> Result<Document<'_>, ReadError> {
    // The reader of XML would leave the mark out of its positions.
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let (text, is_text) = match str::from_utf8(bytes) {
        Ok(text) => (text, true),
        Err(error) => (str::from_utf8(&bytes[..error.valid_up_to()]).unwrap_or_default(), false),
    };
    let mut reader = Reader::from_str(text);
    let mut parser = Parser::default();
    loop {
        let event = reader.read_event();
        // Errors of XML beyond the text mean nothing: there the text is merely cut off.
        let cut_off = || ReadError::Byte { byte: text.len(), detail: "this is not text in UTF-8".to_owned() };
        let at = |byte: u64| 1 + bytes[..bytes.len().min(byte as usize)].iter().filter(|&&b| b == b'\n').count();
        let event = match event {
            Ok(Event::Eof) if is_text => return parser.end(at(reader.buffer_position())),
            Ok(Event::Eof) => return Err(cut_off()),
            Err(_) if !is_text => return Err(cut_off()),
            Err(error) => return Err(wrong(at(reader.error_position()), not_xml(&error))),
            Ok(event) => event,
        };
        let line = || at(reader.buffer_position());
        match event {
            Event::Start(tag) => {
                if tag.name().as_ref() == "AppendedData" {
                    let base64 = attribute(&tag, "encoding", line)?.as_deref() != Some("raw");
                    let rest = bytes.get(reader.buffer_position() as usize..).unwrap_or_default();
                    parser.appended = Some(Appended { data: appended(rest, base64), base64 });
                    return parser.finish(line());
                }
                parser.start(&tag, line)?;
            }
            Event::Empty(tag) => {
                parser.start(&tag, line)?;
                parser.close(line)?;
            }
            Event::End(_) => parser.close(line)?,
            Event::Text(text) => parser.text(text.into_inner()),
            Event::CData(text) => parser.text(text.into_inner()),
            Event::GeneralRef(_) if parser.array.is_some() => {
                return Err(wrong(line(), "an array holds a reference to an entity"));
            }
            _ => {}
        }
    }
}

/// The data within the element: after the underscore, and in base64 up to the end of the element.
fn appended(rest: &[u8], base64: bool) -> &[u8] {
    let Some(data) = rest.trim_ascii_start().strip_prefix(b"_") else { return &[] };
    let end = data.iter().position(|&b| base64 && b == b'<').unwrap_or(data.len());
    &data[..end]
}

#[derive(Default)]
struct Parser<'a> {
    /// What the root element says of all arrays.
    root: Option<(bool, bool, bool)>,
    appended: Option<Appended<'a>>,
    pieces: Vec<Piece<'a>>,
    units: Option<Box<Array<'a>>>,
    patch_names: Option<Box<Array<'a>>>,
    /// Elements so far.
    elements: u64,
    /// Elements that are open.
    depth: usize,
    /// Depth of the piece that is open.
    piece: Option<usize>,
    /// With its depth.
    section: Option<(Section, usize)>,
    /// The array that is open, with its depth.
    array: Option<(Array<'a>, usize)>,
}

impl<'a> Parser<'a> {
    fn start(&mut self, tag: &BytesStart<'a>, line: impl Fn() -> usize + Copy) -> Result<(), ReadError> {
        self.elements += 1;
        limits::limited("document", self.elements, "XML elements", limits::OBJECTS)?;
        self.depth += 1;
        let name = tag.name();
        let name = name.as_ref();
        if self.root.is_none() {
            if name != "VTKFile" {
                return Err(wrong(line(), format!("the document is {} instead of \"VTKFile\"", quoted(name))));
            }
            self.root = Some(root(tag, line)?);
        } else if self.array.is_some() {
            // Keys within an array, such as its range.
        } else if name == "Piece" {
            if self.piece.is_some() {
                return Err(wrong(line(), "a piece lies within another"));
            }
            self.piece = Some(self.depth);
            let count = |name| count(tag, name, line);
            self.pieces.push(Piece {
                points: count("NumberOfPoints")?,
                verts: count("NumberOfVerts")?,
                lines: count("NumberOfLines")?,
                polys: count("NumberOfPolys")?,
                strips: count("NumberOfStrips")?,
                ..Piece::default()
            });
        } else if let Some(section) = Section::of(name)
            && self.section.is_none()
        {
            self.section = Some((section, self.depth));
        } else if name == "DataArray" || name == "Array" {
            self.array = Some((self.read_array(tag, line)?, self.depth));
        }
        Ok(())
    }

    fn close(&mut self, line: impl Fn() -> usize + Copy) -> Result<(), ReadError> {
        if let Some((array, _)) = self.array.take_if(|(_, depth)| *depth == self.depth) {
            self.keep(array, line)?;
        }
        self.section.take_if(|(_, depth)| *depth == self.depth);
        self.piece.take_if(|depth| *depth == self.depth);
        self.depth = self.depth.saturating_sub(1);
        Ok(())
    }

    fn text(&mut self, text: Cow<'a, str>) {
        if let Some((array, depth)) = &mut self.array
            && *depth == self.depth
            && let Place::Inline { text: known, .. } = &mut array.place
            && !text.trim_ascii().is_empty()
        {
            if known.is_empty() {
                *known = text;
            } else {
                known.to_mut().push_str(&text);
            }
        }
    }

    fn read_array(&self, tag: &BytesStart<'a>, line: impl Fn() -> usize + Copy) -> Result<Array<'a>, ReadError> {
        let get = |name| attribute(tag, name, line);
        let name = get("Name")?.unwrap_or_default();
        let section = match self.section {
            Some((Section::Fields, _)) | None => "FieldData",
            Some((Section::CellData, _)) => "CellData",
            Some((Section::Points, _)) => "Points",
            Some((Section::Polys, _)) => "Polys",
            Some((Section::Strips, _)) => "Strips",
        };
        let path = if self.piece.is_some() {
            format!("piece {}, {section}", self.pieces.len() - 1)
        } else {
            section.to_owned()
        };
        let path = format!("{path}, {}", quoted(&name).trim_matches('"'));
        let kind = get("type")?.unwrap_or_default();
        let place = match get("format")?.as_deref().unwrap_or("ascii") {
            "ascii" => Place::Inline { text: Cow::Borrowed(""), binary: false },
            "binary" => Place::Inline { text: Cow::Borrowed(""), binary: true },
            "appended" => {
                let offset = get("offset")?;
                let number = offset.as_deref().and_then(|offset| offset.trim().parse().ok());
                let Some(offset) = number else {
                    return Err(ReadError::document(path, "it states no offset into the appended data"));
                };
                Place::Appended(offset)
            }
            other => return Err(ReadError::document(path, format!("the format {} is not known", quoted(other)))),
        };
        let components = get("NumberOfComponents")?.unwrap_or_default().into_owned();
        Ok(Array { path, name: name.into_owned(), kind: Kind::of(&kind), components, place })
    }

    /// Puts an array where it is used, if it is.
    fn keep(&mut self, array: Array<'a>, line: impl Fn() -> usize) -> Result<(), ReadError> {
        let Some((section, _)) = self.section else { return Ok(()) };
        let piece = self.pieces.last_mut().filter(|_| self.piece.is_some());
        let slot = match (section, piece, array.name.as_str()) {
            (Section::Fields, _, "units") => &mut self.units,
            (Section::Fields, _, "patch_names") => &mut self.patch_names,
            (Section::CellData, Some(piece), "patch") => &mut piece.patch,
            (Section::Points, Some(piece), _) => &mut piece.points_array,
            (Section::Polys, Some(piece), "connectivity") => &mut piece.polys_arrays.connectivity,
            (Section::Polys, Some(piece), "offsets") => &mut piece.polys_arrays.offsets,
            (Section::Strips, Some(piece), "connectivity") => &mut piece.strips_arrays.connectivity,
            (Section::Strips, Some(piece), "offsets") => &mut piece.strips_arrays.offsets,
            _ => return Ok(()),
        };
        if slot.is_some() {
            return Err(wrong(line(), format!("{}: there are two of these arrays", array.path)));
        }
        *slot = Some(Box::new(array));
        Ok(())
    }

    /// At the end of the text.
    fn end(self, line: usize) -> Result<Document<'a>, ReadError> {
        if self.depth > 0 {
            return Err(wrong(line, "the file ends before its elements do"));
        }
        self.finish(line)
    }

    fn finish(self, line: usize) -> Result<Document<'a>, ReadError> {
        let Some((little, wide, zlib)) = self.root else { return Err(wrong(line, "there is no element \"VTKFile\"")) };
        let file = File { little, wide, zlib, appended: self.appended, room: Cell::new(limits::BYTES) };
        Ok(Document { file, pieces: self.pieces, units: self.units, patch_names: self.patch_names })
    }
}

/// Whether numbers are in little-endian order, lengths have 64 bits, and arrays are compressed.
fn root(tag: &BytesStart<'_>, line: impl Fn() -> usize + Copy) -> Result<(bool, bool, bool), ReadError> {
    let get = |name| attribute(tag, name, line);
    let refuse = |what: &str, value: &str| Err(wrong(line(), format!("{what} {} is not read", quoted(value))));
    match get("type")?.as_deref().unwrap_or_default() {
        "PolyData" => {}
        other => return Err(wrong(line(), format!("the file holds {} instead of \"PolyData\"", quoted(other)))),
    }
    let little = match get("byte_order")?.as_deref() {
        Some("LittleEndian") | None => true,
        Some("BigEndian") => false,
        Some(other) => return refuse("the byte order", other),
    };
    let wide = match get("header_type")?.as_deref() {
        Some("UInt32") | None => false,
        Some("UInt64") => true,
        Some(other) => return refuse("the header type", other),
    };
    let zlib = match get("compressor")?.as_deref() {
        None | Some("") => false,
        Some("vtkZLibDataCompressor") => true,
        Some(other) => return refuse("the compressor", other),
    };
    Ok((little, wide, zlib))
}

/// A number of items; 0 if it is not stated.
fn count(tag: &BytesStart<'_>, name: &str, line: impl Fn() -> usize + Copy) -> Result<u64, ReadError> {
    let Some(text) = attribute(tag, name, line)? else { return Ok(0) };
    text.trim().parse().map_err(|_| wrong(line(), format!("{name} is {}, not a number of items", quoted(&text))))
}

/// The value of an attribute.
fn attribute<'t>(
    tag: &'t BytesStart<'_>,
    name: &str,
    line: impl Fn() -> usize,
) -> Result<Option<Cow<'t, str>>, ReadError> {
    // The check against repeated names takes time in the square of their number.
    for attribute in tag.attributes().with_checks(false) {
        let attribute = attribute.map_err(|error| wrong(line(), not_xml(&error)))?;
        if attribute.key.as_ref() == name {
            let value = attribute.normalized_value(XmlVersion::Implicit1_0);
            return value.map(Some).map_err(|error| wrong(line(), format!("{name}: {}", not_xml(&error))));
        }
    }
    Ok(None)
}

/// What the reader of XML says, shortened: it quotes names of any length.
fn not_xml(error: &impl Display) -> String {
    const LONGEST: usize = 200;
    format!("this is not XML: {}", error.to_string().chars().take(LONGEST).collect::<String>())
}
