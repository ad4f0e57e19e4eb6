//! What a batch needs of a GPU: the seam at which tests put another device.

use crate::model::Section;
use crate::sim::gpu::{BatchSink, Checkpoint, GpuDevice, GpuError, replay, run_batch};
use crate::sim::{Plan, SimError, Statistics};

/// Takes what a batch yields, on the thread that drives the device.
pub(super) trait Told<M> {
    /// The next recorded section, with the state that a replay of the slab above it begins at.
    fn section(&mut self, member: usize, section: Section, mark: M);
    /// How far a member is.
    fn progress(&mut self, member: usize, step: i64, particles: u32);
    /// Whether a member shall stop.
    fn cancelled(&mut self, member: usize) -> bool;
    /// A member cannot go on.
    fn failed(&mut self, member: usize, error: SimError);
    /// A member reached its last step.
    fn finished(&mut self, member: usize, statistics: Statistics);
}

/// Runs many simulations at a time.
pub(super) trait Device: Sync {
    /// The state of a simulation at a recorded section.
    type Mark: Send;

    /// In words.
    fn name(&self) -> String;
    /// Runs `plans` to their ends.
    fn run(&self, plans: &[Plan], told: &mut dyn Told<Self::Mark>) -> Result<(), GpuError>;
    /// The sections of every step after `mark`, up to the next recorded one.
    fn replay(&self, plan: &Plan, mark: &Self::Mark) -> Result<Vec<Section>, GpuError>;
}

impl Device for GpuDevice {
    type Mark = Checkpoint;

    fn name(&self) -> String {
        GpuDevice::name(self).to_owned()
    }

    fn run(&self, plans: &[Plan], told: &mut dyn Told<Checkpoint>) -> Result<(), GpuError> {
        run_batch(self, plans, &mut Bridge(told)).map(drop)
    }

    fn replay(&self, plan: &Plan, mark: &Checkpoint) -> Result<Vec<Section>, GpuError> {
        replay(self, plan, mark)
    }
}

struct Bridge<'a>(&'a mut dyn Told<Checkpoint>);

impl BatchSink for Bridge<'_> {
    fn section(&mut self, member: usize, section: Section, checkpoint: Checkpoint) {
        self.0.section(member, section, checkpoint);
    }

    fn progress(&mut self, member: usize, step: i64, particles: u32) {
        self.0.progress(member, step, particles);
    }

    fn cancelled(&mut self, member: usize) -> bool {
        self.0.cancelled(member)
    }

    fn failed(&mut self, member: usize, error: SimError) {
        self.0.failed(member, error);
    }

    fn finished(&mut self, member: usize, statistics: Statistics) {
        self.0.finished(member, statistics);
    }
}
