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
use crate::spec::LEVEL_TRIANGLES;
use encode::Encoded;
use full::{Full, Level as Triangulation, Part};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::Map;
use simplify::coarser;
use std::io::{self, Write};

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

/// Makes the levels of a closed surface, the finest first.
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
    let (mut kept, mut triangles, mut patches) = (Vec::new(), Vec::new(), Vec::new());
    let mut numbers = vec![u32::MAX; mesh.positions.len()];
    for (part, own) in full.parts.iter().zip(&level) {
        let from = triangles.len();
        triangles.extend(own.iter().map(|t| {
            t.map(|corner| {
                let v = full.vertices[corner as usize];
                let number = &mut numbers[v as usize];
                if *number == u32::MAX {
                    *number = kept.len() as u32;
                    kept.push(v);
                }
                *number
            })
        }));
        patches.push(Patch { kind: part.kind, triangles: from..triangles.len() });
    }
    let positions = kept.iter().map(|&v| mesh.positions[v as usize]).collect();
    (Mesh { body: mesh.body, positions, triangles, patches }, kept)
}

/// The levels, unless it was stopped.
fn levels_of(mesh: &Mesh, targets: [usize; 2], stop: &(dyn Fn() -> bool + Sync)) -> Option<Vec<Level>> {
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
    let (first, (second, third)) = rayon::join(
        || level(0, &all),
        || {
            if stop() {
                return (None, None);
            }
            let one = coarser(&full, &all, targets[0]);
            rayon::join(|| level(1, &one), || if stop() { None } else { level(2, &coarser(&full, &one, targets[1])) })
        },
    );
    Some(vec![first?, second?, third?])
}

/// Metres as micrometres, rounded up to a tenth of a nanometre.
fn micrometres(metres: f64) -> f64 {
    (metres * 1e10).ceil() / 1e4
}

/// Largest distance between a level and the full surface, metres.
fn distance(full: &Full<'_>, level: &Triangulation<'_>) -> f64 {
    let of_part = |(part, triangles): (&Part, &std::borrow::Cow<'_, [[u32; 3]]>)| {
        if triangles.len() == part.triangles.len() { moved(full, part) } else { simplified(full, part, triangles) }
    };
    full.parts.par_iter().zip(level).map(of_part).reduce(|| 0.0, f64::max)
}

/// Largest distance by which rounding moves a vertex of a patch.
fn moved(full: &Full<'_>, part: &Part) -> f64 {
    let corners = &full.vertices[part.corners.start as usize..part.corners.end as usize];
    let square = |&v: &u32| -> f64 {
        let (p, q) = (full.mesh.positions[v as usize], full.placed[v as usize]);
        (0..3).map(|axis| (f64::from(p[axis]) - f64::from(q[axis])).powi(2)).sum()
    };
    corners.par_iter().map(square).reduce(|| 0.0, f64::max).sqrt()
}

/// Largest distance between the samples of a patch and its simplification, both ways.
fn simplified(full: &Full<'_>, part: &Part, triangles: &[[u32; 3]]) -> f64 {
    let place = |corner: u32| full.placed[full.vertices[corner as usize] as usize].map(f64::from);
    let corners = |i: usize| triangles[i].map(place);
    let vertices = &full.vertices[part.corners.start as usize..part.corners.end as usize];
    let (there, back) = rayon::join(
        || {
            let sample = |i: usize, visit: &mut dyn FnMut([f64; 3])| {
                visit(full.mesh.positions[vertices[i] as usize].map(f64::from));
            };
            Triangles::new(triangles.len(), corners).farthest(vertices.len(), sample)
        },
        || {
            let sample = |i: usize, visit: &mut dyn FnMut([f64; 3])| {
                let [a, b, c] = corners(i);
                let mean = |points: &[[f64; 3]]| -> [f64; 3] {
                    std::array::from_fn(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / points.len() as f64)
                };
                visit(mean(&[a, b, c]));
                let [u, v, w] = triangles[i];
                // Two triangles have an edge within a patch, in opposite directions. An edge of a border is one of the full
                // surface.
                for (from, to, ends) in [(u, v, [a, b]), (v, w, [b, c]), (w, u, [c, a])] {
                    if from < to {
                        visit(mean(&ends));
                    }
                }
            };
            full.hierarchy(part).farthest(triangles.len(), sample)
        },
    );
    // The vertices of the level are vertices of the full surface.
    there.max(back).max(moved(full, part))
}

#[cfg(test)]
mod tests;
