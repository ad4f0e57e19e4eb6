//! The pair forces segment by segment in scalar arithmetic, as in the paper's single-core version: for
//! benchmarks only. Sums are rounded differently from those of the blocks, so no model is made with it.

use super::chain::Chain;
use super::neighbours::Part;
use super::pairs::{PairTerms, reference_force};
use crate::sim::layout::{LANES, StepRow};
use crate::sim::state::InnerLoop;

/// Sums the pair forces on a part's particles; with `clearance` also the greatest 1/d of vertices and segments.
#[expect(clippy::too_many_arguments, reason = "the same parameters as the vectorised version")]
pub(super) fn gather(
    clearance: bool,
    chain: &Chain,
    s: &InnerLoop,
    row: &StepRow,
    part: &mut Part,
    fx: &mut [f32],
    fy: &mut [f32],
    near: &mut [f32],
) {
    let n = chain.len();
    let mut segment_near = std::mem::take(&mut part.near);
    if clearance {
        segment_near.fill([0.0; LANES]);
    }
    let point = |i: usize| [chain.x[i + 1], chain.y[i + 1]];
    for (k, i) in part.particles.clone().enumerate() {
        let terms = PairTerms::new(row, point(i), [chain.nx[i], chain.ny[i]], s.scale[i]);
        let before = if i == 0 { n - 1 } else { i - 1 };
        let (mut sum, mut nearest) = ([0.0f32; 2], 0.0f32);
        for &b in part.blocks(k) {
            let first = b as usize * LANES;
            for j in first..(first + LANES).min(n) {
                if j == i || j == before {
                    continue;
                }
                let (force, closeness) = reference_force(&terms, point(j), point(j + 1));
                sum[0] += force[0];
                sum[1] += force[1];
                if clearance {
                    nearest = nearest.max(closeness);
                    let seen = &mut segment_near[j / LANES][j % LANES];
                    *seen = seen.max(closeness);
                }
            }
        }
        fx[k] = sum[0];
        fy[k] = sum[1];
        if clearance {
            near[k] = nearest;
        }
    }
    part.near = segment_near;
}
