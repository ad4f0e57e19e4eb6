//! The lean of a model, if its specification has one.

use super::types::Request;
use crate::mesh::lean::{Lean, Station};
use crate::sim::Plan;

/// The lean that a request asks for.
pub(super) fn lean(request: &Request) -> Option<Lean> {
    let spec = &request.spec;
    if !spec.leans() {
        return None;
    }
    let plan = Plan::new(spec, request.seed);
    let station = |step: u32| {
        let row = plan.at(i64::from(step));
        Station {
            z_um: plan.z_um[step as usize],
            // Within every outline, so that the wall keeps its place.
            r_in_um: f64::from(row.r_in * plan.scale * plan.region(i64::from(step)).narrowest()),
            squash: f64::from(row.squash),
            strength_um: spec.lean.strength_um.at(f64::from(step) / f64::from(spec.steps)),
        }
    };
    Some(Lean {
        seed: request.seed,
        wavelength_um: spec.lean.wavelength_um,
        along_um: spec.lean.along_mm * 1000.0,
        ends_um: spec.lean.ends_mm * 1000.0,
        stations: spec.stations().map(station).collect(),
    })
}
