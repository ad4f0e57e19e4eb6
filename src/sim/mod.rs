//! The particle simulation that grows cross sections (paper, section 3).
//!
//! [`Plan`] turns a specification and a seed into plain tables, one row a step; a backend ([`cpu`], [`gpu`]) turns the
//! tables into motion. State and forces are f32 on every backend. Nothing random happens inside a step, and
//! no result depends on the number of threads or on the neighbour search.

pub mod cpu;
pub mod gpu;
mod layout;
mod maths;
mod plan;
mod state;

pub use layout::{LANES, StepRow};
pub use plan::{Lobe, Plan, Wave};
pub use state::{Checkpoint, InnerLoop, OuterLoop};

use crate::model::Section;

/// Why a simulation stopped.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimError {
    /// A position is no longer a finite number.
    #[error("a particle left the finite numbers at step {step}")]
    NotFinite {
        /// Time step.
        step: i64,
    },
}

/// What happened in a run besides the sections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Statistics {
    /// Splits put off because the strand had no room; each was tried again at the next event.
    pub splits_deferred: u64,
    /// Particles still missing at the end, both loops.
    pub splits_missing: u64,
    /// How often the guard shortened a particle's move.
    pub moves_shortened: u64,
    /// How often neighbour lists were built.
    pub list_builds: u64,
    /// On a GPU: how often a block of particles visited all others in an evaluation, for not all of its lists held or had
    /// room. The CPU builds its lists anew instead.
    pub full_searches: u64,
}

/// A running simulation, a step at a time. Backends implement it.
pub trait Simulator: Send {
    /// Advances one step; burn-in steps come first.
    ///
    /// # Errors
    /// [`SimError`] where the state is no longer valid.
    fn step(&mut self) -> Result<(), SimError>;
    /// The step reached; negative during burn-in, 0 at the isthmus end.
    fn time(&self) -> i64;
    /// The cross section at the step reached.
    fn section(&self) -> Section;
    /// Particles of both loops.
    fn particles(&self) -> u32;
    /// What happened so far.
    fn statistics(&self) -> Statistics;
}
