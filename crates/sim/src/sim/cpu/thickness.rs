//! The thickness field: a smooth random field z that scales the force ranges by exp(a·z). It
//! removes the first limitation that the paper names, uniform thickness and gaps.

use super::variety::Around;
use crate::sim::maths::{CUT, cos_turns, fraction};
use crate::sim::plan::Plan;
use crate::sim::state::InnerLoop;

/// Computes the scales of all particles from the field and the variety around the wall. Called at
/// the start and at growth events only, because the field drifts slowly.
pub(super) fn update(plan: &Plan, time: i64, state: &mut InnerLoop) {
    varied(plan, time, state);
    if let Some(around) = Around::new(plan, time) {
        let anchors = state.anchor_x.iter().zip(&state.anchor_y);
        for (scale, (&x, &y)) in state.scale.iter_mut().zip(anchors) {
            *scale *= around.ranges([x, y]);
        }
    }
}

/// Computes the scales from the field alone.
fn varied(plan: &Plan, time: i64, state: &mut InnerLoop) {
    let amplitude = plan.at(time).variation;
    if amplitude == 0.0 {
        state.scale.clear();
        state.scale.resize(state.len(), 1.0);
        return;
    }
    let norm = (2.0 / plan.waves.len() as f32).sqrt();
    let phases: Vec<f32> = plan.waves.iter().map(|w| fraction(w.phase + w.drift * time as f64)).collect();
    let mut z = vec![0.0f32; state.len()];
    for (wave, &phase) in plan.waves.iter().zip(&phases) {
        for (z, (&x, &y)) in z.iter_mut().zip(state.x.iter().zip(&state.y)) {
            *z += cos_turns(x * wave.k[0] + y * wave.k[1] + phase);
        }
    }
    for (scale, z) in state.scale.iter_mut().zip(&z) {
        *scale = libm::expf(amplitude * (norm * z).clamp(-CUT, CUT));
    }
}
