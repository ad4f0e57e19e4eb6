//! The particle simulation that grows cross sections (paper, section 3).
//!
//! [`Plan`] turns a specification and a seed into plain tables, one row per step; a backend ([`cpu`], [`gpu`]) integrates the
//! motion from them. State and forces are f32 on every backend. A step uses no random numbers, and
//! no result depends on the number of threads or on the neighbour search.

pub mod cpu;
pub mod gpu;
mod layout;
mod maths;
mod plan;
pub mod reference;
mod region;
mod state;

pub use layout::{LANES, StepRow};
pub use plan::{Flow, Lobe, Plan, Wave};
pub use region::{Region, Spoke};
pub use state::{Checkpoint, InnerLoop, OuterLoop};

use crate::model::Section;

/// Why a simulation stopped.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimError {
    /// A position is no longer a finite number.
    #[error("the position of a particle is not a finite number at step {step}")]
    NotFinite {
        /// Time step.
        step: i64,
    },
}

/// Counts of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Statistics {
    /// Splits deferred to the next growth event because the edge had no room.
    pub splits_deferred: u64,
    /// Particles still missing at the end, both loops.
    pub splits_missing: u64,
    /// Moves of particles that the guard shortened.
    pub moves_shortened: u64,
    /// Times that neighbour lists were built.
    pub list_builds: u64,
    /// On a GPU: how often a block of particles visited all segments in an evaluation, because its list was outdated or too
    /// long. The CPU rebuilds its lists instead.
    pub full_searches: u64,
}

/// A running simulation that advances one step at a time. Backends implement it.
pub trait Simulator: Send {
    /// Advances one step; burn-in steps come first.
    ///
    /// # Errors
    /// [`SimError`] if the state is no longer valid.
    fn step(&mut self) -> Result<(), SimError>;
    /// The step reached; negative during burn-in, 0 at the isthmus end.
    fn time(&self) -> i64;
    /// The cross section at the step reached.
    fn section(&self) -> Section;
    /// Particles of both loops.
    fn particles(&self) -> u32;
    /// Counts so far.
    fn statistics(&self) -> Statistics;
}
