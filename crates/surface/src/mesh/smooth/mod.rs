//! Contours without sharp angles (the paper's limit 6): where there is room, neighbouring edges turn by at most 60 degrees.
//!
//! Each edge gets a point on it, which is nearer to the corner that has less room. Then each particle moves into the corner between
//! the two points beside it, so that its turn is divided among three points (`turns`). It moves by less than half of its
//! clearance (`clearance`), so contours that do not cross still do not. Corners that are still sharp are then rounded further (`relax`).
//!
//! The result is a continuous function of the section, and ids are kept: `2·id` for a particle, `2·id + 1` for the point of the edge
//! that begins at it. Particles that are inserted between two sections therefore leave all older ids in order. Ids are below
//! 2³¹. All machines give the same bits: only IEEE operations and `libm` are used.

mod clearance;
mod relax;
mod turns;
mod vector;

use crate::model::{Ring, Section};
use clearance::clearances;
use vector::{Point, along, angle, cross, length, minus};

/// Options of [`smooth`].
#[derive(Clone, Copy, Debug)]
pub struct Smooth {
    /// Greatest distance between the old and the new contour, either way, in micrometres.
    pub distance_um: f64,
}

impl Default for Smooth {
    fn default() -> Self {
        Self { distance_um: 5.0 }
    }
}

/// Parts of its clearance and of the greatest distance by which a particle may move.
const OF_CLEARANCE: f64 = 0.45;
const OF_DISTANCE: f64 = 0.9;
/// A turn that needs no room, in radians (43 degrees).
const EASY: f64 = 0.75;
/// Least part of an edge between a particle and the point on the edge.
const NEAREST: f64 = 0.04;

/// A section with smooth contours.
#[must_use]
pub fn smooth(section: &Section, options: &Smooth) -> Section {
    let most = OF_DISTANCE * options.distance_um;
    let clearances = clearances(&section.inner, &section.outer, most / OF_CLEARANCE, true);
    let [inner, outer] = clearances.map(|ring| ring.iter().map(|c| most.min(OF_CLEARANCE * c)).collect::<Vec<f64>>());
    let mut result =
        Section { inner: smooth_ring(&section.inner, &inner), outer: smooth_ring(&section.outer, &outer), ..*section };
    relax::relax(&mut result, section, most);
    result
}

/// `most`: how far each particle may move.
fn smooth_ring(ring: &Ring, most: &[f64]) -> Ring {
    let n = ring.len();
    let points: Vec<Point> = ring.points.iter().map(|p| p.map(f64::from)).collect();
    let (before, after) =
        (|i: usize| if i == 0 { n - 1 } else { i - 1 }, |i: usize| if i + 1 == n { 0 } else { i + 1 });
    let edges: Vec<Point> = (0..n).map(|i| minus(points[after(i)], points[i])).collect();
    let turns: Vec<f64> = (0..n).map(|i| angle(edges[before(i)], edges[i])).collect();
    let rooms: Vec<f64> = turns.iter().zip(most).map(|(turn, most)| room(turn.abs(), *most)).collect();
    let middles: Vec<Point> = (0..n)
        .map(|i| {
            let edge = length(edges[i]);
            let (here, next) = (rooms[i].min(edge), rooms[after(i)].min(edge));
            let at = if here + next > 0.0 { here / (here + next) } else { 0.5 };
            along(points[i], points[after(i)], at.clamp(NEAREST, 1.0 - NEAREST))
        })
        .collect();
    // The angles at the points on the edges between a particle and the next such point.
    let base: Vec<[f64; 2]> = (0..n)
        .map(|i| {
            let (a, b) = (middles[before(i)], middles[i]);
            let first = angle(minus(points[i], a), minus(b, a));
            [first, turns[i] - first]
        })
        .collect();
    let shares = turns::divide(&turns, &base);
    let mut result = Ring { ids: Vec::with_capacity(2 * n), points: Vec::with_capacity(2 * n) };
    for i in 0..n {
        let wanted = corner(middles[before(i)], points[i], middles[i], shares[i]);
        let distance = length(minus(wanted, points[i]));
        let moved = if distance > most[i] { along(points[i], wanted, most[i] / distance) } else { wanted };
        result.ids.extend([ring.ids[i] << 1, (ring.ids[i] << 1) | 1]);
        result.points.extend([moved, middles[i]].map(|p| p.map(|x| x as f32)));
    }
    result
}

/// How far from a corner the points beside it may be, if it can move by `most`, so that its turn becomes [`EASY`].
fn room(turn: f64, most: f64) -> f64 {
    if turn > EASY { most * libm::cos(0.5 * EASY) / libm::sin(0.5 * (turn - EASY)) } else { f64::INFINITY }
}

/// Where a corner goes that leaves `shares` of its turn to the points beside it.
fn corner(before: Point, corner: Point, after: Point, shares: [f64; 2]) -> Point {
    let turned = |v: Point, by: f64| {
        let t = libm::tan(by);
        [v[0] - t * v[1], v[1] + t * v[0]]
    };
    let (u, v) = (turned(minus(corner, before), shares[0]), turned(minus(after, corner), -shares[1]));
    let t = cross(minus(after, before), v) / cross(u, v);
    if t.is_finite() { [before[0] + t * u[0], before[1] + t * u[1]] } else { corner }
}

#[cfg(test)]
mod tests;
