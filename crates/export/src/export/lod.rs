//! Levels of detail for viewers: three GLB files with all, about 300,000 and about 60,000
//! triangles.
//!
//! Each level has the nodes, names and materials of [`glb`](super::glb). Positions are rounded to a
//! grid and normals to 16 bits (`KHR_mesh_quantization`), and all data are compressed
//! (`EXT_meshopt_compression`). A viewer must support both extensions. Merging equal positions
//! results in a closed surface with the Euler number of the body. This surface is not certified:
//! walls with a small gap may intersect by less than the level's distance.
//!
//! The bytes do not depend on the number of threads or on vector units. Simplification compares
//! errors computed in f32. They are equal on all machines only if the C++ compiler does not
//! contract products and sums, which `.cargo/config.toml` therefore disables.

mod encode;
mod full;
mod grid;
mod mend;
mod simplify;

use super::Metadata;
use crate::geometry::distance::Triangles;
use crate::model::{Mesh, Patch};
use encode::Encoded;
use full::{FullSurface, PatchTriangles, number};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::Map;
use simplify::coarser;
use std::borrow::Cow;
use std::io::{self, Write};

/// Maximum number of triangles of the simplified levels of detail, the finer level first.
pub const LEVEL_TRIANGLES: [usize; 2] = [300_000, 60_000];

/// File names, the finest level first.
pub const FILES: [&str; 3] = ["model.lod0.glb", "model.lod1.glb", "model.lod2.glb"];

/// A level of detail.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema), schema(as = DetailLevel))]
pub struct LevelReport {
    /// Name of the file.
    pub file: &'static str,
    /// Number of vertices. Vertices that patches share count once.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub vertices: usize,
    /// Number of triangles.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub triangles: usize,
    /// Step of the grid to which positions are rounded, along x, y and z, micrometres.
    pub precision_um: [f64; 3],
    /// Maximum measured distance between the level and the full surface, in both directions,
    /// micrometres.
    pub distance_um: f64,
}

/// A level that is ready to be written.
pub struct Level {
    /// Description of the level.
    pub report: LevelReport,
    encoded: Encoded,
}

impl Level {
    /// Writes the level as GLB.
    ///
    /// # Errors
    /// Returns any error of writing to `out`, and [`io::ErrorKind::InvalidInput`] if the file would
    /// exceed 4 GiB.
    pub fn write(&self, meta: &Metadata, out: &mut impl Write) -> io::Result<()> {
        let more = Map::from_iter([("level".to_owned(), serde_json::to_value(&self.report)?)]);
        self.encoded.write(meta, more, out)
    }
}

/// Computes the levels of a closed surface whose walls have no common vertices, the finest first.
///
/// A level has at most the target number of triangles, except that vertices of borders and the ends
/// of the tube are kept. A level that would have more triangles than the finer level has the
/// triangles of the finer level.
///
/// The distance of a level is the maximum over its patches:
///
/// - For a patch with all triangles, the maximum distance by which rounding moves a vertex. This
///   bounds the distance of all points of its triangles.
/// - For a simplified patch, the maximum distance from the vertices of the full surface to the
///   level, and from the edge midpoints and centroids of the level to the full surface. It is at
///   least the maximum distance by which rounding moves a vertex.
///
/// Calls `stop` between steps and gives up if it returns true.
///
/// # Errors
/// [`io::ErrorKind::InvalidInput`] if the mesh has no triangles, [`io::ErrorKind::Interrupted`] if
/// it was stopped.
///
/// # Panics
/// If the mesh's indices or patch ranges are out of bounds.
pub fn levels(mesh: &Mesh, stop: &(dyn Fn() -> bool + Sync)) -> io::Result<Vec<Level>> {
    if mesh.triangles.is_empty() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "the mesh has no triangles"));
    }
    levels_of(mesh, LEVEL_TRIANGLES, stop).ok_or_else(|| io::ErrorKind::Interrupted.into())
}

/// Simplifies a surface to about `target` triangles without rounding. Also returns the vertices of
/// `mesh` that remain.
///
/// # Panics
/// As [`levels`].
#[must_use]
pub fn reduced(mesh: &Mesh, target: usize) -> (Mesh, Vec<u32>) {
    let full = FullSurface::new(mesh);
    let level = coarser(&full, &full.triangles(), target);
    let mut patches = Vec::new();
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for (patch, own) in full.patches.iter().zip(&level) {
        let from = triangles.len();
        triangles.extend_from_slice(own);
        patches.push(Patch { kind: patch.kind, triangles: from..triangles.len() });
    }
    let kept = number(triangles.as_flattened_mut());
    let positions = kept.iter().map(|&v| mesh.positions[v as usize]).collect();
    (Mesh { body: mesh.body, positions, triangles, patches }, kept)
}

/// Computes the levels; `None` if it was stopped.
fn levels_of<'a>(mesh: &'a Mesh, targets: [usize; 2], stop: &(dyn Fn() -> bool + Sync)) -> Option<Vec<Level>> {
    let full = FullSurface::new(mesh);
    let all = full.triangles();
    let level = |n: usize, triangles: &PatchTriangles<'_>| {
        if stop() {
            return None;
        }
        let (encoded, distance) = rayon::join(|| Encoded::new(&full, triangles), || distance(&full, triangles));
        let report = LevelReport {
            file: FILES[n],
            vertices: encoded.vertices,
            triangles: encoded.triangles,
            precision_um: full.grid.step.map(|step| micrometres(f64::from(step))),
            distance_um: micrometres(distance),
        };
        Some(Level { report, encoded })
    };
    let coarser = |finer: &PatchTriangles<'a>, target| (!stop()).then(|| coarser(&full, finer, target));
    let one = coarser(&all, targets[0])?;
    let (second, third) = rayon::join(|| level(1, &one), || level(2, &coarser(&one, targets[1])?));
    drop(one);
    // The finest level comes last, because it takes the most memory.
    Some(vec![level(0, &all)?, second?, third?])
}

/// Metres as micrometres, rounded up to a tenth of a nanometre.
fn micrometres(metres: f64) -> f64 {
    (metres * 1e10).ceil() / 1e4
}

/// Maximum distance between a level and the full surface, metres.
fn distance(full: &FullSurface<'_>, level: &PatchTriangles<'_>) -> f64 {
    let of_patch = |(patch, triangles): (&&Patch, &Cow<'_, [[u32; 3]]>)| {
        let source = &full.mesh.triangles[patch.triangles.clone()];
        let vertices = vertices(source, full.cells.len());
        let moved = moved(full, &vertices);
        if triangles.len() == source.len() { moved } else { simplified(full, source, vertices, triangles, moved) }
    };
    full.patches.iter().zip(level).map(of_patch).fold(0.0, f64::max)
}

/// Vertices of triangles, all below `count`, in ascending order.
fn vertices(triangles: &[[u32; 3]], count: usize) -> Vec<u32> {
    let mut is_used = vec![false; count];
    triangles.as_flattened().iter().for_each(|&v| is_used[v as usize] = true);
    (0..count as u32).filter(|&v| is_used[v as usize]).collect()
}

/// Maximum distance by which rounding moves one of the vertices, metres.
fn moved(full: &FullSurface<'_>, vertices: &[u32]) -> f64 {
    let square = |&v: &u32| -> f64 {
        let (p, q) = (full.mesh.positions[v as usize], full.placed(v));
        (0..3).map(|axis| (f64::from(p[axis]) - f64::from(q[axis])).powi(2)).sum()
    };
    vertices.par_iter().map(square).reduce(|| 0.0, f64::max).sqrt()
}

/// Maximum distance between samples of a patch and its simplification in both directions, metres.
/// The patch has the triangles `source` and the given vertices, which rounding moves by at most
/// `moved`.
fn simplified(
    full: &FullSurface<'_>,
    source: &[[u32; 3]],
    mut vertices: Vec<u32>,
    triangles: &[[u32; 3]],
    moved: f64,
) -> f64 {
    let mut is_kept = vec![false; full.cells.len()];
    triangles.as_flattened().iter().for_each(|&v| is_kept[v as usize] = true);
    vertices.retain(|&v| !is_kept[v as usize]);
    drop(is_kept);
    let wide = |[x, y, z]: [f32; 3]| [f64::from(x), f64::from(y), f64::from(z)];
    let position = |v: u32| wide(full.mesh.positions[v as usize]);
    let placed = |v: u32| wide(full.placed(v));
    let corners = |i: usize| {
        let [a, b, c] = triangles[i];
        [placed(a), placed(b), placed(c)]
    };
    let source_corners = |i: usize| {
        let [a, b, c] = source[i];
        [position(a), position(b), position(c)]
    };
    let there = Triangles::new(triangles.len(), corners).farthest(
        moved,
        vertices.len(),
        |i: usize, visit: &mut dyn FnMut([f64; 3])| visit(position(vertices[i])),
    );
    let sample = |i: usize, visit: &mut dyn FnMut([f64; 3])| {
        let [a, b, c] = corners(i);
        let mean = |points: &[[f64; 3]]| -> [f64; 3] {
            std::array::from_fn(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / points.len() as f64)
        };
        visit(mean(&[a, b, c]));
        let [u, v, w] = triangles[i];
        // Two triangles share an inner edge in opposite directions. Border edges belong to the full
        // surface.
        for (from, to, ends) in [(u, v, [a, b]), (v, w, [b, c]), (w, u, [c, a])] {
            if from < to {
                visit(mean(&ends));
            }
        }
    };
    // The vertices of the level need no test, because they are vertices of the full surface.
    Triangles::new(source.len(), source_corners).farthest(there, triangles.len(), sample)
}

#[cfg(test)]
mod tests;
