//! The interface between a batch and its GPU; tests implement it with another device.

use crate::model::Section;
use crate::sim::gpu::{BatchSink, Checkpoint, GpuDevice, GpuError, replay, run_batch};
use crate::sim::{Plan, SimError, Statistics};

/// Receives the results of a batch, on the thread that drives the device.
pub(super) trait Receiver<M> {
    /// The next recorded section, with the state from which the following slab can be replayed.
    fn section(&mut self, member: usize, section: Section, mark: M);
    /// The step that a member has reached.
    fn progress(&mut self, member: usize, step: i64, particles: u32);
    /// Whether a member should stop.
    fn cancelled(&mut self, member: usize) -> bool;
    /// A member has failed.
    fn failed(&mut self, member: usize, error: SimError);
    /// A member has reached its last step.
    fn finished(&mut self, member: usize, statistics: Statistics);
}

/// Runs many simulations at a time.
pub(super) trait Device: Sync {
    /// The state of a simulation at a recorded section.
    type Mark: Send;

    /// Description of the device.
    fn name(&self) -> String;
    /// Runs `plans` to their ends.
    fn run(&self, plans: &[Plan], receiver: &mut dyn Receiver<Self::Mark>) -> Result<(), GpuError>;
    /// The sections of every step after `mark`, up to the next recorded one.
    fn replay(&self, plan: &Plan, mark: &Self::Mark) -> Result<Vec<Section>, GpuError>;
}

impl Device for GpuDevice {
    type Mark = Checkpoint;

    fn name(&self) -> String {
        GpuDevice::name(self).to_owned()
    }

    fn run(&self, plans: &[Plan], receiver: &mut dyn Receiver<Checkpoint>) -> Result<(), GpuError> {
        run_batch(self, plans, &mut Bridge(receiver)).map(drop)
    }

    fn replay(&self, plan: &Plan, mark: &Checkpoint) -> Result<Vec<Section>, GpuError> {
        replay(self, plan, mark)
    }
}

struct Bridge<'a>(&'a mut dyn Receiver<Checkpoint>);

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
