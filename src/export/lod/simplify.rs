//! Fewer triangles by collapsing edges, in the order of the error that this makes (Garland and Heckbert 1997; meshoptimizer).
//!
//! Walls are simplified one by one and keep the vertices of their borders; what closes the ends has no others and is kept as
//! it is. So the patches of a level meet as those of the full surface do.

use super::full::{Full, Level};
use super::mend::mend;
use meshopt::{SimplifyOptions, VertexDataAdapter, simplify};
use rayon::prelude::*;
use std::borrow::Cow;

/// The level of about `target` triangles made from a finer one, or a copy of that if it has no more.
///
/// It has more triangles than asked for where collapses would tear the surface. If the result cannot be made a sound surface
/// (see [`mend`]), it is the finer level.
pub(super) fn coarser<'a>(full: &Full<'_>, finer: &Level<'a>, target: usize) -> Level<'a> {
    let is_wall = |part: usize| full.parts[part].kind.is_wall();
    let count = |walls: bool| -> usize {
        finer.iter().enumerate().filter(|(part, _)| is_wall(*part) == walls).map(|(_, t)| t.len()).sum()
    };
    let (walls, ends) = (count(true), count(false));
    // Ends of very many triangles must not leave the walls without any.
    let share = target.saturating_sub(ends).max(target / 2) as f64 / walls as f64;
    if share >= 1.0 {
        return finer.clone();
    }
    let of_part = |part: usize| -> Cow<'a, [[u32; 3]]> {
        if is_wall(part) { collapse(full, part, &finer[part], share).into() } else { finer[part].clone() }
    };
    let mut level: Level<'a> = (0..finer.len()).into_par_iter().map(of_part).collect();
    if mend(&mut level, &full.vertices, full.mesh) {
        return level;
    }
    tracing::warn!(target, "a simplified level is not a sound surface: it has the triangles of the finer one");
    finer.clone()
}

/// A wall with about `share` of its triangles.
fn collapse(full: &Full<'_>, part: usize, triangles: &[[u32; 3]], share: f64) -> Vec<[u32; 3]> {
    let corners = &full.parts[part].corners;
    let vertices = &full.vertices[corners.start as usize..corners.end as usize];
    let points: Vec<[f32; 3]> = vertices.iter().map(|&v| full.mesh.positions[v as usize]).collect();
    let adapter = VertexDataAdapter::new(bytemuck::cast_slice(&points), size_of::<[f32; 3]>(), 0)
        .expect("positions are a whole number of items");
    let indices: Vec<u32> = triangles.as_flattened().iter().map(|corner| corner - corners.start).collect();
    let target = (triangles.len() as f64 * share) as usize * 3;
    let mut options = SimplifyOptions::LockBorder;
    if triangles.len() < full.parts[part].triangles.len() {
        options |= SimplifyOptions::Sparse;
    }
    // The error is not limited: 1 is the extent of the surface.
    let kept = simplify(&indices, &adapter, target, 1.0, options, None);
    let (kept, _) = kept.as_chunks::<3>();
    kept.iter().map(|t| t.map(|local| local + corners.start)).collect()
}
