//! Tests of VTP files in every encoding, as other programs write them, and of damaged files.

use super::super::surface::{Group, Unit};
use super::super::tests::assert_sound;
use super::*;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use proptest::prelude::*;
use std::io::Write;

const POINTS: [[f64; 3]; 5] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.5, 0.0], [0.0, 1.0, 1e-7], [0.1, -0.2, 0.3]];

/// Encoding of the arrays of a file.
#[derive(Clone, Copy, Debug)]
struct Form {
    place: &'static str,
    big: bool,
    wide: bool,
    zlib: bool,
    floats: &'static str,
    integers: &'static str,
    /// Size of a block of zlib, bytes.
    block: usize,
}

const PLAIN: Form =
    Form { place: "ascii", big: false, wide: false, zlib: false, floats: "Float64", integers: "Int64", block: 10 };

/// Writes files in one encoding.
struct Builder {
    form: Form,
    appended: Vec<u8>,
}

impl Builder {
    fn bytes(&self, kind: &str, value: f64) -> Vec<u8> {
        let mut bytes = match kind {
            "Int8" => (value as i8).to_le_bytes().to_vec(),
            "UInt8" | "String" => (value as u8).to_le_bytes().to_vec(),
            "Int16" => (value as i16).to_le_bytes().to_vec(),
            "UInt16" => (value as u16).to_le_bytes().to_vec(),
            "Int32" => (value as i32).to_le_bytes().to_vec(),
            "UInt32" => (value as u32).to_le_bytes().to_vec(),
            "Int64" => (value as i64).to_le_bytes().to_vec(),
            "UInt64" => (value as u64).to_le_bytes().to_vec(),
            "Float32" => (value as f32).to_le_bytes().to_vec(),
            _ => value.to_le_bytes().to_vec(),
        };
        if self.form.big {
            bytes.reverse();
        }
        bytes
    }

    fn header(&self, lengths: &[usize]) -> Vec<u8> {
        lengths.iter().flat_map(|&n| self.bytes(if self.form.wide { "UInt64" } else { "UInt32" }, n as f64)).collect()
    }

    /// Header and data of an array, as VTK writes them.
    fn encoded(&self, data: &[u8]) -> (Vec<u8>, Vec<u8>) {
        if !self.form.zlib {
            return (self.header(&[data.len()]), data.to_vec());
        }
        let blocks = data.chunks(self.form.block).map(|block| {
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(block).unwrap();
            encoder.finish().unwrap()
        });
        let blocks: Vec<Vec<u8>> = blocks.collect();
        let mut lengths = vec![blocks.len(), self.form.block, data.len() % self.form.block];
        lengths.extend(blocks.iter().map(Vec::len));
        (self.header(&lengths), blocks.concat())
    }

    fn array(&mut self, kind: &str, name: &str, components: usize, values: &[f64]) -> String {
        let form = self.form;
        let tag = if kind == "String" { "Array" } else { "DataArray" };
        let start = format!("<{tag} type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\"");
        if form.place == "ascii" {
            let text = values.iter().map(f64::to_string).collect::<Vec<_>>().join("\n ");
            return format!(
                "{start} format=\"ascii\">\n{text}\n<InformationKey name=\"x\"><Value>9</Value></InformationKey>\n</{tag}>\n"
            );
        }
        let data: Vec<u8> = values.iter().flat_map(|&value| self.bytes(kind, value)).collect();
        let (header, data) = self.encoded(&data);
        // VTK encodes the header together with the data, or separately if the data are compressed.
        let text = match form.zlib {
            true => STANDARD.encode(&header) + &STANDARD.encode(&data),
            false => STANDARD.encode([&header[..], &data].concat()),
        };
        if form.place == "binary" {
            return format!("{start} format=\"binary\">\n  {text}\n</{tag}>\n");
        }
        let offset = self.appended.len();
        self.appended.extend(if form.place == "raw" { [header, data].concat() } else { text.into_bytes() });
        format!("{start} format=\"appended\" offset=\"{offset}\"/>\n")
    }

    fn strings(&mut self, name: &str, values: &[&str]) -> String {
        let bytes: Vec<f64> = values.iter().flat_map(|v| v.bytes().chain([0])).map(f64::from).collect();
        self.array("String", name, 1, &bytes)
    }

    /// Cells of one kind.
    fn cells(&mut self, tag: &str, cells: &[&[usize]]) -> String {
        let corners: Vec<f64> = cells.iter().flat_map(|cell| cell.iter()).map(|&v| v as f64).collect();
        let ends = cells.iter().scan(0, |end, cell| {
            *end += cell.len();
            Some(*end as f64)
        });
        let ends: Vec<f64> = ends.collect();
        let integers = self.form.integers;
        let connectivity = self.array(integers, "connectivity", 1, &corners);
        format!("<{tag}>\n{connectivity}{}</{tag}>\n", self.array(integers, "offsets", 1, &ends))
    }

    fn file(mut self, document: &str) -> Vec<u8> {
        let form = self.form;
        let order = if form.big { "BigEndian" } else { "LittleEndian" };
        let wide = if form.wide { " header_type=\"UInt64\"" } else { "" };
        let zlib = if form.zlib { " compressor=\"vtkZLibDataCompressor\"" } else { "" };
        let mut file = format!(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"{order}\"{wide}{zlib}>\n\
             <PolyData>\n{document}</PolyData>\n"
        )
        .into_bytes();
        if !self.appended.is_empty() {
            file.extend(format!("<AppendedData encoding=\"{}\">\n _", form.place).bytes());
            file.append(&mut self.appended);
            file.extend(b"\n</AppendedData>\n");
        }
        file.extend(b"</VTKFile>\n");
        file
    }
}

/// A file of two pieces. The first has a vertex, a line, three polygons and a strip, the second a
/// triangle.
fn file(form: Form) -> Vec<u8> {
    let mut b = Builder { form, appended: Vec::new() };
    let mut document = format!(
        "<FieldData>\n{}{}</FieldData>\n",
        b.strings("units", &["mm"]),
        b.strings("patch_names", &["inner_wall", "größe", "cap"])
    );
    let points = POINTS.map(|p| if form.floats == "Float32" { p.map(|x| f64::from(x as f32)) } else { p });
    document += "<Piece NumberOfPoints=\"5\" NumberOfVerts=\"1\" NumberOfLines=\"1\" NumberOfStrips=\"1\" NumberOfPolys=\"3\">\n";
    document += &format!("<PointData>\n{}</PointData>\n", b.array("Float64", "patch", 1, &[0.5; 5]));
    document += &format!(
        "<CellData Scalars=\"patch\">\n{}{}</CellData>\n",
        b.array("Float32", "other", 1, &[0.5; 6]),
        b.array(form.integers, "patch", 1, &[9.0, 9.0, 0.0, 0.0, 1.0, 2.0]),
    );
    document += &format!("<Points>\n{}</Points>\n", b.array(form.floats, "Points", 3, points.as_flattened()));
    document += &b.cells("Verts", &[&[4]]);
    document += &b.cells("Lines", &[&[0, 1]]);
    document += &b.cells("Strips", &[&[0, 1, 2, 3, 3, 4]]);
    document += &b.cells("Polys", &[&[0, 1, 2, 3], &[0, 1, 4], &[1, 2, 4]]);
    document += "</Piece>\n<Piece NumberOfPoints=\"0\" NumberOfPolys=\"0\"/>\n<Piece NumberOfPoints=\"3\" NumberOfPolys=\"1\">\n";
    document += &format!("<CellData>\n{}</CellData>\n", b.array(form.integers, "patch", 1, &[7.0]));
    document += &format!("<Points>\n{}</Points>\n", b.array(form.floats, "P", 3, points[..3].as_flattened()));
    document += &b.cells("Polys", &[&[2, 1, 0]]);
    b.file(&(document + "</Piece>\n"))
}

fn group(name: &str, triangles: std::ops::Range<usize>) -> Group {
    Group { name: name.into(), triangles }
}

fn expected(form: Form) -> Surface {
    let points = POINTS.map(|p| if form.floats == "Float32" { p.map(|x| f64::from(x as f32)) } else { p });
    Surface {
        positions: points.iter().chain(&points[..3]).copied().collect(),
        triangles: vec![[0, 1, 2], [0, 2, 3], [0, 1, 4], [1, 2, 4], [0, 1, 2], [2, 1, 3], [7, 6, 5]],
        groups: vec![group("inner_wall", 0..3), group("größe", 3..4), group("cap", 4..6), group("patch 7", 6..7)],
        unit: Unit::Stated(1e-3),
        notes: vec![
            "cells that are vertices (1) are passed over".to_owned(),
            "cells that are lines (1) are passed over".to_owned(),
        ],
    }
}

fn forms() -> Vec<Form> {
    let mut forms = Vec::new();
    for place in ["ascii", "binary", "raw", "base64"] {
        for (big, wide) in [(false, false), (false, true), (true, false), (true, true)] {
            for (zlib, block) in [(false, 0), (true, 1), (true, 7), (true, 32_768)] {
                for floats in ["Float32", "Float64"] {
                    for integers in ["Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"] {
                        forms.push(Form { place, big, wide, zlib, floats, integers, block });
                    }
                }
            }
        }
    }
    forms
}

#[test]
fn every_form_is_read() {
    for form in forms() {
        let read = parse(&file(form)).unwrap_or_else(|error| panic!("{form:?}: {error}"));
        assert_eq!(read, expected(form), "{form:?}");
    }
}

#[test]
fn a_byte_order_mark_moves_no_offset() {
    let form = Form { place: "raw", wide: true, ..PLAIN };
    let with_mark = [b"\xef\xbb\xbf", &file(form)[..]].concat();
    assert_eq!(parse(&with_mark).unwrap(), expected(form));
}

fn refusal(bytes: &[u8]) -> String {
    parse(bytes).unwrap_err().to_string()
}

#[test]
fn what_is_not_read_is_refused_with_its_place() {
    let sound = String::from_utf8(file(PLAIN)).unwrap();
    let compressor = "byte_order=\"LittleEndian\" compressor=\"vtkLZ4DataCompressor\"";
    let points = "type=\"Float64\" Name=\"Points\" NumberOfComponents=\"3\"";
    for (from, to, message) in [
        ("\"PolyData\"", "\"ImageData\"", "line 2: the file holds \"ImageData\" instead of \"PolyData\""),
        ("<VTKFile", "<svg", "line 2: the document is \"svg\" instead of \"VTKFile\""),
        ("LittleEndian", "Middle", "line 2: the byte order \"Middle\" is not read"),
        ("byte_order=\"LittleEndian\"", compressor, "line 2: the compressor \"vtkLZ4DataCompressor\" is not read"),
        ("version=\"1.0\" ", "header_type=\"Int8\" ", "line 2: the header type \"Int8\" is not read"),
        ("byte_order=\"LittleEndian\"", "byte_order=\"&x;\"", "line 2: byte_order: "),
        ("NumberOfPoints=\"5\"", "NumberOfPoints=\"-5\"", "line LINE: NumberOfPoints is \"-5\", not a number of items"),
        ("NumberOfPoints=\"5\"", "NumberOfPoints=\"6\"", "piece 0, Points, Points: it has only 15 values"),
        ("NumberOfPoints=\"5\"", "NumberOfPoints=\"4\"", "piece 0, Polys: cell 1: there is no vertex 4"),
        ("NumberOfPolys=\"3\"", "NumberOfPolys=\"4\"", "piece 0, Polys, offsets: it has only 3 values"),
        ("NumberOfStrips=\"1\"", "NumberOfStrips=\"2\"", "piece 0, Strips, offsets: it has only 1 values"),
        ("-0.2", "x", "piece 0, Points, Points: value 14: \"x\" is not a number"),
        ("-0.2", "&#49;", "line LINE: an array holds a reference to an entity"),
        (
            points,
            "type=\"String\" Name=\"P\" NumberOfComponents=\"3\"",
            "piece 0, Points, P: the coordinates are not numbers",
        ),
        (points, "type=\"Float64\"", "piece 0, Points, : it has \"\" components instead of 3"),
        ("<Points>", "<Nothing>", "line 88: this is not XML: "),
        ("</PolyData>\n", "", "line "),
        ("</VTKFile>\n", "", "line "),
        ("<Piece NumberOfPoints=\"3\"", "<Piece><Piece NumberOfPoints=\"3\"", "line LINE: a piece lies within another"),
        ("format=\"ascii\"", "format=\"morse\"", "FieldData, units: the format \"morse\" is not known"),
        ("format=\"ascii\"", "format=\"appended\"", "FieldData, units: it states no offset into the appended data"),
        ("format=\"ascii\"", "format=\"appended\" offset=\"1\"", "FieldData, units: the file has no appended data"),
        ("-0.2", "0,2", "piece 0, Points, Points: value 14: \"0,2\" is not a number: it has a decimal comma"),
        (
            "\"PolyData\"",
            "\"UnstructuredGrid\"",
            "line 2: the file holds \"UnstructuredGrid\" instead of \"PolyData\"; save",
        ),
        ("109\n", "300\n", "FieldData, units: 300 is no byte"),
        ("109\n", "x\n", "FieldData, units: \"x\" is no byte"),
    ] {
        let at = sound.find(from).unwrap_or_else(|| panic!("{from}"));
        let line = 1 + sound[..at].matches('\n').count();
        let message = message.replace("LINE", &line.to_string());
        let refused = refusal(sound.replacen(from, to, 1).as_bytes());
        assert!(refused.starts_with(&message), "{refused}, not {message}");
    }
}

#[test]
fn arrays_that_are_missing_or_contradict_are_refused() {
    let piece = |form: Form, arrays: &dyn Fn(&mut Builder) -> String| {
        let mut builder = Builder { form, appended: Vec::new() };
        let document = arrays(&mut builder);
        let document = format!("<Piece NumberOfPoints=\"5\" NumberOfPolys=\"2\">\n{document}</Piece>\n");
        refusal(&builder.file(&document))
    };
    let points = |b: &mut Builder| format!("<Points>{}</Points>", b.array("Float32", "P", 3, POINTS.as_flattened()));
    let polys = |b: &mut Builder, corners: &[f64], ends: &[f64]| {
        let connectivity = b.array("Int32", "connectivity", 1, corners);
        points(b) + &format!("<Polys>{connectivity}{}</Polys>", b.array("Int32", "offsets", 1, ends))
    };
    for place in ["ascii", "binary", "raw", "base64"] {
        let form = Form { place, zlib: place != "raw", ..PLAIN };
        assert_eq!(piece(form, &|_| String::new()), "piece 0, Points: the array is missing");
        assert_eq!(piece(form, &|b| points(b)), "piece 0, Polys, offsets: the array is missing");
        let refused = piece(form, &|b| polys(b, &[0.0; 6], &[3.0, 2.0]));
        assert_eq!(refused, "piece 0, Polys: the offset of cell 1 is less than the one before");
        let refused = piece(form, &|b| polys(b, &[0.0; 6], &[3.0, 7.0]));
        assert_eq!(refused, "piece 0, Polys, connectivity: it has only 6 values");
        let refused = piece(form, &|b| polys(b, &[0.0, 1.0, -2.0, 0.0, 1.0, 2.0], &[3.0, 6.0]));
        assert_eq!(refused, "piece 0, Polys: cell 0: there is no vertex -2");
        let refused = piece(form, &|b| polys(b, &[0.0; 6], &[3.0, 2e9]));
        assert!(refused.ends_with("and at most 64000000 are read"), "{refused}");
        let twice = |b: &mut Builder| polys(b, &[0.0; 6], &[3.0, 6.0]).replace("\"offsets\"", "\"connectivity\"");
        assert!(piece(form, &twice).ends_with("piece 0, Polys, connectivity: there are two of these arrays"));
    }
}

/// A triangle and a quadrilateral with cell data and field data.
fn named(cell_data: &dyn Fn(&mut Builder) -> String, field_data: &dyn Fn(&mut Builder) -> String) -> Surface {
    let mut b = Builder { form: Form { place: "raw", ..PLAIN }, appended: Vec::new() };
    let mut document = format!("<FieldData>{}</FieldData>", field_data(&mut b));
    document += "<Piece NumberOfPoints=\"5\" NumberOfPolys=\"4\">";
    document += &format!("<CellData>{}</CellData>", cell_data(&mut b));
    document += &format!("<Points>{}</Points>", b.array("Float64", "P", 3, POINTS.as_flattened()));
    document += &b.cells("Polys", &[&[0, 1, 2], &[0, 1], &[], &[0, 1, 2, 3]]);
    parse(&b.file(&(document + "</Piece>"))).unwrap()
}

const TOO_FEW: &str =
    "2 faces have fewer than three different corners and are passed over (first: piece 0, Polys: cell 1)";

#[test]
fn faces_of_a_model_become_groups_unless_there_are_patches() {
    for kind in ["Int32", "Int64", "UInt8", "Float32", "Float64"] {
        let found = named(&|b| b.array(kind, "ModelFaceID", 1, &[7.0, 7.0, 7.0, 2.0]), &|_| String::new());
        assert_eq!(found.groups, [group("face 7", 0..1), group("face 2", 1..3)], "{kind}");
        assert_eq!(found.notes, [TOO_FEW]);
    }
    // Cell data of others that have too few values, or fractions.
    for (kind, values) in [("Int32", &[1.0][..]), ("Float32", &[0.5; 4])] {
        let found = named(&|b| b.array(kind, "ModelFaceID", 1, values), &|_| String::new());
        assert_eq!((found.groups, found.triangles.len()), (Vec::new(), 3), "{kind}");
    }
    let both = |kind: &'static str| {
        let cell_data = move |b: &mut Builder| {
            let patch = b.array(kind, "patch", 1, &[0.0, 0.0, 0.0, 1.0]);
            b.array("Int32", "ModelFaceID", 1, &[7.0; 4]) + &patch
        };
        named(&cell_data, &|b| b.strings("patch_names", &["wall", "cap"]))
    };
    assert_eq!(both("Int32").groups, [group("wall", 0..1), group("cap", 1..3)]);
    assert_eq!(both("Float32").groups, [group("face 7", 0..3)]);
}

#[test]
fn arrays_of_others_with_known_names_do_not_matter() {
    let nothing = |_: &mut Builder| String::new();
    for (kind, components, value) in [("Float64", 1, 0.5), ("Int32", 3, 1.0), ("String", 1, 65.0)] {
        for name in ["patch", "ModelFaceID"] {
            let array = |b: &mut Builder| b.array(kind, name, components, &vec![value; 4 * components]);
            let found = named(&array, &nothing);
            assert_eq!(found.groups, []);
            let note = format!("the cell data \"{name}\" do not number patches and are passed over");
            assert_eq!(found.notes, [note, TOO_FEW.to_owned()], "{kind}");
        }
    }
    for name in ["units", "patch_names"] {
        let found = named(&nothing, &|b| b.array("Float32", name, 1, &[1.0, 2.0]));
        assert_eq!(found.unit, Unit::Assumed);
        assert_eq!(found.notes[0], format!("the field data \"{name}\" are not strings and are passed over"));
    }
    let found = named(&nothing, &|b| b.strings("units", &["kPa", "mm"]));
    assert_eq!(
        (found.unit, &*found.notes[0]),
        (Unit::Assumed, "the field data \"units\" say \"kPa\", which is not a known unit")
    );
    // Of two arrays the first counts.
    let found = named(&nothing, &|b| b.strings("units", &["mm"]) + &b.strings("units", &["um"]));
    assert_eq!(found.unit, Unit::Stated(1e-3));
}

#[test]
fn coordinates_may_be_integers_or_no_numbers() {
    let text = String::from_utf8(file(PLAIN)).unwrap();
    let read = parse(text.replacen("-0.2", "-nan(ind)", 1).as_bytes()).unwrap();
    assert!(read.positions[4][1].is_nan());
    let whole = text.replace("type=\"Float64\" Name=\"Points\"", "type=\"Int16\" Name=\"Points\"");
    assert_eq!(parse(whole.as_bytes()).unwrap(), expected(PLAIN));
}

#[test]
fn numbers_too_large_for_anything_are_refused_before_anything_is_made() {
    for (what, message) in [
        ("NumberOfPoints=\"18446744073709551615\"", "vertices, and at most 192000000 are read"),
        ("NumberOfPolys=\"18446744073709551615\"", "triangles, and at most 64000000 are read"),
        ("NumberOfPolys=\"18446744073709551615\" NumberOfStrips=\"1\"", "triangles, and at most 64000000 are read"),
        ("NumberOfPoints=\"99999999999999999999999\"", "not a number of items"),
    ] {
        let text = format!("<VTKFile type=\"PolyData\"><PolyData><Piece {what}/></PolyData></VTKFile>");
        let refused = refusal(text.as_bytes());
        assert!(refused.ends_with(message), "{refused}");
    }
    let many = "<a/>".repeat(2_000_000);
    let text = format!("<VTKFile type=\"PolyData\">{many}</VTKFile>");
    assert_eq!(refusal(text.as_bytes()), "document: there are 2000001 XML elements, and at most 2000000 are read");
    // Ten thousand attributes. Comparing their names in pairs would take too long.
    let many: String = (0..200_000).map(|i| format!(" a{i}=\"\"")).collect();
    let text = format!("<VTKFile type=\"PolyData\"{many}><a{many}/></VTKFile>");
    assert_eq!(parse(text.as_bytes()).unwrap(), Surface::default());
}

/// Arrays that all name the same data of the file.
fn overlapping(pieces: usize, array: &str, data: &[u8]) -> Vec<u8> {
    let piece = format!("<Piece NumberOfVerts=\"1000000\" NumberOfPolys=\"1\"><CellData>{array}</CellData></Piece>");
    let root = "<VTKFile type=\"PolyData\" header_type=\"UInt64\" compressor=\"vtkZLibDataCompressor\"><PolyData>";
    let text = format!("{root}{}</PolyData><AppendedData encoding=\"raw\">_", piece.repeat(pieces));
    [text.as_bytes(), data].concat()
}

#[test]
fn what_is_decoded_is_limited_in_all() {
    // Zeros, compressed to a thousandth. Each piece decodes them again.
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(&vec![0; 8_000_000]).unwrap();
    let block = encoder.finish().unwrap();
    let header = [1, 8_000_000, 0, block.len() as u64].map(u64::to_le_bytes);
    let array = "<DataArray type=\"Int64\" Name=\"patch\" format=\"appended\" offset=\"0\"/>";
    let bytes = overlapping(1, array, &[header.as_flattened(), &block].concat());
    assert_eq!(refusal(&bytes), "piece 0, Polys, offsets: the array is missing");
    // The same if the limit is almost reached.
    let fault = |bytes: &[u8], room: u64| {
        let mut document = document::parse(bytes).unwrap();
        document.file.room = std::cell::Cell::new(room);
        let mut integers = match document.file.integers(document.pieces[0].patch.as_ref().unwrap()) {
            Ok(integers) => integers,
            Err(error) => return error.to_string(),
        };
        std::iter::repeat_with(|| integers.integer()).find_map(Result::err).unwrap().to_string()
    };
    let refused = fault(&bytes, 7_999_999);
    assert!(refused.starts_with("piece 0, CellData, patch: the arrays of the file, decoded, have more"), "{refused}");
    // A header that states as many blocks as the file has bytes.
    let blocks = 1_000_000_u64;
    let header = [blocks, 1, 0].map(u64::to_le_bytes);
    let bytes = overlapping(1, array, &[header.as_flattened(), &vec![0; 8_000_000]].concat());
    let stream = "piece 0, CellData, patch: after 0 values: incomplete deflate stream";
    assert_eq!(fault(&bytes, limits::BYTES), stream);
    // Cell data that cannot be read are passed over.
    assert_eq!(refusal(&bytes), "piece 0, Polys, offsets: the array is missing");
    let bytes = overlapping(1, array, &[u64::MAX.to_le_bytes(), [0; 8], [0; 8], [1; 8]].concat());
    let header = "piece 0, CellData, patch: its header: failed to fill whole buffer";
    assert_eq!(fault(&bytes, limits::BYTES), header);
    assert_eq!(refusal(&bytes), "piece 0, Polys, offsets: the array is missing");
}

#[test]
fn what_belongs_to_other_parts_of_xml_does_no_harm() {
    let sound = String::from_utf8(file(PLAIN)).unwrap();
    let lol = "<!DOCTYPE VTKFile [<!ENTITY a \"lol\"><!ENTITY b \"&a;&a;&a;\"><!ENTITY c SYSTEM \"file:///etc/passwd\">]>\n<VTKFile";
    for (from, to) in [
        ("<VTKFile", lol),
        ("<VTKFile", "<!-- <AppendedData encoding=\"raw\">_ --><?pi <Piece>?>\n<VTKFile"),
        ("<PolyData>", "<PolyData other=\"&b;\">&b;&#99;"),
        ("Name=\"patch\"", "Name=\"&#112;atch\""),
        ("-0.2", "<![CDATA[-0.2]]>"),
        ("-0.2", "<!-- 7 -->-0.2<x>8</x>"),
    ] {
        assert!(sound.contains(from), "{from}");
        assert_eq!(parse(sound.replacen(from, to, 1).as_bytes()).unwrap(), expected(PLAIN), "{to}");
    }
}

#[test]
fn refusals_are_short_however_long_the_names() {
    let long = "x".repeat(100_000);
    for text in [
        format!("<{long}/>"),
        format!("<VTKFile type=\"{long}\"/>"),
        format!("<VTKFile type=\"&{long};\"/>"),
        format!("<VTKFile type=\"PolyData\"><a></{long}>"),
        format!("<VTKFile type=\"PolyData\" {long}=>"),
        format!("<VTKFile type=\"PolyData\"><{long}><DataArray Name=\"{long}\" format=\"{long}\"/>"),
    ] {
        let refused = refusal(text.as_bytes());
        assert!(refused.starts_with("line 1: ") || refused.starts_with("FieldData, xxx"), "{refused}");
        assert!(refused.len() < 400, "{}", refused.len());
    }
}

#[test]
fn base64_that_is_none_is_refused() {
    let form = Form { place: "binary", ..PLAIN };
    let text = String::from_utf8(file(form)).unwrap();
    let refused = refusal(text.replacen("format=\"binary\">\n  ", "format=\"binary\">!", 1).as_bytes());
    assert_eq!(refused, "FieldData, units: its header: this is not base64");
}

#[test]
fn files_cut_anywhere_are_refused_or_whole() {
    for (place, zlib) in [("ascii", false), ("binary", true), ("raw", false), ("raw", true), ("base64", true)] {
        let form = Form { place, zlib, wide: zlib, ..PLAIN };
        let whole = file(form);
        for length in 0..whole.len() {
            if let Ok(surface) = parse(&whole[..length]) {
                assert_eq!(surface, expected(form), "{place}, cut at {length}");
            }
        }
    }
}

proptest! {
    #[test]
    fn random_text_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = parse(&bytes);
    }

    #[test]
    fn spoilt_files_never_panic(
        which in any::<prop::sample::Index>(),
        cut in any::<prop::sample::Index>(),
        spoils in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
    ) {
        let forms = forms();
        let mut bytes = file(forms[which.index(forms.len())]);
        for (at, value) in &spoils {
            let at = at.index(bytes.len());
            bytes[at] = *value;
        }
        if spoils.len() % 2 == 1 {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(surface) = parse(&bytes) {
            assert_sound(&surface);
        }
    }
}
