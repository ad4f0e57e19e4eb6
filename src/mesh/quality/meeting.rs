//! All pairs of triangles that have points in common other than shared vertices and edges; exact.

use crate::geometry::bvh::{Bounds, Bvh};
use crate::geometry::tri_tri::{Triangle, meet, meet_beyond_corner, overlap_across_edge};
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
                if in_contact([mesh.triangles[i], mesh.triangles[j]], [corners(i), corners(j)]) {
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

fn in_contact([s, t]: [[u32; 3]; 2], corners: [[[f64; 3]; 3]; 2]) -> bool {
    let [a, b] = corners.map(Triangle::new);
    let shared: Vec<(usize, usize)> =
        (0..3).filter_map(|i| t.iter().position(|&v| v == s[i]).map(|j| (i, j))).collect();
    match shared[..] {
        [] => meet(&a, &b),
        [(i, j)] => meet_beyond_corner(&a, i, &b, j),
        [(i, j), (k, l)] => overlap_across_edge(&a, 3 - i - k, &b, 3 - j - l),
        _ => true,
    }
}
