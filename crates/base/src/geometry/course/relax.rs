//! Changes a course until there is room for the tube.
//!
//! A course is given by its curvature, a vector in rotation-minimising frames. What is above the greatest curvature that is allowed is
//! spread over neighbouring places, so that a bend keeps its angle and becomes longer; if parts still come too near to each other,
//! all curvature is reduced. Without curvature the course is straight and has room, so this ends.

use super::{Course, Room};
use glam::{DQuat, DVec2, DVec3};

/// Nodes of the course for each place at which its curvature is changed.
const COARSE: usize = 4;
/// Steps in which all curvature is reduced.
const STEPS: u32 = 50;
/// Part of the allowed curvature that is used, as the spline through the new nodes is not exactly the same curve.
const MARGIN: f64 = 0.97;
/// Most rounds of spreading, and the excess, as a part of what is allowed, at which it ends.
const ROUNDS: u32 = 4000;
const NEGLIGIBLE: f64 = 1e-3;

/// What a relaxed course must keep.
pub struct Relaxation<'a> {
    /// Radius of the tube at a place.
    pub radius: &'a dyn Fn(f64) -> f64,
    /// Greatest radius of the tube over that of the curve.
    pub share: f64,
    /// Least distance of far parts.
    pub distance: f64,
}

impl Relaxation<'_> {
    fn is_met(&self, room: &Room) -> bool {
        room.bend.share() <= self.share && room.near.is_none_or(|near| near.distance >= self.distance)
    }
}

impl Course {
    /// A course near this one, of the same length, that has room.
    #[must_use]
    pub fn relaxed(&self, to: &Relaxation<'_>) -> Self {
        let nodes = self.places().len() - 1;
        let count = nodes.div_ceil(COARSE);
        let step = self.length() / count as f64;
        let middle = |i: usize| step * (i as f64 + 0.5);
        let bends: Vec<DVec2> = (0..count).map(|i| self.bend(step * i as f64, step * (i + 1) as f64)).collect();
        let most: Vec<f64> = (0..count).map(|i| MARGIN * to.share / (to.radius)(middle(i))).collect();
        for part in (0..=STEPS).rev() {
            let scale = f64::from(part) / f64::from(STEPS);
            let bends = spread(bends.iter().map(|bend| *bend * scale).collect(), &most);
            let points = self.integrate(&bends, step);
            if let Some(found) = Self::through(&points, self.length(), nodes, self.twist)
                && (part == 0 || to.is_met(&found.room(to.radius)))
            {
                return found;
            }
        }
        self.clone()
    }

    /// The mean curvature between two places, by the frame at the first.
    fn bend(&self, from: f64, to: f64) -> DVec2 {
        let ((tangent, u), (next, _)) = (self.untwisted(from), self.untwisted(to));
        let off = DVec2::new(next.dot(u), next.dot(tangent.cross(u)));
        let angle = tangent.angle_between(next);
        off.normalize_or_zero() * (angle / (to - from))
    }

    /// Points of the curve with these curvatures that begins as this one.
    fn integrate(&self, bends: &[DVec2], step: f64) -> Vec<DVec3> {
        let (mut tangent, mut u) = self.untwisted(0.0);
        let mut at = self.at(0.0).origin;
        let mut points = vec![at];
        for bend in bends {
            let v = tangent.cross(u);
            let angle = bend.length() * step;
            if angle > 0.0 {
                let axis = tangent.cross(u * bend.x + v * bend.y).normalize();
                // The chord of the arc.
                at += DQuat::from_axis_angle(axis, 0.5 * angle)
                    * tangent
                    * (step * libm::sin(0.5 * angle) / (0.5 * angle));
                let turn = DQuat::from_axis_angle(axis, angle);
                (tangent, u) = ((turn * tangent).normalize(), turn * u);
                u = (u - tangent * u.dot(tangent)).normalize();
            } else {
                at += tangent * step;
            }
            points.push(at);
        }
        points
    }
}

/// Moves what is above the greatest curvatures to the neighbours, half to each.
fn spread(mut bends: Vec<DVec2>, most: &[f64]) -> Vec<DVec2> {
    let mut given = vec![DVec2::ZERO; bends.len()];
    for _ in 0..ROUNDS {
        let mut is_done = true;
        given.fill(DVec2::ZERO);
        for i in 0..bends.len() {
            let length = bends[i].length();
            if length > most[i] {
                is_done &= length <= (1.0 + NEGLIGIBLE) * most[i];
                let kept = bends[i] * (most[i] / length);
                let excess = bends[i] - kept;
                given[i] -= excess;
                for neighbour in
                    [i.checked_sub(1), Some(i + 1).filter(|&next| next < bends.len())].into_iter().flatten()
                {
                    given[neighbour] += 0.5 * excess;
                }
            }
        }
        bends.iter_mut().zip(&given).for_each(|(bend, given)| *bend += *given);
        if is_done {
            break;
        }
    }
    let kept: Vec<DVec2> = bends.iter().zip(most).map(|(bend, most)| bend.clamp_length_max(*most)).collect();
    smoothed(&kept)
}

/// Means of neighbours: a spline overshoots where its curvature jumps.
fn smoothed(bends: &[DVec2]) -> Vec<DVec2> {
    let at = |i: usize| bends[i.min(bends.len() - 1)];
    (0..bends.len()).map(|i| 0.25 * at(i.saturating_sub(1)) + 0.5 * at(i) + 0.25 * at(i + 1)).collect()
}
