//! Fuzz target: stored states of simulations.

use super::CpuSimulation;
use crate::sim::Plan;
use crate::spec::{ModelSpec, preset};
use serde_json::json;
use std::sync::LazyLock;

/// A small model whose loops grow at the first steps.
static PLAN: LazyLock<Plan> = LazyLock::new(|| {
    let patch = json!({
        "steps": 60, "burn_in": 20, "particles": {
            "total": { "keys": [[0, 70], [1, 140]] }, "outer": { "keys": [[0, 20], [1, 30]] } },
    });
    let spec = preset("pig").map(|pig| ModelSpec::resolve(pig, &patch));
    Plan::new(&spec.expect("the preset exists").expect("the patch is valid"), 11)
});

/// Asserts that a restored state is saved as the same bytes, and that the simulation continues from
/// the state or returns an error.
pub fn state(bytes: &[u8]) {
    let Ok(mut simulation) = CpuSimulation::restore(PLAN.clone(), 1, bytes) else { return };
    assert!(simulation.save() == bytes, "another state was restored");
    for _ in 0..3 {
        if simulation.step().is_err() {
            break;
        }
    }
}
