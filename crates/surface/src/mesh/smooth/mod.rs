//! Smooth contours (limit 6 of the paper): where there is room, neighbouring edges turn by at most
//! 60 degrees.
//!
//! Each edge gets a point, closer to the corner that has less room. Then each particle moves into
//! its corner, between the two neighbouring points, so that its turn is divided among three points.
//! It moves by less than half of its clearance (`clearance`), so contours that do not cross still
//! do not. Corners that are still sharp are rounded further (`relax`).
//!
//! The result is a continuous function of the section. Ids are kept: `2·id` for a particle and
//! `2·id + 1` for the point of the edge that begins at it. Particles inserted between two sections
//! therefore leave all older ids in order. Ids must be below 2³¹. All machines compute the same
//! bits, because only IEEE operations and `libm` are used.

mod clearance;
mod relax;

use crate::geometry::vector::{angle, cross2, distance, lerp, norm, sub};
use crate::model::{Ring, Section};
use clearance::{Point, clearances};
use std::f64::consts::PI;

/// Fractions of its clearance and of the maximum distance by which a particle may move.
const OF_CLEARANCE: f64 = 0.45;
const OF_DISTANCE: f64 = 0.9;
/// Turn that needs no room, radians (43 degrees).
const EASY: f64 = 0.75;
/// Minimum fraction of an edge between a particle and the point on the edge.
const NEAREST: f64 = 0.04;
/// Rounds in which the shares of the turns are relaxed, and the fraction of the way to its best
/// shares that a corner goes per round.
const SHARE_ROUNDS: usize = 8;
const SHARE_PACE: f64 = 0.6;
/// Maximum share as a fraction of the angle at a point, so that a corner does not reach the line
/// between its two points.
const OF_ANGLE: f64 = 0.72;
/// Maximum share, radians; with more, the path to a corner would turn back.
const GREATEST_SHARE: f64 = 1.4;
/// A share and the angle on the other side of the point add up to less than a half turn minus this,
/// radians.
const APART: f64 = 0.25;

/// Smooths the contours of a section. No contour moves by more than `distance_um` (µm), in either
/// direction.
#[must_use]
pub fn smooth(section: &Section, distance_um: f64) -> Section {
    let most = OF_DISTANCE * distance_um;
    let clearances = clearances(&section.inner, &section.outer, most / OF_CLEARANCE, true);
    let [inner, outer] = clearances.map(|ring| ring.iter().map(|c| most.min(OF_CLEARANCE * c)).collect::<Vec<f64>>());
    let mut result =
        Section { inner: smooth_ring(&section.inner, &inner), outer: smooth_ring(&section.outer, &outer), ..*section };
    relax::relax(&mut result, section, most);
    result
}

/// Smooths a ring; particle `i` moves by at most `most[i]`.
fn smooth_ring(ring: &Ring, most: &[f64]) -> Ring {
    let n = ring.len();
    let points: Vec<Point> = ring.points.iter().map(|p| p.map(f64::from)).collect();
    let (before, after) = (|i: usize| (i + n - 1) % n, |i: usize| (i + 1) % n);
    let edges: Vec<Point> = (0..n).map(|i| sub(points[after(i)], points[i])).collect();
    let turns: Vec<f64> = (0..n).map(|i| angle(edges[before(i)], edges[i])).collect();
    let rooms: Vec<f64> = turns.iter().zip(most).map(|(turn, most)| room(turn.abs(), *most)).collect();
    let middles: Vec<Point> = (0..n)
        .map(|i| {
            let edge = norm(edges[i]);
            let (here, next) = (rooms[i].min(edge), rooms[after(i)].min(edge));
            let at = if here + next > 0.0 { here / (here + next) } else { 0.5 };
            lerp(points[i], points[after(i)], at.clamp(NEAREST, 1.0 - NEAREST))
        })
        .collect();
    // Angles at the points on the edges between a particle and the next such point.
    let base: Vec<[f64; 2]> = (0..n)
        .map(|i| {
            let (a, b) = (middles[before(i)], middles[i]);
            let first = angle(sub(points[i], a), sub(b, a));
            [first, turns[i] - first]
        })
        .collect();
    let shares = divide(&turns, &base);
    let mut result = Ring { ids: Vec::with_capacity(2 * n), points: Vec::with_capacity(2 * n) };
    for i in 0..n {
        let wanted = corner(middles[before(i)], points[i], middles[i], shares[i]);
        let far = distance(points[i], wanted);
        let moved = if far > most[i] { lerp(points[i], wanted, most[i] / far) } else { wanted };
        result.ids.extend([ring.ids[i] << 1, (ring.ids[i] << 1) | 1]);
        result.points.extend([moved, middles[i]].map(|p| p.map(|x| x as f32)));
    }
    result
}

/// Distance within which the points next to a corner must lie so that a motion of `most` reduces
/// its turn to [`EASY`].
fn room(turn: f64, most: f64) -> f64 {
    if turn > EASY { most * libm::cos(0.5 * EASY) / libm::sin(0.5 * (turn - EASY)) } else { f64::INFINITY }
}

/// Position of a corner that leaves `shares` of its turn to the two neighbouring points.
fn corner(before: Point, corner: Point, after: Point, shares: [f64; 2]) -> Point {
    let turned = |v: Point, by: f64| {
        let t = libm::tan(by);
        [v[0] - t * v[1], v[1] + t * v[0]]
    };
    let (u, v) = (turned(sub(corner, before), shares[0]), turned(sub(after, corner), -shares[1]));
    let t = cross2(sub(after, before), v) / cross2(u, v);
    if t.is_finite() { [before[0] + t * u[0], before[1] + t * u[1]] } else { corner }
}

/// Divides the turns at the corners among the corners and the points on the edges. Returns for each
/// corner the shares of the points before and after it, with the sign of its turn.
///
/// A point receives the sum of the shares of its two corners. All turns become as equal as
/// possible, so a sharp corner gets what its neighbours leave. Opposite turns cancel. `base` are
/// the angles at the two points if the corner moved onto the line between them.
fn divide(turns: &[f64], base: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let n = turns.len();
    let (before, after) = (|i: usize| (i + n - 1) % n, |i: usize| (i + 1) % n);
    let bounds: Vec<[f64; 2]> = (0..n)
        .map(|i| {
            let others = [base[before(i)][1], base[after(i)][0]];
            [0, 1].map(|k| (PI - APART - others[k].abs()).clamp(0.0, GREATEST_SHARE).min(OF_ANGLE * base[i][k].abs()))
        })
        .collect();
    let mut shares: Vec<[f64; 2]> =
        (0..n).map(|i| bounds[i].map(|most| (0.25 * turns[i]).clamp(-most, most))).collect();
    let mut next = shares.clone();
    for _ in 0..SHARE_ROUNDS {
        for i in 0..n {
            let sign = 1f64.copysign(turns[i]);
            let others = [sign * shares[before(i)][1], sign * shares[after(i)][0]];
            let best = level(turns[i].abs(), others, bounds[i]);
            next[i] = [0, 1].map(|k| shares[i][k] + SHARE_PACE * (sign * best[k] - shares[i][k]));
        }
        std::mem::swap(&mut shares, &mut next);
    }
    shares
}

/// Shares of a corner, within bounds, that make its turn and the turns of its two points as equal
/// as possible. `others` are the turns of the points without the corner.
fn level(turn: f64, others: [f64; 2], bounds: [f64; 2]) -> [f64; 2] {
    let [a, b] = others;
    let first = ((turn + b - 2.0 * a) / 3.0).clamp(0.0, bounds[0]);
    let second = (0.5 * (turn - first - b)).clamp(0.0, bounds[1]);
    let first = (0.5 * (turn - second - a)).clamp(0.0, bounds[0]);
    [first, second]
}

#[cfg(test)]
mod tests;
