//! Contours without sharp angles (the paper's limit 6): no two neighbouring edges turn by more than 60 degrees.
//!
//! Each edge gets a point between its ends, and each particle moves into the corner between the two points beside it: the turn
//! at the particle is divided among three points. The points of the edges stay on them; the nearer they are to a sharp
//! corner, the less is cut off. A particle moves by less than half of its clearance, so contours that do not cross still do not.
//!
//! The result is a continuous function of the section, and ids are kept: `2·id` for a particle, `2·id + 1` for the point of the edge
//! that begins at it. Particles that are inserted between two sections therefore leave all older ids in order.

mod clearance;

use crate::model::{Ring, Section};
use clearance::clearances;

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

/// Part of its clearance by which a particle may move.
const OF_CLEARANCE: f64 = 0.45;
/// Turns at which points of edges begin to move towards a corner, and at which they have done so, in degrees.
const SHARP: [f64; 2] = [45.0, 75.0];

/// A section with smooth contours.
#[must_use]
pub fn smooth(section: &Section, options: &Smooth) -> Section {
    let [inner, outer] = clearances(&section.inner, &section.outer, 2.0 * options.distance_um);
    Section {
        inner: smooth_ring(&section.inner, &inner, options),
        outer: smooth_ring(&section.outer, &outer, options),
        ..*section
    }
}

fn smooth_ring(ring: &Ring, clearance: &[f64], options: &Smooth) -> Ring {
    let n = ring.len();
    let p = |i: usize| ring.points[i % n].map(f64::from);
    let edge: Vec<f64> = (0..n).map(|i| length(minus(p(i + 1), p(i)))).collect();
    let turns: Vec<f64> = (0..n).map(|i| turn(p(i + n - 1), p(i), p(i + 1)).abs().to_degrees()).collect();
    let need = |i: usize| {
        let t = ((turns[i % n] - SHARP[0]) / (SHARP[1] - SHARP[0])).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    // Where the points beside a sharp corner should be.
    let beside = |i: usize| {
        let i = i % n;
        let room = 0.5 * edge[(i + n - 1) % n].min(edge[i]);
        room.min(0.9 * options.distance_um).min((0.9 * clearance[i]).max(0.05))
    };
    let middle: Vec<[f64; 2]> = (0..n)
        .map(|i| {
            const FREE: f64 = 0.05;
            let (here, next) = (need(i), need(i + 1));
            let at =
                (here * beside(i) + next * (edge[i] - beside(i + 1)) + FREE * 0.5 * edge[i]) / (here + next + FREE);
            along(p(i), p(i + 1), at / edge[i])
        })
        .collect();
    let mut result = Ring { ids: Vec::with_capacity(2 * n), points: Vec::with_capacity(2 * n) };
    for i in 0..n {
        let (before, after) = (middle[(i + n - 1) % n], middle[i]);
        let moved = cut(before, p(i), after, (OF_CLEARANCE * clearance[i]).min(0.9 * options.distance_um));
        result.ids.extend([2 * ring.ids[i], 2 * ring.ids[i] + 1]);
        result.points.extend([moved, middle[i]].map(|p| p.map(|x| x as f32)));
    }
    result
}

/// Where the corner between two points goes: into it, until its turn is half of what it was, at most 55 degrees, or it has moved
/// by `most`.
fn cut(before: [f64; 2], corner: [f64; 2], after: [f64; 2], most: f64) -> [f64; 2] {
    let half = 0.5 * turn(before, corner, after).abs().to_degrees();
    let wanted = if half <= 50.0 { half } else { 50.0 + 0.125 * (half - 50.0) };
    let (a, b) = (length(minus(corner, before)), length(minus(after, corner)));
    let foot = along(before, after, a / (a + b));
    let depth = length(minus(foot, corner));
    if depth <= 0.0 {
        return corner;
    }
    // The turn decreases on the way to the foot.
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..20 {
        let middle = 0.5 * (low + high);
        if turn(before, along(corner, foot, middle), after).abs().to_degrees() > wanted {
            low = middle;
        } else {
            high = middle;
        }
    }
    along(corner, foot, high.min(most / depth))
}

/// The angle by which the way from `a` by `b` to `c` turns at `b`.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    let (u, v) = (minus(b, a), minus(c, b));
    (u[0] * v[1] - u[1] * v[0]).atan2(u[0] * v[0] + u[1] * v[1])
}

fn minus(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

fn length(v: [f64; 2]) -> f64 {
    v[0].hypot(v[1])
}

fn along(a: [f64; 2], b: [f64; 2], t: f64) -> [f64; 2] {
    [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
}

#[cfg(test)]
mod tests;
