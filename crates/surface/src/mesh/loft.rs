//! The lofter: receives sections one after the other and joins consecutive cross sections by
//! triangle strips, slab by slab. Every slab is tested.
//!
//! If the walls of a slab intersect, the lofter tries in this order:
//!
//! - flip diagonals
//! - add one of the sections in between (the steps that the simulation kept)
//! - add sections between two steps, halfway on the straight paths of the vertices, down to
//!   1/4096 of a step
//!
//! The straight paths from step to step never cross (docs/physics.md), so this terminates.

use super::align;
use super::error::{LoftError, Wall};
use super::mend::settle;
use super::slab::{Rim, Slab};
use crate::geometry::blocks::Blocks;
use crate::geometry::polygon::{ContourError, check_contour, check_nested};
use crate::geometry::triangulate::annulus;
use crate::model::{BodyKind, Mesh, Patch, Ring, RowRuns, Rows, Section};

/// Indices of the patches in [`Lofter::patches`].
const INNER_WALL: usize = 0;
const OUTER_WALL: usize = 1;
const CAP_ISTHMUS: usize = 2;
const CAP_AMPULLA: usize = 3;
/// Maximum number of times that the interval between two steps is halved.
const DEEPEST: u32 = 12;

/// Result of [`Lofter::advance`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Accepted {
    /// Sections that were added to the surface, in order: first those that mend the slab (`added`
    /// is true), then the recorded section.
    pub sections: Vec<Section>,
    /// Number of diagonals flipped to separate walls.
    pub flipped: usize,
}

/// Lofts sections into the surface of the tissue; see [`Lofter::advance`].
#[derive(Clone, Debug)]
pub struct Lofter {
    /// Last accepted section, µm.
    section: Section,
    front: Front,
    /// Slab below the front. It is emitted later, because the next slab may still refine its upper
    /// rim.
    below: Option<SlabBelow>,
    /// Vertices, metres.
    positions: Vec<[f32; 3]>,
    /// Triangles of each patch of the tissue, in their order, without the newest slab.
    patches: [Vec<[u32; 3]>; 4],
    /// Rows of the inner and of the outer wall below the front, and their places.
    rows: [RowRuns; 2],
    row_places: Vec<f32>,
    /// Maximum number of vertices.
    most: usize,
}

/// Upper rim of the surface so far; the next slab starts here.
#[derive(Clone, Debug)]
pub(super) struct Front {
    pub(super) rim: Rim,
    /// Stable ids of the inner and of the outer ring, in the order of the rim.
    pub(super) ids: [Vec<u32>; 2],
    /// Vertex index of each rim point.
    pub(super) vertices: Vec<u32>,
    /// Place along the tube, m.
    pub(super) z: f32,
}

impl Front {
    /// Vertex indices of the inner (0) or outer (1) ring.
    pub(super) fn ring(&self, wall: usize) -> &[u32] {
        let (inner, outer) = self.vertices.split_at(self.rim.inner);
        [inner, outer][wall]
    }
}

#[derive(Clone, Debug)]
struct SlabBelow {
    slab: Slab,
    /// Bounding boxes of its cells.
    blocks: Blocks,
    /// Vertex index of each point of the lower rim.
    vertices: Vec<u32>,
}

/// Slab that passed all tests.
struct TestedSlab {
    /// Number of new vertices after each point of the front.
    new_after: Vec<u32>,
    /// Slab below, with the new vertices in its upper rim.
    below: Option<Slab>,
    slab: Slab,
    blocks: Blocks,
    /// The next front, without its vertices.
    front: Front,
    flipped: usize,
}

impl Lofter {
    /// Starts a surface at the isthmus end.
    ///
    /// # Errors
    /// Returns [`LoftError::Ids`], [`LoftError::Contour`] or [`LoftError::Nesting`] if the section
    /// is not sound.
    pub fn new(first: Section) -> Result<Self, LoftError> {
        check_form(&first)?;
        let (inner, outer) = (exported(&first.inner, 0), exported(&first.outer, 0));
        check_section(&first, &inner, &outer)?;
        let rim = joined(&inner, &outer);
        let z = metres(first.z_um);
        let positions = rim.points.iter().map(|p| [p[0], p[1], z]).collect();
        Ok(Self {
            front: Front {
                vertices: (0..rim.len() as u32).collect(),
                ids: [first.inner.ids.clone(), first.outer.ids.clone()],
                rim,
                z,
            },
            section: first,
            below: None,
            positions,
            patches: Default::default(),
            rows: Default::default(),
            row_places: Vec::new(),
            most: u32::MAX as usize,
        })
    }

    /// Limits the number of vertices. Otherwise mending could add sections almost without end if
    /// walls intersect in many places.
    #[must_use]
    pub fn with_most_vertices(mut self, most: u64) -> Self {
        self.most = usize::try_from(most).unwrap_or(usize::MAX).min(u32::MAX as usize);
        self
    }

    /// Adds the slab up to the last section of `history`. `history` contains the sections of the
    /// steps since the last call, in order. Its last section is recorded; the others are used only
    /// to mend the slab. Returns the sections that are part of the surface now.
    ///
    /// # Errors
    /// Returns an error if the section is not sound or does not continue the previous one, if its
    /// walls cannot be separated, or if the surface becomes too large. The lofter must not be used
    /// again.
    pub fn advance(&mut self, history: &[Section]) -> Result<Accepted, LoftError> {
        let added = history.last().ok_or(LoftError::NoSection)?.added;
        let mut accepted = Accepted::default();
        self.climb(history, added, DEEPEST, &mut accepted)?;
        Ok(accepted)
    }

    /// Adds the slab up to `section` if it needs no sections in between. Returns `None` if flipped
    /// diagonals cannot separate its walls. The lofter is then unchanged, and [`Lofter::advance`]
    /// can be called with the sections of the steps in between.
    ///
    /// # Errors
    /// Returns the errors of [`Lofter::advance`], except for walls that intersect.
    #[inline(never)] // counted by scripts/counts
    pub fn try_advance(&mut self, section: &Section) -> Result<Option<Accepted>, LoftError> {
        let Ok(tested) = self.attempt(section)? else { return Ok(None) };
        let flipped = tested.flipped;
        self.accept(tested)?;
        self.section = section.clone();
        Ok(Some(Accepted { sections: vec![section.clone()], flipped }))
    }

    /// Closes the ends. Vertices are numbered section by section. The patches are `inner_wall`,
    /// `outer_wall`, `cap_isthmus` and `cap_ampulla`; the walls are ordered slab by slab.
    ///
    /// # Errors
    /// Returns [`LoftError::NoSlab`] if there is only one section, and [`LoftError::Cap`] if the
    /// end at the ampulla cannot be closed.
    pub fn finish(self) -> Result<Mesh, LoftError> {
        self.finish_with_rows().map(|(mesh, _)| mesh)
    }

    /// Closes the ends, and also returns the rows of the walls.
    ///
    /// # Errors
    /// As [`Lofter::finish`].
    #[inline(never)] // counted by scripts/counts
    pub fn finish_with_rows(mut self) -> Result<(Mesh, Rows), LoftError> {
        let below = self.below.take().ok_or(LoftError::NoSlab)?;
        self.emit(&below.slab, &below.vertices, &self.front.vertices.clone());
        self.patches[CAP_AMPULLA] = ampulla_cap(&self.front.rim, &self.front.vertices)?;
        self.row_places.push(self.front.z);
        for (wall, rows) in self.rows.iter_mut().enumerate() {
            self.front.ring(wall).iter().for_each(|&vertex| rows.push(vertex, false));
            rows.end_row();
        }
        let rows = Rows { z: self.row_places, walls: self.rows };
        Ok((assembled(self.positions, self.patches), rows))
    }

    /// Adds the slabs up to the last section of `history`, with sections in between where walls
    /// intersect.
    fn climb(
        &mut self,
        history: &[Section],
        added: bool,
        depth: u32,
        accepted: &mut Accepted,
    ) -> Result<(), LoftError> {
        let target = history.last().ok_or(LoftError::NoSection)?;
        let point = match self.attempt(target)? {
            Ok(tested) => {
                accepted.flipped += tested.flipped;
                self.accept(tested)?;
                self.section = Section { added, ..target.clone() };
                accepted.sections.push(self.section.clone());
                return Ok(());
            }
            Err(point) => point,
        };
        let (inner, outer) = (exported(&target.inner, 0), exported(&target.outer, 0));
        let sound = check_section(target, &inner, &outer);
        if depth == DEEPEST {
            sound.clone()?;
        }
        if history.len() > 1 {
            let middle = history.len() / 2;
            self.climb(&history[..middle], true, depth, accepted)?;
            return self.climb(&history[middle..], added, depth, accepted);
        }
        // If a section halfway is not sound, the straight paths themselves cross.
        let unmendable = LoftError::Unmendable {
            from_step: self.section.step,
            to_step: target.step,
            z_um: target.z_um,
            x_um: f64::from(point[0]) * 1e6,
            y_um: f64::from(point[1]) * 1e6,
        };
        if depth == 0 || sound.is_err() {
            return Err(unmendable);
        }
        let middle = align::halfway(&self.section, target)?;
        // There may be no f32 between the two places.
        let z = metres(middle.z_um);
        if z <= self.front.z || z >= metres(target.z_um) {
            return Err(unmendable);
        }
        self.climb(&[middle], true, depth - 1, accepted)?;
        self.climb(history, added, depth - 1, accepted)
    }

    /// Builds and tests the slab up to `target`. The inner error is a point (m) near which walls
    /// intersect.
    fn attempt(&self, target: &Section) -> Result<Result<TestedSlab, [f32; 2]>, LoftError> {
        check_form(target)?;
        let z = metres(target.z_um);
        if z <= self.front.z || !z.is_finite() {
            return Err(LoftError::Order { step: target.step, z_um: target.z_um });
        }
        let align = |k: usize, ring: &Ring, wall| align::align(&self.front.ids[k], &ring.ids, wall, target.step);
        let (inner, outer) = (align(0, &target.inner, Wall::Inner)?, align(1, &target.outer, Wall::Outer)?);
        let upper = joined(&exported(&target.inner, inner.turn), &exported(&target.outer, outer.turn));
        let ids = [turned(&target.inner.ids, inner.turn), turned(&target.outer.ids, outer.turn)];
        let (inner_points, outer_points) = self.front.rim.points.split_at(self.front.rim.inner);
        let insert = align::insert;
        let lower = joined(&insert(inner_points, &inner.new_after), &insert(outer_points, &outer.new_after));
        let new_after = [inner.new_after, outer.new_after].concat();
        let front = Front { rim: upper, ids, vertices: Vec::new(), z };
        Ok(self.test(lower, front, new_after))
    }

    /// Tests the slab from the refined front to the next one, and the slab below with its refined
    /// rim.
    fn test(&self, lower: Rim, upper: Front, new_after: Vec<u32>) -> Result<TestedSlab, [f32; 2]> {
        let (mut flipped, mut below) = (0, None);
        if let Some(SlabBelow { slab, blocks, .. }) = &self.below {
            let (mut slab, changed) = slab.refined(lower.clone(), &new_after);
            flipped += settle(&mut slab, blocks, Some(&changed))?;
            below = Some(slab);
        }
        let mut slab = Slab::new(lower, upper.rim.clone());
        let blocks = slab.blocks();
        flipped += settle(&mut slab, &blocks, None)?;
        Ok(TestedSlab { new_after, below, slab, blocks, front: upper, flipped })
    }

    /// Makes a tested slab part of the surface. The slab below it is then final.
    fn accept(&mut self, tested: TestedSlab) -> Result<(), LoftError> {
        let TestedSlab { new_after, below, slab, blocks, front, .. } = tested;
        let added = slab.lower.len() - self.front.rim.len() + slab.upper.len();
        if self.positions.len() + added > self.most {
            return Err(LoftError::TooLarge { most: self.most });
        }
        let mut lower = Vec::with_capacity(slab.lower.len());
        let (rows, inner) = (&mut self.rows, slab.lower.inner);
        let mut push = |lower: &mut Vec<u32>, vertex: u32, is_new: bool| {
            rows[usize::from(lower.len() >= inner)].push(vertex, is_new);
            lower.push(vertex);
        };
        for (&vertex, &count) in self.front.vertices.iter().zip(&new_after) {
            push(&mut lower, vertex, false);
            for _ in 0..count {
                let p = slab.lower.points[lower.len()];
                push(&mut lower, self.positions.len() as u32, true);
                self.positions.push([p[0], p[1], self.front.z]);
            }
        }
        self.rows.iter_mut().for_each(RowRuns::end_row);
        self.row_places.push(self.front.z);
        match (below, self.below.take()) {
            (Some(refined), Some(below)) => self.emit(&refined, &below.vertices, &lower),
            _ => self.patches[CAP_ISTHMUS] = isthmus_cap(&slab.lower, &lower)?,
        }
        let first = self.positions.len() as u32;
        self.positions.extend(slab.upper.points.iter().map(|p| [p[0], p[1], front.z]));
        let vertices = (first..self.positions.len() as u32).collect();
        self.front = Front { vertices, ..front };
        self.below = Some(SlabBelow { slab, blocks, vertices: lower });
        Ok(())
    }

    /// Emits the triangles of a slab. Those of the inner wall face the lumen.
    fn emit(&mut self, slab: &Slab, lower: &[u32], upper: &[u32]) {
        let vertices = [lower, upper].concat();
        let inner = slab.lower.inner;
        for (wall, cells) in [(INNER_WALL, 0..inner), (OUTER_WALL, inner..slab.len())] {
            let patch = &mut self.patches[wall];
            patch.reserve(slab.triangle_count(&cells));
            for cell in cells {
                slab.for_triangles(cell, |triangle| {
                    let [a, b, c] = triangle.map(|corner| vertices[corner]);
                    patch.push(if wall == INNER_WALL { [a, c, b] } else { [a, b, c] });
                });
            }
        }
    }
}

/// Checks the preconditions of the tests of slabs.
pub(super) fn check_form(section: &Section) -> Result<(), LoftError> {
    for (wall, ring) in [(Wall::Inner, &section.inner), (Wall::Outer, &section.outer)] {
        if ring.ids.len() != ring.points.len() || ring.is_empty() {
            return Err(LoftError::Ids { step: section.step, wall, points: ring.points.len(), ids: ring.ids.len() });
        }
        if ring.points.iter().flatten().any(|x| !x.is_finite()) {
            let source = ContourError::Malformed;
            return Err(LoftError::Contour { step: section.step, z_um: section.z_um, wall, source });
        }
    }
    Ok(())
}

/// Tests the exported contours of a section.
fn check_section(section: &Section, inner: &[[f32; 2]], outer: &[[f32; 2]]) -> Result<(), LoftError> {
    let (step, z_um) = (section.step, section.z_um);
    for (wall, points) in [(Wall::Inner, inner), (Wall::Outer, outer)] {
        check_contour(points).map_err(|source| LoftError::Contour { step, z_um, wall, source })?;
    }
    check_nested(inner, outer).map_err(|source| LoftError::Nesting { step, z_um, source })
}

/// Joins the patches of the tissue, given in their order, into one mesh.
pub(super) fn assembled(positions: Vec<[f32; 3]>, parts: [Vec<[u32; 3]>; 4]) -> Mesh {
    let body = BodyKind::Tissue;
    let (mut triangles, mut patches) = (Vec::new(), Vec::with_capacity(parts.len()));
    for (&kind, part) in body.patches().iter().zip(parts) {
        let from = triangles.len();
        if from == 0 {
            triangles = part;
        } else {
            triangles.extend_from_slice(&part);
        }
        patches.push(Patch { kind, triangles: from..triangles.len() });
    }
    Mesh { body, positions, triangles, patches }
}

/// Closes the end at the isthmus with triangles that face down the tube.
pub(super) fn isthmus_cap(rim: &Rim, vertices: &[u32]) -> Result<Vec<[u32; 3]>, LoftError> {
    Ok(cap(rim, vertices, "isthmus")?.into_iter().map(|[a, b, c]| [a, c, b]).collect())
}

/// Closes the end at the ampulla with triangles that face up the tube.
pub(super) fn ampulla_cap(rim: &Rim, vertices: &[u32]) -> Result<Vec<[u32; 3]>, LoftError> {
    cap(rim, vertices, "ampulla")
}

/// Triangles of an end cap, which closes the tissue between the inner and the outer wall.
fn cap(rim: &Rim, vertices: &[u32], end: &'static str) -> Result<Vec<[u32; 3]>, LoftError> {
    let (inner, outer) = rim.points.split_at(rim.inner);
    let triangles = annulus(inner, outer).map_err(|source| LoftError::Cap { end, source })?;
    Ok(triangles.into_iter().map(|t| t.map(|i| vertices[i as usize])).collect())
}

/// Converts micrometres to metres as exported: computed in f64 and rounded once.
pub(super) fn metres(um: f64) -> f32 {
    (um * 1e-6) as f32
}

/// Exported points of a ring, from point `turn` on.
pub(super) fn exported(ring: &Ring, turn: usize) -> Vec<[f32; 2]> {
    let (before, after) = ring.points.split_at(turn);
    after.iter().chain(before).map(|p| p.map(|x| metres(f64::from(x)))).collect()
}

pub(super) fn turned(ids: &[u32], turn: usize) -> Vec<u32> {
    [&ids[turn..], &ids[..turn]].concat()
}

pub(super) fn joined(inner: &[[f32; 2]], outer: &[[f32; 2]]) -> Rim {
    Rim { points: [inner, outer].concat(), inner: inner.len() }
}
