//! A surface of good triangles through the sections of every step: even, graded, and within a tolerance of the loft.
//!
//! Each wall is cut at section planes into sheets (`sheet`), which are meshed independently, so that time is shared by threads and
//! memory is bounded. At a plane the contour is resampled once (`row`); both neighbours keep that row. Within a sheet
//! rows are joined, and edges divided, removed, flipped and moved (`weave`) until their lengths are those of the `field`.
//! Vertices lie on the sheet, and a triangle is changed only if it stays within the tolerance of it; hence walls can meet only where
//! they are nearer than that. Triangles that meet are searched exactly, and their neighbourhood is meshed again with less
//! tolerance.
//!
//! Invariant: the result depends on sections and options only, not on the number of threads.

mod block;
mod cap;
mod error;
mod field;
mod row;
mod sheet;
mod weave;
mod web;

pub use error::RemeshError;

use super::meeting;
use crate::model::{BodyKind, Mesh, Patch, PatchKind, Ring, Section};
use block::{Block, Row};
use field::{Aims, Spot};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Length of a sheet as a multiple of the resolution.
const SPAN: f64 = 24.0;
/// Most times that places where walls meet are meshed again.
const ROUNDS: usize = 10;
/// The tolerance at such a place is multiplied by this each time.
const TIGHTER: f64 = 0.4;
/// Part of the tolerance that triangles may use; the rest is for what lies between the places where they are compared.
const SAFETY: f64 = 0.75;

/// Options of [`remesh`].
#[derive(Clone, Copy, Debug)]
pub struct Quality {
    /// Greatest length of edges on the inner wall, about, in micrometres.
    pub resolution_um: f64,
    /// The same for the outer wall.
    pub outer_um: f64,
    /// Greatest distance between the result and the surface through all sections, either way.
    pub tolerance_um: f64,
    /// Whether to close the lumen, too.
    pub lids: bool,
}

impl Default for Quality {
    fn default() -> Self {
        Self { resolution_um: 40.0, outer_um: 80.0, tolerance_um: 4.0, lids: false }
    }
}

/// The result of [`remesh`].
#[derive(Clone, Debug, PartialEq)]
pub struct Remeshed {
    /// The surface of the tissue, with the patches of a lofted one.
    pub tissue: Mesh,
    /// The ends of the lumen, if asked for.
    pub lids: Option<Lids>,
}

/// Discs that close the lumen. Vertices are those of the tissue, then `positions`.
#[derive(Clone, Debug, PartialEq)]
pub struct Lids {
    /// Number of vertices of the tissue that they were made for; more may be added to it.
    pub tissue: u32,
    /// Vertices within the discs, which follow those of the tissue; metres.
    pub positions: Vec<[f32; 3]>,
    /// Triangles of [`PatchKind::Inlet`], facing down the tube.
    pub inlet: Vec<[u32; 3]>,
    /// Triangles of [`PatchKind::Outlet`], facing up the tube.
    pub outlet: Vec<[u32; 3]>,
}

impl Lids {
    /// Both bodies in one mesh, as [`crate::mesh::regions`] makes it of a lofted surface.
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

/// Makes a surface of good triangles through `sections`, which are consecutive along the tube. `watch` is told the fraction
/// that is done, and says whether to stop.
///
/// # Errors
/// [`RemeshError`].
pub fn remesh(
    sections: &[Section],
    options: &Quality,
    watch: &(dyn Fn(f64) -> bool + Sync),
) -> Result<Remeshed, RemeshError> {
    let walls = [PatchKind::InnerWall, PatchKind::OuterWall].map(|kind| Wall::new(kind, options));
    let planes = planes(sections, SPAN * options.resolution_um)?;
    let mut spots: Vec<Spot> = Vec::new();
    let mut plan = Plan { sections, planes, walls, rows: Vec::new(), blocks: Vec::new() };
    for _ in 0..ROUNDS {
        plan.update(&spots, watch)?;
        let assembled = plan.assemble()?;
        let pairs = meeting::pairs(&assembled.mesh);
        if pairs.is_empty() {
            return finish(assembled, options);
        }
        spots = plan.tightened(&assembled.mesh, &pairs, &spots);
    }
    Err(RemeshError::Meeting(meeting::pairs(&plan.assemble()?.mesh).len()))
}

/// One wall.
#[derive(Clone, Copy)]
struct Wall {
    kind: PatchKind,
    aims: Aims,
}

impl Wall {
    fn new(kind: PatchKind, options: &Quality) -> Self {
        let length = if kind == PatchKind::InnerWall { options.resolution_um } else { options.outer_um };
        Self { kind, aims: Aims { length, tolerance: options.tolerance_um * SAFETY } }
    }

    fn ring<'a>(&self, section: &'a Section) -> &'a Ring {
        if self.kind == PatchKind::InnerWall { &section.inner } else { &section.outer }
    }
}

/// The numbers of the sections at which walls are cut.
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

/// The parts of the surface, wall by wall.
struct Plan<'a> {
    sections: &'a [Section],
    planes: Vec<usize>,
    walls: [Wall; 2],
    /// For each wall, a row at each plane.
    rows: Vec<Row>,
    /// For each wall, a block between each two planes.
    blocks: Vec<Block>,
}

/// The surface without its ends.
struct Assembled {
    /// Walls only.
    mesh: Mesh,
    /// Vertices of the rims: of each wall, at the isthmus and at the ampulla.
    rims: [[Vec<u32>; 2]; 2],
}

impl Plan<'_> {
    /// Makes the rows and blocks again that spots concern; all, the first time.
    fn update(&mut self, spots: &[Spot], watch: &(dyn Fn(f64) -> bool + Sync)) -> Result<(), RemeshError> {
        let touched = |from: usize, to: usize| {
            let (low, high) = (self.sections[from].z_um, self.sections[to].z_um);
            spots
                .iter()
                .any(|spot| spot.fresh && spot.centre[2] > low - spot.radius && spot.centre[2] < high + spot.radius)
        };
        let (planes, sections) = (&self.planes, self.sections);
        let first_time = self.rows.is_empty();
        let window = |k: usize| (k.saturating_sub(2), (k + 2).min(sections.len() - 1));
        let wanted: Vec<(usize, usize)> = (0..2).flat_map(|wall| (0..planes.len()).map(move |p| (wall, p))).collect();
        let old_rows = std::mem::take(&mut self.rows);
        let rows: Result<Vec<(Row, bool)>, RemeshError> = wanted
            .into_par_iter()
            .map(|(wall, p)| {
                let (from, to) = window(planes[p]);
                if first_time || touched(from, to) {
                    let wall = self.walls[wall];
                    let rings: Vec<_> = sections[from..=to].iter().map(|s| (wall.ring(s), s.z_um)).collect();
                    Ok((Row::new(&rings, planes[p] - from, wall.aims, spots)?, true))
                } else {
                    Ok((old_rows[wall * planes.len() + p].clone(), false))
                }
            })
            .collect();
        let (rows, renewed): (Vec<Row>, Vec<bool>) = rows?.into_iter().unzip();
        let count = planes.len() - 1;
        let wanted: Vec<(usize, usize)> = (0..2).flat_map(|wall| (0..count).map(move |b| (wall, b))).collect();
        let old_blocks = std::mem::take(&mut self.blocks);
        let (done, all) = (AtomicUsize::new(0), wanted.len());
        let fresh: Result<Vec<Option<Block>>, RemeshError> = wanted
            .into_par_iter()
            .with_max_len(1)
            .map(|(wall, b)| {
                if watch(done.fetch_add(1, Ordering::Relaxed) as f64 / all as f64) {
                    return Err(RemeshError::Stopped);
                }
                let row = wall * planes.len() + b;
                let (from, to) = (planes[b], planes[b + 1]);
                if !(first_time || renewed[row] || renewed[row + 1] || touched(from, to)) {
                    return Ok(None);
                }
                let wall = self.walls[wall];
                let rings: Vec<_> = sections[from..=to].iter().map(|s| (wall.ring(s), s.z_um)).collect();
                Block::new(&rings, [&rows[row], &rows[row + 1]], wall.aims, spots).map(Some)
            })
            .collect();
        let mut old_blocks = old_blocks.into_iter();
        self.blocks = fresh?
            .into_iter()
            .filter_map(|block| {
                let old = old_blocks.next();
                block.or(old)
            })
            .collect();
        self.rows = rows;
        Ok(())
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
                let number = |v: u32| {
                    let v = v as usize;
                    let (rows, low) = (lower.len() + upper.len(), lower.len());
                    if v < low {
                        lower[v]
                    } else if v < rows {
                        upper[v - low]
                    } else {
                        inside[v - rows]
                    }
                };
                let out = |t: &[u32; 3]| t.map(number);
                if wall.kind == PatchKind::InnerWall {
                    // The inner wall faces the lumen.
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

    /// The spots after a search: those so far, and one for each pair that meets, with less tolerance than there was.
    fn tightened(&self, mesh: &Mesh, pairs: &[[u32; 2]], spots: &[Spot]) -> Vec<Spot> {
        let aims = self.walls[0].aims;
        let mut all: Vec<Spot> = spots.iter().map(|spot| Spot { fresh: false, ..*spot }).collect();
        let old = all.len();
        for pair in pairs {
            let corners = pair
                .map(|t| mesh.triangles[t as usize].map(|v| mesh.positions[v as usize].map(|x| f64::from(x) * 1e6)));
            let centre: [f64; 3] = std::array::from_fn(|k| corners.iter().flatten().map(|p| p[k]).sum::<f64>() / 6.0);
            let away = |p: [f64; 3]| row::length(p, centre);
            if all[old..].iter().any(|spot| away(spot.centre) < 0.25 * spot.radius) {
                continue;
            }
            let radius = 1.5 * corners.iter().flatten().map(|&p| away(p)).fold(aims.length, f64::max);
            let covering = all[..old].iter().filter(|spot| away(spot.centre) < spot.radius);
            let tolerance = TIGHTER * covering.map(|spot| spot.tolerance).fold(aims.tolerance, f64::min);
            all.push(Spot { centre, radius, tolerance, fresh: true });
        }
        all
    }
}

/// Closes the ends.
fn finish(assembled: Assembled, options: &Quality) -> Result<Remeshed, RemeshError> {
    let Assembled { mut mesh, rims } = assembled;
    let [inner, outer] = &rims;
    let mut lid = Vec::new();
    let ends = [(PatchKind::CapIsthmus, 0), (PatchKind::CapAmpulla, 1)];
    for (kind, end) in ends {
        let start = mesh.triangles.len();
        let triangles = cap::annulus(&mut mesh.positions, &inner[end], &outer[end], options.resolution_um)?;
        mesh.triangles.extend(if end == 0 { turned(triangles) } else { triangles });
        mesh.patches.push(Patch { kind, triangles: start..mesh.triangles.len() });
    }
    if !options.lids {
        return Ok(Remeshed { tissue: mesh, lids: None });
    }
    let tissue = mesh.positions.len();
    let mut positions = mesh.positions.clone();
    for (_, end) in ends {
        lid.push(cap::disc(&mut positions, &inner[end], options.resolution_um)?);
    }
    let outlet = lid.pop().unwrap_or_default();
    let inlet = turned(lid.pop().unwrap_or_default());
    Ok(Remeshed {
        tissue: mesh,
        lids: Some(Lids { tissue: tissue as u32, positions: positions.split_off(tissue), inlet, outlet }),
    })
}

fn turned(mut triangles: Vec<[u32; 3]>) -> Vec<[u32; 3]> {
    triangles.iter_mut().for_each(|t| t.swap(1, 2));
    triangles
}

#[cfg(test)]
mod tests;
