//! The self-intersection force with side-dependent range, the barrier, and the clearance (paper, section 3).
//!
//! For a particle p with lumen normal n against the closest point of a segment at distance d: the other strand
//! lies in direction −q/d, so D = mean + half·cos α with cos α = −n·q/d; force
//! `kr·(ref/D)·(1 − d/D)` for d < D, plus `fb·(b/d − 1)` for d < b, both along q/d.

use super::chain::{BLOCK, Block, Chain};
use crate::sim::layout::StepRow;
use crate::sim::maths::{max, min};

/// Arithmetic of the pair forces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// Consecutive particles at a time, with the widest vectors of the processor. All models are made with it.
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

/// Coordinates of particles that pad the last group: far from all others.
pub(super) const FAR: f32 = 1e9;

/// The terms of a group of `G` consecutive particles, and the sums of the forces on them.
pub(super) struct Group<const G: usize> {
    x: [f32; G],
    y: [f32; G],
    mean: [f32; G],
    side_x: [f32; G],
    side_y: [f32; G],
    pub(super) fx: [f32; G],
    pub(super) fy: [f32; G],
    /// Least squared distance.
    pub(super) near: [f32; G],
    repulsion: f32,
    barrier: f32,
    barrier_reach: f32,
}

impl<const G: usize> Group<G> {
    /// The particles from `first` on; at the end of the loop there may be fewer than `G`.
    #[inline(always)]
    pub(super) fn new(row: &StepRow, chain: &Chain, scale: &[f32], first: usize) -> Self {
        let mut group = Self {
            x: [FAR; G],
            y: [FAR; G],
            mean: [row.range_mean; G],
            side_x: [0.0; G],
            side_y: [0.0; G],
            fx: [0.0; G],
            fy: [0.0; G],
            near: [CLEARANCE_CAP * CLEARANCE_CAP; G],
            repulsion: row.repulsion,
            barrier: row.barrier,
            barrier_reach: row.barrier * row.barrier_distance,
        };
        for (l, &scale) in scale.iter().enumerate().take(G) {
            let i = first + l;
            let t = PairTerms::new(row, [chain.x[i + 1], chain.y[i + 1]], [chain.nx[i], chain.ny[i]], scale);
            ([group.x[l], group.y[l]], group.mean[l]) = (t.p, t.mean);
            [group.side_x[l], group.side_y[l]] = t.side;
        }
        group
    }

    /// Adds the forces of segment `j`, with `OWN` times `others`: 0 for its own ends, or else 1. With `NEAR` keeps the least
    /// squared distances, and returns those of this segment.
    #[inline(always)]
    pub(super) fn add<const NEAR: bool, const OWN: bool>(
        &mut self,
        blocks: &[Block],
        j: usize,
        others: &[f32; G],
    ) -> [f32; G] {
        let (block, at) = (&blocks[j / BLOCK], j % BLOCK);
        let (ax, ay) = (block.x[at], block.y[at]);
        let (dx, dy) = (block.dx[at], block.dy[at]);
        let (ox, oy) = (block.over_x[at], block.over_y[at]);
        let mut squares = [0.0; G];
        for l in 0..G {
            let (rx, ry) = (self.x[l] - ax, self.y[l] - ay);
            let along = min(max(rx * ox + ry * oy, 0.0), 1.0);
            let (qx, qy) = (rx - along * dx, ry - along * dy);
            let square = max(qx * qx + qy * qy, TINY);
            let distance = square.sqrt();
            // With D the range and d the distance, Dd, so that one division serves both forces.
            let reach = self.mean[l] * distance + (self.side_x[l] * qx + self.side_y[l] * qy);
            let reach_square = reach * reach;
            let soft = max(reach - square, 0.0) * (self.repulsion * square);
            let hard = max(self.barrier_reach - self.barrier * distance, 0.0) * reach_square;
            let mut force = (soft + hard) / (reach_square * square);
            let mut nearness = square;
            if OWN {
                force *= others[l];
                nearness += CLEARANCE_CAP * CLEARANCE_CAP * (1.0 - others[l]);
            }
            self.fx[l] += force * qx;
            self.fy[l] += force * qy;
            if NEAR {
                self.near[l] = min(self.near[l], nearness);
                squares[l] = nearness;
            }
        }
        squares
    }
}

/// The least lane.
#[inline(always)]
pub(super) fn least<const G: usize>(mut lanes: [f32; G]) -> f32 {
    let mut width = G / 2;
    while width > 0 {
        for l in 0..width {
            lanes[l] = min(lanes[l], lanes[l + width]);
        }
        width /= 2;
    }
    lanes[0]
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
    use crate::sim::state::InnerLoop;
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
        fn a_group_equals_the_reference(
            points in prop::collection::vec(prop::array::uniform2(-150f32..150.0), 12..40),
            scales in prop::array::uniform8(0.4f32..2.5),
            first in 0usize..4,
        ) {
            let (row, n) = (row(), points.len());
            let s = InnerLoop {
                id: (0..n as u32).collect(),
                x: points.iter().map(|p| p[0]).collect(),
                y: points.iter().map(|p| p[1]).collect(),
                vx: vec![0.0; n],
                vy: vec![0.0; n],
                ..InnerLoop::default()
            };
            let mut chain = Chain::default();
            chain.load(&s);
            let mut group = Group::<8>::new(&row, &chain, &scales, first);
            for j in 0..n {
                let others: [f32; 8] = std::array::from_fn(|l| f32::from(u8::from(first + l != j && first + l != (j + 1) % n)));
                group.add::<true, true>(&chain.blocks, j, &others);
            }
            for (l, &scale) in scales.iter().enumerate() {
                let i = first + l;
                let terms = PairTerms::new(&row, points[i], [chain.nx[i], chain.ny[i]], scale);
                let (mut expected, mut size, mut near) = ([0f64; 2], 1f64, CLEARANCE_CAP);
                for j in (0..n).filter(|&j| j != i && (j + 1) % n != i) {
                    let (f, inverse) = reference_force(&terms, points[j], points[(j + 1) % n]);
                    expected = [expected[0] + f64::from(f[0]), expected[1] + f64::from(f[1])];
                    size += f64::from(f[0].hypot(f[1]));
                    near = near.min(1.0 / inverse);
                }
                // The place on a segment is rounded to about 1e-5 µm, which matters next to it.
                let tolerance = 1e-3 * f64::from((0.1 / near).max(1.0));
                prop_assert!((f64::from(group.fx[l]) - expected[0]).abs() < tolerance * size);
                prop_assert!((f64::from(group.fy[l]) - expected[1]).abs() < tolerance * size);
                prop_assert!(f64::from((group.near[l].sqrt() / near - 1.0).abs()) < tolerance);
            }
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
