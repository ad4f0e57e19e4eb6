//! State that all slots and attempts of a pool share.

use super::generator::Generator;
use super::options::PoolOptions;
use super::policy::Storage;
use crate::jobs::Store;
use crate::jobs::artifacts::Artifacts;
use crate::jobs::scratch::Scratch;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tokio::sync::watch;

/// State that all slots and attempts of a pool share.
pub(super) struct Context {
    pub(super) store: Store,
    pub(super) artifacts: Artifacts,
    /// Runs jobs on the CPU.
    pub(super) generator: Arc<Generator>,
    pub(super) options: PoolOptions,
    pub(super) scratch: Arc<Scratch>,
    pub(super) storage: Storage,
    pub(super) phase: watch::Receiver<Phase>,
    /// True while a GPU of this pool waits because the surfaces of its batches take longer than
    /// their simulations.
    pub(super) surfaces_lag: AtomicBool,
}

/// Instruction to all workers of a pool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Claim and run jobs.
    Run,
    /// Claim no more jobs; running jobs may end.
    Drain,
    /// Release running jobs.
    Release,
}
