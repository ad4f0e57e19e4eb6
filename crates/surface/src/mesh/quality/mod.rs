//! Remeshes the walls into even, graded triangles within a tolerance of the lofted surface.
//!
//! Each wall is cut at section planes into sheets (`sheet`). The sheets are remeshed independently,
//! which bounds the memory and lets threads share the work. The contour at each plane is resampled
//! once (`row`), and the sheets on both sides keep that row. Within a sheet, rows are joined; then
//! edges are divided, collapsed and flipped and vertices are moved (`weave`) until the edges have
//! the lengths that the `field` requires.
//!
//! Vertices lie on the sheet, and a triangle changes only if it stays within the tolerance of the
//! sheet. Walls can therefore intersect only where they are closer to each other than the
//! tolerance. An exact search finds intersecting triangles; their neighbourhood is remeshed with a
//! smaller tolerance.
//!
//! Invariant: the result depends on sections and options only, not on the number of threads.

mod block;
mod error;
mod field;
mod row;
mod sheet;
mod weave;
mod web;

pub use error::RemeshError;

use super::intersection;
use crate::geometry::triangulate::{TriangulateError, refined};
use crate::geometry::vector::distance;
use crate::model::{BodyKind, Mesh, Patch, PatchKind, Ring, Section};
use block::{Block, Row};
use field::{RemeshLimits, Spot};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Length of a sheet as a multiple of the resolution.
const SPAN: f64 = 24.0;
/// Maximum number of attempts to separate walls.
const ROUNDS: usize = 10;
/// Factor on the tolerance near intersecting triangles, per attempt.
const TIGHTER: f64 = 0.4;
/// Fraction of the tolerance that triangles may use. The rest covers points between those at which
/// triangles are compared with the sheet.
const SAFETY: f64 = 0.75;

/// Options of [`remesh`].
#[derive(Clone, Copy, Debug)]
pub struct Quality {
    /// Approximate maximum length of edges on the inner wall, µm.
    pub resolution_um: f64,
    /// Approximate maximum length of edges on the outer wall, µm.
    pub outer_um: f64,
    /// Maximum distance between the result and the lofted surface, in both directions, µm.
    pub tolerance_um: f64,
    /// True to close the lumen as well.
    pub lids: bool,
}

/// Result of [`remesh`].
#[derive(Clone, Debug, PartialEq)]
pub struct Remeshed {
    /// Surface of the tissue, with the patches of a lofted surface.
    pub tissue: Mesh,
    /// Discs at the ends of the lumen, if requested.
    pub lids: Option<Lids>,
}

/// Discs that close the lumen. Their vertices are numbered after those of the tissue.
#[derive(Clone, Debug, PartialEq)]
pub struct Lids {
    /// Number of tissue vertices when the lids were created. Later steps may append vertices to the
    /// tissue.
    pub tissue: u32,
    /// Vertices inside the discs, metres.
    pub positions: Vec<[f32; 3]>,
    /// Triangles of [`PatchKind::Inlet`], facing down the tube.
    pub inlet: Vec<[u32; 3]>,
    /// Triangles of [`PatchKind::Outlet`], facing up the tube.
    pub outlet: Vec<[u32; 3]>,
}

impl Lids {
    /// Returns both bodies in one mesh, like [`crate::mesh::regions`] for a lofted surface.
    #[must_use]
    pub fn regions(&self, tissue: &Mesh) -> Mesh {
        let mut regions = Mesh { body: BodyKind::Regions, ..tissue.clone() };
        regions.positions.extend_from_slice(&self.positions);
        for (kind, triangles) in [(PatchKind::Inlet, &self.inlet), (PatchKind::Outlet, &self.outlet)] {
            let start = regions.triangles.len();
            let moved = |v: u32| if v < self.tissue { v } else { v - self.tissue + tissue.positions.len() as u32 };
            regions.triangles.extend(triangles.iter().map(|t| t.map(moved)));
            regions.patches.push(Patch { kind, triangles: start..regions.triangles.len() });
        }
        regions
    }
}

/// Remeshes the walls through `sections`, which follow each other along the tube. `watch` receives
/// the completed fraction and returns true to stop.
///
/// # Errors
/// Returns [`RemeshError`] if the sections do not form a surface, an end cannot be closed, walls
/// still intersect after the last attempt, or `watch` stops the remesher.
pub fn remesh(
    sections: &[Section],
    options: &Quality,
    watch: &(dyn Fn(f64) -> bool + Sync),
) -> Result<Remeshed, RemeshError> {
    let mut spots: Vec<Spot> = Vec::new();
    let mut plan = Plan::new(sections, SPAN * options.resolution_um, options)?;
    for _ in 0..ROUNDS {
        plan.update(&spots, watch)?;
        let assembled = plan.assemble()?;
        let pairs = intersection::all_pairs(&assembled.mesh);
        if pairs.is_empty() {
            return finish(assembled, options);
        }
        spots = plan.tightened(&assembled.mesh, &pairs, &spots);
    }
    Err(RemeshError::Meeting(intersection::all_pairs(&plan.assemble()?.mesh).len()))
}

/// One wall.
#[derive(Clone, Copy)]
struct Wall {
    kind: PatchKind,
    limits: RemeshLimits,
}

impl Wall {
    fn new(kind: PatchKind, options: &Quality) -> Self {
        let length = if kind == PatchKind::InnerWall { options.resolution_um } else { options.outer_um };
        Self { kind, limits: RemeshLimits { length, tolerance: options.tolerance_um * SAFETY } }
    }

    fn rings<'a>(&self, sections: &'a [Section]) -> Vec<(&'a Ring, f64)> {
        let is_inner = self.kind == PatchKind::InnerWall;
        sections.iter().map(|s| (if is_inner { &s.inner } else { &s.outer }, s.z_um)).collect()
    }
}

/// Indices of the sections at which walls are cut.
fn planes(sections: &[Section], span: f64) -> Result<Vec<usize>, RemeshError> {
    let [first, .., last] = sections else { return Err(RemeshError::Sections) };
    if sections.windows(2).any(|pair| pair[1].z_um <= pair[0].z_um) {
        return Err(RemeshError::Sections);
    }
    let parts = ((last.z_um - first.z_um) / span).floor().max(1.0);
    let mut planes = vec![0];
    for part in 1..parts as usize {
        let z = first.z_um + (last.z_um - first.z_um) * part as f64 / parts;
        let k = sections.partition_point(|section| section.z_um < z);
        if k > planes[planes.len() - 1] && k + 1 < sections.len() {
            planes.push(k);
        }
    }
    planes.push(sections.len() - 1);
    Ok(planes)
}

/// Rows and blocks of the surface, wall by wall.
struct Plan<'a> {
    sections: &'a [Section],
    planes: Vec<usize>,
    walls: [Wall; 2],
    /// One row per plane; first all rows of the inner wall.
    rows: Vec<Row>,
    /// One block between each two planes, in the same order.
    blocks: Vec<Block>,
}

/// Both walls as one mesh, without the ends.
struct Assembled {
    mesh: Mesh,
    /// Vertices of the rims by wall, at the isthmus and at the ampulla.
    rims: [[Vec<u32>; 2]; 2],
}

impl<'a> Plan<'a> {
    /// A plan without rows and blocks, whose walls are cut about every `span`, µm.
    fn new(sections: &'a [Section], span: f64, options: &Quality) -> Result<Self, RemeshError> {
        let walls = [PatchKind::InnerWall, PatchKind::OuterWall].map(|kind| Wall::new(kind, options));
        let planes = planes(sections, span)?;
        let rows = vec![Row::default(); walls.len() * planes.len()];
        let blocks = vec![Block::default(); walls.len() * (planes.len() - 1)];
        Ok(Self { sections, planes, walls, rows, blocks })
    }

    /// Recomputes rows and blocks near fresh spots; the first call computes all of them.
    fn update(&mut self, spots: &[Spot], watch: &(dyn Fn(f64) -> bool + Sync)) -> Result<(), RemeshError> {
        let Self { sections, planes, walls, rows, blocks } = self;
        let (sections, last) = (*sections, sections.len() - 1);
        let is_touched = |from: usize, to: usize| {
            let (low, high) = (sections[from].z_um, sections[to].z_um);
            let reaches = |s: &Spot| s.centre[2] > low - s.radius && s.centre[2] < high + s.radius;
            spots.iter().any(|spot| spot.fresh && reaches(spot))
        };
        let renew = |row: &mut Row, number: usize| {
            let (wall, plane) = (walls[number / planes.len()], planes[number % planes.len()]);
            let (from, to) = (plane.saturating_sub(2), (plane + 2).min(last));
            let is_stale = row.points.is_empty() || is_touched(from, to);
            if is_stale {
                *row = Row::new(&wall.rings(&sections[from..=to]), plane - from, wall.limits, spots)?;
            }
            Ok(is_stale)
        };
        let renewed = rows.par_iter_mut().enumerate().map(|(number, row)| renew(row, number));
        let renewed: Vec<bool> = renewed.collect::<Result<_, RemeshError>>()?;
        let (done, all, count) = (AtomicUsize::new(0), blocks.len(), planes.len() - 1);
        blocks.par_iter_mut().enumerate().with_max_len(1).try_for_each(|(number, block)| {
            if watch(done.fetch_add(1, Ordering::Relaxed) as f64 / all as f64) {
                return Err(RemeshError::Stopped);
            }
            let (wall, b) = (number / count, number % count);
            let (from, to) = (planes[b], planes[b + 1]);
            let row = wall * planes.len() + b;
            if renewed[row] || renewed[row + 1] || is_touched(from, to) {
                let wall = walls[wall];
                *block =
                    Block::new(&wall.rings(&sections[from..=to]), [&rows[row], &rows[row + 1]], wall.limits, spots)?;
            }
            Ok(())
        })
    }

    /// Joins the blocks.
    fn assemble(&self) -> Result<Assembled, RemeshError> {
        let (mut positions, mut triangles, mut patches) = (Vec::new(), Vec::new(), Vec::new());
        let mut rims: [[Vec<u32>; 2]; 2] = Default::default();
        let planes = self.planes.len();
        for (w, wall) in self.walls.iter().enumerate() {
            let start = triangles.len();
            let mut add = |points: &[[f64; 3]]| {
                let first = positions.len() as u32;
                positions.extend(points.iter().map(|p| p.map(|x| (x * 1e-6) as f32)));
                (first..positions.len() as u32).collect::<Vec<u32>>()
            };
            let mut lower = add(&self.rows[w * planes].points);
            rims[w][0].clone_from(&lower);
            for b in 0..planes - 1 {
                let block = &self.blocks[w * (planes - 1) + b];
                let inside = add(&block.points);
                let upper = add(&self.rows[w * planes + b + 1].points);
                let numbers = [&lower[..], &upper, &inside].concat();
                let out = |t: &[u32; 3]| t.map(|v| numbers[v as usize]);
                if wall.kind == PatchKind::InnerWall {
                    // The triangles of the inner wall face the lumen.
                    triangles.extend(block.triangles.iter().map(out).map(|[a, b, c]| [a, c, b]));
                } else {
                    triangles.extend(block.triangles.iter().map(out));
                }
                lower = upper;
            }
            rims[w][1] = lower;
            patches.push(Patch { kind: wall.kind, triangles: start..triangles.len() });
        }
        if u32::try_from(positions.len()).is_err() {
            return Err(RemeshError::Sections);
        }
        Ok(Assembled { mesh: Mesh { body: BodyKind::Tissue, positions, triangles, patches }, rims })
    }

    /// Adds a spot with a smaller tolerance for each intersecting pair that no new spot covers yet.
    fn tightened(&self, mesh: &Mesh, pairs: &[[u32; 2]], spots: &[Spot]) -> Vec<Spot> {
        let limits = self.walls[0].limits;
        let mut all: Vec<Spot> = spots.iter().map(|spot| Spot { fresh: false, ..*spot }).collect();
        let old = all.len();
        for pair in pairs {
            let corners = pair
                .map(|t| mesh.triangles[t as usize].map(|v| mesh.positions[v as usize].map(|x| f64::from(x) * 1e6)));
            let centre: [f64; 3] = std::array::from_fn(|k| corners.iter().flatten().map(|p| p[k]).sum::<f64>() / 6.0);
            let away = |p: [f64; 3]| distance(p, centre);
            if all[old..].iter().any(|spot| away(spot.centre) < 0.25 * spot.radius) {
                continue;
            }
            let radius = 1.5 * corners.iter().flatten().map(|&p| away(p)).fold(limits.length, f64::max);
            let covering = all[..old].iter().filter(|spot| away(spot.centre) < spot.radius);
            let tolerance = TIGHTER * covering.map(|spot| spot.tolerance).fold(limits.tolerance, f64::min);
            all.push(Spot { centre, radius, tolerance, fresh: true });
        }
        all
    }
}

/// Closes the ends of the tissue and, if requested, of the lumen.
fn finish(assembled: Assembled, options: &Quality) -> Result<Remeshed, RemeshError> {
    let Assembled { mut mesh, rims: [inner, outer] } = assembled;
    for (kind, end) in [(PatchKind::CapIsthmus, 0), (PatchKind::CapAmpulla, 1)] {
        let start = mesh.triangles.len();
        let triangles = fill(&mut mesh.positions, &[&inner[end]], &outer[end], options.resolution_um)?;
        mesh.triangles.extend(if end == 0 { turned(triangles) } else { triangles });
        mesh.patches.push(Patch { kind, triangles: start..mesh.triangles.len() });
    }
    let lids = options.lids.then(|| {
        let tissue = mesh.positions.len();
        let mut positions = mesh.positions.clone();
        let [inlet, outlet] = inner.map(|rim| fill(&mut positions, &[], &rim, options.resolution_um));
        let positions = positions.split_off(tissue);
        Ok::<_, RemeshError>(Lids { tissue: tissue as u32, positions, inlet: turned(inlet?), outlet: outlet? })
    });
    Ok(Remeshed { lids: lids.transpose()?, tissue: mesh })
}

fn turned(mut triangles: Vec<[u32; 3]>) -> Vec<[u32; 3]> {
    triangles.iter_mut().for_each(|t| t.swap(1, 2));
    triangles
}

/// Triangulates the plane region inside the rim `outer` and outside of `holes`. Appends the
/// vertices it adds to `positions`. The triangles face up the tube.
fn fill(
    positions: &mut Vec<[f32; 3]>,
    holes: &[&[u32]],
    outer: &[u32],
    resolution_um: f64,
) -> Result<Vec<[u32; 3]>, TriangulateError> {
    let flat = |rim: &[u32]| -> Vec<[f32; 2]> {
        rim.iter().map(|&v| [positions[v as usize][0], positions[v as usize][1]]).collect()
    };
    let rims: Vec<Vec<[f32; 2]>> = holes.iter().copied().map(flat).collect();
    let z = positions[outer[0] as usize][2];
    let edge = resolution_um * 1e-6;
    // Area of an equilateral triangle with some slack, because it is a maximum.
    let region = refined(&rims.iter().map(Vec::as_slice).collect::<Vec<_>>(), &flat(outer), 0.6 * edge * edge)?;
    let mut vertices: Vec<u32> = holes.iter().copied().chain([outer]).flatten().copied().collect();
    for [x, y] in region.added {
        vertices.push(positions.len() as u32);
        positions.push([x, y, z]);
    }
    Ok(region.triangles.into_iter().map(|t| t.map(|i| vertices[i as usize])).collect())
}

#[cfg(test)]
mod tests;
