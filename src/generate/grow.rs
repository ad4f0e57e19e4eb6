//! The simulation and the loft side by side: each slab is tested while the steps between its sections are still at
//! hand, so that a slab that needs mending can have a section of them.

use super::pace::Pace;
use super::types::{CancelToken, GenerateError, Request};
use crate::clock::Stopwatch;
use crate::mesh::{LoftError, Lofter};
use crate::model::Section;
use crate::sim::cpu::CpuSimulation;
use crate::sim::{Plan, SimError, Simulator, Statistics};

/// What was grown.
pub(super) struct Grown {
    /// The surface, its ends still open.
    pub(super) lofter: Lofter,
    /// All sections, those added to mend slabs included.
    pub(super) sections: Vec<Section>,
    /// Diagonals flipped to mend slabs.
    pub(super) flipped: usize,
    /// What happened in the simulation.
    pub(super) statistics: Statistics,
    /// Seconds spent in the loft.
    pub(super) loft_seconds: f64,
}

#[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
pub(super) fn unsound(error: LoftError) -> GenerateError {
    GenerateError::Certificate { detail: error.to_string() }
}

#[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
fn failed(error: SimError) -> GenerateError {
    GenerateError::Simulation { detail: error.to_string() }
}

/// Runs the whole simulation and lofts its sections.
pub(super) fn grow(request: &Request, pace: &mut Pace<'_>, cancel: &CancelToken) -> Result<Grown, GenerateError> {
    let plan = Plan::new(&request.spec, request.seed);
    let mut simulation = CpuSimulation::new(plan, rayon::current_num_threads());
    while simulation.time() < 0 {
        advance(&mut simulation, pace, cancel)?;
    }
    let first = simulation.section();
    pace.section(&first);
    let mut sections = vec![first.clone()];
    let mut lofter = Lofter::new(first).map_err(unsound)?;
    let (steps, every) = (i64::from(request.spec.steps), i64::from(request.spec.solver.record_every));
    let mut history = Vec::with_capacity(every as usize);
    let mut loft_seconds = 0.0;
    let mut flipped = 0;
    while simulation.time() < steps {
        advance(&mut simulation, pace, cancel)?;
        history.push(simulation.section());
        let time = simulation.time();
        if time % every == 0 || time == steps {
            let watch = Stopwatch::start();
            let accepted = lofter.advance(&history).map_err(unsound)?;
            loft_seconds += watch.seconds();
            flipped += accepted.flipped;
            sections.extend(accepted.sections);
            if let Some(section) = history.last() {
                pace.section(section);
            }
            history.clear();
        }
    }
    Ok(Grown { lofter, sections, flipped, statistics: simulation.statistics(), loft_seconds })
}

fn advance(simulation: &mut CpuSimulation, pace: &mut Pace<'_>, cancel: &CancelToken) -> Result<(), GenerateError> {
    if cancel.is_cancelled() {
        return Err(GenerateError::Cancelled);
    }
    simulation.step().map_err(failed)?;
    pace.step(simulation.time(), simulation.particles());
    Ok(())
}
