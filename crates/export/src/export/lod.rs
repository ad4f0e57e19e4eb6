//! Levels of detail for viewers: three GLB files with all, about 300,000 and about 60,000 triangles.
//!
//! Each has the nodes, names and materials of [`glb`](super::glb). Positions are rounded to a grid and normals to 16 bits
//! (`KHR_mesh_quantization`), and all data are compressed (`EXT_meshopt_compression`); a viewer must support both. Merging
//! equal positions gives a closed surface with the Euler number of the body, as in the full file. It is not certified: walls
//! that nearly touch may pass through each other by less than the level's distance.
//!
//! The bytes do not depend on the number of threads or on vector units. Simplification compares errors computed in f32, so
//! that they are the same on all machines only if the C++ compiler does not contract products and sums; `.cargo/config.toml`
//! asks for that.

mod encode;
mod full;
mod grid;
mod mend;
mod simplify;

pub(in crate::export) use encode::{COMPRESSION, Compression, Mode, VECTOR_BYTES};
pub(in crate::export) use grid::Grid;

use super::Metadata;
use crate::geometry::distance::Triangles;
use crate::model::{Mesh, Patch};
use encode::Encoded;
use full::{Full, Level as Triangulation, number};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::Map;
use simplify::coarser;
use std::borrow::Cow;
use std::io::{self, Write};

/// Maximum number of triangles of the simplified levels of detail, the finer level first.
pub const LEVEL_TRIANGLES: [usize; 2] = [300_000, 60_000];

/// Names of the files, the finest level first.
pub const FILES: [&str; 3] = ["model.lod0.glb", "model.lod1.glb", "model.lod2.glb"];

/// What is known of a level; carried in its file and in the report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LevelReport {
    /// Name of the file.
    pub file: &'static str,
    /// Vertices of the closed surface; those that patches share are counted once.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Step of the grid along x, y and z, micrometres: the precision of positions.
    pub precision_um: [f64; 3],
    /// Largest distance measured between the level and the full surface, patch by patch and in both directions, micrometres;
    /// see [`levels`].
    pub distance_um: f64,
}

/// A level, ready to be written.
pub struct Level {
    /// What is known of it.
    pub report: LevelReport,
    encoded: Encoded,
}

impl Level {
    /// Writes the level as GLB.
    ///
    /// # Errors
    /// Those of `out`; [`io::ErrorKind::InvalidInput`] if the file would exceed 4 GiB.
    pub fn write(&self, meta: &Metadata, out: &mut impl Write) -> io::Result<()> {
        let more = Map::from_iter([("level".to_owned(), serde_json::to_value(&self.report)?)]);
        self.encoded.write(meta, more, out)
    }
}

/// Makes the levels of a closed surface, whose walls have no vertices in common, the finest first.
///
/// A level has no more triangles than asked for, except that the vertices of borders and the ends of the tube stay; one that
/// would have more than the finer level has the triangles of that.
///
/// The distance of a patch that has all of its triangles is that of the vertex that rounding moves farthest, which no point
/// of a triangle exceeds. That of a simplified patch is measured from all vertices of the full surface to the level, and from
/// the edge midpoints and centroids of the level to the full surface; it is at least that of the farthest moved vertex.
///
/// `stop` is asked between steps, whether to give up.
///
/// # Errors
/// [`io::ErrorKind::InvalidInput`] if the mesh has no triangles; [`io::ErrorKind::Interrupted`] if it was stopped.
///
/// # Panics
/// If the mesh's indices or patch ranges are out of bounds.
pub fn levels(mesh: &Mesh, stop: &(dyn Fn() -> bool + Sync)) -> io::Result<Vec<Level>> {
    if mesh.triangles.is_empty() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "the mesh has no triangles"));
    }
    levels_of(mesh, LEVEL_TRIANGLES, stop).ok_or_else(|| io::ErrorKind::Interrupted.into())
}

/// The surface of a simplified level with about `target` triangles, not rounded, and which vertices of the full one it has.
///
/// # Panics
/// As [`levels`].
#[must_use]
pub fn reduced(mesh: &Mesh, target: usize) -> (Mesh, Vec<u32>) {
    let full = Full::new(mesh);
    let level = coarser(&full, &full.level(), target);
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

/// The levels, unless it was stopped.
fn levels_of<'a>(mesh: &'a Mesh, targets: [usize; 2], stop: &(dyn Fn() -> bool + Sync)) -> Option<Vec<Level>> {
    let full = Full::new(mesh);
    let all = full.level();
    let level = |n: usize, triangles: &Triangulation<'_>| {
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
    let coarser = |finer: &Triangulation<'a>, target| (!stop()).then(|| coarser(&full, finer, target));
    let one = coarser(&all, targets[0])?;
    let (second, third) = rayon::join(|| level(1, &one), || level(2, &coarser(&one, targets[1])?));
    drop(one);
    // The finest is the last one, since it takes the most memory.
    Some(vec![level(0, &all)?, second?, third?])
}

/// Metres as micrometres, rounded up to a tenth of a nanometre.
fn micrometres(metres: f64) -> f64 {
    (metres * 1e10).ceil() / 1e4
}

/// Largest distance between a level and the full surface, metres.
fn distance(full: &Full<'_>, level: &Triangulation<'_>) -> f64 {
    let of_patch = |(patch, triangles): (&&Patch, &Cow<'_, [[u32; 3]]>)| {
        let source = &full.mesh.triangles[patch.triangles.clone()];
        let vertices = vertices(source, full.cells.len());
        let moved = moved(full, &vertices);
        if triangles.len() == source.len() { moved } else { moved.max(simplified(full, source, &vertices, triangles)) }
    };
    full.patches.iter().zip(level).map(of_patch).fold(0.0, f64::max)
}

/// The vertices of triangles, which are less than `count`, in ascending order.
fn vertices(triangles: &[[u32; 3]], count: usize) -> Vec<u32> {
    let mut is_used = vec![false; count];
    triangles.as_flattened().iter().for_each(|&v| is_used[v as usize] = true);
    (0..count as u32).filter(|&v| is_used[v as usize]).collect()
}

/// Largest distance by which rounding moves one of the vertices.
fn moved(full: &Full<'_>, vertices: &[u32]) -> f64 {
    let square = |&v: &u32| -> f64 {
        let (p, q) = (full.mesh.positions[v as usize], full.placed(v));
        (0..3).map(|axis| (f64::from(p[axis]) - f64::from(q[axis])).powi(2)).sum()
    };
    vertices.par_iter().map(square).reduce(|| 0.0, f64::max).sqrt()
}

/// Largest distance between the samples of a patch, which has the triangles `source` and these vertices, and its simplification, both
/// ways.
fn simplified(full: &Full<'_>, source: &[[u32; 3]], vertices: &[u32], triangles: &[[u32; 3]]) -> f64 {
    let position = |v: u32| full.mesh.positions[v as usize].map(f64::from);
    let corners = |i: usize| triangles[i].map(|v| full.placed(v).map(f64::from));
    let there = Triangles::new(triangles.len(), corners)
        .farthest(vertices.len(), |i: usize, visit: &mut dyn FnMut([f64; 3])| visit(position(vertices[i])));
    let sample = |i: usize, visit: &mut dyn FnMut([f64; 3])| {
        let [a, b, c] = corners(i);
        let mean = |points: &[[f64; 3]]| -> [f64; 3] {
            std::array::from_fn(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / points.len() as f64)
        };
        visit(mean(&[a, b, c]));
        let [u, v, w] = triangles[i];
        // Two triangles have an edge within a patch, in opposite directions. An edge of a border is one of the full surface.
        for (from, to, ends) in [(u, v, [a, b]), (v, w, [b, c]), (w, u, [c, a])] {
            if from < to {
                visit(mean(&ends));
            }
        }
    };
    // The vertices of the level are vertices of the full surface.
    let back = Triangles::new(source.len(), |i| source[i].map(position)).farthest(triangles.len(), sample);
    there.max(back)
}

#[cfg(test)]
mod tests;
