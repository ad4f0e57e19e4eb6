//! Rounds corners that are still sharp, where the point at the corner could not move far enough: it moves on toward the line between
//! its neighbours, and they move the other way, round by round.
//!
//! Both ends of an edge may move here, so points move by less than a quarter of their clearance. Moves are zero for a corner that is
//! only just not sharp, and end where the contour would leave its greatest distance, so the result stays a continuous function of the
//! section.

use super::clearance::clearances;
use super::vector::{Point, angle, length, minus};
use crate::model::{Ring, Section};

/// The turn from which a corner is sharp, in radians (55 degrees).
const SHARP: f64 = 0.96;
/// Rounds, and the pace: a corner moves by this part of the way to the middle of its neighbours, times the part of its turn beyond
/// [`SHARP`].
const ROUNDS: usize = 48;
const PACE: f64 = 0.5;
/// Part of its clearance beyond the least one by which a point may move in a round.
const OF_CLEARANCE: f64 = 0.225;
/// The least clearance, µm: far more than positions are rounded by, so that walls that approach round by round do not meet.
const LEAST_CLEARANCE: f64 = 0.05;

/// `smooth` was made from `section`; no point goes farther than `most` from where it was there.
pub(super) fn relax(smooth: &mut Section, section: &Section, most: f64) {
    let origins = [origins(&smooth.inner, &section.inner), origins(&smooth.outer, &section.outer)].concat();
    for _ in 0..ROUNDS {
        let moves = [moves(&smooth.inner), moves(&smooth.outer)].concat();
        let is_moving = |i: usize| moves[i] != [0.0; 2];
        if !(0..moves.len()).any(is_moving) {
            return;
        }
        let reach = most / OF_CLEARANCE + LEAST_CLEARANCE;
        let clearances = clearances(&smooth.inner, &smooth.outer, reach, false).concat();
        let mut has_moved = false;
        let points = smooth.inner.points.iter_mut().chain(&mut smooth.outer.points);
        for (i, point) in points.enumerate().filter(|&(i, _)| is_moving(i)) {
            let (at, by) = (point.map(f64::from), moves[i]);
            let clearance = (clearances[i] - LEAST_CLEARANCE).max(0.0);
            let free = (OF_CLEARANCE * clearance / length(by)).min(1.0);
            let part = free.min(within(minus(at, origins[i]), by, most));
            let to = [0, 1].map(|axis| (at[axis] + part * by[axis]) as f32);
            has_moved |= to != *point;
            *point = to;
        }
        if !has_moved {
            return;
        }
    }
}

/// Where the points of a smooth ring were in the old one: particles, and points on edges, which have not moved.
fn origins(new: &Ring, old: &Ring) -> Vec<Point> {
    let particle = |i: usize| if i.is_multiple_of(2) { old.points[i / 2] } else { new.points[i] };
    (0..new.len()).map(|i| particle(i).map(f64::from)).collect()
}

/// How the points of a ring should move: zero but at and beside sharp corners.
fn moves(ring: &Ring) -> Vec<Point> {
    let n = ring.len();
    let at = |i: usize| ring.points[i % n].map(f64::from);
    let mut moves = vec![[0.0; 2]; n];
    for i in 0..n {
        let (before, here, after) = (at(i + n - 1), at(i), at(i + 1));
        let turn = angle(minus(here, before), minus(after, here)).abs();
        if turn > SHARP {
            let part = PACE * (turn - SHARP) / turn;
            for axis in [0, 1] {
                let by = part * (0.5 * (before[axis] + after[axis]) - here[axis]);
                moves[i][axis] += by;
                moves[(i + n - 1) % n][axis] -= by;
                moves[(i + 1) % n][axis] -= by;
            }
        }
    }
    moves
}

/// The part of a way that stays in a circle of radius `most`, from a point that is `from` its centre.
fn within(from: Point, way: Point, most: f64) -> f64 {
    let dot = |u: Point, v: Point| u[0] * v[0] + u[1] * v[1];
    let (a, b, c) = (dot(way, way), dot(from, way), dot(from, from) - most * most);
    let part = ((b * b - a * c).max(0.0).sqrt() - b) / a;
    if part.is_finite() { part.clamp(0.0, 1.0) } else { 0.0 }
}
