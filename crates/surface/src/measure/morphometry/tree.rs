//! Folds by the shape tree of the tissue: its chordal axis (Prasad 1997).
//!
//! The tissue is triangulated with the points of its contours. Triangles that share an edge are
//! neighbours. Around the lumen they form a cycle, the wall, from which trees of triangles branch
//! off, the folds. The edge by which a tree joins the wall is the *base* of the fold, from the
//! bottom of the valley on one side to the bottom on the other side. The axis runs through the
//! midpoints of the edges between neighbours.

use super::shape::{Ellipse, Shape};
use super::spread::Spread;
use crate::geometry::polygon::signed_area;
use crate::geometry::predicates::widen2;
use crate::geometry::triangulate::{Linked, NO_NEIGHBOUR, perforated};
use crate::geometry::vector::{cross2, distance, dot, sub};
use serde::Serialize;

type P2 = [f64; 2];

/// Minimum height of a branch that counts, µm.
pub(super) const LEAST_HEIGHT_UM: f64 = 40.0;
/// Minimum height of a branch that counts, relative to the width of its base; a half circle has
/// 0.5.
pub(super) const LEAST_SLENDERNESS: f64 = 1.0;
/// Maximum height of a tip, in widths of its base. A tip has no axis, because the triangles of a
/// round tip may have any direction. Its height is the distance to its farthest point.
const TIP: f64 = 0.75;
/// Number of generations that are counted separately. The last one contains all further
/// generations.
pub(super) const GENERATIONS: usize = 4;

/// Folds of a section by the shape tree.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Folds {
    /// Branches by generation: primary folds, secondary folds on them, tertiary ones, and all
    /// further ones.
    pub branches: [u32; GENERATIONS],
    /// Primary folds by branching order, the number of generations that a fold has: 1, 2, 3, and 4
    /// or more.
    pub orders: [u32; GENERATIONS],
    /// Height of the primary folds, along their axis from the base to the farthest tip, µm.
    pub height_um: Option<Spread>,
    /// Angle between the axis of a primary fold, from the middle of its base to its farthest tip,
    /// and the direction from there to the centre of the tube, degrees. Median, weighted by height.
    pub angle_deg: Option<f64>,
    /// Deepest point of the lumen between each two neighbouring primary folds, µm.
    #[serde(skip)]
    pub(super) clefts: Vec<P2>,
}

impl Folds {
    /// Median branching order of the primary folds; the lower of two medians.
    pub(super) fn median_order(&self) -> Option<f64> {
        let folds: u32 = self.orders.iter().sum();
        let mut passed = 0;
        let median = self.orders.iter().position(|count| {
            passed += count;
            2 * passed >= folds
        });
        (folds > 0).then(|| median.map_or(0.0, |place| place as f64 + 1.0))
    }

    /// Mean branching order of the primary folds.
    pub(super) fn mean_order(&self) -> Option<f64> {
        let folds: u32 = self.orders.iter().sum();
        let sum: u32 = self.orders.iter().zip(1..).map(|(count, order)| count * order).sum();
        (folds > 0).then(|| f64::from(sum) / f64::from(folds))
    }
}

/// Tree of triangles, seen from the edge by which it is attached.
#[derive(Clone, Copy, Default)]
struct Branch {
    height: f64,
    /// End of the axis at the farthest tip.
    end: P2,
    /// Branches by generation, including this one.
    branches: [u32; GENERATIONS],
    /// True if the branch is only a tip: all of it lies within [`TIP`] widths of its base from the
    /// midpoint of the base.
    tip: bool,
}

impl Branch {
    fn order(&self) -> usize {
        self.branches.iter().take_while(|&&count| count > 0).count().max(1)
    }
}

/// Folds of a section; `None` if its tissue cannot be triangulated. Islands have no folds.
pub(super) fn folds(shape: &Shape<'_>, ellipse: &Ellipse) -> Option<Folds> {
    let holes: Vec<&[[f32; 2]]> = shape.lumen.iter().copied().filter(|ring| signed_area(ring) > 0.0).collect();
    let tissue = perforated(&holes, shape.outer).ok()?;
    let points: Vec<P2> = holes.iter().copied().chain([shape.outer]).flatten().map(|&p| widen2(p)).collect();
    let lengths = holes.iter().map(|ring| ring.len()).chain([shape.outer.len()]);
    let rings: Vec<u32> = std::iter::once(0)
        .chain(lengths.scan(0, |end, length| {
            *end += length as u32;
            Some(*end)
        }))
        .collect();
    let mucosa = rings[holes.len()];
    let mut trees =
        Trees { tissue: &tissue, points: &points, rings: &rings, branch: vec![None; tissue.triangles.len()] };
    trees.peel();
    let none = [0; GENERATIONS];
    let mut folds = Folds { branches: none, orders: none, height_um: None, angle_deg: None, clefts: Vec::new() };
    let (mut heights, mut angles, mut bases) = (Vec::new(), Vec::new(), Vec::new());
    for (t, neighbours) in tissue.neighbours.iter().enumerate().filter(|&(t, _)| trees.branch[t].is_none()) {
        for (side, &neighbour) in neighbours.iter().enumerate() {
            let branch = trees.branch.get(neighbour as usize).copied().flatten();
            let Some(branch) = branch.filter(|branch| trees.counts(t, side, branch)) else { continue };
            if trees.side(t, side).iter().all(|&point| point < mucosa) {
                heights.push(branch.height as f32);
                let base = trees.middle(t, side);
                let (axis, inward) = (sub(branch.end, base), sub(ellipse.centre, base));
                angles.push((cross2(axis, inward).atan2(dot(axis, inward)).abs().to_degrees(), branch.height));
                let [to, from] = trees.side(t, side);
                bases.push([from, to]);
                folds.orders[branch.order() - 1] += 1;
                folds.branches.iter_mut().zip(branch.branches).for_each(|(sum, count)| *sum += count);
            }
        }
    }
    folds.height_um = Spread::of(heights);
    folds.angle_deg = weighted_median(angles);
    folds.clefts = trees.clefts(bases, |point| ellipse.radius(points[point as usize].map(|x| x as f32)));
    Some(folds)
}

/// Smallest value up to which half of the weight lies.
fn weighted_median(mut values: Vec<(f64, f64)>) -> Option<f64> {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = values.iter().map(|(_, weight)| weight).sum();
    let mut passed = 0.0;
    let mut reached = values.iter().filter(|(_, weight)| {
        passed += weight;
        2.0 * passed >= total
    });
    reached.next().map(|(value, _)| *value)
}

struct Trees<'a> {
    tissue: &'a Linked,
    points: &'a [P2],
    /// First point of each contour, and the end.
    rings: &'a [u32],
    /// Tree attached to each triangle, seen from its edge towards the wall; `None` for triangles of
    /// the wall.
    branch: Vec<Option<Branch>>,
}

impl Trees<'_> {
    /// Removes triangles with one neighbour until none is left. The cycles around the lumen remain.
    fn peel(&mut self) {
        let mut left: Vec<u8> =
            self.tissue.neighbours.iter().map(|n| n.iter().filter(|&&n| n != NO_NEIGHBOUR).count() as u8).collect();
        let mut ends: Vec<u32> = (0..left.len() as u32).filter(|&t| left[t as usize] == 1).collect();
        while let Some(t) = ends.pop() {
            let neighbours = self.tissue.neighbours[t as usize];
            let is_left = |&n: &u32| n != NO_NEIGHBOUR && self.branch[n as usize].is_none();
            let Some(toward) = neighbours.iter().position(is_left) else { continue };
            self.branch[t as usize] = Some(self.join(t as usize, toward));
            let next = neighbours[toward];
            left[next as usize] -= 1;
            if left[next as usize] == 1 {
                ends.push(next);
            }
        }
    }

    /// Tree of a triangle whose other neighbours have been removed.
    fn join(&self, t: usize, toward: usize) -> Branch {
        let base = self.middle(t, toward);
        let mut above: Vec<(usize, Branch)> = Vec::with_capacity(2);
        for side in [(toward + 1) % 3, (toward + 2) % 3] {
            let neighbour = self.tissue.neighbours[t][side];
            above.extend(self.branch.get(neighbour as usize).copied().flatten().map(|branch| (side, branch)));
        }
        let reach = |(side, branch): (usize, Branch)| branch.height + distance(base, self.middle(t, side));
        let mut branch = match above[..] {
            [only] => Branch { height: reach(only), ..only.1 },
            [first, second] => {
                let (main, other) = if reach(first) >= reach(second) { (first, second) } else { (second, first) };
                let mut branches = main.1.branches;
                if self.counts(t, other.0, &other.1) {
                    for (generation, count) in other.1.branches.into_iter().enumerate() {
                        branches[(generation + 1).min(GENERATIONS - 1)] += count;
                    }
                }
                Branch { height: reach(main), end: main.1.end, branches, tip: main.1.tip && other.1.tip }
            }
            _ => {
                let mut branches = [0; GENERATIONS];
                branches[0] = 1;
                let apex = self.points[self.tissue.triangles[t][(toward + 2) % 3] as usize];
                Branch { height: distance(base, apex), end: apex, branches, tip: true }
            }
        };
        if branch.tip {
            let [a, b] = self.side(t, toward);
            let places = self.arc(a, b).map(|p| self.points[p as usize]);
            let far = places.map(|p| (distance(base, p), p));
            let (farthest, end) = far.fold((0.0, base), |most, one| if one.0 > most.0 { one } else { most });
            let width = distance(self.points[a as usize], self.points[b as usize]);
            branch.tip = farthest <= TIP * width;
            if branch.tip {
                (branch.height, branch.end) = (farthest, end);
            }
        }
        branch
    }

    /// Points of a contour from one to another, in its order. Between the ends of a base these are
    /// the points of its tree.
    fn arc(&self, from: u32, to: u32) -> impl Iterator<Item = u32> + use<'_> {
        let ring = self.rings.partition_point(|&start| start <= from);
        let (start, end) = (self.rings[ring - 1], self.rings[ring]);
        let count = if to >= from { to - from } else { end - from + to - start };
        (0..=count).map(move |k| if from + k < end { from + k } else { from + k - end + start })
    }

    /// Deepest point between each two neighbouring folds of a contour, that with the largest
    /// `depth`. A base is given by the first and the last point of its fold.
    fn clefts(&self, mut bases: Vec<[u32; 2]>, depth: impl Fn(u32) -> f64) -> Vec<P2> {
        bases.sort_unstable();
        let ring = |base: &[u32; 2]| self.rings.partition_point(|&start| start <= base[0]);
        let of_rings = bases.chunk_by(|a, b| ring(a) == ring(b));
        let pairs = of_rings.flat_map(|own| (0..own.len()).map(|i| (own[i][1], own[(i + 1) % own.len()][0])));
        let deepest = pairs.filter_map(|(from, to)| self.arc(from, to).max_by(|&a, &b| depth(a).total_cmp(&depth(b))));
        deepest.map(|point| self.points[point as usize]).collect()
    }

    /// True if a tree on a side of a triangle is high enough to count.
    fn counts(&self, t: usize, side: usize, branch: &Branch) -> bool {
        let [a, b] = self.side(t, side).map(|p| self.points[p as usize]);
        branch.height >= LEAST_HEIGHT_UM.max(LEAST_SLENDERNESS * distance(a, b))
    }

    fn side(&self, t: usize, side: usize) -> [u32; 2] {
        let corners = self.tissue.triangles[t];
        [corners[side], corners[(side + 1) % 3]]
    }

    fn middle(&self, t: usize, side: usize) -> P2 {
        let [a, b] = self.side(t, side).map(|p| self.points[p as usize]);
        [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0]
    }
}
