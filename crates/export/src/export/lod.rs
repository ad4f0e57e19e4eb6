//! Levels of detail for viewers: three GLB files with all, about 300,000 and about 60,000
//! triangles.
//!
//! Each level has the nodes, names and materials of [`glb`](super::glb). Positions are rounded to a
//! grid and normals to 16 bits (`KHR_mesh_quantization`), and all data are compressed
//! (`EXT_meshopt_compression`). A viewer must support both extensions. Merging equal positions
//! results in a closed surface with the Euler number of the body. This surface is not certified:
//! walls with a small gap may intersect by less than the level's distance.
//!
//! The bytes do not depend on the number of threads or on vector units. Edge collapses compare
//! errors computed in f32. They are equal on all machines only if the C++ compiler does not
//! contract products and sums, which `.cargo/config.toml` therefore disables.

mod distance;
mod encode;
mod full;
mod grid;
mod mend;
mod simplify;
mod thin;

use super::Metadata;
use crate::model::{Mesh, Patch, Rows};
use distance::Source;
use encode::Encoded;
use full::{FullSurface, PatchTriangles, number};
use serde::Serialize;
use serde_json::Map;
use simplify::coarser;
use std::io::{self, Write};
use thin::Thinning;

/// Maximum number of triangles of the simplified levels of detail, the finer level first.
pub const LEVEL_TRIANGLES: [usize; 2] = [300_000, 60_000];

/// Interval of the vertices and triangles whose distance is measured on a lofted surface.
const SAMPLED: usize = 2;

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
/// `rows` are those of a lofted surface, whose vertices may have been moved and whose edges may have
/// been divided since. They make the levels faster to compute.
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
///   least the maximum distance by which rounding moves a vertex. For a lofted surface, every
///   second vertex and triangle is measured.
///
/// Calls `stop` between steps and gives up if it returns true.
///
/// # Errors
/// [`io::ErrorKind::InvalidInput`] if the mesh has no triangles, [`io::ErrorKind::Interrupted`] if
/// it was stopped.
///
/// # Panics
/// If the mesh's indices or patch ranges are out of bounds.
#[inline(never)] // counted by scripts/counts
pub fn levels(mesh: &Mesh, rows: Option<&Rows>, stop: &(dyn Fn() -> bool + Sync)) -> io::Result<Vec<Level>> {
    if mesh.triangles.is_empty() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "the mesh has no triangles"));
    }
    levels_of(mesh, rows, LEVEL_TRIANGLES, stop).ok_or_else(|| io::ErrorKind::Interrupted.into())
}

/// Simplifies a surface to about `target` triangles without rounding. Also returns the vertices of
/// `mesh` that remain.
///
/// # Panics
/// As [`levels`].
#[must_use]
pub fn reduced(mesh: &Mesh, target: usize) -> (Mesh, Vec<u32>) {
    let full = FullSurface::new(mesh);
    assembled(&full, &coarser(&full, &full.triangles(), target))
}

/// The mesh of a level without rounding, and the vertices of the full surface that remain.
fn assembled(full: &FullSurface<'_>, level: &PatchTriangles<'_>) -> (Mesh, Vec<u32>) {
    let mesh = full.mesh;
    let mut patches = Vec::new();
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for (patch, own) in full.patches.iter().zip(level) {
        let from = triangles.len();
        triangles.extend_from_slice(own);
        patches.push(Patch { kind: patch.kind, triangles: from..triangles.len() });
    }
    let kept = number(triangles.as_flattened_mut());
    let positions = kept.iter().map(|&v| mesh.positions[v as usize]).collect();
    (Mesh { body: mesh.body, positions, triangles, patches }, kept)
}

/// Computes the levels; `None` if it was stopped.
fn levels_of<'a>(
    mesh: &'a Mesh,
    rows: Option<&Rows>,
    targets: [usize; 2],
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<Level>> {
    // Thinning comes first, because it takes memory too.
    let thinned = rows.map(|rows| thinned(mesh, rows, targets));
    if stop() {
        return None;
    }
    let full = FullSurface::new(mesh);
    let all = full.triangles();
    let coarser = |finer: &PatchTriangles<'a>, target| (!stop()).then(|| coarser(&full, finer, target));
    let (one, two) = match thinned {
        Some((one, two)) => (one, Some(two)),
        None => (coarser(&all, targets[0])?, None),
    };
    let sources: Vec<Source<'_, _>> = full.patches.iter().map(|patch| distance::source(&full, patch)).collect();
    // The levels of a loft are near it by construction, so fewer samples suffice.
    let step = if rows.is_some() { SAMPLED } else { 1 };
    let described = |n: usize, encoded: Encoded, distance: f64| {
        let report = LevelReport {
            file: FILES[n],
            vertices: encoded.vertices,
            triangles: encoded.triangles,
            precision_um: full.grid.step.map(|step| micrometres(f64::from(step))),
            distance_um: micrometres(distance),
        };
        Level { report, encoded }
    };
    let encoded = |triangles: &PatchTriangles<'_>| Encoded::new(&full, triangles, rows.is_some());
    let level = |n: usize, triangles: &PatchTriangles<'_>| {
        if stop() {
            return None;
        }
        let of_patches = || sources.iter().zip(triangles).map(|(source, level)| source.distance(level, step));
        let (encoded, distance) = rayon::join(|| encoded(triangles), || of_patches().fold(0.0, f64::max));
        Some(described(n, encoded, distance))
    };
    let (second, third) =
        rayon::join(|| level(1, &one), || level(2, &two.map_or_else(|| coarser(&one, targets[1]), Some)?));
    drop(one);
    // The finest level comes last, because it takes the most memory.
    let moved = sources.iter().map(Source::moved).fold(0.0, f64::max);
    drop(sources);
    let (second, third) = (second?, third?);
    (!stop()).then(|| vec![described(0, encoded(&all), moved), second, third])
}

/// The coarser levels of a lofted surface.
fn thinned<'a>(mesh: &'a Mesh, rows: &Rows, [one, two]: [usize; 2]) -> (PatchTriangles<'a>, PatchTriangles<'a>) {
    let thinning = Thinning::new(mesh, rows);
    rayon::join(|| thinning.level(one), || thinning.level(two.min(one)))
}

/// Metres as micrometres, rounded up to a tenth of a nanometre.
fn micrometres(metres: f64) -> f64 {
    (metres * 1e10).ceil() / 1e4
}

#[cfg(test)]
mod tests;
