//! Runs the simulation and builds the walls from its sections. Each slab is tested while the steps
//! between its two sections are in memory, so that one of them can mend the slab.

use super::checkpoint::{Checkpoint, CheckpointParts};
use super::pace::ProgressMeter;
use super::types::{CancelToken, GenerateError, Request};
use super::walls::Walls;
use crate::clock::Stopwatch;
use crate::model::Section;
use crate::sim::cpu::CpuSimulation;
use crate::sim::{Plan, Statistics};
use std::borrow::Cow;

/// Result of the growth of a model.
pub(super) struct GrownSections {
    /// Walls with open ends.
    pub(super) walls: Walls,
    /// Counts of the simulation.
    pub(super) statistics: Statistics,
    /// Seconds of the simulation.
    pub(super) seconds: f64,
}

/// A running growth.
struct Growth<'a> {
    request: &'a Request,
    simulation: CpuSimulation,
    walls: Walls,
    /// Sections of the steps since the last recorded one.
    history: Vec<Section>,
    recorded: u32,
}

/// Runs the whole simulation, or the rest after a checkpoint, and builds the walls from its
/// sections.
pub(super) fn grow(
    request: &Request,
    from: Option<Checkpoint>,
    pace: &mut ProgressMeter<'_>,
    cancel: &CancelToken,
) -> Result<GrownSections, GenerateError> {
    let watch = Stopwatch::start();
    let mut growth = match from {
        None => Growth::begin(request, pace, cancel)?,
        Some(checkpoint) => match Growth::resume(request, checkpoint, pace, cancel) {
            Ok(growth) => growth,
            Err(GenerateError::Cancelled) => return Err(GenerateError::Cancelled),
            // A checkpoint that cannot be restored only costs time.
            Err(error) => {
                tracing::warn!(%error, "the checkpoint cannot be restored: the model is grown from its beginning");
                Growth::begin(request, pace, cancel)?
            }
        },
    };
    let (last, every) = (i64::from(*request.spec.recorded().end()), i64::from(request.spec.interval()));
    while growth.simulation.time() < last {
        if pace.wants_checkpoint() {
            growth.save(pace)?;
        }
        advance(&mut growth.simulation, pace, cancel)?;
        growth.history.push(growth.simulation.section());
        let time = growth.simulation.time();
        if time % every == 0 || time == last {
            growth.record(pace)?;
        }
    }
    let seconds = watch.seconds() - growth.walls.seconds();
    Ok(GrownSections { walls: growth.walls, statistics: growth.simulation.statistics(), seconds })
}

impl<'a> Growth<'a> {
    /// Runs the burn-in and the steps before the piece, and records the first section.
    fn begin(request: &'a Request, pace: &mut ProgressMeter<'_>, cancel: &CancelToken) -> Result<Self, GenerateError> {
        let plan = Plan::new(&request.spec, request.seed);
        let mut simulation = CpuSimulation::new(plan, rayon::current_num_threads());
        while simulation.time() < i64::from(*request.spec.recorded().start()) {
            advance(&mut simulation, pace, cancel)?;
        }
        let first = simulation.section();
        pace.section(&first);
        let walls = Walls::new(request, &first)?;
        Ok(Self { request, simulation, walls, history: Vec::new(), recorded: 1 })
    }

    /// Restores the simulation, and the walls from their sections. Reports the sections when
    /// everything is restored.
    fn resume(
        request: &'a Request,
        mut from: Checkpoint,
        pace: &mut ProgressMeter<'_>,
        cancel: &CancelToken,
    ) -> Result<Self, GenerateError> {
        let plan = Plan::new(&request.spec, request.seed);
        let simulation = CpuSimulation::restore(plan, rayon::current_num_threads(), &from.simulation)?;
        let flipped = from.flipped;
        let walls = Walls::restored(request, from.accepted(), flipped, || cancel.is_cancelled())?;
        pace.resumed(simulation.time(), simulation.particles());
        for section in from.accepted() {
            let section = section?;
            if !section.added && walls.shows(section.step as u32) {
                pace.section(&section);
            }
        }
        Ok(Self { request, simulation, walls, history: from.history, recorded: from.recorded })
    }

    /// Extends the walls up to the current step.
    fn record(&mut self, pace: &mut ProgressMeter<'_>) -> Result<(), GenerateError> {
        let Some(section) = self.history.last() else { return Ok(()) };
        self.walls.extend(section, || Ok(Cow::Borrowed(&self.history)))?;
        if self.walls.shows(section.step as u32) {
            self.recorded += 1;
            pace.section(section);
        }
        self.history.clear();
        Ok(())
    }

    /// Writes a checkpoint between two steps.
    fn save(&mut self, pace: &ProgressMeter<'_>) -> Result<(), GenerateError> {
        let Self { request, simulation, walls, history, recorded } = self;
        let flipped = walls.flipped();
        let parts = CheckpointParts {
            simulation: &simulation.save(),
            accepted: &mut |out| walls.save(&request.metadata(0), out),
            history,
            flipped,
            recorded: *recorded,
        };
        let path = parts.save(request).map_err(|source| GenerateError::Io { name: "checkpoint".into(), source })?;
        pace.checkpoint(path);
        Ok(())
    }
}

fn advance(
    simulation: &mut CpuSimulation,
    pace: &mut ProgressMeter<'_>,
    cancel: &CancelToken,
) -> Result<(), GenerateError> {
    if cancel.is_cancelled() {
        return Err(GenerateError::Cancelled);
    }
    simulation.step()?;
    pace.step(simulation.time(), simulation.particles());
    Ok(())
}
