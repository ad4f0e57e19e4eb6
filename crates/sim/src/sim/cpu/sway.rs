//! Sway: a smooth random flow that changes slowly with time and carries the fronds sideways. The
//! flow is the curl of a sum of cosines, so it neither compresses nor stretches tissue.

use crate::sim::layout::StepRow;
use crate::sim::maths::{cos_turns, fraction, max, min};
use crate::sim::plan::Plan;
use crate::sim::region::Region;
use crate::vectorize::Vectors;

/// Gauge, in units of `R_in`, up to which the flow has its full strength.
pub(super) const SWAYS: f32 = 0.55;
/// Gauge, in units of `R_in`, from which on there is no flow.
pub(super) const STILL: f32 = 0.95;

/// Computes the force on particles at `x`, `y` in a step: friction times the velocity of the flow.
/// The result is empty without sway.
pub(super) fn update(
    plan: &Plan,
    time: i64,
    row: &StepRow,
    region: &Region,
    vectors: Vectors,
    [x, y]: [&[f32]; 2],
    force: &mut [Vec<f32>; 2],
) {
    let n = if row.sway == 0.0 { 0 } else { x.len() };
    for axis in force.iter_mut() {
        axis.clear();
        axis.resize(n, 0.0);
    }
    if n == 0 {
        return;
    }
    let [fx, fy] = force;
    let (x, y, fx, fy) = (&x[..n], &y[..n], &mut fx[..n], &mut fy[..n]);
    let phases: Vec<f32> = plan.flows.iter().map(|f| fraction(f.phase + f.frequency * time as f64)).collect();
    let strength = row.sway * (2.0 / plan.flows.len() as f32).sqrt();
    let unsquash = 1.0 / row.squash;
    vectors.run(
        #[inline(always)]
        || {
            for (flow, &phase) in plan.flows.iter().zip(&phases) {
                for i in 0..n {
                    let wave = cos_turns(x[i] * flow.k[0] + y[i] * flow.k[1] + phase);
                    fx[i] += flow.direction[0] * wave;
                    fy[i] += flow.direction[1] * wave;
                }
            }
            for i in 0..n {
                let flat = [x[i], y[i] * unsquash];
                let gauge = match region {
                    Region::Ellipse => (flat[0] * flat[0] + flat[1] * flat[1]).sqrt(),
                    Region::Shaped(gauge) => gauge.radius(flat),
                };
                let radius = gauge / row.r_in;
                let still = min(max((radius - SWAYS) / (STILL - SWAYS), 0.0), 1.0);
                let weight = strength * (1.0 - still * still * (3.0 - 2.0 * still));
                fx[i] *= weight;
                fy[i] *= weight;
            }
        },
    );
}
