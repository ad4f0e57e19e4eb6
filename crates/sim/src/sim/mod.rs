//! The particle simulation that grows cross sections (paper, section 3).
//!
//! [`Plan`] samples a specification and a seed into plain tables with one row per step. A backend
//! ([`cpu`], [`gpu`]) integrates the motion from these tables. All backends store the state and
//! compute the forces in f32. A step uses no random numbers. No result depends on the number of
//! threads or on the neighbour search.

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

/// Reason why a simulation stopped.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimError {
    /// A position is not a finite number.
    #[error("the position of a particle is not a finite number at step {step}")]
    NotFinite {
        /// Time step.
        step: i64,
    },
}

/// Counts of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Statistics {
    /// Number of splits deferred to the next growth event because the edge had no room.
    pub splits_deferred: u64,
    /// Number of particles still missing at the end, in both loops.
    pub splits_missing: u64,
    /// Number of moves that the guard shortened.
    pub moves_shortened: u64,
    /// Number of builds of the neighbour lists.
    pub list_builds: u64,
    /// Number of fallbacks to all segments, GPU only: evaluations in which a block of particles
    /// ignored its neighbour list because the list was outdated or full. Always 0 on the CPU, which
    /// rebuilds the list.
    pub full_searches: u64,
}
