//! Distance between a level and the full surface.

use super::full::FullSurface;
use crate::geometry::distance::Triangles;
use crate::model::Patch;
use rayon::prelude::*;

/// A patch of the full surface.
pub(super) struct Source<'a, F> {
    full: &'a FullSurface<'a>,
    /// Vertices, ascending.
    vertices: Vec<u32>,
    /// Maximum distance by which rounding moves one of them, m.
    moved: f64,
    triangles: Triangles<F>,
    count: usize,
}

/// A patch of the full surface, as it was before rounding.
pub(super) fn source<'a>(
    full: &'a FullSurface<'a>,
    patch: &Patch,
) -> Source<'a, impl Fn(usize) -> [[f64; 3]; 3] + Sync> {
    let triangles = &full.mesh.triangles[patch.triangles.clone()];
    let vertices = vertices(triangles, full.cells.len());
    let corners = |i: usize| {
        let [a, b, c] = triangles[i];
        [full.position(a), full.position(b), full.position(c)]
    };
    let moved = moved(full, &vertices);
    Source { full, vertices, moved, triangles: Triangles::new(triangles.len(), corners), count: triangles.len() }
}

impl<F: Fn(usize) -> [[f64; 3]; 3] + Sync> Source<'_, F> {
    /// Maximum distance between the patch and a level of it, m. If the level has fewer triangles,
    /// every `step`-th vertex and triangle is measured.
    pub(super) fn distance(&self, level: &[[u32; 3]], step: usize) -> f64 {
        if level.len() == self.count { self.moved } else { self.simplified(level, step) }
    }

    /// Maximum distance by which rounding moves a vertex, m.
    pub(super) fn moved(&self) -> f64 {
        self.moved
    }

    fn simplified(&self, level: &[[u32; 3]], step: usize) -> f64 {
        let full = self.full;
        let mut is_kept = vec![false; full.cells.len()];
        level.as_flattened().iter().for_each(|&v| is_kept[v as usize] = true);
        let dropped: Vec<u32> = self.vertices.iter().copied().filter(|&v| !is_kept[v as usize]).step_by(step).collect();
        drop(is_kept);
        let placed = |v: u32| full.placed(v).map(f64::from);
        let corners = |i: usize| {
            let [a, b, c] = level[i];
            [placed(a), placed(b), placed(c)]
        };
        let there = Triangles::new(level.len(), corners).farthest(
            self.moved,
            dropped.len(),
            |i: usize, visit: &mut dyn FnMut([f64; 3])| visit(full.position(dropped[i])),
        );
        let sample = |i: usize, visit: &mut dyn FnMut([f64; 3])| {
            let i = i * step;
            let [a, b, c] = corners(i);
            let mean = |points: &[[f64; 3]]| -> [f64; 3] {
                std::array::from_fn(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / points.len() as f64)
            };
            visit(mean(&[a, b, c]));
            let [u, v, w] = level[i];
            // Two triangles share an inner edge in opposite directions. Border edges belong to the
            // full surface.
            for (from, to, ends) in [(u, v, [a, b]), (v, w, [b, c]), (w, u, [c, a])] {
                if from < to {
                    visit(mean(&ends));
                }
            }
        };
        // The vertices of the level need no test, because they are vertices of the full surface.
        self.triangles.farthest(there, level.len().div_ceil(step), sample)
    }
}

/// Vertices of triangles, all below `count`, in ascending order.
fn vertices(triangles: &[[u32; 3]], count: usize) -> Vec<u32> {
    let mut is_used = vec![false; count];
    triangles.as_flattened().iter().for_each(|&v| is_used[v as usize] = true);
    (0..count as u32).filter(|&v| is_used[v as usize]).collect()
}

/// Maximum distance by which rounding moves one of the vertices, m.
fn moved(full: &FullSurface<'_>, vertices: &[u32]) -> f64 {
    let square = |&v: &u32| -> f64 {
        let (p, q) = (full.position(v), full.placed(v).map(f64::from));
        (0..3).map(|axis| (p[axis] - q[axis]).powi(2)).sum()
    };
    vertices.par_iter().map(square).reduce(|| 0.0, f64::max).sqrt()
}
