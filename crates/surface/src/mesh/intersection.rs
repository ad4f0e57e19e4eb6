//! Finds all pairs of triangles that intersect outside their shared vertices and edges. All
//! decisions use exact predicates.

use crate::geometry::bvh::{self, Bounds, Bvh, Points};
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
    pub(super) fn update(&mut self, mesh: &Mesh, is_moved: &[bool]) {
        let moved = numbers(is_moved);
        for &t in &moved {
            self.is_flat[t as usize] = Triangle::new(corners(mesh, t as usize)).is_degenerate();
        }
        self.coarse.update(&moved, |some, of| points(mesh, &self.is_flat, some, of));
    }

    /// Returns all intersecting pairs.
    pub(super) fn all_pairs(&self, mesh: &Mesh) -> Vec<[u32; 2]> {
        let mut pairs: Vec<[u32; 2]> = (0..mesh.triangles.len()).filter_map(|t| self.flat(t)).collect();
        let mut tree = Bvh::default();
        for Window { items, own } in self.coarse.windows() {
            let triangle = |item: usize| items[item] as usize;
            tree = Bvh::of_hulls(tree, items.len(), |some, of| points(mesh, &self.is_flat, some.map(triangle), of));
            pairs.par_extend((0..own.div_ceil(tree.part_len())).into_par_iter().flat_map_iter(|part| {
                let mut found = Vec::new();
                tree.pairs(part, |i, j| {
                    if i < own {
                        found.extend(pair(mesh, triangle(i), triangle(j)));
                    }
                });
                found
            }));
        }
        pairs.sort_unstable();
        pairs
    }

    /// Returns the intersecting pairs that contain at least one of the marked triangles.
    pub(super) fn pairs_touching(&self, mesh: &Mesh, is_marked: &[bool]) -> Vec<[u32; 2]> {
        let mut pairs: Vec<[u32; 2]> = numbers(is_marked)
            .into_par_iter()
            .with_min_len(256)
            .flat_map_iter(|t| {
                let t = t as usize;
                // A triangle without area has no exact test with others.
                if let Some(own) = self.flat(t) {
                    return vec![own];
                }
                let mut found = Vec::new();
                let near = Bounds::of(corners(mesh, t));
                self.coarse.overlapping(
                    &near,
                    |some, of| points(mesh, &self.is_flat, some, of),
                    |other| {
                        if other > t || (other < t && !is_marked[other]) {
                            found.extend(pair(mesh, t.min(other), t.max(other)));
                        }
                    },
                );
                found
            })
            .collect();
        pairs.sort_unstable();
        pairs
    }

    fn flat(&self, t: usize) -> Option<[u32; 2]> {
        self.is_flat[t].then_some([t as u32; 2])
    }
}

/// Indices of the marked triangles.
fn numbers(is_marked: &[bool]) -> Vec<u32> {
    (0u32..).zip(is_marked).filter(|(_, is_marked)| **is_marked).map(|(t, _)| t).collect()
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

/// Returns the pair if its triangles intersect.
fn pair(mesh: &Mesh, i: usize, j: usize) -> Option<[u32; 2]> {
    let [a, b] = [i, j].map(|t| Triangle::new(corners(mesh, t)));
    meet_in_mesh((&a, mesh.triangles[i]), (&b, mesh.triangles[j])).then_some([i as u32, j as u32])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::BodyKind;

    #[test]
    fn a_triangle_without_area_intersects_itself_alone() {
        // Vertices 1 and 2 coincide, so the triangles that are not flat meet along an edge.
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let triangles = vec![[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 4]];
        let mesh = Mesh { body: BodyKind::Tissue, positions, triangles, patches: Vec::new() };
        let search = IntersectionSearch::new(&mesh);
        assert_eq!(search.all_pairs(&mesh), [[0, 0], [1, 3], [2, 2]]);
        assert_eq!(search.pairs_touching(&mesh, &[true; 4]), [[0, 0], [1, 3], [2, 2]]);
        assert_eq!(search.pairs_touching(&mesh, &[true, false, false, false]), [[0, 0]]);
    }
}
