//! STL, binary or text, for printing, meshing and flow solvers. The format has neither shared
//! vertices nor patches.
//!
//! The binary form stores the number of the patch, from 1, in the attribute of each triangle
//! (`attribute byte count`), which most readers ignore. The text form has one solid per patch, from
//! which solvers create named boundaries. It cannot state a unit.

use super::chunks::{CHUNK, join, one_line, vec3, write_if_full, write_items};
use super::normals;
use super::shape::{Shape, engine};
use std::io::{self, Write};

/// Media type of the file.
pub const MEDIA_TYPE: &str = "model/stl";

/// Bytes of the header of a binary file.
const HEADER: usize = 80;
/// Bytes of a triangle of a binary file.
const RECORD: usize = 50;
/// Maximum attribute, because some programs interpret the highest bit as the flag of a colour.
const MAX_ATTRIBUTE: u16 = (1 << 15) - 1;

/// Writes a surface as binary STL.
///
/// The attribute of a triangle is the number of its patch, from 1; it is 0 for patches beyond
/// 32,767.
///
/// # Errors
/// Returns any error of writing to `out`, and [`io::ErrorKind::InvalidInput`] if there are more
/// triangles than the format can count.
///
/// # Panics
/// If the triangles or patches of a shape are out of bounds.
pub fn write_stl(surface: &Shape<'_>, out: &mut impl Write) -> io::Result<()> {
    let count = count(surface.triangles.len() as u64)?;
    out.write_all(&header(surface))?;
    out.write_all(&count.to_le_bytes())?;
    for (patch, number) in surface.patches.iter().zip(1_usize..) {
        let attribute = u16::try_from(number).ok().filter(|&a| a <= MAX_ATTRIBUTE).unwrap_or_default();
        write_items(surface.triangles_of(patch), out, |&triangle| {
            let corners = surface.corners(triangle);
            let [a, b, c] = corners.map(vec3);
            join::<RECORD>([&vec3(normals::of_triangle(corners))[..], &a, &b, &c, &attribute.to_le_bytes()])
        })?;
    }
    Ok(())
}

/// Writes a surface as text STL.
///
/// Positions are the shortest decimals that read back as the same 32-bit floats. Patches without
/// triangles are omitted.
///
/// # Errors
/// Returns any error of writing to `out`.
///
/// # Panics
/// If the triangles or patches of a shape are out of bounds.
pub fn write_ascii_stl(surface: &Shape<'_>, out: &mut impl Write) -> io::Result<()> {
    let mut points = VertexTexts::new();
    let mut text = Vec::with_capacity(CHUNK + 1024);
    for patch in surface.patches.iter().filter(|patch| !patch.triangles.is_empty()) {
        let name = one_line(patch.name);
        writeln!(text, "solid {name}")?;
        for &triangle in surface.triangles_of(patch) {
            let [x, y, z] = normals::of_triangle(surface.corners(triangle));
            writeln!(text, "facet normal {x} {y} {z}\nouter loop")?;
            for vertex in triangle {
                text.extend_from_slice(b"vertex");
                text.extend_from_slice(points.get(vertex, surface)?);
            }
            text.extend_from_slice(b"endloop\nendfacet\n");
            write_if_full(&mut text, out)?;
        }
        writeln!(text, "endsolid {name}")?;
    }
    if surface.triangles.is_empty() {
        let name = one_line(surface.name);
        write!(text, "solid {name}\nendsolid {name}\n")?;
    }
    out.write_all(&text)
}

/// Cache of the text of vertices, because each vertex is written for about six triangles.
struct VertexTexts(Vec<(Option<u32>, Vec<u8>)>);

impl VertexTexts {
    /// Size of the cache. A wall uses the vertices of two sections at a time, which are fewer.
    const KEPT: usize = 1 << 16;

    fn new() -> Self {
        Self(vec![(None, Vec::new()); Self::KEPT])
    }

    fn get(&mut self, vertex: u32, surface: &Shape<'_>) -> io::Result<&[u8]> {
        let (kept, text) = &mut self.0[vertex as usize % Self::KEPT];
        if *kept != Some(vertex) {
            let [x, y, z] = surface.positions[vertex as usize];
            text.clear();
            writeln!(text, " {x} {y} {z}")?;
            *kept = Some(vertex);
        }
        Ok(text)
    }
}

/// Number of triangles as the format stores it.
fn count(triangles: u64) -> io::Result<u32> {
    u32::try_from(triangles).map_err(|_| {
        let most = u32::MAX;
        let message = format!("a binary STL file holds at most {most} triangles, and the surface has {triangles}");
        io::Error::new(io::ErrorKind::InvalidInput, message)
    })
}

/// Header with generator and unit first, because a long text is cut off. It must not begin with
/// `solid`, which marks the text form.
fn header(surface: &Shape<'_>) -> [u8; HEADER] {
    // Only letters, digits and a few signs, because some readers search the header for colours.
    let plain = |text: &str| text.replace(|c: char| !(c.is_ascii_alphanumeric() || "._-".contains(c)), "_");
    let (engine, name) = (plain(engine(surface.meta)), plain(surface.name));
    let mut text = format!("oviduct {engine:.16} units={} {name}", surface.unit.name());
    if let Some(meta) = surface.meta {
        text += &format!(" digest={}", plain(&meta.digest));
    }
    let mut header = [0; HEADER];
    let length = text.len().min(HEADER);
    header[..length].copy_from_slice(&text.as_bytes()[..length]);
    header
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::read::{Format, Unit, parse};
    use crate::export::tests::{Sample, bits, samples};
    use proptest::prelude::*;

    fn binary(sample: &Sample) -> Vec<u8> {
        let mut file = Vec::new();
        write_stl(&sample.shape(), &mut file).unwrap();
        file
    }

    fn text(sample: &Sample) -> String {
        let mut file = Vec::new();
        write_ascii_stl(&sample.shape(), &mut file).unwrap();
        String::from_utf8(file).unwrap()
    }

    #[test]
    fn the_header_states_the_unit_and_is_cut() {
        let mut sample = Sample::new(3);
        let file = binary(&sample);
        assert_eq!(&file[..80], b"oviduct 0.1.0 units=mm tissue digest=0f3a0f3a0f3a0f3a0f3a0f3a0f3a0f3a0f3a0f3a0f3");
        sample.meta = None;
        let mut shape = sample.shape();
        shape.name = "units µm, solid";
        let expected = format!("oviduct {} units=mm units__m__solid\0", env!("CARGO_PKG_VERSION"));
        assert!(header(&shape).starts_with(expected.as_bytes()));
    }

    #[test]
    fn the_text_is_as_agreed() {
        let mut sample = Sample::new(2);
        sample.positions = vec![[0.1, 0.0, 1e-7], [1.0, -0.0, 1e-7], [0.1, 123.456, 1e-7], [2.5, 0.0, 7.0]];
        sample.triangles[1] = [1, 1, 3];
        assert_eq!(
            text(&sample),
            "solid outer_wall\nfacet normal 0 0 1\nouter loop\nvertex 0.1 0 0.0000001\nvertex 1 -0 0.0000001\n\
             vertex 0.1 123.456 0.0000001\nendloop\nendfacet\nendsolid outer_wall\nsolid cap_ampulla\n\
             facet normal 0 0 0\nouter loop\nvertex 1 -0 0.0000001\nvertex 1 -0 0.0000001\nvertex 2.5 0 7\nendloop\n\
             endfacet\nendsolid cap_ampulla\n"
        );
        sample = Sample::new(0);
        assert_eq!(text(&sample), "solid tissue\nendsolid tissue\n");
    }

    #[test]
    fn a_large_file_is_written_in_pieces() {
        let sample = Sample::new(10_000);
        let read = parse(&binary(&sample), Format::Stl, None).unwrap();
        assert_eq!((read.positions, read.triangles), (sample.soup().positions, sample.soup().triangles));
        let read = parse(text(&sample).as_bytes(), Format::Stl, None).unwrap();
        assert_eq!((read.positions, read.groups), (sample.soup().positions, sample.soup().groups));
    }

    #[test]
    fn normals_have_unit_length_and_attributes_name_the_patch() {
        let file = binary(&Sample::new(9));
        assert_eq!(u32::from_le_bytes(file[80..84].try_into().unwrap()), 9);
        let records: Vec<_> = file[84..].chunks_exact(RECORD).collect();
        let attributes: Vec<_> = records.iter().map(|r| u16::from_le_bytes([r[48], r[49]])).collect();
        assert_eq!(attributes, [1, 1, 1, 2, 4, 4, 4, 4, 4]);
        for record in records {
            let (floats, _) = record[..12].as_chunks::<4>();
            let length: f64 = floats.iter().map(|&x| f64::from(f32::from_le_bytes(x)).powi(2)).sum();
            assert!((length - 1.0).abs() < 1e-6, "{length}");
        }
    }

    #[test]
    fn more_triangles_than_the_format_counts_are_refused() {
        assert_eq!(count(u64::from(u32::MAX)).unwrap(), u32::MAX);
        let refused = count(1 << 32).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::InvalidInput);
        let message = "a binary STL file holds at most 4294967295 triangles, and the surface has 4294967296";
        assert_eq!(refused.to_string(), message);
    }

    proptest! {
        #[test]
        fn files_read_back_are_the_same_surface(sample in samples(12)) {
            let expected = sample.soup();
            let read = parse(&binary(&sample), Format::Stl, None).unwrap();
            prop_assert_eq!(bits(&read.positions), bits(&expected.positions));
            prop_assert_eq!((&read.triangles, read.unit), (&expected.triangles, expected.unit));
            let runs: Vec<_> = read.groups.iter().map(|g| g.triangles.clone()).collect();
            prop_assert_eq!(runs, expected.groups.iter().map(|g| g.triangles.clone()).collect::<Vec<_>>());
            let read = parse(text(&sample).as_bytes(), Format::Stl, None).unwrap();
            prop_assert_eq!(bits(&read.positions), bits(&expected.positions));
            prop_assert_eq!((&read.triangles, &read.groups), (&expected.triangles, &expected.groups));
            prop_assert_eq!(read.unit, Unit::Assumed);
        }
    }
}
