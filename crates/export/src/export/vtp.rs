//! VTK XML PolyData (`.vtp`), for ParaView and other programs built on VTK: a surface with its
//! normals and patches, or a line with values along it.
//!
//! All arrays are appended to the document as raw bytes in little-endian order, the default of VTK,
//! and are computed while they are written. Names and origin are arrays of strings in the field
//! data.

use super::chunks::{one_line, vec3, write_items};
use super::normals;
use super::shape::{Shape, engine};
use super::{CITATION, Metadata};
use crate::model::LengthUnit;
use quick_xml::escape::escape;
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io::{self, Write};

/// Media type of the file. None is registered, and a file with raw bytes is not XML.
pub const MEDIA_TYPE: &str = "application/octet-stream";

/// Writes a surface as VTP.
///
/// - Point data: `Normals`.
/// - Cell data: `patch`, the number of the patch of each triangle, and `ModelFaceID`, the number of
///   the face as `SimVascular` reads it.
/// - Field data: `name`, `units`, `patch_names` in the order of the numbers, `ModelFaceName` in the
///   order of the patches, `generator`, `citation`, and the origin of a model.
///
/// Faces are numbered from 1 in the order of the patches. If all patches are called `face N`, as
/// those of a file of `SimVascular`, the faces keep these numbers.
///
/// # Errors
/// Returns any error of writing to `out`.
///
/// # Panics
/// If the triangles or patches of a shape are out of bounds.
pub fn write_vtp(surface: &Shape<'_>, out: &mut impl Write) -> io::Result<()> {
    let (points, triangles) = (surface.positions.len() as u64, surface.triangles.len() as u64);
    let names: Vec<&str> = surface.patches.iter().map(|patch| patch.name).collect();
    let (numbers, faces): (Vec<i32>, Vec<i32>) = ((0..).take(names.len()).collect(), face_numbers(&names));
    let of_triangles = |numbers: &[i32], out: &mut dyn Write| {
        let patches = surface.patches.iter().zip(numbers);
        let each = patches.flat_map(|(patch, &number)| std::iter::repeat_n(number, patch.triangles.len()));
        write_items(each, out, i32::to_le_bytes)
    };
    let mut document = Document::new(surface.unit, surface.meta);
    document.strings("name", &[surface.name]);
    document.strings("patch_names", &names);
    document.strings("ModelFaceName", &names);
    document.piece(points, 0, triangles);

    document.open("PointData Normals=\"Normals\"");
    document.array("Float32", "Normals", 3, 12 * points, |out| normals::write_of_vertices(surface, out));
    document.close();
    document.open("CellData Scalars=\"patch\"");
    document.array("Int32", "patch", 1, 4 * triangles, |out| of_triangles(&numbers, out));
    document.array("Int32", "ModelFaceID", 1, 4 * triangles, |out| of_triangles(&faces, out));
    document.close();
    document.open("Points");
    document.array("Float32", "Points", 3, 12 * points, |out| write_items(surface.positions, out, |&p| vec3(p)));
    document.close();
    document.open("Polys");
    let corners = || surface.patches.iter().flat_map(|patch| surface.triangles_of(patch).as_flattened());
    let ends = || (1..=triangles).map(|i| 3 * i);
    if i32::try_from(points.max(3 * triangles)).is_ok() {
        document
            .array("Int32", "connectivity", 1, 12 * triangles, |out| write_items(corners(), out, |v| v.to_le_bytes()));
        document.array("Int32", "offsets", 1, 4 * triangles, |out| {
            write_items(ends(), out, |end| (end as u32).to_le_bytes())
        });
    } else {
        document.array("Int64", "connectivity", 1, 24 * triangles, |out| {
            write_items(corners(), out, |&v| u64::from(v).to_le_bytes())
        });
        document.array("Int64", "offsets", 1, 8 * triangles, |out| write_items(ends(), out, u64::to_le_bytes));
    }
    document.close();
    document.write(out)
}

/// Numbers of the faces of `SimVascular`, which are positive and distinct.
fn face_numbers(names: &[&str]) -> Vec<i32> {
    let stated = |name: &&str| name.strip_prefix("face ")?.parse().ok().filter(|number: &i32| *number > 0);
    let numbers: Option<Vec<i32>> = names.iter().map(stated).collect();
    let is_distinct = |numbers: &Vec<i32>| numbers.iter().collect::<BTreeSet<_>>().len() == numbers.len();
    numbers.filter(is_distinct).unwrap_or_else(|| (1..).take(names.len()).collect())
}

/// Writes a line through `points`, for example the centre line of a tube. `arrays` are named values
/// at the points.
///
/// # Errors
/// Returns any error of writing to `out`, and [`io::ErrorKind::InvalidInput`] if there are fewer
/// than two points or an array does not have one value per point.
pub(super) fn write_polyline_vtp(
    points: &[[f64; 3]],
    arrays: &[(&str, &[f64])],
    unit: LengthUnit,
    meta: &Metadata,
    out: &mut impl Write,
) -> io::Result<()> {
    let invalid = |message: String| Err(io::Error::new(io::ErrorKind::InvalidInput, message));
    let count = points.len() as u64;
    if count < 2 {
        return invalid(format!("a line has at least two points, not {count}"));
    }
    if let Some((name, values)) = arrays.iter().find(|(_, values)| values.len() != points.len()) {
        return invalid(format!("the line has {count} points, and the array {name:?} has {} values", values.len()));
    }
    let mut document = Document::new(unit, Some(meta));
    document.piece(count, 1, 0);
    let numbers = |values| move |out: &mut dyn Write| write_items(values, out, |&x: &f64| x.to_le_bytes());
    document.open("PointData");
    for &(name, values) in arrays {
        document.array("Float64", name, 1, 8 * count, numbers(values));
    }
    document.close();
    document.open("Points");
    document.array("Float64", "Points", 3, 24 * count, numbers(points.as_flattened()));
    document.close();
    document.open("Lines");
    document.array("Int64", "connectivity", 1, 8 * count, |out| write_items(0..count, out, u64::to_le_bytes));
    document.array("Int64", "offsets", 1, 8, |out| out.write_all(&count.to_le_bytes()));
    document.close();
    document.write(out)
}

/// A document under construction: its text, and the arrays to be appended.
struct Document<'a> {
    text: String,
    /// Open elements, the innermost last.
    open: Vec<&'a str>,
    arrays: Vec<Array<'a>>,
    /// Bytes of `arrays` in the file, with their lengths.
    length: u64,
}

/// Writes the values of an array.
type Values<'a> = dyn Fn(&mut dyn Write) -> io::Result<()> + 'a;

struct Array<'a> {
    /// Number of bytes that `write` writes.
    bytes: u64,
    write: Box<Values<'a>>,
}

/// Size of the length before each appended array, bytes.
const PREFIX: u64 = 8;

impl<'a> Document<'a> {
    /// Begins a document with the field data that all files have.
    fn new(unit: LengthUnit, meta: Option<&Metadata>) -> Self {
        let text = "<?xml version=\"1.0\"?>\n".to_owned();
        let mut document = Self { text, open: Vec::new(), arrays: Vec::new(), length: 0 };
        document.open("VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\"");
        document.open("PolyData");
        document.open("FieldData");
        document.strings("units", &[unit.name()]);
        document.strings("generator", &[&format!("oviduct {}", engine(meta))]);
        document.strings("citation", &[CITATION]);
        if let Some(meta) = meta {
            document.strings("preset", &[&meta.preset]);
            document.strings("seed", &[&meta.seed.to_string()]);
            document.strings("digest", &[&meta.digest]);
            document.strings("engine", &[&meta.engine]);
        }
        document
    }

    /// Ends the field data and begins the piece.
    fn piece(&mut self, points: u64, lines: u64, polys: u64) {
        self.close();
        self.line(&format!(
            "<Piece NumberOfPoints=\"{points}\" NumberOfVerts=\"0\" NumberOfLines=\"{lines}\" NumberOfStrips=\"0\" \
             NumberOfPolys=\"{polys}\">"
        ));
        self.open.push("Piece");
    }

    /// Begins an element. Attributes may follow its name.
    fn open(&mut self, element: &'a str) {
        self.line(&format!("<{element}>"));
        self.open.push(element.split_once(' ').map_or(element, |(name, _)| name));
    }

    fn close(&mut self) {
        if let Some(name) = self.open.pop() {
            self.line(&format!("</{name}>"));
        }
    }

    fn line(&mut self, text: &str) {
        self.text.extend(std::iter::repeat_n("  ", self.open.len()));
        self.text.push_str(text);
        self.text.push('\n');
    }

    /// Adds an array of numbers. `write` writes its `bytes` bytes.
    fn array(
        &mut self,
        kind: &str,
        name: &str,
        components: usize,
        bytes: u64,
        write: impl Fn(&mut dyn Write) -> io::Result<()> + 'a,
    ) {
        let (name, components) = (attribute(name), format!("NumberOfComponents=\"{components}\""));
        let offset = self.append(bytes, write);
        self.line(&format!("<DataArray type=\"{kind}\" Name={name} {components} format=\"appended\" {offset}/>"));
    }

    /// Adds an array of strings, each of which ends with a zero.
    fn strings(&mut self, name: &str, values: &[&str]) {
        let text: String = values.iter().flat_map(|value| [one_line(value), "\0".to_owned()]).collect();
        let offset = self.append(text.len() as u64, move |out| out.write_all(text.as_bytes()));
        let (name, count) = (attribute(name), values.len());
        self.line(&format!(
            "<Array type=\"String\" Name={name} NumberOfTuples=\"{count}\" format=\"appended\" {offset}/>"
        ));
    }

    /// Appends an array and returns the attribute with its offset.
    fn append(&mut self, bytes: u64, write: impl Fn(&mut dyn Write) -> io::Result<()> + 'a) -> String {
        let offset = format!("offset=\"{}\"", self.length);
        self.length += PREFIX + bytes;
        self.arrays.push(Array { bytes, write: Box::new(write) });
        offset
    }

    fn write(mut self, out: &mut dyn Write) -> io::Result<()> {
        while self.open.len() > 1 {
            self.close();
        }
        // The format requires an underscore before the bytes.
        self.line("<AppendedData encoding=\"raw\">");
        self.text.push('_');
        out.write_all(self.text.as_bytes())?;
        for array in &self.arrays {
            out.write_all(&array.bytes.to_le_bytes())?;
            (array.write)(out)?;
        }
        out.write_all(b"\n  </AppendedData>\n</VTKFile>\n")
    }
}

/// Value of an attribute, in quotes.
fn attribute(text: &str) -> String {
    let mut quoted = String::from("\"");
    // XML forbids control characters, even escaped.
    let plain = text.replace(|c: char| c.is_control(), " ");
    let _ = write!(quoted, "{}\"", escape(&plain));
    quoted
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::read::{Format, Unit, parse};
    use crate::export::tests::{Sample, bits, meta, samples};
    use proptest::prelude::*;

    fn vtp(sample: &Sample) -> Vec<u8> {
        let mut file = Vec::new();
        write_vtp(&sample.shape(), &mut file).unwrap();
        file
    }

    /// XML before the appended bytes.
    fn document(file: &[u8]) -> &str {
        let end = file.windows(2).position(|pair| pair == b"\n_").unwrap();
        str::from_utf8(&file[..end]).unwrap()
    }

    #[test]
    fn the_document_is_as_agreed() {
        let expected = r#"<?xml version="1.0"?>
<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
  <PolyData>
    <FieldData>
      <Array type="String" Name="units" NumberOfTuples="1" format="appended" offset="0"/>
      <Array type="String" Name="generator" NumberOfTuples="1" format="appended" offset="11"/>
      <Array type="String" Name="citation" NumberOfTuples="1" format="appended" offset="33"/>
      <Array type="String" Name="preset" NumberOfTuples="1" format="appended" offset="140"/>
      <Array type="String" Name="seed" NumberOfTuples="1" format="appended" offset="152"/>
      <Array type="String" Name="digest" NumberOfTuples="1" format="appended" offset="162"/>
      <Array type="String" Name="engine" NumberOfTuples="1" format="appended" offset="235"/>
      <Array type="String" Name="name" NumberOfTuples="1" format="appended" offset="249"/>
      <Array type="String" Name="patch_names" NumberOfTuples="4" format="appended" offset="264"/>
      <Array type="String" Name="ModelFaceName" NumberOfTuples="4" format="appended" offset="318"/>
    </FieldData>
    <Piece NumberOfPoints="5" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="3">
      <PointData Normals="Normals">
        <DataArray type="Float32" Name="Normals" NumberOfComponents="3" format="appended" offset="372"/>
      </PointData>
      <CellData Scalars="patch">
        <DataArray type="Int32" Name="patch" NumberOfComponents="1" format="appended" offset="440"/>
        <DataArray type="Int32" Name="ModelFaceID" NumberOfComponents="1" format="appended" offset="460"/>
      </CellData>
      <Points>
        <DataArray type="Float32" Name="Points" NumberOfComponents="3" format="appended" offset="480"/>
      </Points>
      <Polys>
        <DataArray type="Int32" Name="connectivity" NumberOfComponents="1" format="appended" offset="548"/>
        <DataArray type="Int32" Name="offsets" NumberOfComponents="1" format="appended" offset="592"/>
      </Polys>
    </Piece>
  </PolyData>
  <AppendedData encoding="raw">"#;
        assert_eq!(document(&vtp(&Sample::new(3))), expected);
        assert!(!document(&vtp(&Sample { meta: None, ..Sample::new(3) })).contains("digest"));
    }

    #[test]
    fn faces_are_numbered_from_one_or_keep_their_numbers() {
        assert_eq!(face_numbers(&["inner_wall", "outer_wall"]), [1, 2]);
        assert_eq!(face_numbers(&["face 7", "face 2"]), [7, 2]);
        for names in [["face 7", "face 7"], ["face 7", "cut"], ["face 0", "face 1"], ["face", "face 1"]] {
            assert_eq!(face_numbers(&names), [1, 2], "{names:?}");
        }
        let mut sample = Sample::new(3);
        for (patch, number) in sample.patches.iter_mut().zip([9, 4, 5, 6]) {
            patch.0 = format!("face {number}");
        }
        let file = vtp(&sample);
        // Of the three triangles, the first is in the first patch and the others are in the last.
        let after = |name: &str| {
            let text = document(&file);
            let at = text.find(&format!("Name=\"{name}\"")).unwrap();
            let offset =
                text[at..].split_once("offset=\"").unwrap().1.split_once('"').unwrap().0.parse::<usize>().unwrap();
            file[text.len() + 2 + offset + 8..][..12]
                .chunks(4)
                .map(|n| i32::from_le_bytes(n.try_into().unwrap()))
                .collect::<Vec<_>>()
        };
        assert_eq!(after("ModelFaceID"), [9, 6, 6]);
        assert_eq!(after("patch"), [0, 3, 3]);
    }

    #[test]
    fn a_large_file_is_written_in_pieces() {
        let sample = Sample::new(10_000);
        assert_eq!(parse(&vtp(&sample), Format::Vtp, None).unwrap(), sample.surface());
    }

    #[test]
    fn names_need_no_care() {
        let mut sample = Sample::new(7);
        sample.patches[0].0 = "a <b> & \"c\"\n\0 größe_".to_owned();
        let read = parse(&vtp(&sample), Format::Vtp, None).unwrap();
        assert_eq!(&*read.groups[0].name, "a <b> & \"c\"   größe_");
    }

    #[test]
    fn a_line_has_one_cell_and_its_arrays() {
        let points: Vec<[f64; 3]> = (0..5000).map(|i| [0.1 * f64::from(i), 1e-9, -2.0]).collect();
        let values: Vec<f64> = points.iter().map(|p| p[0].sin()).collect();
        let arrays = [("arc", values.as_slice()), ("r <mm> \"&\"", &values)];
        let mut file = Vec::new();
        write_polyline_vtp(&points, &arrays, LengthUnit::Micrometre, &meta(), &mut file).unwrap();
        let text = document(&file);
        assert!(text.contains("NumberOfPoints=\"5000\" NumberOfVerts=\"0\" NumberOfLines=\"1\""), "{text}");
        assert!(text.contains("Name=\"r &lt;mm&gt; &quot;&amp;&quot;\""), "{text}");
        let read = parse(&file, Format::Vtp, None).unwrap();
        assert_eq!(bits(&read.positions), bits(&points));
        assert_eq!((read.triangles.len(), read.unit), (0, Unit::Stated(1e-6)));
        let end = b"\n  </AppendedData>\n</VTKFile>\n";
        assert_eq!(&file[file.len() - end.len()..], end);
    }

    #[test]
    fn a_line_that_is_none_is_refused() {
        let refused = |points: usize, values: usize| {
            let (points, values) = (vec![[0.0; 3]; points], vec![0.0; values]);
            let arrays = [("arc", values.as_slice())];
            let refused =
                write_polyline_vtp(&points, &arrays, LengthUnit::Metre, &meta(), &mut Vec::new()).unwrap_err();
            assert_eq!(refused.kind(), io::ErrorKind::InvalidInput);
            refused.to_string()
        };
        assert_eq!(refused(1, 1), "a line has at least two points, not 1");
        assert_eq!(refused(3, 2), "the line has 3 points, and the array \"arc\" has 2 values");
    }

    proptest! {
        #[test]
        fn a_file_read_back_is_the_same_surface(sample in samples(12)) {
            let read = parse(&vtp(&sample), Format::Vtp, None).unwrap();
            prop_assert_eq!(bits(&read.positions), bits(&sample.surface().positions));
            prop_assert_eq!(read, sample.surface());
        }
    }
}
