//! PLY, binary. The file contains only positions and triangles, because several readers (Gmsh,
//! meshio) refuse other properties. Patches are runs of triangles; a comment states the first
//! triangle, the number of triangles and the name of each (`comment patch 0 120 inner_wall`).

use super::CITATION;
use super::chunks::{join, one_line, vec3, write_items};
use super::shape::Shape;
use std::io::{self, Write};

/// Media type of the file. It is not registered, but has the form of those of STL and OBJ.
pub const MEDIA_TYPE: &str = "model/ply";

/// Writes a surface as binary PLY in little-endian order.
///
/// # Errors
/// Returns any error of writing to `out`, and [`io::ErrorKind::InvalidInput`] if there are more
/// vertices than a signed 32-bit index can name. Readers expect this type.
///
/// # Panics
/// If the triangles or patches of the shape are out of bounds.
pub fn write_ply(surface: &Shape<'_>, out: &mut impl Write) -> io::Result<()> {
    indexable(surface.positions.len() as u64)?;
    out.write_all(&header(surface)?)?;
    write_items(surface.positions, out, |&p| vec3(p))?;
    let triangles = surface.patches.iter().flat_map(|patch| surface.triangles_of(patch));
    write_items(triangles, out, |t| join::<13>([&[3][..], t.map(u32::to_le_bytes).as_flattened()]))
}

fn indexable(vertices: u64) -> io::Result<()> {
    const MOST: u64 = 1 << 31;
    if vertices <= MOST {
        return Ok(());
    }
    let message =
        format!("a PLY file with 32-bit indices holds at most {MOST} vertices, and the surface has {vertices}");
    Err(io::Error::new(io::ErrorKind::InvalidInput, message))
}

fn header(surface: &Shape<'_>) -> io::Result<Vec<u8>> {
    let mut text = b"ply\nformat binary_little_endian 1.0\n".to_vec();
    writeln!(text, "comment generator: {}", one_line(&surface.generator()))?;
    writeln!(text, "comment method: {CITATION}")?;
    if let Some(meta) = surface.meta {
        writeln!(text, "comment axes: right-handed, y up, z along the tube from isthmus to ampulla")?;
        writeln!(text, "comment preset: {}", one_line(&meta.preset))?;
        writeln!(text, "comment seed: {}", meta.seed)?;
        writeln!(text, "comment digest: {}", one_line(&meta.digest))?;
    }
    writeln!(text, "comment body: {}", one_line(surface.name))?;
    for patch in &surface.patches {
        writeln!(text, "comment patch {} {} {}", patch.triangles.start, patch.triangles.len(), one_line(patch.name))?;
    }
    // Last, because a name above may look like a unit to readers.
    writeln!(text, "comment units: {}", surface.unit.name())?;
    writeln!(text, "element vertex {}", surface.positions.len())?;
    for property in ["x", "y", "z"] {
        writeln!(text, "property float {property}")?;
    }
    writeln!(text, "element face {}", surface.triangles.len())?;
    writeln!(text, "property list uchar int vertex_indices\nend_header")?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::read::{Format, parse};
    use crate::export::tests::{Sample, bits, samples};
    use proptest::prelude::*;

    fn ply(sample: &Sample) -> Vec<u8> {
        let mut file = Vec::new();
        write_ply(&sample.shape(), &mut file).unwrap();
        file
    }

    #[test]
    fn the_header_is_as_agreed() {
        let mut sample = Sample::new(7);
        sample.patches[1].0 = "units: m\nnext".to_owned();
        let file = ply(&sample);
        let (header, data) = file.split_at(file.len() - 9 * 12 - 7 * 13);
        let expected = format!(
            "ply\nformat binary_little_endian 1.0\ncomment generator: oviduct 0.1.0\ncomment method: {CITATION}\n\
             comment axes: right-handed, y up, z along the tube from isthmus to ampulla\ncomment preset: pig\n\
             comment seed: 7\ncomment digest: {}\ncomment body: tissue\ncomment patch 0 2 inner_wall\n\
             comment patch 2 1 units: m next\ncomment patch 3 0 cap_isthmus\ncomment patch 3 4 cap_ampulla\n\
             comment units: mm\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\n\
             element face 7\nproperty list uchar int vertex_indices\nend_header\n",
            "0f3a".repeat(16)
        );
        assert_eq!(str::from_utf8(header).unwrap(), expected);
        assert_eq!(data[9 * 12..][..13], [3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
        assert_eq!(&*parse(&file, Format::Ply, None).unwrap().groups[1].name, "units: m next");
        let converted = Sample { meta: None, ..Sample::new(1) };
        assert!(!String::from_utf8_lossy(&ply(&converted)).contains("seed"));
    }

    #[test]
    fn more_vertices_than_indices_can_name_are_refused() {
        assert!(indexable(1 << 31).is_ok());
        let refused = indexable((1 << 31) + 1).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::InvalidInput);
        assert!(refused.to_string().contains("at most 2147483648 vertices"), "{refused}");
    }

    #[test]
    fn a_large_file_is_written_in_pieces() {
        let sample = Sample::new(10_000);
        assert_eq!(parse(&ply(&sample), Format::Ply, None).unwrap(), sample.surface());
    }

    proptest! {
        #[test]
        fn a_file_read_back_is_the_same_surface(sample in samples(12)) {
            let read = parse(&ply(&sample), Format::Ply, None).unwrap();
            prop_assert_eq!(bits(&read.positions), bits(&sample.surface().positions));
            prop_assert_eq!(read, sample.surface());
        }
    }
}
