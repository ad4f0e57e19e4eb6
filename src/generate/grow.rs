//! Runs the simulation and the loft together: each slab is tested while the steps between its two sections are still
//! in memory, so that it can be mended with one of them.

use super::checkpoint::Checkpoint;
use super::pace::Pace;
use super::types::{CancelToken, GenerateError, Request};
use crate::clock::Stopwatch;
use crate::mesh::{LoftError, Lofter};
use crate::model::Section;
use crate::sim::cpu::CpuSimulation;
use crate::sim::{Plan, SimError, Simulator, Statistics};

/// A grown model.
pub(super) struct Grown {
    /// The surface with open ends.
    pub(super) lofter: Lofter,
    /// All sections, those added to mend slabs included.
    pub(super) sections: Vec<Section>,
    /// Diagonals flipped to mend slabs.
    pub(super) flipped: usize,
    /// Counts of the simulation.
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

/// Vertices that mending may add to any model, besides as many as were predicted.
const SPARE_VERTICES: u64 = 1_000_000;

/// A surface that begins with `first`, limited in the number of vertices that mending may add.
pub(super) fn lofter(request: &Request, first: Section) -> Result<Lofter, GenerateError> {
    let most = 2 * request.spec.cost(&[]).vertices + SPARE_VERTICES;
    Ok(Lofter::new(first).map_err(unsound)?.with_most_vertices(most))
}

/// A growth under way.
struct Growth<'a> {
    request: &'a Request,
    simulation: CpuSimulation,
    lofter: Lofter,
    sections: Vec<Section>,
    /// The sections of the steps since the last recorded one.
    history: Vec<Section>,
    flipped: usize,
    recorded: u32,
    loft_seconds: f64,
}

/// Runs the whole simulation, or what remains after a checkpoint, and lofts its sections.
pub(super) fn grow(
    request: &Request,
    from: Option<Checkpoint>,
    pace: &mut Pace<'_>,
    cancel: &CancelToken,
) -> Result<Grown, GenerateError> {
    let mut growth = match from {
        None => Growth::begin(request, pace, cancel)?,
        Some(checkpoint) => match Growth::resume(request, checkpoint, pace, cancel) {
            Ok(growth) => growth,
            Err(GenerateError::Cancelled) => return Err(GenerateError::Cancelled),
            // A checkpoint that cannot be restored costs time only.
            Err(error) => {
                tracing::warn!(%error, "the checkpoint cannot be restored: the model is grown from its beginning");
                Growth::begin(request, pace, cancel)?
            }
        },
    };
    let (steps, every) = (i64::from(request.spec.steps), i64::from(request.spec.solver.record_every));
    while growth.simulation.time() < steps {
        if pace.wants_checkpoint() {
            growth.save(pace)?;
        }
        advance(&mut growth.simulation, pace, cancel)?;
        growth.history.push(growth.simulation.section());
        let time = growth.simulation.time();
        if time % every == 0 || time == steps {
            growth.record(pace)?;
        }
    }
    Ok(Grown {
        lofter: growth.lofter,
        sections: growth.sections,
        flipped: growth.flipped,
        statistics: growth.simulation.statistics(),
        loft_seconds: growth.loft_seconds,
    })
}

impl<'a> Growth<'a> {
    /// Runs the burn-in and records the first section.
    fn begin(request: &'a Request, pace: &mut Pace<'_>, cancel: &CancelToken) -> Result<Self, GenerateError> {
        let plan = Plan::new(&request.spec, request.seed);
        let mut simulation = CpuSimulation::new(plan, rayon::current_num_threads());
        while simulation.time() < 0 {
            advance(&mut simulation, pace, cancel)?;
        }
        let first = simulation.section();
        pace.section(&first);
        Ok(Self {
            request,
            simulation,
            lofter: lofter(request, first.clone())?,
            sections: vec![first],
            history: Vec::with_capacity(request.spec.solver.record_every as usize),
            flipped: 0,
            recorded: 1,
            loft_seconds: 0.0,
        })
    }

    /// Restores the simulation and lofts the sections of the surface again. Reports the sections once all is restored.
    fn resume(
        request: &'a Request,
        from: Checkpoint,
        pace: &mut Pace<'_>,
        cancel: &CancelToken,
    ) -> Result<Self, GenerateError> {
        let plan = Plan::new(&request.spec, request.seed);
        let simulation = CpuSimulation::restore(plan, rayon::current_num_threads(), &from.simulation)
            .map_err(|error| GenerateError::Simulation { detail: error.to_string() })?;
        let watch = Stopwatch::start();
        let mut sections = from.accepted.iter();
        let first = sections.next().ok_or_else(|| unsound(LoftError::NoSection))?;
        let mut lofter = lofter(request, first.clone())?;
        for section in sections {
            if cancel.is_cancelled() {
                return Err(GenerateError::Cancelled);
            }
            lofter.advance(std::slice::from_ref(section)).map_err(unsound)?;
        }
        pace.resumed(simulation.time(), simulation.particles());
        from.accepted.iter().filter(|section| !section.added).for_each(|section| pace.section(section));
        Ok(Self {
            request,
            simulation,
            lofter,
            sections: from.accepted,
            history: from.history,
            flipped: from.flipped,
            recorded: from.recorded,
            loft_seconds: watch.seconds(),
        })
    }

    /// Lofts up to the current step.
    fn record(&mut self, pace: &mut Pace<'_>) -> Result<(), GenerateError> {
        let watch = Stopwatch::start();
        let accepted = self.lofter.advance(&self.history).map_err(unsound)?;
        self.loft_seconds += watch.seconds();
        self.recorded += 1;
        self.flipped += accepted.flipped;
        self.sections.extend(accepted.sections);
        if let Some(section) = self.history.last() {
            pace.section(section);
        }
        self.history.clear();
        Ok(())
    }

    /// Writes a checkpoint between two steps.
    fn save(&self, pace: &Pace<'_>) -> Result<(), GenerateError> {
        let state = self.simulation.save();
        let bytes = Checkpoint::write(self.request, &state, &self.sections, &self.history, self.flipped, self.recorded)
            .map_err(|source| GenerateError::Io { name: "checkpoint".into(), source })?;
        pace.checkpoint(bytes);
        Ok(())
    }
}

fn advance(simulation: &mut CpuSimulation, pace: &mut Pace<'_>, cancel: &CancelToken) -> Result<(), GenerateError> {
    if cancel.is_cancelled() {
        return Err(GenerateError::Cancelled);
    }
    simulation.step().map_err(failed)?;
    pace.step(simulation.time(), simulation.particles());
    Ok(())
}
