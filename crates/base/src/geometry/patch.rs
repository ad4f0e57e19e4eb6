//! A patch of a mesh as a separate surface: its vertices, local triangle indices and smooth
//! normals.
//!
//! In a [`Mesh`], patches share the vertices of their borders, but each patch is shaded separately
//! because caps and walls join at sharp edges. File formats with normals therefore need separate
//! patches. Normals are computed with additions, multiplications and square roots in a fixed order,
//! so every machine computes the same bits.

use super::vector::{cross, norm, sub};
use crate::model::{Mesh, Patch};

/// A patch with its own vertices.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PatchGeometry {
    /// Index into [`Mesh::positions`] of each vertex, in the order of first use.
    pub vertices: Vec<u32>,
    /// Unit normal of each vertex, pointing out of the body.
    pub normals: Vec<[f32; 3]>,
    /// Triangles as indices into `vertices`, in the order and orientation of the mesh.
    pub triangles: Vec<[u32; 3]>,
}

/// Extracts a patch from a mesh.
///
/// A normal is the mean of the normals of the patch's triangles around the vertex, weighted by
/// area. If they cancel out, which happens only around degenerate triangles, the normal is the z
/// axis.
///
/// # Panics
/// Panics if the patch belongs to another mesh, so that a range or an index is out of bounds.
#[must_use]
pub fn patch_geometry(mesh: &Mesh, patch: &Patch) -> PatchGeometry {
    part_geometry(&mesh.positions, &mesh.triangles[patch.triangles.clone()])
}

/// Extracts triangles from a surface, like [`patch_geometry`].
///
/// # Panics
/// Panics if an index is out of bounds.
#[must_use]
pub fn part_geometry(positions: &[[f32; 3]], source: &[[u32; 3]]) -> PatchGeometry {
    // A surface has about half as many vertices as triangles.
    let expected = positions.len().min(source.len() / 2 + source.len() / 16 + 3);
    let mut numbering = Numbering::default();
    numbering.advance(0, positions.len());
    let mut vertices = Vec::with_capacity(expected);
    let mut sums: Vec<[f64; 3]> = Vec::with_capacity(expected);
    let mut triangles = Vec::with_capacity(source.len());
    for triangle in source {
        let normal = doubled_area_normal(triangle.map(|v| positions[v as usize]));
        let local = triangle.map(|v| {
            let (local, is_new) = numbering.number(v);
            if is_new {
                vertices.push(v);
                sums.push([0.0; 3]);
            }
            add(&mut sums[local as usize], normal);
            local
        });
        triangles.push(local);
    }
    let normals = sums.into_iter().map(unit).collect();
    PatchGeometry { vertices, normals, triangles }
}

/// Numbers the vertices of a patch in the order of their first use.
#[derive(Debug, Default)]
pub struct Numbering {
    /// Vertices before this one are no longer used.
    first: u32,
    /// Number of each vertex, beginning with vertex `first`, or [`Self::UNUSED`].
    numbers: Vec<u32>,
    count: u32,
}

impl Numbering {
    const UNUSED: u32 = u32::MAX;

    /// Declares that `count` vertices, beginning with `first`, may be used next. `first` must not
    /// decrease.
    pub fn advance(&mut self, first: u32, count: usize) {
        let done = (first - self.first) as usize;
        self.numbers.drain(..done.min(self.numbers.len()));
        self.numbers.resize(self.numbers.len().max(count), Self::UNUSED);
        self.first = first;
    }

    /// Returns the number of a vertex, and true if this is its first use.
    #[inline]
    pub fn number(&mut self, vertex: u32) -> (u32, bool) {
        let number = &mut self.numbers[(vertex - self.first) as usize];
        let is_new = *number == Self::UNUSED;
        if is_new {
            *number = self.count;
            self.count += 1;
        }
        (*number, is_new)
    }

    /// Number of numbered vertices.
    pub fn count(&self) -> u32 {
        self.count
    }
}

/// Adds `part` to `sum`.
#[inline]
pub fn add(sum: &mut [f64; 3], part: [f64; 3]) {
    for (sum, part) in sum.iter_mut().zip(part) {
        *sum += part;
    }
}

/// Normal of a triangle, with twice the area as its length.
pub fn doubled_area_normal(corners: [[f32; 3]; 3]) -> [f64; 3] {
    let [a, b, c] = corners.map(|p| p.map(f64::from));
    cross(sub(b, a), sub(c, a))
}

/// `v` scaled to length 1, or the z axis if `v` is zero.
pub fn unit(v: [f64; 3]) -> [f32; 3] {
    let length = norm(v);
    if length.is_normal() { v.map(|x| (x / length) as f32) } else { [0.0, 0.0, 1.0] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{BodyKind, PatchKind};
    use proptest::prelude::*;

    fn mesh(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>, split: usize) -> Mesh {
        let patches = vec![
            Patch { kind: PatchKind::InnerWall, triangles: 0..split },
            Patch { kind: PatchKind::OuterWall, triangles: split..triangles.len() },
        ];
        Mesh { body: BodyKind::Tissue, positions, triangles, patches }
    }

    #[test]
    fn border_vertices_are_split_and_shaded_apart() {
        let positions = vec![[0.0; 3], [1e-5, 0.0, 0.0], [0.0, 1e-5, 0.0], [0.0, 0.0, 1e-5]];
        let mesh = mesh(positions, vec![[0, 1, 2], [3, 1, 0]], 1);
        let first = patch_geometry(&mesh, &mesh.patches[0]);
        let second = patch_geometry(&mesh, &mesh.patches[1]);
        assert_eq!(first.normals, vec![[0.0, 0.0, 1.0]; 3]);
        assert_eq!(second.vertices, vec![3, 1, 0]);
        assert_eq!(second.triangles, vec![[0, 1, 2]]);
        assert_eq!(second.normals, vec![[0.0, 1.0, 0.0]; 3]);
    }

    #[test]
    fn the_larger_triangle_weighs_more() {
        let positions = vec![[0.0; 3], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]];
        let mesh = mesh(positions, vec![[0, 1, 2], [0, 3, 4]], 2);
        let normal = patch_geometry(&mesh, &mesh.patches[0]).normals[0];
        let scale = 17f32.sqrt();
        for (found, expected) in normal.iter().zip([0.0, 1.0 / scale, 4.0 / scale]) {
            assert!((found - expected).abs() < 1e-6, "{normal:?}");
        }
    }

    #[test]
    fn numbers_go_on_where_vertices_are_dropped() {
        let mut numbering = Numbering::default();
        numbering.advance(0, 3);
        assert_eq!([2, 0, 2].map(|v| numbering.number(v)), [(0, true), (1, true), (0, false)]);
        numbering.advance(2, 2);
        assert_eq!([3, 2].map(|v| numbering.number(v)), [(2, true), (0, false)]);
        numbering.advance(9, 2);
        assert_eq!([9, 10].map(|v| numbering.number(v)), [(3, true), (4, true)]);
        assert_eq!(numbering.count(), 5);
    }

    proptest! {
        #[test]
        fn normals_are_unit_and_triangles_map_back(
            positions in prop::collection::vec(prop::array::uniform3(-1e-3f32..1e-3), 3..20),
            corners in prop::collection::vec(prop::array::uniform3(0u32..1000), 1..40),
        ) {
            let n = positions.len() as u32;
            let triangles: Vec<[u32; 3]> = corners.iter().map(|t| t.map(|v| v % n)).collect();
            let split = triangles.len() / 2;
            let mesh = mesh(positions, triangles, split);
            for patch in &mesh.patches {
                let geometry = patch_geometry(&mesh, patch);
                let back: Vec<[u32; 3]> =
                    geometry.triangles.iter().map(|t| t.map(|v| geometry.vertices[v as usize])).collect();
                prop_assert_eq!(&back[..], &mesh.triangles[patch.triangles.clone()]);
                prop_assert_eq!(geometry.vertices.len(), geometry.normals.len());
                for n in &geometry.normals {
                    let length = n.iter().map(|x| x * x).sum::<f32>().sqrt();
                    prop_assert!((length - 1.0).abs() < 1e-5);
                }
            }
        }
    }
}
