//! Folds on a ring: where the boundary of the lumen crosses an ellipse, and how folds continue
//! along the tube.

use super::shape::{Ellipse, Shape};
use crate::geometry::vector::{cross2, dot, norm};
use crate::model::Section;

/// The ring, as a fraction of the base ellipse.
pub(super) const SHARE: f64 = 0.75;

/// Number of folds that cross the ring: runs of the boundary of the lumen inside the ring.
pub(super) fn count(shape: &Shape<'_>, base: &Ellipse) -> u32 {
    let reach = SHARE * base.semi_major;
    let crossings = |ring: &&[[f32; 2]]| {
        let inside: Vec<bool> = ring.iter().map(|&p| base.radius(p) < reach).collect();
        (0..inside.len()).filter(|&i| inside[i] && !inside[(i + 1) % inside.len()]).count()
    };
    shape.lumen.iter().map(|ring| crossings(ring) as u32).sum()
}

/// Change of the inner contour from one section to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step {
    /// Fraction of the folds that continue as one fold each; `None` without folds.
    pub(super) continued: Option<f64>,
    /// Angle of the rotation around the centre that brings the points nearest to their next places
    /// (least squares), from x towards y positive, radians.
    pub(super) turn: f64,
}

/// Inner contour of a section, prepared for the comparison with the next section.
pub(super) struct Marked<'a> {
    ids: &'a [u32],
    /// Fold on the ring (or [`NO_FOLD`]) and position in the flattened plane of each point.
    points: Vec<(u32, [f64; 2])>,
    folds: u32,
}

const NO_FOLD: u32 = u32::MAX;

impl<'a> Marked<'a> {
    pub(super) fn new(section: &'a Section, base: &Ellipse) -> Self {
        let reach = SHARE * base.semi_major;
        let places: Vec<[f64; 2]> = section.inner.points.iter().map(|&p| base.flattened(p)).collect();
        let mut points: Vec<(u32, [f64; 2])> = places.iter().map(|&place| (NO_FOLD, place)).collect();
        let n = places.len();
        let inside: Vec<bool> = places.iter().map(|&place| norm(place) < reach).collect();
        // Starts outside of the ring, so that no fold is divided.
        let start = inside.iter().position(|is_inside| !is_inside).unwrap_or(0);
        let mut folds = 0;
        for k in (start..n).chain(0..start).filter(|&k| inside[k]) {
            folds += u32::from(k == start || !inside[(k + n - 1) % n]);
            points[k].0 = folds - 1;
        }
        Self { ids: &section.inner.ids, points, folds }
    }

    /// Compares with the next section. A fold continues in another fold if most of its points that
    /// lie in any fold of the next section lie in that one, and vice versa.
    pub(super) fn step(&self, next: &Self) -> Step {
        let (mut pairs, mut turn) = (Vec::new(), [0.0; 2]);
        let mut following = 0;
        for (id, &(fold, at)) in self.ids.iter().zip(&self.points) {
            // Points keep their order along the contour, and new ones lie between them.
            let Some(place) = position_from(next.ids, following, *id) else { continue };
            following = place + 1;
            let (other, to) = next.points[place];
            turn[0] += cross2(at, to);
            turn[1] += dot(at, to);
            if fold != NO_FOLD && other != NO_FOLD {
                add(&mut pairs, [fold, other]);
            }
        }
        let forth = most(&mut pairs, self.folds);
        pairs.iter_mut().for_each(|(pair, _)| pair.reverse());
        let back = most(&mut pairs, next.folds);
        let continues = |(fold, other): (usize, &u32)| back.get(*other as usize) == Some(&(fold as u32));
        let continued = forth.iter().enumerate().filter(|&pair| continues(pair)).count();
        Step {
            continued: (self.folds > 0).then(|| continued as f64 / f64::from(self.folds)),
            turn: libm::atan2(turn[0], turn[1]),
        }
    }
}

/// Index of an id, looked for from `start` on and then from the beginning.
fn position_from(ids: &[u32], start: usize, id: u32) -> Option<usize> {
    let (before, after) = ids.split_at(start.min(ids.len()));
    let ahead = after.iter().position(|&other| other == id).map(|k| before.len() + k);
    ahead.or_else(|| before.iter().position(|&other| other == id))
}

/// Pairs of folds with the number of their common points.
type Pairs = Vec<([u32; 2], u32)>;

/// Adds a point to the last pair, or a new pair.
fn add(pairs: &mut Pairs, pair: [u32; 2]) {
    match pairs.last_mut() {
        Some(last) if last.0 == pair => last.1 += 1,
        _ => pairs.push((pair, 1)),
    }
}

/// Returns for each first member its most frequent second member, or [`NO_FOLD`].
fn most(pairs: &mut Pairs, firsts: u32) -> Vec<u32> {
    pairs.sort_unstable();
    let mut best = vec![(0, NO_FOLD); firsts as usize];
    for same in pairs.chunk_by(|a, b| a.0 == b.0) {
        let [first, second] = same[0].0;
        let (found, points) = (&mut best[first as usize], same.iter().map(|(_, points)| points).sum());
        if points > found.0 {
            *found = (points, second);
        }
    }
    best.into_iter().map(|(_, second)| second).collect()
}
