//! Time integration (paper, section 3: Runge–Kutta of fourth order, or Euler) and the guard that keeps walls apart.
//!
//! Guard: with clear_i the least distance over all vertex–segment pairs that touch vertex i or one of its two edges,
//! a move is limited to 0.45·(clear_i − g_min). In the plane, first contact is always a vertex on a segment; the two
//! sides together close less than their distance, so the straight path from step to step is free of contact.

use super::chain::Chain;
use super::neighbours::{Neighbours, Part};
use super::pairs::{CLEARANCE_CAP, Kernel, PairTerms, Sums, add_block, greatest, reduce};
use super::vectorize::vectorize;
use super::{local, scalar, sway};
use crate::sim::Statistics;
use crate::sim::layout::{LANES, StepRow};
use crate::sim::maths::{max, min};
use crate::sim::plan::Plan;
use crate::sim::state::InnerLoop;
use crate::spec::Integrator;
use rayon::prelude::*;

/// Fraction of the free distance that one side may close in a step.
pub(super) const SHARE: f32 = 0.45;
/// Least and greatest limit of a move, µm.
pub(super) const LIMITS: [f32; 2] = [1e-5, 5.0];

/// Buffers of a step.
#[derive(Clone, Debug, Default)]
pub(super) struct Work {
    /// Arithmetic of the pair forces.
    kernel: Kernel,
    /// Accelerations of the stages.
    ax: [Vec<f32>; 4],
    ay: [Vec<f32>; 4],
    /// Weighted sum of the stage velocities.
    sx: Vec<f32>,
    sy: Vec<f32>,
    /// Force of the sway, the same in all stages; empty if there is none.
    sway: [Vec<f32>; 2],
    /// Greatest 1/d at the start of the step: of each vertex, of each segment.
    vertex_near: Vec<f32>,
    /// Clearance of each particle at the start of the last step, µm.
    clearance: Vec<f32>,
}

impl Work {
    pub(super) fn with_kernel(self, kernel: Kernel) -> Self {
        Self { kernel, ..self }
    }

    pub(super) fn resize(&mut self, n: usize) {
        for v in self.ax.iter_mut().chain(&mut self.ay) {
            v.resize(n, 0.0);
        }
        for v in [&mut self.sx, &mut self.sy, &mut self.vertex_near] {
            v.resize(n, 0.0);
        }
    }

    /// Buffers of a simulation that continues with these clearances of the last step.
    pub(super) fn with_clearance(clearance: Vec<f32>) -> Self {
        Self { clearance, ..Self::default() }
    }

    /// Clearances at the start of the last step; empty before the first one.
    pub(super) fn clearance(&self) -> &[f32] {
        &self.clearance
    }
}

/// Advances the inner loop one step.
#[expect(clippy::too_many_arguments, reason = "parts of the state that are borrowed separately")]
pub(super) fn step(
    plan: &Plan,
    time: i64,
    row: &StepRow,
    s: &mut InnerLoop,
    chain: &mut Chain,
    neighbours: &mut Neighbours,
    work: &mut Work,
    statistics: &mut Statistics,
) {
    let n = s.len();
    let region = plan.region(time);
    let at = |modifier: f32| local::Step { row, region: &region, modifier };
    sway::update(plan, time, row, &region, s, &mut work.sway);
    chain.resize(n);
    chain.x[1..=n].copy_from_slice(&s.x);
    chain.y[1..=n].copy_from_slice(&s.y);
    chain.vx[1..=n].copy_from_slice(&s.vx);
    chain.vy[1..=n].copy_from_slice(&s.vy);
    evaluate(at(row.contortion[0]), s, chain, neighbours, work, 0, true);
    gather_clearance(neighbours, work);
    match plan.integrator {
        Integrator::Euler => vectorize(
            #[inline(always)]
            || {
                for i in 0..n {
                    s.vx[i] += work.ax[0][i];
                    s.vy[i] += work.ay[0][i];
                    work.sx[i] = s.vx[i];
                    work.sy[i] = s.vy[i];
                }
            },
        ),
        Integrator::Rk4 => {
            // (weight of the stage velocity in the move, offset of the next stage) for stages 2, 3 and 4.
            work.sx.copy_from_slice(&s.vx);
            work.sy.copy_from_slice(&s.vy);
            for (stage, h, modifier, weight) in
                [(1, 0.5, row.contortion[1], 2.0), (2, 0.5, row.contortion[1], 2.0), (3, 1.0, row.contortion[2], 1.0)]
            {
                vectorize(
                    #[inline(always)]
                    || {
                        advance(h, weight, &s.x, &s.vx, &work.ax[stage - 1], &mut chain.x, &mut chain.vx, &mut work.sx);
                        advance(h, weight, &s.y, &s.vy, &work.ay[stage - 1], &mut chain.y, &mut chain.vy, &mut work.sy);
                    },
                );
                evaluate(at(modifier), s, chain, neighbours, work, stage, false);
            }
            vectorize(
                #[inline(always)]
                || {
                    conclude(&mut s.vx, &mut work.sx, &work.ax);
                    conclude(&mut s.vy, &mut work.sy, &work.ay);
                },
            );
        }
    }
    statistics.moves_shortened += guard(plan, s, work);
    for rest in &mut s.rest {
        *rest += row.relaxation * (row.edge - *rest);
    }
}

/// Moves one axis to the next stage: position by the previous stage's velocity, velocity by its acceleration; adds the
/// new stage velocity to the weighted sum. The chain holds the previous stage's velocity.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "one axis of a structure of arrays")]
fn advance(h: f32, weight: f32, x0: &[f32], v0: &[f32], a: &[f32], x: &mut [f32], v: &mut [f32], sum: &mut [f32]) {
    let n = x0.len();
    let (v0, a, sum) = (&v0[..n], &a[..n], &mut sum[..n]);
    let (x, v) = (&mut x[1..=n], &mut v[1..=n]);
    for i in 0..n {
        x[i] = x0[i] + h * v[i];
        v[i] = v0[i] + h * a[i];
        sum[i] += weight * v[i];
    }
}

/// Turns sums into the step's move and its final velocity.
#[inline(always)]
fn conclude(v: &mut [f32], sum: &mut [f32], a: &[Vec<f32>; 4]) {
    let n = v.len();
    let (a0, a1, a2, a3) = (&a[0][..n], &a[1][..n], &a[2][..n], &a[3][..n]);
    let sum = &mut sum[..n];
    for i in 0..n {
        v[i] += (a0[i] + 2.0 * (a1[i] + a2[i]) + a3[i]) * (1.0 / 6.0);
        sum[i] *= 1.0 / 6.0;
    }
}

/// Computes the accelerations of `stage` from all forces on the chain (mass is 1).
fn evaluate(
    step: local::Step<'_>,
    s: &InnerLoop,
    chain: &mut Chain,
    neighbours: &mut Neighbours,
    work: &mut Work,
    stage: usize,
    clearance: bool,
) {
    let row = step.row;
    vectorize(
        #[inline(always)]
        || {
            chain.close();
            chain.derive(&s.rest, row);
        },
    );
    neighbours.prepare(chain, s, row);
    let chain = &*chain;
    let mut outputs = Vec::with_capacity(neighbours.parts.len());
    let kernel = work.kernel;
    let (mut fx, mut fy) = (&mut work.ax[stage][..], &mut work.ay[stage][..]);
    let mut near = &mut work.vertex_near[..];
    for part in &mut neighbours.parts {
        let count = part.particles.len();
        let (fx1, fx2) = std::mem::take(&mut fx).split_at_mut(count);
        let (fy1, fy2) = std::mem::take(&mut fy).split_at_mut(count);
        let (near1, near2) = std::mem::take(&mut near).split_at_mut(count);
        (fx, fy, near) = (fx2, fy2, near2);
        outputs.push((part, fx1, fy1, near1));
    }
    let work_on = |(part, fx, fy, near): (&mut Part, &mut [f32], &mut [f32], &mut [f32])| {
        if kernel == Kernel::Scalar {
            scalar::gather(clearance, chain, s, row, part, fx, fy, near);
            local::add(chain, s, step, part.particles.clone(), fx, fy);
            return;
        }
        vectorize(
            #[inline(always)]
            || {
                if clearance {
                    gather::<true>(chain, s, row, part, fx, fy, near);
                } else {
                    gather::<false>(chain, s, row, part, fx, fy, near);
                }
                local::add(chain, s, step, part.particles.clone(), fx, fy);
            },
        );
    };
    if outputs.len() == 1 {
        outputs.into_iter().for_each(work_on);
    } else {
        outputs.into_par_iter().for_each(work_on);
    }
    for (a, sway) in [&mut work.ax[stage], &mut work.ay[stage]].into_iter().zip(&work.sway) {
        a.iter_mut().zip(sway).for_each(|(a, sway)| *a += sway);
    }
}

/// Sums the pair forces on a part's particles; with `CLEARANCE` also the greatest 1/d of vertices and segments.
#[inline(always)]
fn gather<const CLEARANCE: bool>(
    chain: &Chain,
    s: &InnerLoop,
    row: &StepRow,
    part: &mut Part,
    fx: &mut [f32],
    fy: &mut [f32],
    near: &mut [f32],
) {
    let n = chain.len();
    if CLEARANCE {
        part.near.iter_mut().for_each(|b| *b = [0.0; LANES]);
    }
    let mut segment_near = std::mem::take(&mut part.near);
    for (k, i) in part.particles.clone().enumerate() {
        let p = [chain.x[i + 1], chain.y[i + 1]];
        let terms = PairTerms::new(row, p, [chain.nx[i], chain.ny[i]], s.scale[i]);
        let before = if i == 0 { n - 1 } else { i - 1 };
        let mut sums = Sums::ZERO;
        for &b in part.blocks(k) {
            let b = b as usize;
            let block = &chain.blocks[b];
            let closeness = if b == i / LANES || b == before / LANES {
                let mut own = [false; LANES];
                if b == i / LANES {
                    own[i % LANES] = true;
                }
                if b == before / LANES {
                    own[before % LANES] = true;
                }
                add_block(&mut sums, &terms, block, Some(&own))
            } else {
                add_block(&mut sums, &terms, block, None)
            };
            if CLEARANCE {
                let seen = &mut segment_near[b];
                for l in 0..LANES {
                    seen[l] = max(seen[l], closeness[l]);
                }
            }
        }
        fx[k] = reduce(sums.fx);
        fy[k] = reduce(sums.fy);
        if CLEARANCE {
            near[k] = greatest(sums.near);
        }
    }
    part.near = segment_near;
}

/// Combines the distances found by all parts into the clearance of each particle.
fn gather_clearance(neighbours: &mut Neighbours, work: &mut Work) {
    let n = work.vertex_near.len();
    let Some((first, others)) = neighbours.parts.split_first_mut() else { return };
    for part in others {
        for (a, b) in first.near.iter_mut().zip(&part.near) {
            for l in 0..LANES {
                a[l] = max(a[l], b[l]);
            }
        }
    }
    let segment = |i: usize| first.near[i / LANES][i % LANES];
    work.clearance.clear();
    work.clearance.extend((0..n).map(|i| {
        let before = if i == 0 { n - 1 } else { i - 1 };
        let near = max(work.vertex_near[i], max(segment(before), segment(i)));
        1.0 / max(near, 1.0 / CLEARANCE_CAP)
    }));
}

/// Moves every particle by its sum of stage velocities, shortened to what its clearance allows. Returns the number of
/// shortened moves.
fn guard(plan: &Plan, s: &mut InnerLoop, work: &Work) -> u64 {
    let n = s.len();
    let (x, y, vx, vy) = (&mut s.x[..n], &mut s.y[..n], &mut s.vx[..n], &mut s.vy[..n]);
    let (sx, sy, clearance) = (&work.sx[..n], &work.sy[..n], &work.clearance[..n]);
    vectorize(
        #[inline(always)]
        || {
            let mut shortened = 0u32;
            for i in 0..n {
                let limit = min(max(SHARE * (clearance[i] - plan.clearance), LIMITS[0]), LIMITS[1]);
                let move_length = (sx[i] * sx[i] + sy[i] * sy[i]).sqrt();
                let factor = if move_length > limit { limit / move_length } else { 1.0 };
                shortened += u32::from(move_length > limit);
                x[i] += factor * sx[i];
                y[i] += factor * sy[i];
                vx[i] *= factor;
                vy[i] *= factor;
            }
            u64::from(shortened)
        },
    )
}
