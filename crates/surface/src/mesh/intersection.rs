//! Finds all pairs of triangles that intersect outside their shared vertices and edges. All
//! decisions use exact predicates.

use crate::geometry::bvh::{self, Bvh, Points, WIDTH, lanes};
use crate::geometry::coarse::{Coarse, Window};
use crate::geometry::tri_tri::{Triangle, meet_in_mesh};
use crate::model::Mesh;
use rayon::prelude::*;

/// Returns all intersecting pairs of a mesh.
pub(super) fn all_pairs(mesh: &Mesh) -> Vec<[u32; 2]> {
    IntersectionSearch::new(mesh).all_pairs(mesh)
}

/// Search among the triangles of a mesh. Pairs are sorted. A triangle without area counts as
/// intersecting itself.
pub(super) struct IntersectionSearch {
    is_flat: Vec<bool>,
    coarse: Coarse,
}

impl IntersectionSearch {
    pub(super) fn new(mesh: &Mesh) -> Self {
        let is_flat: Vec<bool> = (0..mesh.triangles.len())
            .into_par_iter()
            .map(|t| Triangle::new(corners(mesh, t)).is_degenerate())
            .collect();
        Self { coarse: Coarse::of_hulls(is_flat.len(), |some, of| points(mesh, &is_flat, some, of)), is_flat }
    }

    /// Updates the search after the corners of some triangles moved.
    pub(super) fn update(&mut self, mesh: &Mesh, is_moved: impl Fn(usize) -> bool) {
        let moved: Vec<u32> = (0..mesh.triangles.len() as u32).filter(|&t| is_moved(t as usize)).collect();
        for &t in &moved {
            self.is_flat[t as usize] = Triangle::new(corners(mesh, t as usize)).is_degenerate();
        }
        self.coarse.update(&moved, |some, of| points(mesh, &self.is_flat, some, of));
    }

    /// Returns all intersecting pairs.
    pub(super) fn all_pairs(&self, mesh: &Mesh) -> Vec<[u32; 2]> {
        self.pairs_touching(mesh, |_| true)
    }

    /// Returns the intersecting pairs that contain at least one of the marked triangles.
    pub(super) fn pairs_touching(&self, mesh: &Mesh, is_marked: impl Fn(usize) -> bool + Sync) -> Vec<[u32; 2]> {
        let count = mesh.triangles.len();
        let mut blocks: Vec<u32> = (0..count.div_ceil(WIDTH) as u32).collect();
        blocks.retain(|&block| {
            let first = block as usize * WIDTH;
            (first..count.min(first + WIDTH)).any(&is_marked)
        });
        let mut pairs = Vec::new();
        let mut tree = Bvh::default();
        for Window { items, own } in self.coarse.windows_over(blocks) {
            let triangle = |item: usize| items[item] as usize;
            let is_flat = |t: &&u32| self.is_flat[**t as usize] && is_marked(**t as usize);
            pairs.extend(items[..own].iter().filter(is_flat).map(|&t| [t; 2]));
            tree = Bvh::of_hulls(tree, items.len(), |some, of| points(mesh, &self.is_flat, some.map(triangle), of));
            pairs.par_extend((0..own.div_ceil(tree.part_len())).into_par_iter().flat_map_iter(|part| {
                let mut found = Vec::new();
                tree.pairs_by_block(
                    part,
                    #[inline(always)]
                    |i, block, others| {
                        // The last part may contain items that are not the window's own.
                        if i >= own {
                            return;
                        }
                        let i = triangle(i);
                        let (a, ta) = (Triangle::new(corners(mesh, i)), mesh.triangles[i]);
                        lanes(others, |lane| {
                            let j = triangle(block * WIDTH + lane);
                            let (points, tb) = (corners(mesh, j), mesh.triangles[j]);
                            if !(is_marked(i) || is_marked(j)) || a.clears_in_mesh(ta, points, tb) {
                                return;
                            }
                            let b = Triangle::new(points);
                            if !b.clears_in_mesh(tb, a.points, ta) && meet_in_mesh((&a, ta), (&b, tb)) {
                                found.push([i.min(j) as u32, i.max(j) as u32]);
                            }
                        });
                    },
                );
                found
            }));
        }
        pairs.sort_unstable();
        pairs
    }
}

/// Centre of the six corners of two triangles at the positions that `place` returns.
pub(super) fn middle_of(mesh: &Mesh, pair: [u32; 2], place: impl Fn(u32) -> [f64; 3]) -> [f64; 3] {
    let corners = pair.map(|t| mesh.triangles[t as usize]);
    let mut middle = [0.0; 3];
    for p in corners.as_flattened().iter().map(|&v| place(v)) {
        (0..3).for_each(|axis| middle[axis] += p[axis] / 6.0);
    }
    middle
}

/// Stores the corners of up to eight triangles; triangles without area have none.
#[inline(always)]
fn points(mesh: &Mesh, is_flat: &[bool], triangles: impl Iterator<Item = usize>, points: &mut Points<3>) {
    bvh::points(triangles.map(|t| if is_flat[t] { [[f64::NAN; 3]; 3] } else { corners(mesh, t) }), points);
}

#[inline(always)]
fn corners(mesh: &Mesh, t: usize) -> [[f64; 3]; 3] {
    mesh.triangles[t].map(|v| mesh.positions[v as usize].map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::lean::tests::pressed;
    use crate::model::BodyKind;

    #[test]
    fn a_triangle_without_area_intersects_itself_alone() {
        // Vertices 1 and 2 coincide, so the triangles that are not flat meet along an edge.
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let triangles = vec![[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 4]];
        let mesh = Mesh { body: BodyKind::Tissue, positions, triangles, patches: Vec::new() };
        let search = IntersectionSearch::new(&mesh);
        assert_eq!(search.all_pairs(&mesh), [[0, 0], [1, 3], [2, 2]]);
        assert_eq!(search.pairs_touching(&mesh, |_| true), [[0, 0], [1, 3], [2, 2]]);
        assert_eq!(search.pairs_touching(&mesh, |t| t == 0), [[0, 0]]);
    }

    #[test]
    fn pairs_are_those_of_an_exact_test_of_all_neighbours() {
        let (mesh, ..) = pressed();
        let search = IntersectionSearch::new(&mesh);
        let all = search.all_pairs(&mesh);
        let found: Vec<_> = (0..all.len() / 50).map(|k| all[50 * k]).collect();
        assert!(found.len() > 3, "too few pairs to test: {}", all.len());
        let triangle = |t: usize| Triangle::new(corners(&mesh, t));
        for t in found.iter().map(|pair| pair[0] as usize) {
            let others = (0..mesh.triangles.len()).filter(|&other| other != t);
            let exact: Vec<[u32; 2]> = others
                .filter(|&j| meet_in_mesh((&triangle(t), mesh.triangles[t]), (&triangle(j), mesh.triangles[j])))
                .map(|j| [t.min(j) as u32, t.max(j) as u32])
                .collect();
            assert_eq!(search.pairs_touching(&mesh, |other| other == t), exact);
            let touching: Vec<_> = all.iter().copied().filter(|pair| pair.contains(&(t as u32))).collect();
            assert_eq!(touching, exact);
        }
    }
}
