//! Levels of a lofted surface, from its rows and columns.
//!
//! A level consists of vertices of the full surface, which two rules choose for a tolerance:
//!
//! - Rows ([`sagitta`]): where a row is within the tolerance of the straight lines between two
//!   other rows, along their columns, it has no vertices.
//! - Contours ([`contour`]): elsewhere, the chords between consecutive vertices of a row are within
//!   the tolerance of the vertices that they skip.
//!
//! The tolerance of the outer wall is limited by its width.
//!
//! The vertices are joined row by row, in the order of their columns ([`strips`]). The first and the
//! last row keep all vertices, so that the patches at the ends stay unchanged. The tolerance is the
//! one that leads to the number of triangles of the level ([`search`]).
//!
//! Edges across a strip deviate more than the tolerance where the surface is twisted, so the
//! distance of a level is measured.

mod contour;
mod sagitta;
mod search;
mod strips;

use super::full::{PatchTriangles, all_triangles};
use crate::model::{Mesh, Patch, PatchKind, RowRuns, Rows, WallRows};
use contour::{Choice, Kept};
use rayon::prelude::*;
use sagitta::Sagittas;
use search::Search;
use std::borrow::Cow;
use strips::{Strips, Surface};

/// First tolerance that is tried, m.
const FIRST: f64 = 4e-6;
/// Maximum tolerance of the outer wall as a part of its width, because its outline is in view.
const OUTLINE: f64 = 1e-3;
/// Estimates of the number of triangles consider every fifth row. The rows of all ranks (see
/// [`sagitta`]) are among them.
const SAMPLED: usize = 5;
/// Maximum number of estimates, and the precision at which they end.
const ESTIMATES: usize = 8;
const PRECISION: f64 = 0.02;
/// Least part of its number of triangles that a level should have, and the number of surfaces after
/// which the best one is taken in any case.
const LEAST: f64 = 0.95;
const TRIES: usize = 4;

/// Walls in the order of [`Rows::walls`].
const WALLS: [PatchKind; 2] = [PatchKind::InnerWall, PatchKind::OuterWall];

/// Triangles of the inner and of the outer wall.
type WallTriangles = Vec<Vec<[u32; 3]>>;

/// A lofted surface that can be thinned.
pub(super) struct Thinning<'a> {
    mesh: &'a Mesh,
    walls: Vec<Wall<'a>>,
    /// Number of triangles of the ends.
    ends: usize,
}

struct Wall<'a> {
    positions: &'a [[f32; 3]],
    rows: WallRows,
    sagittas: Sagittas,
    is_inner: bool,
    /// Maximum tolerance, m.
    coarsest: f64,
}

impl<'a> Thinning<'a> {
    pub(super) fn new(mesh: &'a Mesh, rows: &Rows) -> Self {
        let of_wall = |(kind, runs): (PatchKind, &RowRuns)| {
            let wall = runs.expanded();
            Wall {
                positions: &mesh.positions,
                sagittas: Sagittas::new(&mesh.positions, &wall, &rows.z),
                is_inner: kind == PatchKind::InnerWall,
                coarsest: if kind == PatchKind::OuterWall { OUTLINE * width(mesh, &wall) } else { f64::INFINITY },
                rows: wall,
            }
        };
        let walls = WALLS.into_iter().zip(&rows.walls).map(of_wall).collect();
        let ends = mesh.patches.iter().filter(|patch| !patch.kind.is_wall()).map(|patch| patch.triangles.len()).sum();
        Self { mesh, walls, ends }
    }

    /// A level of at most `target` triangles, or of all. The walls have at least half of them, however many
    /// triangles the ends have.
    pub(super) fn level(&self, target: usize) -> PatchTriangles<'a> {
        if target >= self.mesh.triangles.len() {
            return all_triangles(self.mesh);
        }
        let mut walls = self.within(target.saturating_sub(self.ends).max(target / 2)).into_iter();
        let of_patch = |patch: &Patch| -> Cow<'a, [[u32; 3]]> {
            if patch.kind.is_wall() {
                walls.next().expect("a loft has two walls").into()
            } else {
                Cow::Borrowed(&self.mesh.triangles[patch.triangles.clone()])
            }
        };
        self.mesh.patches.iter().filter(|patch| !patch.triangles.is_empty()).map(of_patch).collect()
    }

    /// Walls of at most `most` triangles, or of as few as possible.
    fn within(&self, most: usize) -> WallTriangles {
        let goal = most as f64 * (1.0 + LEAST) / 2.0;
        let mut search = Search::new(self.estimate(goal), goal);
        let mut best: Option<WallTriangles> = None;
        for tried in 1.. {
            let (walls, is_last) = (self.build(search.tolerance), search.is_at_end());
            let count = count(&walls);
            search.add(count as f64);
            if is_last || count <= most && best.as_ref().is_none_or(|best| self::count(best) < count) {
                best = Some(walls);
            }
            let is_good = count <= most && count as f64 >= most as f64 * LEAST;
            match best {
                Some(best) if is_good || is_last || tried >= TRIES => return best,
                _ => {}
            }
        }
        unreachable!("the search ends")
    }

    /// The tolerance for a number of triangles, estimated from some of the rows.
    fn estimate(&self, goal: f64) -> f64 {
        let mut search = Search::new(FIRST, goal);
        for _ in 0..ESTIMATES {
            let count: usize = self.walls.par_iter().map(|wall| wall.estimated_triangles(search.tolerance)).sum();
            if (count as f64 / goal - 1.0).abs() < PRECISION {
                break;
            }
            search.add(count as f64);
        }
        search.tolerance
    }

    fn build(&self, tolerance: f64) -> WallTriangles {
        self.walls.par_iter().map(|wall| wall.build(tolerance)).collect()
    }
}

/// Number of triangles.
fn count(walls: &WallTriangles) -> usize {
    walls.iter().map(Vec::len).sum()
}

/// The largest extent of a row, m.
fn width(mesh: &Mesh, rows: &WallRows) -> f64 {
    let extent = |row: usize, axis: usize| {
        let places = rows.row(row).vertices.iter().map(|&v| f64::from(mesh.positions[v as usize][axis]));
        let (low, high) = places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        high - low
    };
    (0..rows.len()).flat_map(|row| (0..3).map(move |axis| extent(row, axis))).fold(0.0, f64::max)
}

impl Wall<'_> {
    fn choice(&self, tolerance: f64) -> Choice {
        Choice { tolerance: tolerance.min(self.coarsest) }
    }

    /// Number of triangles, estimated from some of the rows without regard to the others.
    fn estimated_triangles(&self, tolerance: f64) -> usize {
        let choice = self.choice(tolerance);
        let last = self.rows.len() - 1;
        let ends = self.rows.row(0).len() + self.rows.row(last).len();
        let of_row = |row: usize| choice.estimated(self.positions, self.rows.row(row), self.sagittas.of_row(row));
        ends + 2 * SAMPLED * (1..last).step_by(SAMPLED).map(of_row).sum::<usize>()
    }

    /// Joins the kept vertices of all rows.
    fn build(&self, tolerance: f64) -> Vec<[u32; 3]> {
        let choice = self.choice(tolerance);
        let surface = Surface { positions: self.positions, rows: &self.rows };
        let mut strips = Strips::new(&surface);
        let last = self.rows.len() - 1;
        for row in 1..last {
            let sagittas = self.sagittas.of_row(row);
            let kept = choice.of_row(self.positions, self.rows.row(row), sagittas, strips.front_columns());
            strips.add(&surface, row, &kept);
        }
        strips.add(&surface, last, &Kept::Whole((0..self.rows.row(last).len()).collect()));
        let mut triangles = strips.triangles;
        if self.is_inner {
            triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        triangles
    }
}

#[cfg(test)]
mod tests;
