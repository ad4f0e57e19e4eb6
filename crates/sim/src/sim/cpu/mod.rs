//! The simulation on the CPU. Its results do not depend on the number of threads.
//!
//! Each particle adds the forces of segments one by one, in ascending order; segments out of range
//! add exact zeros. A vector holds consecutive particles, not segments. Therefore neither the
//! number of threads, nor the neighbour search, nor the width of the vectors changes any bit. The
//! code never uses fused multiply-add.

mod chain;
mod clearance;
mod clefts;
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
mod team;
mod thickness;
mod variety;

use super::layout::StepRow;
use super::maths;
use super::plan::Plan;
use super::state::{Checkpoint, InnerLoop, OuterLoop, section};
use super::{SimError, Statistics};
use crate::model::Section;
use crate::spec::Search;
use crate::vectorize::Vectors;
use neighbours::Neighbours;
pub use pairs::{Kernel, PairTerms, reference_force};
pub use saved::StateError;
pub(super) use variety::coefficients;

/// Constants that every backend must share, by their names in the shaders.
pub const CONSTANTS: [(&str, f32); 21] = [
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
    ("FAR_FROM_CLEFTS", clefts::FAR),
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
        let time = -i64::from(plan.burn_in);
        let (mut inner, outer) = (InnerLoop::start(&plan), outer::start(&plan, time));
        thickness::update(&plan, time, &mut inner);
        clefts::update(&plan, time, &mut inner);
        let start = Checkpoint { time, inner, outer, clearance: Vec::new() };
        Self::from_checkpoint(plan, start, Kernel::default(), Vectors::best(), threads)
    }

    /// A simulation that continues from `checkpoint`; `threads` as for [`CpuSimulation::new`].
    #[must_use]
    pub fn resume(plan: Plan, checkpoint: &Checkpoint, threads: usize) -> Self {
        Self::from_checkpoint(plan, checkpoint.clone(), Kernel::default(), Vectors::best(), threads)
    }

    fn from_checkpoint(plan: Plan, from: Checkpoint, kernel: Kernel, vectors: Vectors, threads: usize) -> Self {
        let Checkpoint { time, inner, outer, clearance } = from;
        Self {
            neighbours: Neighbours::new(plan.search, vectors, threads),
            work: integrate::Work::new(kernel, vectors, clearance),
            plan,
            time,
            inner,
            outer,
            statistics: Statistics::default(),
        }
    }

    /// A copy that continues with another search and arithmetic, divided for `threads` threads: for
    /// benchmarks.
    #[must_use]
    pub fn fork(&self, search: Search, kernel: Kernel, threads: usize) -> Self {
        self.fork_with(search, kernel, Vectors::best(), threads)
    }

    fn fork_with(&self, search: Search, kernel: Kernel, vectors: Vectors, threads: usize) -> Self {
        let plan = Plan { search, ..self.plan.clone() };
        let copy = Self::from_checkpoint(plan, self.checkpoint(), kernel, vectors, threads);
        Self { statistics: self.statistics, ..copy }
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

    /// Advances one step; burn-in steps come first.
    ///
    /// # Errors
    /// [`SimError`] if the new state is not valid.
    pub fn step(&mut self) -> Result<(), SimError> {
        team::awake(self.neighbours.threads(), || self.advance())
    }

    fn advance(&mut self) -> Result<(), SimError> {
        let row = *self.plan.at(self.time);
        if self.plan.grows_at(self.time) {
            self.grow(&row);
        }
        let result =
            integrate::step(&self.plan, self.time, &row, &mut self.inner, &mut self.neighbours, &mut self.work);
        self.statistics.moves_shortened += u64::from(result.shortened);
        outer::step(&self.plan, self.time, &row, &self.inner, &mut self.outer);
        self.time += 1;
        if result.not_finite { Err(SimError::NotFinite { step: self.time }) } else { Ok(()) }
    }

    fn grow(&mut self, row: &StepRow) {
        let deferred = growth::grow_inner(&self.plan, self.time, row, &mut self.inner, self.work.clearance());
        self.statistics.splits_deferred += u64::from(deferred);
        growth::grow_outer(row, &mut self.outer);
        thickness::update(&self.plan, self.time, &mut self.inner);
        clefts::update(&self.plan, self.time, &mut self.inner);
        self.work.invalidate();
    }

    /// The current step; negative during burn-in, 0 at the isthmus end.
    #[must_use]
    pub fn time(&self) -> i64 {
        self.time
    }

    /// The cross section at the current step.
    #[must_use]
    pub fn section(&self) -> Section {
        section(&self.plan, self.time, &self.inner, &self.outer)
    }

    /// Number of particles of both loops.
    #[must_use]
    pub fn particles(&self) -> u32 {
        (self.inner.len() + self.outer.len()) as u32
    }

    /// Counts so far.
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        Statistics {
            splits_missing: self.plan.missing_splits(self.particles()),
            list_builds: self.neighbours.builds(),
            ..self.statistics
        }
    }
}

#[cfg(test)]
mod tests;
