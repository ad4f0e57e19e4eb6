//! All pairs of triangles that have points in common other than shared vertices and edges; exact.

use crate::geometry::bvh::{self, Bounds, Bvh, Points};
use crate::geometry::coarse::{Coarse, Window};
use crate::geometry::tri_tri::{Triangle, meet_in_mesh};
use crate::model::Mesh;
use rayon::prelude::*;

/// All pairs of a mesh.
pub(super) fn pairs(mesh: &Mesh) -> Vec<[u32; 2]> {
    Meeting::new(mesh).pairs(mesh)
}

/// A search among the triangles of a mesh. Pairs are in order; a triangle without area counts as meeting itself.
pub(super) struct Meeting {
    is_flat: Vec<bool>,
    coarse: Coarse,
}

impl Meeting {
    pub(super) fn new(mesh: &Mesh) -> Self {
        let is_flat: Vec<bool> = (0..mesh.triangles.len())
            .into_par_iter()
            .map(|t| Triangle::new(corners(mesh, t)).is_degenerate())
            .collect();
        Self { coarse: Coarse::of_hulls(is_flat.len(), |some, of| points(mesh, &is_flat, some, of)), is_flat }
    }

    /// Takes new places of the corners of some triangles into account; ascending.
    pub(super) fn update(&mut self, mesh: &Mesh, moved: &[u32]) {
        for &t in moved {
            self.is_flat[t as usize] = Triangle::new(corners(mesh, t as usize)).is_degenerate();
        }
        self.coarse.update(moved, |some, of| points(mesh, &self.is_flat, some, of));
    }

    /// All pairs.
    pub(super) fn pairs(&self, mesh: &Mesh) -> Vec<[u32; 2]> {
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

    /// The pairs to which one of `some` triangles belongs; `is_one` tells which these are.
    pub(super) fn pairs_of(&self, mesh: &Mesh, some: &[u32], is_one: &[bool]) -> Vec<[u32; 2]> {
        let mut pairs: Vec<[u32; 2]> = some
            .par_iter()
            .with_min_len(256)
            .flat_map_iter(|&t| {
                let t = t as usize;
                let mut found: Vec<[u32; 2]> = self.flat(t).into_iter().collect();
                let near = Bounds::of(corners(mesh, t));
                self.coarse.overlapping(
                    &near,
                    |some, of| points(mesh, &self.is_flat, some, of),
                    |other| {
                        if other > t || (other < t && !is_one[other]) {
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

/// The corners of up to eight triangles; those without area have none.
#[inline(always)]
fn points(mesh: &Mesh, is_flat: &[bool], triangles: impl Iterator<Item = usize>, points: &mut Points<3>) {
    bvh::points(triangles.map(|t| if is_flat[t] { [[f64::NAN; 3]; 3] } else { corners(mesh, t) }), points);
}

#[inline(always)]
fn corners(mesh: &Mesh, t: usize) -> [[f64; 3]; 3] {
    mesh.triangles[t].map(|v| mesh.positions[v as usize].map(f64::from))
}

/// The pair, if its triangles meet.
fn pair(mesh: &Mesh, i: usize, j: usize) -> Option<[u32; 2]> {
    let [a, b] = [i, j].map(|t| Triangle::new(corners(mesh, t)));
    meet_in_mesh((&a, mesh.triangles[i]), (&b, mesh.triangles[j])).then_some([i as u32, j as u32])
}
