//! The simulation on the CPU; its results do not depend on the number of threads.
//!
//! Each particle gathers its forces from blocks of segments, in ascending order, into [`layout::LANES`](super::layout::LANES) partial
//! sums that are reduced in a fixed order; pairs out of range add exact zeros. Therefore neither the number of threads nor
//! the neighbour search changes a bit. Fused multiply-add is never used.

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
mod vectorize;

use super::layout::StepRow;
use super::maths;
use super::plan::Plan;
use super::state::{Checkpoint, InnerLoop, OuterLoop};
use super::{SimError, Simulator, Statistics};
use crate::model::Section;
use crate::spec::Search;
use chain::Chain;
use neighbours::Neighbours;
pub use pairs::{Kernel, PairTerms, reference_force};
pub use saved::StateError;
pub(super) use variety::coefficients;

/// Constants of the model that every backend must share, by their names in the shaders.
pub const CONSTANTS: [(&str, f32); 20] = [
    ("SHARE", integrate::SHARE),
    ("LEAST_MOVE", integrate::LIMITS[0]),
    ("GREATEST_MOVE", integrate::LIMITS[1]),
    ("SKIN", neighbours::SKIN),
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
    chain: Chain,
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
        let neighbours = Neighbours::new(plan.search, threads);
        let mut simulation = Self {
            time: -i64::from(plan.burn_in),
            plan,
            inner,
            outer,
            chain: Chain::default(),
            neighbours,
            work: integrate::Work::default(),
            statistics: Statistics::default(),
        };
        simulation.work.resize(simulation.inner.len());
        thickness::update(&simulation.plan, simulation.time, &mut simulation.inner);
        simulation
    }

    /// A copy that continues with another search and arithmetic, divided for `threads` threads: for benchmarks.
    #[must_use]
    pub fn fork(&self, search: Search, kernel: Kernel, threads: usize) -> Self {
        Self {
            plan: Plan { search, ..self.plan.clone() },
            time: self.time,
            inner: self.inner.clone(),
            outer: self.outer.clone(),
            chain: self.chain.clone(),
            neighbours: Neighbours::new(search, threads),
            work: self.work.clone().with_kernel(kernel),
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
        let neighbours = Neighbours::new(plan.search, threads);
        let mut work = integrate::Work::with_clearance(checkpoint.clearance.clone());
        work.resize(checkpoint.inner.len());
        Self {
            time: checkpoint.time,
            plan,
            inner: checkpoint.inner.clone(),
            outer: checkpoint.outer.clone(),
            chain: Chain::default(),
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
        self.work.resize(self.inner.len());
        self.neighbours.invalidate();
    }
}

impl Simulator for CpuSimulation {
    fn step(&mut self) -> Result<(), SimError> {
        let row = *self.plan.at(self.time);
        if self.plan.grows_at(self.time) {
            self.grow(&row);
        }
        integrate::step(
            &self.plan,
            self.time,
            &row,
            &mut self.inner,
            &mut self.chain,
            &mut self.neighbours,
            &mut self.work,
            &mut self.statistics,
        );
        outer::step(&self.plan, self.time, &row, &self.inner, &mut self.outer);
        self.time += 1;
        let finite = |v: &[f32]| v.iter().fold(0.0f32, |sum, x| sum + 0.0 * x) == 0.0;
        if finite(&self.inner.x) && finite(&self.inner.y) {
            Ok(())
        } else {
            Err(SimError::NotFinite { step: self.time })
        }
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
