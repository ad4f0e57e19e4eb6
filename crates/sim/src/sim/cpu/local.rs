//! Forces on a particle from its neighbours in the chain and from the containment region: spring,
//! friction, bending, containment, regulatory, contortion (paper, section 3), and guidance.

use super::chain::Chain;
use crate::sim::layout::StepRow;
use crate::sim::maths::{max, min};
use crate::sim::region::Region;
use std::ops::Range;

/// Parameters of the local forces in a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalStep<'a> {
    pub(super) row: &'a StepRow,
    pub(super) region: &'a Region,
    /// m·c(t) of the contortion at this evaluation.
    pub(super) modifier: f32,
}

/// Properties of the particles that the local forces read.
#[derive(Clone, Copy, Debug)]
pub(super) struct OwnParticles<'a> {
    /// Rest lengths of the edges, beginning with the edge before the first particle.
    pub(super) rest: &'a [f32],
    pub(super) anchor: [&'a [f32]; 2],
    pub(super) sign: &'a [f32],
    pub(super) cleft: &'a [f32],
}

/// Adds the local forces on the particles `range` to `fx`, `fy`. `pull` has room for one more entry
/// than there are particles.
#[inline(always)]
pub(super) fn add(
    chain: &Chain,
    own: OwnParticles<'_>,
    step: LocalStep<'_>,
    range: Range<usize>,
    pull: &mut [Vec<f32>; 2],
    fx: &mut [f32],
    fy: &mut [f32],
) {
    pulls(chain, own, step.row, &range, pull);
    let pull = pull.each_ref().map(|v| &v[..]);
    match step.region {
        Region::Ellipse => {
            let radius = |[x, y]: [f32; 2]| (x * x + y * y).sqrt();
            add_within(chain, own, step, range, pull, fx, fy, radius, |_| 1.0);
        }
        Region::Shaped(gauge) => {
            add_within(chain, own, step, range, pull, fx, fy, |p| gauge.radius(p), |unit| gauge.boundary(unit));
        }
    }
}

/// Computes the pull of each edge on its first particle. Entry 0 belongs to the edge before the
/// first particle.
#[inline(always)]
fn pulls(chain: &Chain, own: OwnParticles<'_>, row: &StepRow, range: &Range<usize>, pull: &mut [Vec<f32>; 2]) {
    let edges = range.len() + 1;
    let ends = range.start..range.end + 2;
    let (x, y) = (&chain.x[ends.clone()][..edges + 1], &chain.y[ends.clone()][..edges + 1]);
    let (vx, vy) = (&chain.vx[ends.clone()][..edges + 1], &chain.vy[ends][..edges + 1]);
    let rest = &own.rest[..edges];
    let [px, py] = pull;
    let (px, py) = (&mut px[..edges], &mut py[..edges]);
    // The compiler would not vectorize a loop with an inclusive end.
    for i in 0..edges {
        let (dx, dy) = (x[i + 1] - x[i], y[i + 1] - y[i]);
        let length = (dx * dx + dy * dy + 1e-12).sqrt();
        let inverse = 1.0 / length;
        let (ux, uy) = (dx * inverse, dy * inverse);
        let closing = (vx[i + 1] - vx[i]) * ux + (vy[i + 1] - vy[i]) * uy;
        let pull = row.stiffness * (length - rest[i]) + row.damping * closing;
        px[i] = pull * ux;
        py[i] = pull * uy;
    }
}

/// `gauge` returns the gauge of a point of the flattened plane, `boundary` the distance of the
/// boundary from the axis in a direction.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the arguments of `add` and the two functions of the region")]
fn add_within(
    chain: &Chain,
    own: OwnParticles<'_>,
    LocalStep { row, modifier, .. }: LocalStep<'_>,
    range: Range<usize>,
    pull: [&[f32]; 2],
    fx: &mut [f32],
    fy: &mut [f32],
    gauge: impl Fn([f32; 2]) -> f32,
    boundary: impl Fn([f32; 2]) -> f32,
) {
    let count = range.len();
    let ends = range.start..range.end + 2;
    let (x, y) = (&chain.x[ends.clone()][..count + 2], &chain.y[ends][..count + 2]);
    let inside = range.start + 1..range.end + 1;
    let (vx, vy) = (&chain.vx[inside.clone()][..count], &chain.vy[inside][..count]);
    let (tx, ty) = (&pull[0][..=count], &pull[1][..=count]);
    let (nx, ny) = (&chain.nx[range.clone()][..count], &chain.ny[range][..count]);
    let (ax, ay) = (&own.anchor[0][..count], &own.anchor[1][..count]);
    let cleft = &own.cleft[..count];
    let (fx, fy) = (&mut fx[..count], &mut fy[..count]);
    let unsquash = 1.0 / row.squash;
    let ramp = 1.0 / row.ramp;
    for i in 0..count {
        let (px, py) = (x[i + 1], y[i + 1]);
        let spring = [tx[i + 1] - tx[i], ty[i + 1] - ty[i]];
        let second = [x[i] - 2.0 * px + x[i + 2], y[i] - 2.0 * py + y[i + 2]];
        let bend = row.bending * (second[0] * nx[i] + second[1] * ny[i]);
        let radius = (px * px + py * py + 1e-6).sqrt();
        let outside = gauge([px, py * unsquash]) - row.r_in;
        let inward = row.containment * min(max(outside * ramp, 0.0), 1.0) / radius;
        let r_anchor = row.r_in * boundary([ax[i], ay[i]]);
        let anchor = [r_anchor * ax[i] - px, row.squash * r_anchor * ay[i] - py];
        let far = (anchor[0] * anchor[0] + anchor[1] * anchor[1]).sqrt();
        let tether = (row.regulatory + row.hold * cleft[i]) / max(far, row.softening);
        let ray = [ax[i], row.squash * ay[i]];
        let along = max(px * ray[0] + py * ray[1], 0.0) / (ray[0] * ray[0] + ray[1] * ray[1]);
        let aside = [along * ray[0] - px, along * ray[1] - py];
        let guide = row.guide / max((aside[0] * aside[0] + aside[1] * aside[1]).sqrt(), row.reach);
        fx[i] += spring[0] - row.friction * vx[i] + bend * nx[i] - inward * px + tether * anchor[0] + guide * aside[0];
        fy[i] += spring[1] - row.friction * vy[i] + bend * ny[i] - inward * py + tether * anchor[1] + guide * aside[1];
    }
    for (i, &sign) in own.sign.iter().enumerate() {
        if sign != 0.0 {
            let a = [x[i] - x[i + 1], y[i] - y[i + 1]];
            let b = [x[i + 2] - x[i + 1], y[i + 2] - y[i + 1]];
            let lengths = (a[0] * a[0] + a[1] * a[1]).sqrt() * (b[0] * b[0] + b[1] * b[1]).sqrt();
            let cosine = (a[0] * b[0] + a[1] * b[1]) / max(lengths, 1e-12);
            let straightness = libm::acosf(cosine.clamp(-1.0, 1.0)) * std::f32::consts::FRAC_1_PI;
            let push = sign * modifier * straightness;
            fx[i] += push * nx[i];
            fy[i] += push * ny[i];
        }
    }
}
