//! XML of a VTP file: finds the arrays and what the document states of them.
//!
//! The document ends at the appended data, which need not be text. Declarations of a document type
//! are ignored, and references to its entities within an array are refused.

use super::super::error::ReadError;
use super::super::limits;
use super::super::scalar::Scalar;
use super::super::text::{quoted, without_mark, wrong};
use super::array::{Appended, Array, ArrayData, File, Kind};
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use quick_xml::reader::Reader;
use std::borrow::Cow;
use std::cell::Cell;
use std::fmt::Display;

/// The parts of a file that are read.
pub(super) struct Document<'a> {
    pub(super) file: File<'a>,
    pub(super) pieces: Vec<Piece<'a>>,
    pub(super) units: Option<Box<Array<'a>>>,
    pub(super) patch_names: Option<Box<Array<'a>>>,
}

/// A piece, with the numbers of points and cells that it states.
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
    /// Cell data with the name `patch`.
    pub(super) patch: Option<Box<Array<'a>>>,
    /// Cell data with the name `ModelFaceID`, by which SimVascular numbers faces.
    pub(super) model_face: Option<Box<Array<'a>>>,
}

#[derive(Default)]
pub(super) struct Cells<'a> {
    pub(super) connectivity: Option<Box<Array<'a>>>,
    pub(super) offsets: Option<Box<Array<'a>>>,
}

/// Elements that contain arrays.
const SECTIONS: [&str; 5] = ["FieldData", "CellData", "Points", "Polys", "Strips"];

pub(super) fn parse(bytes: &[u8]) -> Result<Document<'_>, ReadError> {
    // The XML reader would not count the byte order mark in its positions.
    let bytes = without_mark(bytes);
    if bytes.starts_with(b"# vtk DataFile") {
        let kind = "a file in the legacy format of VTK".to_owned();
        return Err(ReadError::Foreign { kind, remedy: "save the surface as XML PolyData, with the extension .vtp" });
    }
    let (text, is_text) = match str::from_utf8(bytes) {
        Ok(text) => (text, true),
        Err(error) => (str::from_utf8(&bytes[..error.valid_up_to()]).unwrap_or_default(), false),
    };
    let lines = |from: usize, to: u64| {
        let to = bytes.len().min(to as usize);
        (to, bytes[from..to].iter().filter(|&&b| b == b'\n').count())
    };
    let mut reader = Reader::from_str(text);
    let mut parser = Parser::default();
    let (mut position, mut line) = (0, 1);
    loop {
        let event = reader.read_event();
        let (end, ended) = lines(position, reader.buffer_position());
        (position, line) = (end, line + ended);
        match event {
            // The text is cut off at the first byte that is not UTF-8, so this error comes first.
            Ok(Event::Eof) | Err(_) if !is_text => {
                return Err(ReadError::Byte { byte: text.len(), detail: "this is not text in UTF-8".to_owned() });
            }
            Err(error) => return Err(wrong(1 + lines(0, reader.error_position()).1, not_xml(&error))),
            Ok(Event::Eof) if parser.depth > 0 => return Err(wrong(line, "the file ends before its elements do")),
            Ok(Event::Eof) => return parser.finish(line),
            Ok(Event::Start(tag)) if tag.name().as_ref() == "AppendedData" => {
                let base64 = attribute(&tag, "encoding", line)?.as_deref() != Some("raw");
                if let Some(file) = &mut parser.file {
                    file.appended = Some(Appended { data: appended(&bytes[position..], base64), base64 });
                }
                return parser.finish(line);
            }
            Ok(Event::Start(tag)) => parser.start(&tag, line)?,
            Ok(Event::Empty(tag)) => {
                parser.start(&tag, line)?;
                parser.close(line)?;
            }
            Ok(Event::End(_)) => parser.close(line)?,
            Ok(Event::Text(text)) => parser.text(text.into_inner()),
            Ok(Event::CData(text)) => parser.text(text.into_inner()),
            Ok(Event::GeneralRef(_)) if parser.array.is_some() => {
                return Err(wrong(line, "an array holds a reference to an entity"));
            }
            Ok(_) => {}
        }
    }
}

/// Appended data: begins after the underscore; in base64 it ends with the element.
fn appended(rest: &[u8], base64: bool) -> &[u8] {
    let Some(data) = rest.trim_ascii_start().strip_prefix(b"_") else { return &[] };
    let end = data.iter().position(|&b| base64 && b == b'<').unwrap_or(data.len());
    &data[..end]
}

#[derive(Default)]
struct Parser<'a> {
    /// Set by the root element.
    file: Option<File<'a>>,
    pieces: Vec<Piece<'a>>,
    units: Option<Box<Array<'a>>>,
    patch_names: Option<Box<Array<'a>>>,
    /// Number of elements so far.
    elements: u64,
    /// Number of open elements.
    depth: usize,
    /// Depth of the open piece.
    piece: Option<usize>,
    /// Name of the open section, with its depth.
    section: Option<(&'static str, usize)>,
    /// Open array, with its depth.
    array: Option<(Array<'a>, usize)>,
}

impl<'a> Parser<'a> {
    fn start(&mut self, tag: &BytesStart<'a>, line: usize) -> Result<(), ReadError> {
        self.elements += 1;
        limits::limited("document", self.elements, "XML elements", limits::OBJECTS)?;
        self.depth += 1;
        let name = tag.name();
        let name = name.as_ref();
        if self.file.is_none() {
            if name != "VTKFile" {
                return Err(wrong(line, format!("the document is {} instead of \"VTKFile\"", quoted(name))));
            }
            self.file = Some(root(tag, line)?);
        } else if self.array.is_some() {
            // Elements within an array, such as `InformationKey`, are skipped.
        } else if name == "Piece" {
            if self.piece.is_some() {
                return Err(wrong(line, "a piece lies within another"));
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
        } else if let Some(section) = SECTIONS.into_iter().find(|section| *section == name)
            && self.section.is_none()
        {
            self.section = Some((section, self.depth));
        } else if name == "DataArray" || name == "Array" {
            self.array = Some((self.read_array(tag, line)?, self.depth));
        }
        Ok(())
    }

    fn close(&mut self, line: usize) -> Result<(), ReadError> {
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
            && let ArrayData::Inline { text: known, .. } = &mut array.data
            && !text.trim_ascii().is_empty()
        {
            if known.is_empty() {
                *known = text;
            } else {
                known.to_mut().push_str(&text);
            }
        }
    }

    fn read_array(&self, tag: &BytesStart<'a>, line: usize) -> Result<Array<'a>, ReadError> {
        let get = |name| attribute(tag, name, line);
        let name = get("Name")?.unwrap_or_default();
        let section = self.section.map_or("FieldData", |(section, _)| section);
        let piece = self.piece.map_or_else(String::new, |_| format!("piece {}, ", self.pieces.len() - 1));
        let path = format!("{piece}{section}, {}", quoted(&name).trim_matches('"'));
        let kind = get("type")?.unwrap_or_default();
        let data = match get("format")?.as_deref().unwrap_or("ascii") {
            "ascii" => ArrayData::Inline { text: Cow::Borrowed(""), binary: false },
            "binary" => ArrayData::Inline { text: Cow::Borrowed(""), binary: true },
            "appended" => {
                let offset = get("offset")?;
                let number = offset.as_deref().and_then(|offset| offset.trim().parse().ok());
                let Some(offset) = number else {
                    return Err(ReadError::document(path, "it states no offset into the appended data"));
                };
                ArrayData::Appended(offset)
            }
            other => return Err(ReadError::document(path, format!("the format {} is not known", quoted(other)))),
        };
        let components = get("NumberOfComponents")?.unwrap_or_default().into_owned();
        Ok(Array { path, name: name.into_owned(), kind: Kind::named(&kind), components, data })
    }

    /// Stores an array that the reader uses; drops all others.
    fn keep(&mut self, array: Array<'a>, line: usize) -> Result<(), ReadError> {
        let Some((section, _)) = self.section else { return Ok(()) };
        let piece = self.pieces.last_mut().filter(|_| self.piece.is_some());
        let slot = match (section, piece, array.name.as_str()) {
            ("FieldData", _, "units") => &mut self.units,
            ("FieldData", _, "patch_names") => &mut self.patch_names,
            ("CellData", Some(piece), "patch") => &mut piece.patch,
            ("CellData", Some(piece), "ModelFaceID") => &mut piece.model_face,
            ("Points", Some(piece), _) => &mut piece.points_array,
            ("Polys", Some(piece), "connectivity") => &mut piece.polys_arrays.connectivity,
            ("Polys", Some(piece), "offsets") => &mut piece.polys_arrays.offsets,
            ("Strips", Some(piece), "connectivity") => &mut piece.strips_arrays.connectivity,
            ("Strips", Some(piece), "offsets") => &mut piece.strips_arrays.offsets,
            _ => return Ok(()),
        };
        if slot.is_some() && matches!(section, "FieldData" | "CellData") {
            return Ok(());
        }
        if slot.is_some() {
            return Err(wrong(line, format!("{}: there are two of these arrays", array.path)));
        }
        *slot = Some(Box::new(array));
        Ok(())
    }

    fn finish(self, line: usize) -> Result<Document<'a>, ReadError> {
        let Some(file) = self.file else { return Err(wrong(line, "there is no element \"VTKFile\"")) };
        Ok(Document { file, pieces: self.pieces, units: self.units, patch_names: self.patch_names })
    }
}

/// Reads from the root element how arrays are encoded.
fn root<'a>(tag: &BytesStart<'a>, line: usize) -> Result<File<'a>, ReadError> {
    let get = |name| attribute(tag, name, line);
    let refuse = |what: &str, value: &str| Err(wrong(line, format!("{what} {} is not read", quoted(value))));
    match get("type")?.as_deref().unwrap_or_default() {
        "PolyData" => {}
        other => {
            let advice = "save the surface as PolyData, with the extension .vtp";
            return Err(wrong(line, format!("the file holds {} instead of \"PolyData\"; {advice}", quoted(other))));
        }
    }
    let little_endian = match get("byte_order")?.as_deref() {
        Some("LittleEndian") | None => true,
        Some("BigEndian") => false,
        Some(other) => return refuse("the byte order", other),
    };
    let header = match get("header_type")?.as_deref() {
        Some("UInt32") | None => Scalar::Unsigned(4),
        Some("UInt64") => Scalar::Unsigned(8),
        Some(other) => return refuse("the header type", other),
    };
    let zlib = match get("compressor")?.as_deref() {
        None | Some("") => false,
        Some("vtkZLibDataCompressor") => true,
        Some(other) => {
            let advice = "save the file with zlib or without compression";
            return Err(wrong(line, format!("the compressor {} is not read; {advice}", quoted(other))));
        }
    };
    Ok(File { little_endian, header, zlib, appended: None, room: Cell::new(limits::BYTES) })
}

/// Number of items that an attribute states; 0 if there is no such attribute.
fn count(tag: &BytesStart<'_>, name: &str, line: usize) -> Result<u64, ReadError> {
    let Some(text) = attribute(tag, name, line)? else { return Ok(0) };
    text.trim().parse().map_err(|_| wrong(line, format!("{name} is {}, not a number of items", quoted(&text))))
}

/// Value of an attribute. Unlike [`BytesStart::attributes`], this does not check for repeated
/// names, which takes time in the square of their number.
fn attribute<'t>(tag: &'t BytesStart<'_>, name: &str, line: usize) -> Result<Option<Cow<'t, str>>, ReadError> {
    let found = tag.try_get_attribute(name).map_err(|error| wrong(line, not_xml(&error)))?;
    let Some(attribute) = found else { return Ok(None) };
    let value = attribute.normalized_value(XmlVersion::Implicit1_0);
    value.map(Some).map_err(|error| wrong(line, format!("{name}: {}", not_xml(&error))))
}

/// Message for an error of the XML reader, shortened because it quotes names of any length.
fn not_xml(error: &impl Display) -> String {
    format!("this is not XML: {}", error.to_string().chars().take(200).collect::<String>())
}
