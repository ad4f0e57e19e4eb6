//! Pair forces segment by segment in scalar arithmetic, as in the single-core version of the paper,
//! for benchmarks. The rounding differs from that of the vectors, so no model is grown with this
//! arithmetic.

use super::chain::Chain;
use super::clearance::SegmentDistances;
use super::neighbours::{LoopPart, OwnSegments};
use super::pairs::{CLEARANCE_CAP, PairTerms, reference_force};
use crate::sim::layout::StepRow;

/// Sums the pair forces on the particles of a part, whose lists are those of groups of `lanes`.
/// With `segment_near`, also computes the minimum squared distances of vertices (`near`) and
/// segments.
pub(super) fn gather(
    lanes: usize,
    chain: &Chain,
    scale: &[f32],
    row: &StepRow,
    part: &LoopPart,
    [fx, fy, near]: [&mut [f32]; 3],
    segment_near: Option<&SegmentDistances>,
) {
    let n = chain.len();
    let point = |i: usize| [chain.x[i + 1], chain.y[i + 1]];
    for (k, i) in part.particles.clone().enumerate() {
        let terms = PairTerms::new(row, point(i), [chain.nx[i], chain.ny[i]], scale[k]);
        let before = if i == 0 { n - 1 } else { i - 1 };
        let (mut sum, mut nearest) = ([0.0f32; 2], CLEARANCE_CAP * CLEARANCE_CAP);
        let visit = |j: usize, _| {
            if j == i || j == before {
                return;
            }
            let (force, closeness) = reference_force(&terms, point(j), point(j + 1));
            sum[0] += force[0];
            sum[1] += force[1];
            if let Some(segment_near) = segment_near {
                let square = 1.0 / (closeness * closeness);
                nearest = nearest.min(square);
                segment_near.lower(j, square);
            }
        };
        let group = k - k % lanes;
        let particles = part.particles.start + group..(part.particles.start + group + lanes).min(part.particles.end);
        part.groups.visit(group / lanes, &OwnSegments::new(&particles, n), n, visit);
        (fx[k], fy[k]) = (sum[0], sum[1]);
        near[k] = nearest;
    }
}
