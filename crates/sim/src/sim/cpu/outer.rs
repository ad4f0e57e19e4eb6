//! The outer loop: spring, containment to a lobed ellipse, friction (paper, section 3: "a
//! simplification of the same technique is used to approximate the external structure").
//!
//! Invariants, which hold for any forces and at every point of the straight paths from step to
//! step:
//!
//! - The loop is star-shaped around the origin, so it cannot intersect itself: the directions of
//!   its particles increase counter-clockwise. A particle may use less than half of the angle to
//!   each neighbour in a step ([`Fan::hold`]). Therefore two neighbours never exchange their order,
//!   and no angle between neighbours reaches a half turn.
//! - Every particle and every edge stays outside the enlarged region that just contains the inner
//!   loop, so the two loops never intersect. Particles are pushed out until their edges clear this
//!   region ([`floor`], [`clear`], [`clear_outline`]).
//!
//! Both invariants are enforced in the flattened plane (x, y/squash), in which the containment
//! ellipse is a circle. A linear map preserves the order of directions and straight lines.

use crate::sim::layout::StepRow;
use crate::sim::maths::{greatest, max, min};
use crate::sim::plan::Plan;
use crate::sim::region::{Gauge, Region};
use crate::sim::state::{InnerLoop, OuterLoop};

/// Maximum move in a step along each axis, µm, unless the inner loop forces a larger move.
pub(super) const MOVE: f32 = 5.0;
/// Rest length of the edges divided by their mean length. A value below 1 keeps the wall under
/// tension.
pub(super) const TAUT: f32 = 0.8;
/// Pull toward the target per µm of distance.
pub(super) const PULL: f32 = 0.1;
/// Fraction of the angle between two neighbours that each of them may close in a step; below one
/// half.
pub(super) const CLOSING: f32 = 0.45;
/// Fraction of the remaining angle up to [`WIDEST`] by which each of two neighbours may widen the
/// angle between them in a step.
pub(super) const WIDENING: f32 = 0.25;
/// Maximum chord between the directions (unit vectors) of two neighbours: an angle of 106°.
pub(super) const WIDEST: f32 = 1.6;
/// Minimum chord between the directions of two neighbours divided by the mean chord.
pub(super) const NARROWEST: f32 = 0.1;

/// The loop at step `time`, at rest on its target, at equal angles.
pub(super) fn start(plan: &Plan, time: i64) -> OuterLoop {
    let row = plan.at(time);
    let n = plan.start[1];
    let mut s = OuterLoop::default();
    let region = plan.wall_region(time);
    let floor = floor(row.r_in, row.margin, n as usize);
    let phases = phases(plan, time);
    for i in 0..n {
        let angle = std::f64::consts::TAU * f64::from(i) / f64::from(n);
        let unit = [libm::cos(angle) as f32, libm::sin(angle) as f32];
        let r = max(target(plan, row, &region, &phases, unit), floor * region.boundary(unit));
        s.id.push(i);
        s.p.push([r * unit[0], r * row.squash * unit[1]]);
        s.v.push([0.0; 2]);
    }
    if let Region::Shaped(gauge) = &region {
        clear_outline(gauge, row.r_in + row.margin, 1.0 / row.squash, &mut s.p);
    }
    s
}

/// Advances the outer loop one step. `inner` is the inner loop after its step.
pub(super) fn step(plan: &Plan, time: i64, row: &StepRow, inner: &InnerLoop, s: &mut OuterLoop) {
    let n = s.len();
    let next = plan.at(time + 1);
    let unsquash = 1.0 / next.squash;
    let region = plan.wall_region(time + 1);
    let reach = reach(&region, inner, unsquash);
    let floor = floor(reach, next.margin, n);
    let phases = phases(plan, time + 1);
    let at = |i: usize| s.p[i % n];
    let perimeter: f32 = (0..n).map(|i| distance(at(i), at(i + 1))).sum();
    let rest = TAUT * perimeter / n as f32;
    let pulls: Vec<[f32; 2]> = (0..n)
        .map(|i| {
            let (a, b) = (at(i), at(i + 1));
            let (va, vb) = (s.v[i], s.v[(i + 1) % n]);
            let length = max(distance(a, b), 1e-6);
            let u = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
            let closing = (vb[0] - va[0]) * u[0] + (vb[1] - va[1]) * u[1];
            let pull = row.wall_stiffness * (length - rest) + row.wall_damping * closing;
            [pull * u[0], pull * u[1]]
        })
        .collect();
    let fan = Fan::new(s.p.iter().map(|&[x, y]| [x, y * unsquash]).collect());
    for i in 0..n {
        let p = s.p[i];
        let flat = [p[0], p[1] * unsquash];
        let elliptic = max((flat[0] * flat[0] + flat[1] * flat[1]).sqrt(), 1e-6);
        let outward = [flat[0] / elliptic, flat[1] / elliptic];
        let wanted = max(target(plan, next, &region, &phases, outward), floor * region.boundary(outward));
        let pull = min(max(PULL * (wanted - elliptic), -row.containment), row.containment);
        let before = pulls[(i + n - 1) % n];
        let mut v = s.v[i];
        let mut q = p;
        for axis in 0..2 {
            let force = pulls[i][axis] - before[axis] + pull * p[axis] / elliptic - row.wall_friction * v[axis];
            v[axis] = min(max(v[axis] + force, -MOVE), MOVE);
            q[axis] += v[axis];
        }
        if let Some(held) = fan.hold(i, [q[0], q[1] * unsquash]) {
            q = [held[0], held[1] * next.squash];
            v = [q[0] - p[0], q[1] - p[1]];
        }
        let flat = [q[0], q[1] * unsquash];
        let elliptic = (flat[0] * flat[0] + flat[1] * flat[1]).sqrt();
        let least = floor * region.boundary(unit(flat));
        if elliptic < least {
            let scale = least / max(elliptic, 1e-6);
            q = [q[0] * scale, q[1] * scale];
        }
        s.p[i] = q;
        s.v[i] = v;
    }
    match &region {
        Region::Ellipse => clear(reach + next.margin, unsquash, &mut s.p),
        Region::Shaped(gauge) => clear_outline(gauge, reach + next.margin, unsquash, &mut s.p),
    }
}

/// Maximum gauge of the inner loop, including its edges, which may leave a region that is not
/// convex.
fn reach(region: &Region, inner: &InnerLoop, unsquash: f32) -> f32 {
    let flat = |i: usize| [inner.x[i], inner.y[i] * unsquash];
    let n = inner.len();
    match region {
        Region::Ellipse => {
            let (x, y) = (&inner.x[..n], &inner.y[..n]);
            let square = |i: usize| x[i] * x[i] + (y[i] * unsquash) * (y[i] * unsquash);
            greatest(n, square).sqrt()
        }
        Region::Shaped(gauge) => (0..n).map(|i| gauge.extent(flat(i), flat((i + 1) % n))[1]).fold(0.0f32, max),
    }
}

/// Directions of the particles before a step, in the flattened plane.
struct Fan {
    directions: Vec<[f32; 2]>,
    /// Minimum chord to which neighbours may close.
    narrowest: f32,
}

impl Fan {
    fn new(mut points: Vec<[f32; 2]>) -> Self {
        let narrowest = NARROWEST * std::f32::consts::TAU / points.len() as f32;
        points.iter_mut().for_each(|p| *p = unit(*p));
        Self { directions: points, narrowest }
    }

    /// Returns the place for particle `i` if it may not move to `q`: at the same radius, in the
    /// last direction that is allowed. `None` if `q` is allowed.
    fn hold(&self, i: usize, q: [f32; 2]) -> Option<[f32; 2]> {
        let n = self.directions.len();
        let (before, own, after) = (self.directions[(i + n - 1) % n], self.directions[i], self.directions[(i + 1) % n]);
        let [back, ahead] = [distance(before, own), distance(own, after)];
        let limit = |toward: [f32; 2], closing: f32, widening: f32| {
            let close = CLOSING * max(1.0 - self.narrowest / closing, 0.0);
            let widen = WIDENING * max(WIDEST - widening, 0.0) / closing;
            let share = min(close, widen);
            [own[0] + share * (toward[0] - own[0]), own[1] + share * (toward[1] - own[1])]
        };
        let last = limit(after, max(ahead, 1e-9), back);
        let first = limit(before, max(back, 1e-9), ahead);
        let held = if cross(last, q) > 0.0 {
            last
        } else if cross(first, q) < 0.0 {
            first
        } else {
            return None;
        };
        let held = unit(held);
        let radius = length(q);
        Some([radius * held[0], radius * held[1]])
    }
}

/// Pushes out particles whose edges would come nearer to the origin than `least` in the flattened
/// plane. An edge between two directions at the angle α stays outside the circle of radius `least`
/// if both ends are at least at `least`/cos(α/2).
fn clear(least: f32, unsquash: f32, points: &mut [[f32; 2]]) {
    let n = points.len();
    let flat: Vec<[f32; 2]> = points.iter().map(|&[x, y]| [x, y * unsquash]).collect();
    let directions: Vec<[f32; 2]> = flat.iter().map(|&p| unit(p)).collect();
    for (i, point) in points.iter_mut().enumerate() {
        let chord =
            max(distance(directions[(i + n - 1) % n], directions[i]), distance(directions[i], directions[(i + 1) % n]));
        let needed = least / max(1.0 - 0.25 * chord * chord, 0.01).sqrt();
        let radius = length(flat[i]);
        if radius < needed {
            let scale = needed / max(radius, 1e-6);
            *point = [point[0] * scale, point[1] * scale];
        }
    }
}

/// Pushes out particles whose edges would come below the gauge `least`. If both ends of an edge
/// move away from the axis by the same factor, so does each of its points. A further move of one
/// end brings no point of the edge nearer.
fn clear_outline(gauge: &Gauge, least: f32, unsquash: f32, points: &mut [[f32; 2]]) {
    let n = points.len();
    let flat = |i: usize| [points[i % n][0], points[i % n][1] * unsquash];
    let needed: Vec<f32> = (0..n).map(|i| least / max(gauge.extent(flat(i), flat(i + 1))[0], 1e-6)).collect();
    for (i, point) in points.iter_mut().enumerate() {
        let scale = max(max(needed[(i + n - 1) % n], needed[i]), 1.0);
        *point = [scale * point[0], scale * point[1]];
    }
}

/// Minimum elliptic radius of the particles of a wall around an inner loop that extends to `reach`;
/// for other outlines, a gauge. An edge between two particles at elliptic radius r and equal
/// spacing comes as near as r·cos(π/n); 2π/n allows for twice the spacing. [`clear`] handles wider
/// angles.
fn floor(reach: f32, margin: f32, n: usize) -> f32 {
    let sagitta = 1.0 - libm::cosf(std::f32::consts::TAU / n as f32);
    (reach + margin) / (1.0 - sagitta).max(0.5)
}

/// Phases of the lobes at a step, as (cosine, sine).
fn phases(plan: &Plan, time: i64) -> Vec<[f32; 2]> {
    let angle = |l: &crate::sim::plan::Lobe| std::f64::consts::TAU * (l.phase + l.drift * time as f64);
    plan.lobes.iter().map(|l| [libm::cos(angle(l)) as f32, libm::sin(angle(l)) as f32]).collect()
}

/// Elliptic radius of the lobed target in direction (cos θ, sin θ).
fn target(plan: &Plan, row: &StepRow, region: &Region, phases: &[[f32; 2]], direction: [f32; 2]) -> f32 {
    let [c, s] = direction;
    let mut power = [c, s];
    let mut order = 1;
    let mut sum = 0.0;
    for (lobe, phase) in plan.lobes.iter().zip(phases) {
        while order < lobe.order {
            power = [power[0] * c - power[1] * s, power[0] * s + power[1] * c];
            order += 1;
        }
        sum += lobe.weight * (power[0] * phase[0] - power[1] * phase[1]);
    }
    (row.r_wall + row.r_in * (region.boundary(direction) - 1.0)) * (1.0 + row.lobing * sum)
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    length([b[0] - a[0], b[1] - a[1]])
}

fn length(a: [f32; 2]) -> f32 {
    (a[0] * a[0] + a[1] * a[1]).sqrt()
}

fn unit(a: [f32; 2]) -> [f32; 2] {
    let length = max(length(a), 1e-6);
    [a[0] / length, a[1] / length]
}

/// Cross product, positive if `b` lies counter-clockwise of `a`.
fn cross(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[1] - a[1] * b[0]
}
