//! Time integration (paper, section 3: Runge–Kutta of fourth order, or Euler) and the guard that
//! keeps walls apart.
//!
//! Guard: clear_i is the minimum distance over all pairs of a vertex and a segment that contain
//! vertex i or one of its two edges. A move is limited to 0.45·(clear_i − g_min). In the plane, the
//! first contact of two walls is always a vertex on a segment. The two sides together use less than
//! their whole distance, so the straight paths from step to step never meet.
//!
//! An evaluation of the forces is one pass over the parts of the loop, in parallel. Each part
//! computes the forces on its particles from the chain of this evaluation and places the particles
//! in the chain of the next one. The last pass of a step moves the particles.

use super::chain::{Chain, Stretch, take};
use super::clearance::SegmentDistances;
use super::neighbours::{LoopPart, Neighbours, OwnSegments, Update};
use super::pairs::{Group, Kernel, Sums};
use super::team::each;
use super::{local, scalar, sway};
use crate::sim::layout::StepRow;
use crate::sim::maths::{max, min};
use crate::sim::plan::Plan;
use crate::sim::region::Region;
use crate::sim::state::InnerLoop;
use crate::spec::Integrator;
use crate::vectorize::{Lanes, Simd, Vectors, WithSimd};
use std::ops::Range;

/// Fraction of the free distance that one side may use in a step.
pub(super) const SHARE: f32 = 0.45;
/// Bounds of the limit of a move, µm.
pub(super) const LIMITS: [f32; 2] = [1e-5, 5.0];

/// Runge–Kutta stages: weight of the stage in the final sum, and offset of the next stage as a
/// fraction of the step.
const STAGES: [(f32, f32); 4] = [(1.0, 0.5), (2.0, 0.5), (2.0, 1.0), (1.0, 0.0)];

/// Buffers of a step.
#[derive(Debug)]
pub(super) struct Work {
    /// Arithmetic of the pair forces.
    kernel: Kernel,
    vectors: Vectors,
    /// Chain of this evaluation, and chain of the next one.
    chains: [Chain; 2],
    /// True if the first chain is the chain of the state.
    loaded: bool,
    parts: Vec<Buffers>,
    /// Minimum squared distance of each segment to the particles at the start of the step: while the
    /// parts find it, and complete.
    segment_near: SegmentDistances,
    near: Vec<f32>,
    /// Clearance of each particle at the start of the last step, µm.
    clearance: Vec<f32>,
}

/// Buffers of a part, one entry per particle.
#[derive(Clone, Debug, Default)]
struct Buffers {
    /// Acceleration of this stage (mass is 1).
    a: [Vec<f32>; 2],
    /// Weighted sums of the velocities and of the accelerations of the stages.
    sum_v: [Vec<f32>; 2],
    sum_a: [Vec<f32>; 2],
    /// Force of the sway, the same in all stages; empty without sway.
    sway: [Vec<f32>; 2],
    /// Rest lengths and pulls of the edges, beginning with the edge before the first particle.
    rest: Vec<f32>,
    pull: [Vec<f32>; 2],
    /// Minimum squared distance of each particle at the start of the step.
    near: Vec<f32>,
    result: StepResult,
}

/// Result of one integration step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StepResult {
    /// Number of moves that the guard shortened.
    pub(super) shortened: u32,
    /// True if a position is not a finite number.
    pub(super) not_finite: bool,
}

impl Work {
    /// Buffers of a simulation that continues with these clearances of the last step.
    pub(super) fn new(kernel: Kernel, vectors: Vectors, clearance: Vec<f32>) -> Self {
        Self {
            kernel,
            vectors,
            chains: [Chain::default(), Chain::default()],
            loaded: false,
            parts: Vec::new(),
            segment_near: SegmentDistances::default(),
            near: Vec::new(),
            clearance,
        }
    }

    /// Clearances at the start of the last step; empty before the first one.
    pub(super) fn clearance(&self) -> &[f32] {
        &self.clearance
    }

    /// Discards the loaded chain, because the loop has changed.
    pub(super) fn invalidate(&mut self) {
        self.loaded = false;
    }

    /// Loads a changed loop, divided into `parts`.
    fn load(&mut self, s: &InnerLoop, parts: &[LoopPart]) {
        let n = s.len();
        self.chains[0].load(s);
        self.chains[1].resize(n);
        self.segment_near.resize(n);
        self.clearance.resize(n, 0.0);
        self.parts.resize_with(parts.len(), Buffers::default);
        for (buffers, part) in self.parts.iter_mut().zip(parts) {
            buffers.resize(part.particles.len());
        }
        self.loaded = true;
    }
}

impl Buffers {
    fn resize(&mut self, n: usize) {
        let all = self.a.iter_mut().chain(&mut self.sum_v).chain(&mut self.sum_a);
        all.for_each(|v| v.resize(n, 0.0));
        self.near.resize(n, 0.0);
        self.pull.iter_mut().chain([&mut self.rest]).for_each(|v| v.resize(n + 1, 0.0));
    }
}

/// Parameters of a step that are the same for all particles.
#[derive(Clone, Copy, Debug)]
struct Common<'a> {
    plan: &'a Plan,
    time: i64,
    row: &'a StepRow,
    region: &'a Region,
    kernel: Kernel,
    vectors: Vectors,
}

/// Advances the inner loop one step.
pub(super) fn step(
    plan: &Plan,
    time: i64,
    row: &StepRow,
    s: &mut InnerLoop,
    neighbours: &mut Neighbours,
    work: &mut Work,
) -> StepResult {
    if !work.loaded {
        neighbours.divide(s.len());
        work.load(s, &neighbours.parts);
    }
    let region = plan.region(time);
    let common = Common { plan, time, row, region: &region, kernel: work.kernel, vectors: work.vectors };
    let [start, middle, end] = row.contortion;
    let modifiers: &[f32] = match plan.integrator {
        Integrator::Euler => &[start],
        Integrator::Rk4 => &[start, middle, middle, end],
    };
    for (stage, &modifier) in modifiers.iter().enumerate() {
        let [chain, next] = &mut work.chains;
        let chain = &*chain;
        let (parts, lists) = neighbours.prepare(chain, &s.scale, row);
        let mut steps = part_steps(s, next, parts, &mut work.parts, &mut work.clearance);
        if stage == 0 {
            let segment_near = &work.segment_near;
            each(steps.iter_mut(), |step| {
                step.begin(common);
                step.evaluate(common, modifier, chain, &lists, Some(segment_near));
                if plan.integrator == Integrator::Rk4 {
                    step.advance(common, stage, chain);
                }
            });
            work.segment_near.take(&mut work.near);
        } else {
            let near = &work.near;
            each(steps.iter_mut(), |step| {
                step.evaluate(common, modifier, chain, &lists, None);
                if stage + 1 < STAGES.len() {
                    step.advance(common, stage, chain);
                } else {
                    step.conclude(common, chain, near);
                }
            });
        }
        if plan.integrator == Integrator::Euler {
            // The clearances are complete only after all parts.
            let near = &work.near;
            each(steps.iter_mut(), |step| step.conclude(common, chain, near));
        }
        work.chains.swap(0, 1);
        work.chains[0].join(neighbours.parts.iter().map(|part| part.particles.clone()));
    }
    work.parts.iter().fold(StepResult::default(), |all, part| StepResult {
        shortened: all.shortened + part.result.shortened,
        not_finite: all.not_finite || part.result.not_finite,
    })
}

/// Particles of a part in an evaluation.
struct PartStep<'a> {
    part: &'a mut LoopPart,
    buffers: &'a mut Buffers,
    next: Stretch<'a>,
    x: &'a mut [f32],
    y: &'a mut [f32],
    vx: &'a mut [f32],
    vy: &'a mut [f32],
    rest: &'a mut [f32],
    /// Rest length of the edge before the first particle.
    rest_before: f32,
    anchor: [&'a [f32]; 2],
    sign: &'a [f32],
    scale: &'a [f32],
    cleft: &'a [f32],
    clearance: &'a mut [f32],
}

fn part_steps<'a>(
    s: &'a mut InnerLoop,
    next: &'a mut Chain,
    parts: &'a mut [LoopPart],
    buffers: &'a mut [Buffers],
    mut clearance: &'a mut [f32],
) -> Vec<PartStep<'a>> {
    let n = s.len();
    let ranges: Vec<Range<usize>> = parts.iter().map(|part| part.particles.clone()).collect();
    let before: Vec<f32> = ranges.iter().map(|own| s.rest[(own.start + n - 1) % n]).collect();
    let stretches = next.stretches(ranges.into_iter());
    let (mut x, mut y, mut vx, mut vy) = (&mut s.x[..], &mut s.y[..], &mut s.vx[..], &mut s.vy[..]);
    let mut rest = &mut s.rest[..];
    let mut all = Vec::with_capacity(parts.len());
    for (((part, buffers), next), rest_before) in parts.iter_mut().zip(buffers).zip(stretches).zip(before) {
        let (own, count) = (part.particles.clone(), part.particles.len());
        all.push(PartStep {
            part,
            buffers,
            next,
            x: take(&mut x, count),
            y: take(&mut y, count),
            vx: take(&mut vx, count),
            vy: take(&mut vy, count),
            rest: take(&mut rest, count),
            rest_before,
            anchor: [&s.anchor_x[own.clone()], &s.anchor_y[own.clone()]],
            sign: &s.sign[own.clone()],
            scale: &s.scale[own.clone()],
            cleft: &s.cleft[own],
            clearance: take(&mut clearance, count),
        });
    }
    all
}

impl PartStep<'_> {
    /// Computes the values that are the same in all evaluations of a step.
    fn begin(&mut self, c: Common<'_>) {
        self.buffers.rest[0] = self.rest_before;
        self.buffers.rest[1..].copy_from_slice(self.rest);
        sway::update(c.plan, c.time, c.row, c.region, c.vectors, [self.x, self.y], &mut self.buffers.sway);
    }

    /// Updates the lists and computes the accelerations from all forces. With `near`, also computes
    /// the minimum distances of vertices and segments.
    fn evaluate(
        &mut self,
        c: Common<'_>,
        modifier: f32,
        chain: &Chain,
        lists: &Update<'_>,
        near: Option<&SegmentDistances>,
    ) {
        lists.apply(self.part, self.scale);
        let step = local::LocalStep { row: c.row, region: c.region, modifier };
        let Self { part, buffers, scale, .. } = self;
        let particles = part.particles.clone();
        let Buffers { a: [ax, ay], near: vertex_near, pull, sway, rest, .. } = &mut **buffers;
        let own = local::OwnParticles { rest, anchor: self.anchor, sign: self.sign, cleft: self.cleft };
        let (ax, ay, vertex_near) = (&mut ax[..], &mut ay[..], &mut vertex_near[..]);
        match c.kernel {
            Kernel::Scalar => {
                scalar::gather(c.vectors.lanes(), chain, scale, c.row, part, [ax, ay, vertex_near], near);
            }
            Kernel::Vector => c.vectors.run_in_lanes(Gather {
                chain,
                scale,
                row: c.row,
                part,
                fx: &mut *ax,
                fy: &mut *ay,
                near: vertex_near,
                segment_near: near,
            }),
        }
        c.vectors.run(
            #[inline(always)]
            || {
                local::add(chain, own, step, particles.clone(), pull, ax, ay);
                for (a, sway) in [&mut *ax, &mut *ay].into_iter().zip(&*sway) {
                    a.iter_mut().zip(sway).for_each(|(a, sway)| *a += sway);
                }
            },
        );
    }

    /// Adds the stage to the sums and moves to the next stage: positions by the velocities of this
    /// stage, velocities by its accelerations.
    fn advance(&mut self, c: Common<'_>, stage: usize, chain: &Chain) {
        let (weight, ahead) = STAGES[stage];
        let places = self.part.particles.start + 1..self.part.particles.end + 1;
        let Buffers { a: [ax, ay], sum_v: [sum_vx, sum_vy], sum_a: [sum_ax, sum_ay], .. } = &mut *self.buffers;
        let Stretch { x, y, vx, vy, .. } = &mut self.next;
        let (own_vx, own_vy) = (&chain.vx[places.clone()], &chain.vy[places]);
        let first = stage == 0;
        c.vectors.run(
            #[inline(always)]
            || {
                lead(ahead, [self.x, self.y], [own_vx, own_vy], [x, y]);
                advance(first, weight, ahead, self.vx, own_vx, ax, vx, sum_vx, sum_ax);
                advance(first, weight, ahead, self.vy, own_vy, ay, vy, sum_vy, sum_ay);
            },
        );
        self.place(c);
    }

    /// Derives blocks and normals in the next chain.
    fn place(&mut self, c: Common<'_>) {
        let (part, next) = (&mut *self.part, &mut self.next);
        c.vectors.run(
            #[inline(always)]
            || {
                next.derive();
                part.follow(next);
            },
        );
    }

    /// Moves the particles, as far as their clearances allow.
    fn conclude(&mut self, c: Common<'_>, chain: &Chain, near: &[f32]) {
        self.clear(c, near);
        let places = self.part.particles.start + 1..self.part.particles.end + 1;
        let (own_vx, own_vy) = (&chain.vx[places.clone()], &chain.vy[places]);
        let Buffers { a: [ax, ay], sum_v: [sum_vx, sum_vy], sum_a: [sum_ax, sum_ay], result, .. } = &mut *self.buffers;
        let rk4 = c.plan.integrator == Integrator::Rk4;
        let (x, y, vx, vy) = (&mut *self.x, &mut *self.y, &mut *self.vx, &mut *self.vy);
        let (rest, clearance) = (&mut *self.rest, &*self.clearance);
        *result = c.vectors.run(
            #[inline(always)]
            || {
                if rk4 {
                    conclude(vx, own_vx, ax, sum_vx, sum_ax);
                    conclude(vy, own_vy, ay, sum_vy, sum_ay);
                } else {
                    accelerate(vx, ax, sum_vx);
                    accelerate(vy, ay, sum_vy);
                }
                let result = guard(c.plan.clearance, [x, y], [vx, vy], [sum_vx, sum_vy], clearance);
                for rest in rest.iter_mut() {
                    *rest += c.row.relaxation * (c.row.edge - *rest);
                }
                result
            },
        );
        for (to, from) in [(&mut self.next.x, &self.x), (&mut self.next.y, &self.y)] {
            to.copy_from_slice(from);
        }
        for (to, from) in [(&mut self.next.vx, &self.vx), (&mut self.next.vy, &self.vy)] {
            to.copy_from_slice(from);
        }
        self.place(c);
    }

    /// Computes the clearances from the distances that all parts have found.
    fn clear(&mut self, c: Common<'_>, near: &[f32]) {
        let (first, count) = (self.part.particles.start, self.part.particles.len());
        let before = near[(first + near.len() - 1) % near.len()];
        let (vertex_near, near) = (&self.buffers.near[..count], &near[first..][..count]);
        let clearance = &mut self.clearance[..count];
        c.vectors.run(
            #[inline(always)]
            || {
                clearance[0] = min(min(vertex_near[0], before), near[0]).sqrt();
                for i in 1..count {
                    clearance[i] = min(min(vertex_near[i], near[i - 1]), near[i]).sqrt();
                }
            },
        );
    }
}

/// Computes the positions of the next stage. A particle moves at most as far as a whole step may
/// move it.
#[inline(always)]
fn lead(ahead: f32, [x, y]: [&[f32]; 2], [vx, vy]: [&[f32]; 2], [next_x, next_y]: [&mut [f32]; 2]) {
    let n = x.len();
    let (y, vx, vy, next_x, next_y) = (&y[..n], &vx[..n], &vy[..n], &mut next_x[..n], &mut next_y[..n]);
    for i in 0..n {
        let (dx, dy) = (ahead * vx[i], ahead * vy[i]);
        let distance = (dx * dx + dy * dy).sqrt();
        let factor = if distance > LIMITS[1] { LIMITS[1] / distance } else { 1.0 };
        next_x[i] = x[i] + factor * dx;
        next_y[i] = y[i] + factor * dy;
    }
}

/// One axis of [`PartStep::advance`]: velocities of the next stage, and the sums.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "one axis of a structure of arrays")]
fn advance(
    first: bool,
    weight: f32,
    ahead: f32,
    v0: &[f32],
    v: &[f32],
    a: &[f32],
    next_v: &mut [f32],
    sum_v: &mut [f32],
    sum_a: &mut [f32],
) {
    let n = v0.len();
    let (v, a) = (&v[..n], &a[..n]);
    let (next_v, sum_v, sum_a) = (&mut next_v[..n], &mut sum_v[..n], &mut sum_a[..n]);
    for i in 0..n {
        next_v[i] = v0[i] + ahead * a[i];
    }
    if first {
        sum_v.copy_from_slice(v);
        sum_a.copy_from_slice(a);
        return;
    }
    for i in 0..n {
        sum_v[i] += weight * v[i];
        sum_a[i] += weight * a[i];
    }
}

/// One axis of the end of a step: the new velocity, and the move in place of the sum of velocities.
#[inline(always)]
fn conclude(v0: &mut [f32], v: &[f32], a: &[f32], sum_v: &mut [f32], sum_a: &[f32]) {
    let n = v0.len();
    let (v, a, sum_v, sum_a) = (&v[..n], &a[..n], &mut sum_v[..n], &sum_a[..n]);
    for i in 0..n {
        sum_v[i] = (sum_v[i] + v[i]) * (1.0 / 6.0);
        v0[i] += (sum_a[i] + a[i]) * (1.0 / 6.0);
    }
}

/// One axis of the end of an Euler step.
#[inline(always)]
fn accelerate(v0: &mut [f32], a: &[f32], sum_v: &mut [f32]) {
    let n = v0.len();
    let (a, sum_v) = (&a[..n], &mut sum_v[..n]);
    for i in 0..n {
        v0[i] += a[i];
    }
    sum_v.copy_from_slice(v0);
}

/// Moves every particle as far as its clearance allows.
#[inline(always)]
fn guard(
    least: f32,
    [x, y]: [&mut [f32]; 2],
    [vx, vy]: [&mut [f32]; 2],
    [sx, sy]: [&[f32]; 2],
    clearance: &[f32],
) -> StepResult {
    let n = x.len();
    let (y, vx, vy) = (&mut y[..n], &mut vx[..n], &mut vy[..n]);
    let (sx, sy, clearance) = (&sx[..n], &sy[..n], &clearance[..n]);
    let (mut shortened, mut not_finite) = (0u32, 0u32);
    for i in 0..n {
        let limit = min(max(SHARE * (clearance[i] - least), LIMITS[0]), LIMITS[1]);
        let move_length = (sx[i] * sx[i] + sy[i] * sy[i]).sqrt();
        let factor = if move_length > limit { limit / move_length } else { 1.0 };
        shortened += u32::from(move_length > limit);
        x[i] += factor * sx[i];
        y[i] += factor * sy[i];
        vx[i] *= factor;
        vy[i] *= factor;
        // Zero times an infinity is not a number, and no number is not equal to itself.
        let zero = 0.0 * x[i] + 0.0 * y[i];
        not_finite |= u32::from(zero != 0.0);
    }
    StepResult { shortened, not_finite: not_finite != 0 }
}

/// Sums the pair forces on the particles of a part. With `segment_near`, also computes the minimum
/// squared distances of vertices (`near`) and segments.
struct Gather<'a> {
    chain: &'a Chain,
    scale: &'a [f32],
    row: &'a StepRow,
    part: &'a LoopPart,
    fx: &'a mut [f32],
    fy: &'a mut [f32],
    near: &'a mut [f32],
    segment_near: Option<&'a SegmentDistances>,
}

impl WithSimd for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.segment_near {
            Some(segment_near) => self.run::<S, true>(simd, segment_near),
            None => self.run::<S, false>(simd, &SegmentDistances::default()),
        }
    }
}

impl Gather<'_> {
    #[inline(always)]
    fn run<S: Simd, const CLEARANCE: bool>(self, simd: S, segment_near: &SegmentDistances) {
        let Self { chain, scale, row, part, fx, fy, near, .. } = self;
        let (lanes, n) = (Lanes::<S>::COUNT, chain.len());
        let (first, count) = (part.particles.start, part.particles.len());
        for (number, k) in (0..count).step_by(lanes).enumerate() {
            let own = k..(k + lanes).min(count);
            let particles = first + own.start..first + own.end;
            let group = Group::new(simd, row, chain, &scale[own.clone()], particles.start);
            let mut sums = Sums::new(simd);
            part.groups.visit(
                number,
                &OwnSegments::new(&particles, n),
                n,
                #[inline(always)]
                |j, is_own| {
                    let placed = if is_own {
                        group.place::<true>(&chain.blocks, j)
                    } else {
                        group.place::<false>(&chain.blocks, j)
                    };
                    if CLEARANCE && let Some(least) = sums.approach(&group, &placed) {
                        segment_near.lower(j, least);
                    }
                    sums.take(&group, placed);
                },
            );
            let [sum_x, sum_y, least] = sums.finish(&group);
            sum_x.write(&mut fx[own.clone()]);
            sum_y.write(&mut fy[own.clone()]);
            if CLEARANCE {
                least.write(&mut near[own]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_stage_displaces_a_particle_farther_than_a_step_can() {
        let (x, y) = ([1.0; 4], [-2.0; 4]);
        let (vx, vy) = ([6.0, 6.1, 3e30, -3000.0], [8.0, 8.0, 0.0, 4000.0]);
        let (mut next_x, mut next_y) = ([0.0; 4], [0.0; 4]);
        lead(0.5, [&x, &y], [&vx, &vy], [&mut next_x, &mut next_y]);
        assert_eq!((next_x[0], next_y[0]), (4.0, 2.0), "5 µm are not shortened");
        // The square of 1.5e30 is infinite in f32.
        assert_eq!((next_x[2], next_y[2]), (1.0, -2.0));
        for i in [1, 3] {
            let distance = (next_x[i] - 1.0).hypot(next_y[i] + 2.0);
            assert!((distance - 5.0).abs() < 1e-5, "{distance}");
        }
        assert!((next_x[3] + 2.0).abs() < 1e-5 && (next_y[3] - 2.0).abs() < 1e-5, "in the direction of the velocity");
    }
}
