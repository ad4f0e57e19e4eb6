//! All pairs of triangles that have points in common other than shared vertices and edges; exact.

use crate::geometry::bvh::{Bounds, Bvh};
use crate::geometry::tri_tri::{Triangle, meet_in_mesh};
use crate::model::Mesh;
use rayon::prelude::*;

/// The pairs, in order. A triangle without area counts as meeting itself.
pub(super) fn pairs(mesh: &Mesh) -> Vec<[u32; 2]> {
    let corners = |t: usize| mesh.triangles[t].map(|v| mesh.positions[v as usize].map(f64::from));
    let flat: Vec<bool> =
        (0..mesh.triangles.len()).into_par_iter().map(|t| Triangle::new(corners(t)).is_degenerate()).collect();
    let bvh = Bvh::build(mesh.triangles.len(), |t| if flat[t] { Bounds::EMPTY } else { Bounds::of(corners(t)) });
    let mut pairs: Vec<[u32; 2]> = (0..bvh.blocks())
        .into_par_iter()
        .with_min_len(64)
        .flat_map_iter(|block| {
            let mut found = Vec::new();
            bvh.pairs(block, 0.0, |i, j| {
                let [a, b] = [i, j].map(|t| Triangle::new(corners(t)));
                if meet_in_mesh((&a, mesh.triangles[i]), (&b, mesh.triangles[j])) {
                    found.push([i as u32, j as u32]);
                }
            });
            found
        })
        .collect();
    pairs.extend((0u32..).zip(&flat).filter(|(_, flat)| **flat).map(|(t, _)| [t, t]));
    pairs.sort_unstable();
    pairs
}
