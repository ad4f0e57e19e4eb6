//! The outer loop: spring, containment to its own lobed ellipse, friction (paper, section 3: "a simplification of
//! the same technique is used to approximate the external structure").
//!
//! Invariant: every particle, and every edge, stays outside the ellipse that just holds the inner loop, so the two
//! loops never meet.

use crate::sim::layout::StepRow;
use crate::sim::maths::{max, min};
use crate::sim::plan::Plan;
use crate::sim::state::{InnerLoop, OuterLoop};

/// Least thickness of the wall, µm.
pub(super) const MARGIN: f32 = 20.0;
/// Greatest move in a step, µm, where the inner loop does not demand more.
pub(super) const MOVE: f32 = 5.0;
/// Rest length of the edges over their mean length: the wall is kept taut, so that it never buckles.
pub(super) const TAUT: f32 = 0.8;
/// Pull toward the target per µm of distance.
pub(super) const PULL: f32 = 0.1;

/// The loop at step `time`, at rest on its target.
pub(super) fn start(plan: &Plan, time: i64) -> OuterLoop {
    let row = plan.at(time);
    let n = plan.start[1];
    let mut s = OuterLoop::default();
    let floor = floor(row.r_in, n as usize);
    let phases = phases(plan, time);
    for i in 0..n {
        let angle = std::f64::consts::TAU * f64::from(i) / f64::from(n);
        let (c, sine) = (libm::cos(angle) as f32, libm::sin(angle) as f32);
        let r = max(target(plan, row, &phases, [c, sine]), floor);
        s.id.push(i);
        s.p.push([r * c, r * row.squash * sine]);
        s.v.push([0.0; 2]);
    }
    s
}

/// Advances the outer loop one step; `inner` is the inner loop after its step.
pub(super) fn step(plan: &Plan, time: i64, row: &StepRow, inner: &InnerLoop, s: &mut OuterLoop) {
    let n = s.len();
    let next = plan.at(time + 1);
    let unsquash = 1.0 / next.squash;
    let reach = inner.x.iter().zip(&inner.y).fold(0.0f32, |m, (&x, &y)| {
        let flat = y * unsquash;
        max(m, x * x + flat * flat)
    });
    let floor = floor(reach.sqrt(), n);
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
    for i in 0..n {
        let p = s.p[i];
        let flat = [p[0], p[1] * unsquash];
        let elliptic = max((flat[0] * flat[0] + flat[1] * flat[1]).sqrt(), 1e-6);
        let wanted = max(target(plan, next, &phases, [flat[0] / elliptic, flat[1] / elliptic]), floor);
        let pull = min(max(PULL * (wanted - elliptic), -row.containment), row.containment);
        let before = pulls[(i + n - 1) % n];
        let mut v = s.v[i];
        let mut q = p;
        for axis in 0..2 {
            let force = pulls[i][axis] - before[axis] + pull * p[axis] / elliptic - row.wall_friction * v[axis];
            v[axis] = min(max(v[axis] + force, -MOVE), MOVE);
            q[axis] += v[axis];
        }
        let flat = [q[0], q[1] * unsquash];
        let elliptic = (flat[0] * flat[0] + flat[1] * flat[1]).sqrt();
        if elliptic < floor {
            let scale = floor / max(elliptic, 1e-6);
            q = [q[0] * scale, q[1] * scale];
        }
        s.p[i] = q;
        s.v[i] = v;
    }
}

/// Least elliptic radius of the particles of a wall around what reaches out to `reach`. An edge between particles at elliptic
/// radius r comes as near as r·cos(π/n); the loop is spaced evenly within a factor of two, hence 2π/n.
fn floor(reach: f32, n: usize) -> f32 {
    let sagitta = 1.0 - libm::cosf(std::f32::consts::TAU / n as f32);
    (reach + MARGIN) / (1.0 - sagitta).max(0.5)
}

/// Phases of the lobes at a step, as (cosine, sine).
fn phases(plan: &Plan, time: i64) -> Vec<[f32; 2]> {
    let angle = |l: &crate::sim::plan::Lobe| std::f64::consts::TAU * (l.phase + l.drift * time as f64);
    plan.lobes.iter().map(|l| [libm::cos(angle(l)) as f32, libm::sin(angle(l)) as f32]).collect()
}

/// Elliptic radius of the lobed target in direction (cos θ, sin θ).
fn target(plan: &Plan, row: &StepRow, phases: &[[f32; 2]], direction: [f32; 2]) -> f32 {
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
    row.r_wall * (1.0 + row.lobing * sum)
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    ((b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1])).sqrt()
}
