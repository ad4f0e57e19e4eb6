//! The lofter: takes sections one after the other and builds the surface slab by slab, each tested.
//!
//! A slab is mended, in this order, by flipping diagonals, by adding one of the sections in between (the
//! steps that the simulation kept), and by adding sections between two steps, half way on the straight
//! paths of the vertices, down to 1/4096 of a step. Straight paths from step to step are free of
//! contact (docs/physics.md), so this terminates.

use super::align::{self, Alignment};
use super::error::{LoftError, Wall};
use super::mend::settle;
use super::slab::{Rim, Slab};
use crate::geometry::blocks::Blocks;
use crate::geometry::polygon::{ContourError, check_contour, check_nested};
use crate::geometry::triangulate::annulus;
use crate::model::{BodyKind, Mesh, Patch, Ring, Section};

/// Places of the patches in [`Lofter::patches`].
const INNER_WALL: usize = 0;
const OUTER_WALL: usize = 1;
const CAP_ISTHMUS: usize = 2;
const CAP_AMPULLA: usize = 3;
/// Greatest number of times that the interval between two steps is halved.
const DEEPEST: u32 = 12;

/// Result of [`Lofter::advance`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Accepted {
    /// The sections that were added to the surface, in order: those that mend the slab (`added` is true), then the recorded
    /// one.
    pub sections: Vec<Section>,
    /// Number of diagonals that were flipped to separate walls.
    pub flipped: usize,
}

/// Lofts sections into the surface of the tissue; see [`Lofter::advance`].
#[derive(Clone, Debug)]
pub struct Lofter {
    /// The last accepted section, micrometres.
    section: Section,
    front: Front,
    /// The slab below the front, not yet emitted: the next slab may still refine its upper rim.
    below: Option<Below>,
    /// Vertices, metres.
    positions: Vec<[f32; 3]>,
    /// Triangles of each patch of the tissue, in their order: those of all slabs but the newest.
    patches: [Vec<[u32; 3]>; 4],
    /// Most vertices that the surface may have.
    most: usize,
}

/// The upper rim of the surface so far; the next slab starts here.
#[derive(Clone, Debug)]
struct Front {
    rim: Rim,
    /// Stable ids of the inner and of the outer ring, in the order of the rim.
    ids: [Vec<u32>; 2],
    /// Number of the vertex of each rim point.
    vertices: Vec<u32>,
    /// Place along the tube in metres.
    z: f32,
}

#[derive(Clone, Debug)]
struct Below {
    slab: Slab,
    /// Boxes of its cells.
    blocks: Blocks,
    /// Number of the vertex of each point of the lower rim.
    vertices: Vec<u32>,
}

/// A slab that has passed all tests.
struct Attempt {
    /// New vertices after each point of the front.
    new_after: Vec<u32>,
    /// The slab below with the new vertices in its upper rim.
    below: Option<Slab>,
    slab: Slab,
    blocks: Blocks,
    ids: [Vec<u32>; 2],
    z: f32,
    flipped: usize,
}

/// Why a slab was not accepted.
enum Refusal {
    /// Walls meet near this point (metres).
    Contact([f32; 2]),
    Error(LoftError),
}

impl From<LoftError> for Refusal {
    fn from(error: LoftError) -> Self {
        Self::Error(error)
    }
}

impl Lofter {
    /// Begins a surface at the isthmus end.
    ///
    /// # Errors
    /// The section is not sound: see [`LoftError::Ids`], [`LoftError::Contour`], [`LoftError::Nesting`].
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
            most: u32::MAX as usize,
        })
    }

    /// Limits the number of vertices: if walls meet in many places, mending could add sections almost without end.
    #[must_use]
    pub fn with_most_vertices(mut self, most: u64) -> Self {
        self.most = usize::try_from(most).unwrap_or(usize::MAX).min(u32::MAX as usize);
        self
    }

    /// Adds the slab up to the last section of `history`. `history` holds the sections of the steps since the
    /// last call, in order: at least the last of them, which is recorded; the others are used to mend
    /// the slab. Returns the sections that are now part of the surface.
    ///
    /// # Errors
    /// The section is not sound or does not continue the previous one, or its walls cannot be separated. The
    /// lofter must not be used again.
    pub fn advance(&mut self, history: &[Section]) -> Result<Accepted, LoftError> {
        let added = history.last().ok_or(LoftError::NoSection)?.added;
        let mut accepted = Accepted::default();
        self.climb(history, added, DEEPEST, &mut accepted)?;
        Ok(accepted)
    }

    /// Adds the slab up to `section` if it needs no sections in between. Returns `None` if walls
    /// meet that flipped diagonals cannot separate. The lofter is then unchanged, and [`Lofter::advance`] can be called with
    /// the sections of the steps in between.
    ///
    /// # Errors
    /// As [`Lofter::advance`], except for walls that meet.
    #[inline(never)] // counted by scripts/counts
    pub fn try_advance(&mut self, section: &Section) -> Result<Option<Accepted>, LoftError> {
        match self.attempt(section) {
            Ok(attempt) => {
                let flipped = attempt.flipped;
                self.accept(attempt)?;
                self.section = section.clone();
                Ok(Some(Accepted { sections: vec![section.clone()], flipped }))
            }
            Err(Refusal::Contact(_)) => Ok(None),
            Err(Refusal::Error(error)) => Err(error),
        }
    }

    /// Closes the ends. Vertices are numbered section by section; the patches are `inner_wall`,
    /// `outer_wall`, `cap_isthmus`, `cap_ampulla`, the walls slab by slab in the order of the rings.
    ///
    /// # Errors
    /// [`LoftError::NoSlab`] with one section only, [`LoftError::Cap`] if the end at the ampulla cannot be closed.
    #[inline(never)] // counted by scripts/counts
    pub fn finish(mut self) -> Result<Mesh, LoftError> {
        let below = self.below.take().ok_or(LoftError::NoSlab)?;
        self.emit(&below.slab, &below.vertices, &self.front.vertices.clone());
        self.patches[CAP_AMPULLA] = cap(&self.front.rim, &self.front.vertices, "ampulla")?;
        let body = BodyKind::Tissue;
        let (mut triangles, mut patches) = (Vec::new(), Vec::with_capacity(self.patches.len()));
        for (&kind, part) in body.patches().iter().zip(self.patches) {
            let from = triangles.len();
            if from == 0 {
                triangles = part;
            } else {
                triangles.extend_from_slice(&part);
            }
            patches.push(Patch { kind, triangles: from..triangles.len() });
        }
        Ok(Mesh { body, positions: self.positions, triangles, patches })
    }

    /// Adds the slabs up to the last section of `history`, with sections in between if walls meet.
    fn climb(
        &mut self,
        history: &[Section],
        added: bool,
        depth: u32,
        accepted: &mut Accepted,
    ) -> Result<(), LoftError> {
        let target = history.last().ok_or(LoftError::NoSection)?;
        let point = match self.attempt(target) {
            Ok(attempt) => {
                accepted.flipped += attempt.flipped;
                self.accept(attempt)?;
                self.section = Section { added, ..target.clone() };
                accepted.sections.push(self.section.clone());
                return Ok(());
            }
            Err(Refusal::Contact(point)) => point,
            Err(Refusal::Error(error)) => return Err(error),
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
        // If a section half way is not sound, the straight paths themselves meet.
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
        // Single precision may have no number between the two places.
        let z = metres(middle.z_um);
        if z <= self.front.z || z >= metres(target.z_um) {
            return Err(unmendable);
        }
        self.climb(&[middle], true, depth - 1, accepted)?;
        self.climb(history, added, depth - 1, accepted)
    }

    /// Builds and tests the slab up to `target`.
    fn attempt(&self, target: &Section) -> Result<Attempt, Refusal> {
        check_form(target)?;
        let z = metres(target.z_um);
        if z <= self.front.z || !z.is_finite() {
            return Err(Refusal::Error(LoftError::Order { step: target.step, z_um: target.z_um }));
        }
        let align = |k: usize, ring: &Ring, wall| align::align(&self.front.ids[k], &ring.ids, wall, target.step);
        let Alignment { turn, new_after } = align(0, &target.inner, Wall::Inner)?;
        let outer = align(1, &target.outer, Wall::Outer)?;
        let upper = joined(&exported(&target.inner, turn), &exported(&target.outer, outer.turn));
        let ids = [turned(&target.inner.ids, turn), turned(&target.outer.ids, outer.turn)];
        let (inner_points, outer_points) = self.front.rim.points.split_at(self.front.rim.inner);
        let lower = joined(&align::insert(inner_points, &new_after), &align::insert(outer_points, &outer.new_after));
        let mut new_after = new_after;
        new_after.extend(outer.new_after);

        let mut flipped = 0;
        let below = match &self.below {
            None => None,
            Some(below) => {
                let (mut slab, changed) = below.slab.refined(lower.clone(), &new_after);
                flipped += settle(&mut slab, &below.blocks, Some(&changed)).map_err(Refusal::Contact)?;
                Some(slab)
            }
        };
        let mut slab = Slab::new(lower, upper);
        let blocks = slab.blocks();
        flipped += settle(&mut slab, &blocks, None).map_err(Refusal::Contact)?;
        Ok(Attempt { new_after, below, slab, blocks, ids, z, flipped })
    }

    /// Makes a tested slab part of the surface; the slab below it is then final.
    fn accept(&mut self, attempt: Attempt) -> Result<(), LoftError> {
        let Attempt { new_after, below, slab, blocks, ids, z, .. } = attempt;
        let added = slab.lower.len() - self.front.rim.len() + slab.upper.len();
        if self.positions.len() + added > self.most {
            return Err(LoftError::TooLarge { most: self.most });
        }
        let mut lower = Vec::with_capacity(slab.lower.len());
        for (&vertex, &count) in self.front.vertices.iter().zip(&new_after) {
            lower.push(vertex);
            for _ in 0..count {
                let p = slab.lower.points[lower.len()];
                lower.push(self.positions.len() as u32);
                self.positions.push([p[0], p[1], self.front.z]);
            }
        }
        match (below, self.below.take()) {
            (Some(refined), Some(below)) => self.emit(&refined, &below.vertices, &lower),
            _ => {
                let mut isthmus = cap(&slab.lower, &lower, "isthmus")?;
                isthmus.iter_mut().for_each(|t| t.swap(1, 2));
                self.patches[CAP_ISTHMUS] = isthmus;
            }
        }
        let first = self.positions.len() as u32;
        self.positions.extend(slab.upper.points.iter().map(|p| [p[0], p[1], z]));
        let vertices = (first..self.positions.len() as u32).collect();
        let front = Front { rim: slab.upper.clone(), ids, vertices, z };
        self.front = front;
        self.below = Some(Below { slab, blocks, vertices: lower });
        Ok(())
    }

    /// Emits the triangles of a slab; the inner wall faces the lumen.
    fn emit(&mut self, slab: &Slab, lower: &[u32], upper: &[u32]) {
        let index = |id: usize| match id.checked_sub(lower.len()) {
            None => lower[id],
            Some(id) => upper[id],
        };
        for cell in 0..slab.len() {
            for k in 0..=slab.edges(cell) {
                let [a, b, c] = slab.triangle(cell, k, slab.diagonals[cell]).map(index);
                if cell < slab.lower.inner {
                    self.patches[INNER_WALL].push([a, c, b]);
                } else {
                    self.patches[OUTER_WALL].push([a, b, c]);
                }
            }
        }
    }
}

/// Checks the preconditions of the slab tests.
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

/// Closes an end: triangles facing up the tube.
pub(super) fn cap(rim: &Rim, vertices: &[u32], end: &'static str) -> Result<Vec<[u32; 3]>, LoftError> {
    let (inner, outer) = rim.points.split_at(rim.inner);
    let triangles = annulus(inner, outer).map_err(|source| LoftError::Cap { end, source })?;
    Ok(triangles.into_iter().map(|t| t.map(|i| vertices[i as usize])).collect())
}

/// Micrometres to metres as exported: computed in f64, rounded once.
pub(super) fn metres(um: f64) -> f32 {
    (um * 1e-6) as f32
}

/// The points of a ring as exported, from point `turn` on.
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
