//! Part of a surface, with all vertices of the surface.

use crate::model::{Mesh, Patch, PatchKind};

/// Selects the triangles of a mesh for which `keep` returns true. Its arguments are the patch and
/// the corners in metres. Patches without triangles are omitted.
///
/// # Panics
/// If the mesh's indices or patch ranges are out of bounds.
#[must_use]
pub fn piece(mesh: &Mesh, keep: impl Fn(PatchKind, [[f32; 3]; 3]) -> bool) -> Mesh {
    let (mut triangles, mut patches) = (Vec::new(), Vec::new());
    for patch in &mesh.patches {
        let from = triangles.len();
        let all = mesh.triangles[patch.triangles.clone()].iter();
        triangles.extend(all.filter(|t| keep(patch.kind, t.map(|v| mesh.positions[v as usize]))));
        if from < triangles.len() {
            patches.push(Patch { kind: patch.kind, triangles: from..triangles.len() });
        }
    }
    Mesh { body: mesh.body, positions: mesh.positions.clone(), triangles, patches }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample;

    #[test]
    fn a_cap_is_a_ring_of_triangles() {
        let tube = sample::tube(24, 2, 0.3);
        let cap = piece(&tube, |kind, _| kind == PatchKind::CapIsthmus);
        assert_eq!((cap.triangles.len(), cap.patches.len()), (48, 1));
        assert_eq!(cap.patches[0], Patch { kind: PatchKind::CapIsthmus, triangles: 0..48 });
        // Two rings of 24 edges, and 48 edges between them.
        assert_eq!(super::super::edge_count(&cap), 4 * 24);
        let near = piece(&tube, |_, corners| corners.iter().all(|p| p[2] < 2.5e-3));
        assert_eq!(
            near.patches.iter().map(|p| p.kind).collect::<Vec<_>>().len(),
            3,
            "one of two slabs, one of two caps"
        );
        assert!(piece(&tube, |_, _| false).patches.is_empty());
    }
}
