//! Wavefront OBJ: text, shared vertices, one group per patch.
//!
//! Positions are the shortest decimals that read back as the same 32-bit floats. Normals are
//! omitted: they would double the size, and readers compute them. Material names (`usemtl`) serve
//! as labels; there is no material library.

use super::CITATION;
use super::chunks::{CHUNK, one_line, push_number, write_if_full};
use super::shape::{AXES, Shape};
use crate::model::LengthUnit;
use std::io::{self, Write};

/// Media type of the file.
pub const MEDIA_TYPE: &str = "model/obj";

/// Writes a surface as OBJ.
///
/// # Errors
/// Returns any error of writing to `out`.
pub fn write_obj(surface: &Shape<'_>, out: &mut impl Write) -> io::Result<()> {
    let mut text = Vec::with_capacity(CHUNK + 256);
    let unit = match surface.unit {
        LengthUnit::Metre => "metres",
        unit => unit.name(),
    };
    writeln!(text, "# generator: {}", surface.generator())?;
    if let Some(meta) = surface.meta {
        writeln!(text, "# method: {CITATION}")?;
        writeln!(text, "# units: {unit}; axes: {AXES}")?;
        writeln!(text, "# preset: {}", one_line(&meta.preset))?;
        writeln!(text, "# seed: {}", meta.seed)?;
        writeln!(text, "# digest: {}", one_line(&meta.digest))?;
        writeln!(text, "# length_mm: {}", meta.length_mm)?;
        writeln!(text, "# body: {}", surface.name)?;
        writeln!(text, "# sections: {}", meta.sections)?;
    } else {
        writeln!(text, "# units: {unit}")?;
    }
    writeln!(text, "# vertices: {}", surface.positions.len())?;
    writeln!(text, "# triangles: {}", surface.triangles.len())?;
    writeln!(text, "o {}", one_word(surface.name))?;
    for [x, y, z] in surface.positions {
        writeln!(text, "v {x} {y} {z}")?;
        write_if_full(&mut text, out)?;
    }
    for patch in &surface.patches {
        let name = one_word(patch.name);
        writeln!(text, "g {name}\nusemtl {name}")?;
        for triangle in surface.triangles_of(patch) {
            text.extend_from_slice(b"f");
            for index in triangle {
                text.push(b' ');
                push_number(&mut text, u64::from(*index) + 1);
            }
            text.push(b'\n');
            write_if_full(&mut text, out)?;
        }
    }
    out.write_all(&text)
}

/// Joins the words of a name by underscores, because most readers end a name at the first space.
fn one_word(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join("_")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::Shape;
    use crate::export::tests::meta;
    use crate::model::{Mesh, Patch, PatchKind, sample};
    use proptest::prelude::*;

    fn obj(mesh: &Mesh) -> String {
        let mut file = Vec::new();
        write_obj(&Shape::of(mesh, &meta()), &mut file).unwrap();
        String::from_utf8(file).unwrap()
    }

    /// Positions, triangles, and the name and first triangle of each group.
    type Parts = (Vec<[f32; 3]>, Vec<[u32; 3]>, Vec<(String, usize)>);

    /// Reads `v`, `f` and `g` statements.
    fn read(text: &str) -> Parts {
        let (mut positions, mut triangles, mut groups) = (Vec::new(), Vec::new(), Vec::new());
        for line in text.lines() {
            let mut words = line.split(' ');
            match words.next().unwrap() {
                "v" => positions.push([(); 3].map(|()| words.next().unwrap().parse().unwrap())),
                "f" => triangles.push([(); 3].map(|()| words.next().unwrap().parse::<u32>().unwrap() - 1)),
                "g" => groups.push((words.next().unwrap().to_owned(), triangles.len())),
                _ => {}
            }
        }
        (positions, triangles, groups)
    }

    #[test]
    fn a_file_read_back_is_the_same_mesh() {
        let mesh = sample::tube(30, 6, 0.3);
        let (positions, triangles, groups) = read(&obj(&mesh));
        assert_eq!(positions, mesh.positions);
        assert_eq!(triangles, mesh.triangles);
        let expected: Vec<_> = mesh.patches.iter().map(|p| (p.kind.name().to_owned(), p.triangles.start)).collect();
        assert_eq!(groups, expected);
    }

    #[test]
    fn the_text_is_as_agreed() {
        insta::assert_snapshot!(obj(&sample::tube(4, 1, 0.0)));
    }

    proptest! {
        #[test]
        fn every_finite_float_survives(bits in prop::collection::vec(prop::num::f32::ANY, 3)) {
            prop_assume!(bits.iter().all(|x| x.is_finite()));
            let mut mesh = sample::tube(4, 1, 0.0);
            mesh.positions.truncate(1);
            mesh.positions[0] = [bits[0], bits[1], bits[2]];
            mesh.triangles.clear();
            mesh.patches = vec![Patch { kind: PatchKind::InnerWall, triangles: 0..0 }];
            let (positions, ..) = read(&obj(&mesh));
            prop_assert_eq!(positions[0].map(f32::to_bits), mesh.positions[0].map(f32::to_bits));
        }

        #[test]
        fn numbers_are_decimal(number: u64) {
            let mut text = Vec::new();
            push_number(&mut text, number);
            prop_assert_eq!(String::from_utf8(text).unwrap(), number.to_string());
        }
    }
}
