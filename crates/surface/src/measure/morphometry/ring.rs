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
    /// Mean angle by which the points turn around the centre, from x towards y positive, radians.
    pub(super) turn: f64,
}

/// Inner contour of a section, prepared for the comparison with the next section.
pub(super) struct Marked {
    /// Id, fold on the ring (or [`NO_FOLD`]) and position in the flattened plane of each point,
    /// sorted by id.
    points: Vec<(u32, u32, [f64; 2])>,
    folds: u32,
}

const NO_FOLD: u32 = u32::MAX;

impl Marked {
    pub(super) fn new(section: &Section, base: &Ellipse) -> Self {
        let reach = SHARE * base.semi_major;
        let places: Vec<[f64; 2]> = section.inner.points.iter().map(|&p| base.flattened(p)).collect();
        let n = places.len();
        let inside = |i: usize| norm(places[i % n]) < reach;
        // Starts outside of the ring, so that no fold is divided.
        let start = (0..n).find(|&i| !inside(i)).unwrap_or(0);
        let (mut folds, mut points) = (0, Vec::with_capacity(n));
        for i in start..start + n {
            let within = inside(i);
            if within && (i == start || !inside(i - 1)) {
                folds += 1;
            }
            let k = i % n;
            points.push((section.inner.ids[k], if within { folds - 1 } else { NO_FOLD }, places[k]));
        }
        points.sort_unstable_by_key(|&(id, ..)| id);
        Self { points, folds }
    }

    /// Compares with the next section. A fold continues in another fold if most of its points that
    /// lie in any fold of the next section lie in that one, and vice versa.
    pub(super) fn step(&self, next: &Self) -> Step {
        let (mut pairs, mut turn, mut weight) = (Vec::new(), 0.0, 0.0);
        let mut others = next.points.iter().peekable();
        for &(id, fold, at) in &self.points {
            while others.next_if(|other| other.0 < id).is_some() {}
            let Some(&&(_, other, to)) = others.peek().filter(|other| other.0 == id) else { continue };
            let angle = cross2(at, to).atan2(dot(at, to));
            let mass = dot(at, at);
            turn += mass * angle;
            weight += mass;
            if fold != NO_FOLD && other != NO_FOLD {
                pairs.push((fold, other));
            }
        }
        let forth = most(&mut pairs, self.folds);
        pairs.iter_mut().for_each(|(a, b)| std::mem::swap(a, b));
        let back = most(&mut pairs, next.folds);
        let continues = |(fold, other): (usize, &u32)| back.get(*other as usize) == Some(&(fold as u32));
        let continued = forth.iter().enumerate().filter(|&pair| continues(pair)).count();
        Step {
            continued: (self.folds > 0).then(|| continued as f64 / f64::from(self.folds)),
            turn: if weight > 0.0 { turn / weight } else { 0.0 },
        }
    }
}

/// Returns for each first member its most frequent second member, or [`NO_FOLD`].
fn most(pairs: &mut [(u32, u32)], firsts: u32) -> Vec<u32> {
    pairs.sort_unstable();
    let mut best = vec![(0, NO_FOLD); firsts as usize];
    for same in pairs.chunk_by(|a, b| a == b) {
        let (first, second) = same[0];
        let found = &mut best[first as usize];
        if same.len() > found.0 {
            *found = (same.len(), second);
        }
    }
    best.into_iter().map(|(_, second)| second).collect()
}
