//! Rounds corners that are still sharp because their particle could not move far enough. Round by
//! round, the particle moves on towards the line between its neighbours, and the neighbours move
//! the other way.
//!
//! Both ends of an edge may move, so points move by less than a quarter of their clearance. The
//! motion is zero for a corner that is barely not sharp, and ends where the contour would leave its
//! maximum distance. The result therefore remains a continuous function of the section.

use super::clearance::{Point, clearances};
use crate::geometry::vector::{angle, dot, norm, sub};
use crate::model::{Ring, Section};

/// Turn above which a corner is sharp, radians (55 degrees).
const SHARP: f64 = 0.96;
/// Number of rounds, and the pace. A corner moves by this fraction of the way to the midpoint of
/// its neighbours, times the fraction of its turn beyond [`SHARP`].
const ROUNDS: usize = 48;
const PACE: f64 = 0.5;
/// Fraction of its clearance beyond [`LEAST_CLEARANCE`] by which a point may move per round.
const OF_CLEARANCE: f64 = 0.225;
/// Minimum clearance, µm: far more than the rounding of positions, so that walls that approach each
/// other round by round do not touch.
const LEAST_CLEARANCE: f64 = 0.05;

/// Rounds the corners of `smooth`, which was computed from `section`. No point moves farther than
/// `most` from its position in `section`.
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
            let free = (OF_CLEARANCE * clearance / norm(by)).min(1.0);
            let part = free.min(within(sub(at, origins[i]), by, most));
            let to = [0, 1].map(|axis| (at[axis] + part * by[axis]) as f32);
            has_moved |= to != *point;
            *point = to;
        }
        if !has_moved {
            return;
        }
    }
}

/// Original positions of the points of a smooth ring. Points on edges have not moved.
fn origins(new: &Ring, old: &Ring) -> Vec<Point> {
    let particle = |i: usize| if i.is_multiple_of(2) { old.points[i / 2] } else { new.points[i] };
    (0..new.len()).map(|i| particle(i).map(f64::from)).collect()
}

/// Desired motion of each point of a ring: zero except at sharp corners and their neighbours.
fn moves(ring: &Ring) -> Vec<Point> {
    let n = ring.len();
    let at = |i: usize| ring.points[i % n].map(f64::from);
    let mut moves = vec![[0.0; 2]; n];
    for i in 0..n {
        let (before, here, after) = (at(i + n - 1), at(i), at(i + 1));
        let turn = angle(sub(here, before), sub(after, here)).abs();
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

/// Fraction of a path that stays in a circle of radius `most`, from a point at `from` relative to
/// the centre.
fn within(from: Point, way: Point, most: f64) -> f64 {
    let (a, b, c) = (dot(way, way), dot(from, way), dot(from, from) - most * most);
    let part = ((b * b - a * c).max(0.0).sqrt() - b) / a;
    if part.is_finite() { part.clamp(0.0, 1.0) } else { 0.0 }
}
