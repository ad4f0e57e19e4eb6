//! Folds on a ring: where the boundary of the lumen crosses an ellipse, and how folds continue along the tube.

use super::shape::{Ellipse, Shape, distance};
use crate::model::Section;

/// The ring: this part of the base ellipse.
pub(super) const SHARE: f64 = 0.75;

/// Folds that cross the ring: the runs of the boundary of the lumen within it.
pub(super) fn count(shape: &Shape<'_>, base: &Ellipse) -> u32 {
    let reach = SHARE * base.semi_major;
    let crossings = |ring: &&[[f32; 2]]| {
        let inside: Vec<bool> = ring.iter().map(|&p| base.radius(p) < reach).collect();
        (0..inside.len()).filter(|&i| inside[i] && !inside[(i + 1) % inside.len()]).count()
    };
    shape.lumen.iter().map(|ring| crossings(ring) as u32).sum()
}

/// How the inner contour of one section continues in the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step {
    /// Part of the folds that continue as one fold each; none without folds.
    pub(super) continued: Option<f64>,
    /// Mean angle by which the points turn around the centre, in the sense from x to y, radians.
    pub(super) turn: f64,
}

/// The inner contour of a section, prepared to be compared with the next.
pub(super) struct Marked {
    /// Id, fold on the ring (or [`NO_FOLD`]), and position in the flattened plane of each point, in the order of ids.
    points: Vec<(u32, u32, [f64; 2])>,
    folds: u32,
}

const NO_FOLD: u32 = u32::MAX;

impl Marked {
    pub(super) fn new(section: &Section, base: &Ellipse) -> Self {
        let reach = SHARE * base.semi_major;
        let places: Vec<[f64; 2]> = section.inner.points.iter().map(|&p| base.flattened(p)).collect();
        let n = places.len();
        let inside = |i: usize| distance(places[i % n], [0.0; 2]) < reach;
        // Begins outside of the ring, so that no fold is divided.
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

    /// A fold continues in another if most of its points that lie in any fold of the next section lie in that one, and
    /// the other way round.
    pub(super) fn step(&self, next: &Self) -> Step {
        let (mut pairs, mut turn, mut weight) = (Vec::new(), 0.0, 0.0);
        let mut others = next.points.iter().peekable();
        for &(id, fold, at) in &self.points {
            while others.next_if(|other| other.0 < id).is_some() {}
            let Some(&&(_, other, to)) = others.peek().filter(|other| other.0 == id) else { continue };
            let angle = (at[0] * to[1] - at[1] * to[0]).atan2(at[0] * to[0] + at[1] * to[1]);
            let mass = at[0] * at[0] + at[1] * at[1];
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

/// For each first member its most frequent second one, or [`NO_FOLD`].
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
