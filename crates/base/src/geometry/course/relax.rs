//! Changes a course until there is room for the tube.
//!
//! A course is described by its curvature, a vector in rotation-minimising frames. Curvature above
//! the limit is spread over neighbouring places, so a bend keeps its angle and becomes longer. If
//! distant parts are still too close, all curvature is scaled down. A course without curvature is
//! straight and has room, so the search ends.

use super::integrate::{Heading, integrate};
use super::{Course, Room};
use glam::DVec2;

const NODES_PER_BEND: usize = 4;
/// Number of scales tried, from 1 down to 0.
const SCALE_STEPS: u32 = 50;
/// Fraction of the curvature limit that is used. The spline through the new nodes deviates slightly
/// from the integrated curve.
const CURVATURE_MARGIN: f64 = 0.97;
/// Spreading stops after this many rounds, or when no curvature exceeds its limit by more than this
/// fraction.
const MAX_SPREAD_ROUNDS: u32 = 4000;
const NEGLIGIBLE_EXCESS: f64 = 1e-3;

/// Conditions for a relaxed course.
pub struct Relaxation<'a> {
    /// Radius of the tube at a place.
    pub radius: &'a dyn Fn(f64) -> f64,
    /// Maximum of [`Bend::radius_ratio`](super::Bend::radius_ratio).
    pub max_radius_ratio: f64,
    /// Minimum distance between distant parts of the tube.
    pub min_distance: f64,
}

impl Relaxation<'_> {
    fn is_met(&self, room: &Room) -> bool {
        room.bend.radius_ratio() <= self.max_radius_ratio
            && room.near.is_none_or(|near| near.distance >= self.min_distance)
    }
}

impl Course {
    /// Course of the same length, as similar to this one as the conditions permit.
    #[must_use]
    pub fn relaxed(&self, to: &Relaxation<'_>) -> Self {
        let nodes = self.places().len() - 1;
        let count = nodes.div_ceil(NODES_PER_BEND);
        let step = self.length() / count as f64;
        let middle = |i: usize| step * (i as f64 + 0.5);
        let bends: Vec<DVec2> = (0..count).map(|i| self.bend(step * i as f64, step * (i + 1) as f64)).collect();
        let limits: Vec<f64> =
            (0..count).map(|i| CURVATURE_MARGIN * to.max_radius_ratio / (to.radius)(middle(i))).collect();
        let (tangent, u) = self.untwisted(0.0);
        let begin = Heading { at: self.at(0.0).origin, tangent, u };
        for part in (0..=SCALE_STEPS).rev() {
            let scale = f64::from(part) / f64::from(SCALE_STEPS);
            let bends = spread(bends.iter().map(|bend| *bend * scale).collect(), &limits);
            let points = integrate(begin, bends, step);
            if let Some(found) = Self::through(&points, self.length(), nodes, self.twist)
                && (part == 0 || to.is_met(&found.room(to.radius)))
            {
                return found;
            }
        }
        self.clone()
    }

    /// Mean curvature between two places, in the frame at `from`.
    fn bend(&self, from: f64, to: f64) -> DVec2 {
        let ((tangent, u), (next, _)) = (self.untwisted(from), self.untwisted(to));
        let off = DVec2::new(next.dot(u), next.dot(tangent.cross(u)));
        let angle = tangent.angle_between(next);
        off.normalize_or_zero() * (angle / (to - from))
    }
}

/// Moves curvature above the limits to the neighbours, half to each, and smooths the result.
fn spread(mut bends: Vec<DVec2>, limits: &[f64]) -> Vec<DVec2> {
    let mut moved = vec![DVec2::ZERO; bends.len()];
    for _ in 0..MAX_SPREAD_ROUNDS {
        let mut is_done = true;
        moved.fill(DVec2::ZERO);
        for i in 0..bends.len() {
            let length = bends[i].length();
            if length > limits[i] {
                is_done &= length <= (1.0 + NEGLIGIBLE_EXCESS) * limits[i];
                let kept = bends[i] * (limits[i] / length);
                let excess = bends[i] - kept;
                moved[i] -= excess;
                for neighbour in
                    [i.checked_sub(1), Some(i + 1).filter(|&next| next < bends.len())].into_iter().flatten()
                {
                    moved[neighbour] += 0.5 * excess;
                }
            }
        }
        bends.iter_mut().zip(&moved).for_each(|(bend, moved)| *bend += *moved);
        if is_done {
            break;
        }
    }
    let kept: Vec<DVec2> = bends.iter().zip(limits).map(|(bend, limit)| bend.clamp_length_max(*limit)).collect();
    smoothed(&kept)
}

/// Weighted means of neighbours. A spline overshoots where its curvature jumps.
fn smoothed(bends: &[DVec2]) -> Vec<DVec2> {
    let at = |i: usize| bends[i.min(bends.len() - 1)];
    (0..bends.len()).map(|i| 0.25 * at(i.saturating_sub(1)) + 0.5 * at(i) + 0.25 * at(i + 1)).collect()
}
