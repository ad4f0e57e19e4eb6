//! One patch of a mesh by itself, as an exporter writes it: its vertices, their normals, its triangles.
//!
//! Invariant: normals are smooth within a patch and know nothing of other patches, so rims stay sharp;
//! every normal has unit length.

use super::predicates::widen3;
use crate::model::{Mesh, Patch};

/// A patch with its own numbering of vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchGeometry {
    /// For each vertex of the patch its index in [`Mesh::positions`], in order of first use.
    pub vertices: Vec<u32>,
    /// Unit normals, one a vertex, pointing out of the body.
    pub normals: Vec<[f32; 3]>,
    /// Triangles as indices into `vertices`, in the order of the mesh.
    pub triangles: Vec<[u32; 3]>,
}

/// Takes a patch out of a mesh, with vertex normals weighted as in N. Max, *Weights for computing vertex
/// normals from facet normals* (1999): each triangle by the sine of its angle at the vertex over the
/// lengths of the two edges there, so that how flat regions are split does not matter.
#[must_use]
pub fn patch_geometry(mesh: &Mesh, patch: &Patch) -> PatchGeometry {
    const UNUSED: u32 = u32::MAX;
    let mut local = vec![UNUSED; mesh.positions.len()];
    let mut vertices = Vec::new();
    let triangles: Vec<[u32; 3]> = mesh.triangles[patch.triangles.clone()]
        .iter()
        .map(|triangle| {
            triangle.map(|vertex| {
                let slot = &mut local[vertex as usize];
                if *slot == UNUSED {
                    *slot = vertices.len() as u32;
                    vertices.push(vertex);
                }
                *slot
            })
        })
        .collect();
    let mut sums = vec![[0.0f64; 3]; vertices.len()];
    for triangle in &triangles {
        let corners = triangle.map(|v| widen3(mesh.positions[vertices[v as usize] as usize]));
        let edges = [0, 1, 2].map(|k| minus(corners[(k + 1) % 3], corners[k]));
        let lengths = edges.map(|e| dot(e, e));
        let normal = cross(edges[0], edges[1]);
        for k in 0..3 {
            let weight = 1.0 / (lengths[k] * lengths[(k + 2) % 3]);
            if weight.is_finite() {
                let sum = &mut sums[triangle[k] as usize];
                for axis in 0..3 {
                    sum[axis] += weight * normal[axis];
                }
            }
        }
    }
    // A vertex whose triangles cancel or have no area gets the direction of the axis.
    let normals = sums.into_iter().map(|sum| unit(sum).unwrap_or([0.0, 0.0, 1.0]).map(|x| x as f32)).collect();
    PatchGeometry { vertices, normals, triangles }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The vector at unit length, unless it is too short to have a direction.
fn unit(a: [f64; 3]) -> Option<[f64; 3]> {
    let length = dot(a, a).sqrt();
    (length > 1e-60).then(|| a.map(|x| x / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{BodyKind, PatchKind};

    /// A unit cube's lower and side faces as two patches.
    fn box_mesh() -> Mesh {
        let positions = (0..8u8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|bit| f32::from(bit) * 1e-6)).collect();
        let side = |a: u32, b: u32| [[a, b, b + 4], [a, b + 4, a + 4]];
        let mut triangles = vec![[0, 2, 1], [1, 2, 3]];
        for (a, b) in [(0, 1), (1, 3), (3, 2), (2, 0)] {
            triangles.extend(side(a, b));
        }
        Mesh {
            body: BodyKind::Lumen,
            positions,
            triangles,
            patches: vec![
                Patch { kind: PatchKind::Inlet, triangles: 0..2 },
                Patch { kind: PatchKind::Wall, triangles: 2..10 },
            ],
        }
    }

    #[test]
    fn rims_stay_sharp_and_walls_smooth() {
        let mesh = box_mesh();
        let inlet = patch_geometry(&mesh, &mesh.patches[0]);
        assert_eq!(inlet.vertices, [0, 2, 1, 3]);
        assert_eq!(inlet.triangles, [[0, 1, 2], [2, 1, 3]]);
        assert!(inlet.normals.iter().all(|&n| n == [0.0, 0.0, -1.0]));
        let wall = patch_geometry(&mesh, &mesh.patches[1]);
        assert_eq!(wall.vertices.len(), 8);
        for (&v, n) in wall.vertices.iter().zip(&wall.normals) {
            let corner = mesh.positions[v as usize];
            assert!(n[2].abs() < 1e-6);
            for axis in 0..2 {
                let outward = if corner[axis] > 0.0 { 1.0 } else { -1.0 };
                assert!((n[axis] - outward * 0.5f32.sqrt()).abs() < 1e-6, "{n:?}");
            }
        }
    }

    #[test]
    fn triangles_without_area_still_give_unit_normals() {
        let mut mesh = box_mesh();
        mesh.positions.fill([1e-3, 2e-3, 3e-3]);
        for patch in &mesh.patches {
            for n in patch_geometry(&mesh, patch).normals {
                assert!((n.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-6);
            }
        }
    }
}
