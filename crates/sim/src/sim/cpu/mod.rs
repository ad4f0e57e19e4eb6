//! The simulation on the CPU; its results do not depend on the number of threads.
//!
//! Each particle adds the forces of segments one by one, in ascending order; segments out of range add exact zeros. A vector holds
//! consecutive particles, not segments. Therefore neither the number of threads, nor the neighbour search, nor the
//! width of the vectors changes a bit. Fused multiply-add is never used.

mod chain;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod growth;
mod integrate;
mod local;
mod neighbours;
mod outer;
mod pairs;
mod saved;
mod scalar;
mod sway;
mod thickness;
mod variety;

use super::layout::StepRow;
use super::maths;
use super::plan::Plan;
use super::state::{Checkpoint, InnerLoop, OuterLoop};
use super::{SimError, Simulator, Statistics};
use crate::model::Section;
use crate::spec::Search;
use crate::vectorize::Vectors;
use neighbours::Neighbours;
pub use pairs::{Kernel, PairTerms, reference_force};
pub use saved::StateError;
pub(super) use variety::coefficients;

/// Constants of the model that every backend must share, by their names in the shaders.
pub const CONSTANTS: [(&str, f32); 20] = [
    ("SHARE", integrate::SHARE),
    ("LEAST_MOVE", integrate::LIMITS[0]),
    ("GREATEST_MOVE", integrate::LIMITS[1]),
    ("SKIN", super::layout::DEVICE_SKIN),
    ("CLEARANCE_CAP", pairs::CLEARANCE_CAP),
    ("TINY", pairs::TINY),
    ("ROOM", growth::ROOM),
    ("SPAN", growth::SPAN as f32),
    ("CUT", maths::CUT),
    ("WEIGHT", variety::WEIGHT),
    ("HEAVIEST", variety::HEAVIEST),
    ("SWAYS", sway::SWAYS),
    ("STILL", sway::STILL),
    ("MOVE", outer::MOVE),
    ("TAUT", outer::TAUT),
    ("PULL", outer::PULL),
    ("CLOSING", outer::CLOSING),
    ("WIDENING", outer::WIDENING),
    ("WIDEST", outer::WIDEST),
    ("NARROWEST", outer::NARROWEST),
];

/// A simulation on the CPU. Runs on the threads of the rayon pool in which it is called.
#[derive(Debug)]
pub struct CpuSimulation {
    plan: Plan,
    time: i64,
    inner: InnerLoop,
    outer: OuterLoop,
    neighbours: Neighbours,
    work: integrate::Work,
    statistics: Statistics,
}

impl CpuSimulation {
    /// The state before the first burn-in step. The work is divided for `threads` threads.
    #[must_use]
    pub fn new(plan: Plan, threads: usize) -> Self {
        let inner = InnerLoop::start(&plan);
        let outer = outer::start(&plan, -i64::from(plan.burn_in));
        let vectors = Vectors::best();
        let neighbours = Neighbours::new(plan.search, vectors, threads);
        let mut simulation = Self {
            time: -i64::from(plan.burn_in),
            plan,
            inner,
            outer,
            neighbours,
            work: integrate::Work::new(Kernel::default(), vectors, Vec::new()),
            statistics: Statistics::default(),
        };
        thickness::update(&simulation.plan, simulation.time, &mut simulation.inner);
        simulation
    }

    /// A copy that continues with another search and arithmetic, divided for `threads` threads: for benchmarks.
    #[must_use]
    pub fn fork(&self, search: Search, kernel: Kernel, threads: usize) -> Self {
        self.fork_with(search, kernel, Vectors::best(), threads)
    }

    /// The same with given vectors.
    fn fork_with(&self, search: Search, kernel: Kernel, vectors: Vectors, threads: usize) -> Self {
        Self {
            plan: Plan { search, ..self.plan.clone() },
            time: self.time,
            inner: self.inner.clone(),
            outer: self.outer.clone(),
            neighbours: Neighbours::new(search, vectors, threads),
            work: integrate::Work::new(kernel, vectors, self.work.clearance().to_vec()),
            statistics: self.statistics,
        }
    }

    /// The current inner loop.
    #[must_use]
    pub fn inner(&self) -> &InnerLoop {
        &self.inner
    }

    /// The whole current state.
    #[must_use]
    pub fn checkpoint(&self) -> Checkpoint {
        Checkpoint {
            time: self.time,
            inner: self.inner.clone(),
            outer: self.outer.clone(),
            clearance: self.work.clearance().to_vec(),
        }
    }

    /// A simulation that continues from `checkpoint`; `threads` as for [`CpuSimulation::new`].
    #[must_use]
    pub fn resume(plan: Plan, checkpoint: &Checkpoint, threads: usize) -> Self {
        let vectors = Vectors::best();
        let neighbours = Neighbours::new(plan.search, vectors, threads);
        let work = integrate::Work::new(Kernel::default(), vectors, checkpoint.clearance.clone());
        Self {
            time: checkpoint.time,
            plan,
            inner: checkpoint.inner.clone(),
            outer: checkpoint.outer.clone(),
            neighbours,
            work,
            statistics: Statistics::default(),
        }
    }

    fn grow(&mut self, row: &StepRow) {
        let deferred = growth::grow_inner(&self.plan, self.time, row, &mut self.inner, self.work.clearance());
        self.statistics.splits_deferred += u64::from(deferred);
        growth::grow_outer(row, &mut self.outer);
        thickness::update(&self.plan, self.time, &mut self.inner);
        self.work.invalidate();
    }
}

impl Simulator for CpuSimulation {
    fn step(&mut self) -> Result<(), SimError> {
        let row = *self.plan.at(self.time);
        if self.plan.grows_at(self.time) {
            self.grow(&row);
        }
        let outcome =
            integrate::step(&self.plan, self.time, &row, &mut self.inner, &mut self.neighbours, &mut self.work);
        self.statistics.moves_shortened += u64::from(outcome.shortened);
        outer::step(&self.plan, self.time, &row, &self.inner, &mut self.outer);
        self.time += 1;
        if outcome.not_finite { Err(SimError::NotFinite { step: self.time }) } else { Ok(()) }
    }

    fn time(&self) -> i64 {
        self.time
    }

    fn section(&self) -> Section {
        let at = self.time.clamp(0, i64::from(self.plan.steps)) as usize;
        Section {
            step: at as f64,
            z_um: self.plan.z_um[at],
            added: false,
            inner: self.inner.ring(self.plan.scale),
            outer: self.outer.ring(self.plan.scale),
        }
    }

    fn particles(&self) -> u32 {
        (self.inner.len() + self.outer.len()) as u32
    }

    fn statistics(&self) -> Statistics {
        let [inner, outer] = {
            let last = self.plan.at(i64::from(self.plan.steps));
            [last.inner_target, last.outer_target]
        };
        Statistics {
            splits_missing: u64::from((inner + outer).saturating_sub(self.particles())),
            list_builds: self.neighbours.builds(),
            ..self.statistics
        }
    }
}

#[cfg(test)]
mod tests;
