//! The self-intersection force with side-dependent range, the barrier, and the clearance (paper, section 3).
//!
//! For a particle p with lumen normal n against the closest point of a segment at distance d: the other strand
//! lies in direction −q/d, so D = mean + half·cos α with cos α = −n·q/d; force
//! `kr·(ref/D)·(1 − d/D)` for d < D, plus `fb·(b/d − 1)` for d < b, both along q/d.

use super::chain::Block;
use crate::sim::layout::{LANES, StepRow};
use crate::sim::maths::{max, min};

/// Arithmetic of the pair forces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// Sixteen segments at a time, with the widest vectors of the processor. All models are made with it.
    #[default]
    Vector,
    /// One segment after another, without vectors, as in the paper: for benchmarks. Results differ in rounding.
    Scalar,
}

/// Clearances are capped at this value, µm; the guard does not act above it.
pub(super) const CLEARANCE_CAP: f32 = 12.0;

/// Least squared distance; smaller ones are raised to it.
pub(super) const TINY: f32 = 1e-12;

/// Inputs of the force on one particle besides the segments.
#[derive(Clone, Copy, Debug)]
pub struct PairTerms {
    /// Position.
    pub p: [f32; 2],
    /// Mean range times the particle's scale.
    pub mean: f32,
    /// −half range times scale times normal.
    pub side: [f32; 2],
    /// kr times the reference range.
    pub repulsion: f32,
    /// fb.
    pub barrier: f32,
    /// fb times the barrier distance.
    pub barrier_reach: f32,
}

impl PairTerms {
    /// Gathers the terms of a particle at `p` with normal `n` and range scale `scale`.
    #[inline(always)]
    #[must_use]
    pub fn new(row: &StepRow, p: [f32; 2], n: [f32; 2], scale: f32) -> Self {
        let half = scale * row.range_half;
        Self {
            p,
            mean: scale * row.range_mean,
            side: [-half * n[0], -half * n[1]],
            repulsion: row.repulsion,
            barrier: row.barrier,
            barrier_reach: row.barrier * row.barrier_distance,
        }
    }
}

/// Partial sums of the force on one particle, and the greatest 1/d.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sums {
    pub(super) fx: [f32; LANES],
    pub(super) fy: [f32; LANES],
    pub(super) near: [f32; LANES],
}

impl Sums {
    pub(super) const ZERO: Self = Self { fx: [0.0; LANES], fy: [0.0; LANES], near: [0.0; LANES] };
}

/// Adds the forces of one block of segments. `own` marks lanes to skip (the particle's own segments).
/// Returns 1/d of every lane.
#[inline(always)]
#[expect(clippy::needless_range_loop, reason = "one loop over lanes of many arrays, which the compiler vectorises")]
pub(super) fn add_block(sums: &mut Sums, t: &PairTerms, block: &Block, own: Option<&[bool; LANES]>) -> [f32; LANES] {
    let mut near = [0.0f32; LANES];
    for l in 0..LANES {
        let (rx, ry) = (t.p[0] - block.x[l], t.p[1] - block.y[l]);
        let along = (rx * block.dx[l] + ry * block.dy[l]) * block.inverse[l];
        let along = min(max(along, 0.0), 1.0);
        let (qx, qy) = (rx - along * block.dx[l], ry - along * block.dy[l]);
        let square = max(qx * qx + qy * qy, TINY);
        let inverse = 1.0 / square.sqrt();
        let distance = square * inverse;
        let range = t.mean + (t.side[0] * qx + t.side[1] * qy) * inverse;
        let inverse_range = 1.0 / range;
        let soft = t.repulsion * inverse_range * max(1.0 - distance * inverse_range, 0.0);
        let hard = max(t.barrier_reach * inverse - t.barrier, 0.0);
        let mut force = (soft + hard) * inverse;
        let mut closeness = inverse;
        if let Some(own) = own {
            force = if own[l] { 0.0 } else { force };
            closeness = if own[l] { 0.0 } else { closeness };
        }
        sums.fx[l] += force * qx;
        sums.fy[l] += force * qy;
        near[l] = closeness;
    }
    for l in 0..LANES {
        sums.near[l] = max(sums.near[l], near[l]);
    }
    near
}

/// Sums lanes in a fixed order: halves onto each other.
#[inline(always)]
pub(super) fn reduce(mut lanes: [f32; LANES]) -> f32 {
    let mut width = LANES / 2;
    while width > 0 {
        for l in 0..width {
            lanes[l] += lanes[l + width];
        }
        width /= 2;
    }
    lanes[0]
}

/// The greatest lane.
#[inline(always)]
pub(super) fn greatest(lanes: [f32; LANES]) -> f32 {
    lanes.iter().fold(0.0, |a, &b| max(a, b))
}

/// The same force from one segment `a`–`b` in scalar arithmetic: the reference for tests
/// and the kernel of the paper's single-core version in benchmarks. Returns the force and 1/d.
#[must_use]
pub fn reference_force(t: &PairTerms, a: [f32; 2], b: [f32; 2]) -> ([f32; 2], f32) {
    let d = [b[0] - a[0], b[1] - a[1]];
    let r = [t.p[0] - a[0], t.p[1] - a[1]];
    let along = ((r[0] * d[0] + r[1] * d[1]) / (d[0] * d[0] + d[1] * d[1] + 1e-12)).clamp(0.0, 1.0);
    let q = [r[0] - along * d[0], r[1] - along * d[1]];
    let square = (q[0] * q[0] + q[1] * q[1]).max(TINY);
    let distance = square.sqrt();
    let range = t.mean + (t.side[0] * q[0] + t.side[1] * q[1]) / distance;
    let mut force = 0.0;
    if distance < range {
        force += t.repulsion / range * (1.0 - distance / range);
    }
    if t.barrier_reach > t.barrier * distance {
        force += t.barrier_reach / distance - t.barrier;
    }
    ([force * q[0] / distance, force * q[1] / distance], 1.0 / distance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn row() -> StepRow {
        StepRow {
            repulsion: 16.5,
            range_mean: 70.0,
            range_half: -30.0,
            barrier: 3.0,
            barrier_distance: 5.0,
            ..StepRow::default()
        }
    }

    proptest! {
        #[test]
        fn a_block_equals_the_reference(
            p in prop::array::uniform2(-100f32..100.0),
            angle in 0f32..std::f32::consts::TAU,
            scale in 0.4f32..2.5,
            points in prop::collection::vec(prop::array::uniform2(-150f32..150.0), LANES + 1),
        ) {
            let row = row();
            let terms = PairTerms::new(&row, p, [angle.cos(), angle.sin()], scale);
            let mut block = Block { x: [0.0; LANES], y: [0.0; LANES], dx: [0.0; LANES], dy: [0.0; LANES], inverse: [0.0; LANES] };
            let mut expected = [0f64; 2];
            let mut near = 0f32;
            for l in 0..LANES {
                let (a, b) = (points[l], points[l + 1]);
                block.x[l] = a[0];
                block.y[l] = a[1];
                block.dx[l] = b[0] - a[0];
                block.dy[l] = b[1] - a[1];
                block.inverse[l] = 1.0 / (block.dx[l].powi(2) + block.dy[l].powi(2) + 1e-12);
                let (f, inverse) = reference_force(&terms, a, b);
                expected[0] += f64::from(f[0]);
                expected[1] += f64::from(f[1]);
                near = near.max(inverse);
            }
            let mut sums = Sums::ZERO;
            add_block(&mut sums, &terms, &block, None);
            let size = 1.0 + expected[0].abs() + expected[1].abs();
            prop_assert!((f64::from(reduce(sums.fx)) - expected[0]).abs() < 1e-3 * size);
            prop_assert!((f64::from(reduce(sums.fy)) - expected[1]).abs() < 1e-3 * size);
            prop_assert!((greatest(sums.near) / near - 1.0).abs() < 1e-3);
        }
    }

    #[test]
    fn range_depends_on_the_side() {
        let row = row();
        // Lumen upwards: a strand above is across the gap (range 40), one below across tissue (range 100).
        let terms = PairTerms::new(&row, [0.0, 0.0], [0.0, 1.0], 1.0);
        let above = reference_force(&terms, [-5.0, 60.0], [5.0, 60.0]).0;
        let below = reference_force(&terms, [-5.0, -60.0], [5.0, -60.0]).0;
        assert_eq!(above, [0.0, 0.0]);
        assert!(below[1] > 0.0);
    }
}
