//! Normals of triangles and vertices. They are computed from additions, multiplications, divisions
//! and square roots in a fixed order, so the same surface gives the same bits on every machine.

use super::chunks::{vec3, write_items};
use super::shape::Shape;
use crate::geometry::patch::{add, doubled_area_normal};
use std::io::{self, Write};

/// Unit normal of a triangle; zero if its area is zero.
pub(super) fn of_triangle(corners: [[f32; 3]; 3]) -> [f32; 3] {
    unit(doubled_area_normal(corners)).unwrap_or_default()
}

/// Writes the unit normal of each vertex: the mean normal of the adjacent triangles, weighted by
/// area.
///
/// At the sharp edge between a wall and a cap, only the triangles of the wall count (patches with
/// `wall` in their name), because the mean of both would shade the wall as if it were bent. A
/// vertex whose mean has no direction gets the z axis.
///
/// # Errors
/// Returns any error of writing to `out`.
///
/// # Panics
/// If the triangles or patches of a shape are out of bounds.
pub(super) fn write_of_vertices(surface: &Shape<'_>, out: &mut dyn Write) -> io::Result<()> {
    let mut sums = vec![NormalSum::default(); surface.positions.len()];
    for patch in &surface.patches {
        let on_wall = patch.name.contains("wall");
        for &triangle in surface.triangles_of(patch) {
            let normal = doubled_area_normal(surface.corners(triangle));
            for vertex in triangle {
                sums[vertex as usize].add(normal, on_wall);
            }
        }
    }
    write_items(sums, out, NormalSum::bytes)
}

#[derive(Clone, Copy, Default)]
struct NormalSum {
    normal: [f64; 3],
    /// True if the sum contains only triangles of walls.
    on_wall: bool,
}

impl NormalSum {
    fn add(&mut self, normal: [f64; 3], on_wall: bool) {
        if on_wall && !self.on_wall {
            *self = Self { normal: [0.0; 3], on_wall };
        }
        if on_wall == self.on_wall {
            add(&mut self.normal, normal);
        }
    }

    fn bytes(self) -> [u8; 12] {
        vec3(unit(self.normal).unwrap_or([0.0, 0.0, 1.0]))
    }
}

/// `v` scaled to length 1, if it has a direction. Zeros are positive, because the sign would show
/// in text.
fn unit(v: [f64; 3]) -> Option<[f32; 3]> {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    length.is_normal().then(|| v.map(|x| (x / length) as f32 + 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::shape::{NamedPatch, Shape};
    use crate::model::LengthUnit;

    const POSITIONS: [[f32; 3]; 5] = [[0., 0., 0.], [2., 0., 0.], [0., 1., 0.], [0., 0., 3.], [9., 9., 9.]];
    const TRIANGLES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

    fn normals(names: [&str; 2]) -> Vec<[f32; 3]> {
        let patches = names.into_iter().enumerate().map(|(i, name)| NamedPatch { name, triangles: i..i + 1 }).collect();
        let (positions, triangles) = (&POSITIONS, &TRIANGLES);
        let shape = Shape { name: "x", positions, triangles, patches, unit: LengthUnit::Metre, meta: None };
        let mut bytes = Vec::new();
        write_of_vertices(&shape, &mut bytes).unwrap();
        let (floats, _) = bytes.as_chunks::<4>();
        let (normals, _) = floats.as_chunks::<3>();
        normals.iter().map(|normal| normal.map(f32::from_le_bytes)).collect()
    }

    #[test]
    fn a_border_takes_the_normal_of_the_wall() {
        let (x, z) = ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
        assert_eq!(normals(["cap_isthmus", "inner_wall"]), [x, z, x, x, z]);
        assert_eq!(normals(["outer_wall", "cap_isthmus"]), [z, z, z, x, z]);
        // Without a wall, the normals are weighted by the areas 1 and 1.5.
        let mixed = [1.5 / 3.25_f64.sqrt(), 0.0, 1.0 / 3.25_f64.sqrt()].map(|x| x as f32);
        assert_eq!(normals(["a", "b"]), [mixed, z, mixed, x, z]);
        assert_eq!(normals(["a", "b"]), normals(["wall", "wall"]));
    }

    #[test]
    fn a_triangle_without_area_has_no_normal() {
        assert_eq!(of_triangle([[1., 2., 3.], [2., 3., 4.], [3., 4., 5.]]), [0.0; 3]);
        assert_eq!(of_triangle([[0., 0., 0.], [1e-20, 0., 0.], [0., 1e-20, 0.]]), [0.0, 0.0, 1.0]);
        assert_eq!(of_triangle([[f32::NAN; 3]; 3]), [0.0; 3]);
    }
}
