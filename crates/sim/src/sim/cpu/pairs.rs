//! The self-intersection force with side-dependent range, the barrier and the clearance (paper,
//! section 3).
//!
//! For a particle with lumen normal n and the closest point of a segment, let q be the vector from
//! this point to the particle, and d its length. The other strand lies in the direction −q/d, so
//! the range is D = mean + half·cos α with cos α = −n·q/d. The force is `kr·(ref/D)·(1 − d/D)` for
//! d < D, plus `fb·(b/d − 1)` for d < b, both along q/d.

use super::chain::{BLOCK, Block, Chain};
use crate::sim::layout::StepRow;
use crate::vectorize::{Lanes, Simd};

/// Arithmetic of the pair forces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// One vector of consecutive particles at a time, with the widest vectors of the processor. All
    /// models are grown with it.
    #[default]
    Vector,
    /// One segment after another, without vectors, as in the paper; for benchmarks. Results differ
    /// in rounding.
    Scalar,
}

/// Maximum clearance, µm. The guard does not act above it.
pub(super) const CLEARANCE_CAP: f32 = 12.0;

/// Minimum squared distance; smaller ones are raised to it.
pub(super) const TINY: f32 = 1e-12;

/// Inputs of the force on one particle, except the segments.
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

/// Coordinate of particles that pad the last group: far from all others.
pub(super) const FAR: f32 = 1e9;

/// Distance beyond all ranges, µm.
const DISTANT: f32 = 1e6;

/// Maximum number of particles in a group.
pub(super) const MOST: usize = 16;

/// Terms of a group of consecutive particles, one per lane.
#[derive(Clone, Copy)]
pub(super) struct Group<S: Simd> {
    simd: S,
    /// Index of the first particle, and number of all particles.
    first: usize,
    n: usize,
    x: Lanes<S>,
    y: Lanes<S>,
    mean: Lanes<S>,
    side_x: Lanes<S>,
    side_y: Lanes<S>,
    repulsion: Lanes<S>,
    barrier: Lanes<S>,
    barrier_reach: Lanes<S>,
}

impl<S: Simd> Group<S> {
    /// Gathers the particles from `first` on, which have these scales. At the end of the loop there
    /// may be fewer particles than lanes.
    #[inline(always)]
    pub(super) fn new(simd: S, row: &StepRow, chain: &Chain, scale: &[f32], first: usize) -> Self {
        let (mut x, mut y, mut mean) = ([FAR; MOST], [FAR; MOST], [row.range_mean; MOST]);
        let (mut side_x, mut side_y) = ([0.0; MOST], [0.0; MOST]);
        for (l, &scale) in scale.iter().enumerate().take(Lanes::<S>::COUNT) {
            let i = first + l;
            let t = PairTerms::new(row, [chain.x[i + 1], chain.y[i + 1]], [chain.nx[i], chain.ny[i]], scale);
            ([x[l], y[l]], mean[l]) = (t.p, t.mean);
            [side_x[l], side_y[l]] = t.side;
        }
        Self {
            simd,
            first,
            n: chain.len(),
            x: Lanes::of(simd, &x),
            y: Lanes::of(simd, &y),
            mean: Lanes::of(simd, &mean),
            side_x: Lanes::of(simd, &side_x),
            side_y: Lanes::of(simd, &side_y),
            repulsion: Lanes::all(simd, row.repulsion),
            barrier: Lanes::all(simd, row.barrier),
            barrier_reach: Lanes::all(simd, row.barrier * row.barrier_distance),
        }
    }

    /// Places the particles relative to segment `j`. With `OWN`, the particles at the ends of the
    /// segment count as distant.
    #[inline(always)]
    pub(super) fn place<const OWN: bool>(&self, blocks: &[Block], j: usize) -> SegmentPlacement<S> {
        let all = |number| Lanes::all(self.simd, number);
        let (block, at) = (&blocks[j / BLOCK], j % BLOCK);
        let (rx, ry) = (self.x - all(block.x[at]), self.y - all(block.y[at]));
        let along = (rx * all(block.over_x[at]) + ry * all(block.over_y[at])).max(all(0.0)).min(all(1.0));
        let (qx, qy) = (rx - along * all(block.dx[at]), ry - along * all(block.dy[at]));
        let mut square = (qx * qx + qy * qy).max(all(TINY));
        if OWN {
            square = square.max(self.distant_ends(j));
        }
        SegmentPlacement { qx, qy, square, distance: square.sqrt() }
    }

    /// The square of a distance beyond all ranges in the lanes of the ends of segment `j`, 0 in
    /// other lanes.
    #[inline(always)]
    fn distant_ends(&self, j: usize) -> Lanes<S> {
        let lane = |particle: usize| (particle as u32).wrapping_sub(self.first as u32);
        let (start, end) = (lane(j), lane(if j + 1 == self.n { 0 } else { j + 1 }));
        let mut squares = [0.0; MOST];
        for (l, square) in (0..).zip(&mut squares) {
            *square = if (l == start) | (l == end) { DISTANT * DISTANT } else { 0.0 };
        }
        Lanes::of(self.simd, &squares)
    }

    /// Computes the forces of a segment.
    #[inline(always)]
    fn pull(&self, to: &SegmentPlacement<S>) -> Pull<S> {
        let zero = Lanes::all(self.simd, 0.0);
        let SegmentPlacement { qx, qy, square, distance } = *to;
        // Both terms are multiplied by D (range) and d (distance), so that one division serves both
        // forces.
        let reach = self.mean * distance + (self.side_x * qx + self.side_y * qy);
        let reach_square = reach * reach;
        let soft = (reach - square).max(zero) * (self.repulsion * square);
        let hard = (self.barrier_reach - self.barrier * distance).max(zero) * reach_square;
        Pull { qx, qy, force: (soft + hard) / (reach_square * square) }
    }
}

/// Places of the particles of a group relative to a segment.
#[derive(Clone, Copy)]
pub(super) struct SegmentPlacement<S: Simd> {
    /// Vector from the closest point of the segment to the particle.
    qx: Lanes<S>,
    qy: Lanes<S>,
    square: Lanes<S>,
    distance: Lanes<S>,
}

/// Forces of a segment on the particles of a group.
#[derive(Clone, Copy)]
struct Pull<S: Simd> {
    qx: Lanes<S>,
    qy: Lanes<S>,
    /// Force divided by the distance.
    force: Lanes<S>,
}

/// Sums of the forces on the particles of a group.
///
/// A force takes a square root and then a division, and each waits for the operation before it. To
/// hide this latency, three segments are in progress: the current one is placed while the force of
/// the previous one is computed and that of the one before is added.
#[derive(Clone, Copy)]
pub(super) struct Sums<S: Simd> {
    placed: SegmentPlacement<S>,
    pull: Pull<S>,
    fx: Lanes<S>,
    fy: Lanes<S>,
    /// Minimum squared distances.
    near: Lanes<S>,
}

impl<S: Simd> Sums<S> {
    #[inline(always)]
    pub(super) fn new(simd: S) -> Self {
        let all = |number| Lanes::all(simd, number);
        let zero = all(0.0);
        Self {
            placed: SegmentPlacement { qx: zero, qy: zero, square: all(DISTANT * DISTANT), distance: all(DISTANT) },
            pull: Pull { qx: zero, qy: zero, force: zero },
            fx: zero,
            fy: zero,
            near: all(CLEARANCE_CAP * CLEARANCE_CAP),
        }
    }

    /// Adds the next segment.
    #[inline(always)]
    pub(super) fn take(&mut self, group: &Group<S>, placed: SegmentPlacement<S>) {
        self.add(self.pull);
        self.pull = group.pull(&self.placed);
        self.placed = placed;
    }

    #[inline(always)]
    fn add(&mut self, Pull { qx, qy, force }: Pull<S>) {
        self.fx = self.fx + force * qx;
        self.fy = self.fy + force * qy;
    }

    /// Updates the minimum squared distances. Returns the minimum squared distance of the segment
    /// if it is less than the square of the cap.
    #[inline(always)]
    pub(super) fn approach(&mut self, group: &Group<S>, placed: &SegmentPlacement<S>) -> Option<f32> {
        self.near = self.near.min(placed.square);
        let cap = Lanes::all(group.simd, CLEARANCE_CAP * CLEARANCE_CAP);
        placed.square.any_less(cap).then(|| placed.square.least())
    }

    /// Sums and minimum squared distances after the last segment.
    #[inline(always)]
    pub(super) fn finish(mut self, group: &Group<S>) -> [Lanes<S>; 3] {
        self.add(self.pull);
        self.add(group.pull(&self.placed));
        [self.fx, self.fy, self.near]
    }
}

/// Force from one segment `a`–`b` in scalar arithmetic, and 1/d: the reference for tests, and the
/// kernel of the single-core version of the paper in benchmarks.
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
    use crate::vectorize::{Vectors, WithSimd};
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

    /// The forces of all segments on eight particles, and their minimum squared distances.
    struct OfGroup<'a> {
        row: &'a StepRow,
        chain: &'a Chain,
        scales: &'a [f32; 8],
        first: usize,
    }

    impl WithSimd for OfGroup<'_> {
        type Output = [[f32; 8]; 3];

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let Self { row, chain, scales, first } = self;
            let group = Group::new(simd, row, chain, scales, first);
            let mut sums = Sums::new(simd);
            for j in 0..chain.len() {
                let placed = group.place::<true>(&chain.blocks, j);
                sums.approach(&group, &placed);
                sums.take(&group, placed);
            }
            sums.finish(&group).map(|lanes| {
                let mut numbers = [0.0; 8];
                lanes.write(&mut numbers);
                numbers
            })
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
            let work = || OfGroup { row: &row, chain: &chain, scales: &scales, first };
            let [fx, fy, squares] = Vectors::Baseline.run_in_lanes(work());
            for vectors in [Vectors::Avx2, Vectors::Avx512] {
                let wider = vectors.run_in_lanes(work());
                prop_assert_eq!(wider.map(|v| v.map(f32::to_bits)), [fx, fy, squares].map(|v| v.map(f32::to_bits)));
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
                prop_assert!((f64::from(fx[l]) - expected[0]).abs() < tolerance * size);
                prop_assert!((f64::from(fy[l]) - expected[1]).abs() < tolerance * size);
                prop_assert!(f64::from((squares[l].sqrt() / near - 1.0).abs()) < tolerance);
            }
        }
    }

    #[test]
    fn range_depends_on_the_side() {
        let row = row();
        // The lumen is above: a strand above is across the gap (range 40), a strand below across
        // tissue (range 100).
        let terms = PairTerms::new(&row, [0.0, 0.0], [0.0, 1.0], 1.0);
        let above = reference_force(&terms, [-5.0, 60.0], [5.0, 60.0]).0;
        let below = reference_force(&terms, [-5.0, -60.0], [5.0, -60.0]).0;
        assert_eq!(above, [0.0, 0.0]);
        assert!(below[1] > 0.0);
    }
}
