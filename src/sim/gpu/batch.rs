//! Runs a batch of simulations of like size together, one dispatch for all of them.

use super::device::GpuDevice;
use super::error::GpuError;
use crate::model::Section;
use crate::sim::{Plan, SimError, Statistics};

/// The whole state of one simulation at a recorded section: where [`replay`] begins.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    pub(super) step: i64,
}

impl Checkpoint {
    /// The step that it holds.
    #[must_use]
    pub fn step(&self) -> i64 {
        self.step
    }
}

/// What a batch did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BatchReport {
    /// Dispatches submitted.
    pub dispatches: u64,
    /// Submissions to the queue.
    pub submissions: u64,
    /// Seconds on the device by its own clock; `None` where it has none.
    pub device_seconds: Option<f64>,
    /// Seconds from the first submission to the last section.
    pub seconds: f64,
}

/// Who takes what a batch yields. All methods are called on the thread of [`run_batch`]; while one of them works, the
/// device goes on with what is queued, and stands still when the ring of staging buffers is full.
pub trait BatchSink {
    /// The next recorded section of a member, in order: at step 0, at each multiple of `record_every` and at the
    /// last step. `checkpoint` is the state at that section. Where the slab up to the *next* section cannot be
    /// lofted as it stands, [`replay`] from this checkpoint gives the sections of all steps in between; keep
    /// a checkpoint until the slab above it is accepted, then drop it.
    fn section(&mut self, member: usize, section: Section, checkpoint: Checkpoint);
    /// How far a member is; at least twice a second.
    fn progress(&mut self, member: usize, step: i64, particles: u32);
    /// Whether a member shall stop; asked at least every 0.2 s. The others go on; nothing more is told of this one.
    fn cancelled(&mut self, member: usize) -> bool;
    /// A member cannot go on; the others do.
    fn failed(&mut self, member: usize, error: SimError);
    /// A member reached its last step; its last section was told before.
    fn finished(&mut self, member: usize, statistics: Statistics);
}

/// Runs `plans` together to their ends. Sections of a member do not depend on what else is in the batch.
///
/// # Errors
/// [`GpuError::Unfit`] before anything is told to the sink; [`GpuError::OutOfMemory`], [`GpuError::Lost`] and
/// [`GpuError::Refused`] at any time: members without `finished` or `failed` are then to be run elsewhere from
/// their beginning. The memory of the batch is given back in every case.
pub fn run_batch(device: &GpuDevice, plans: &[Plan], sink: &mut dyn BatchSink) -> Result<BatchReport, GpuError> {
    let all: Vec<&Plan> = plans.iter().collect();
    device.fits(&all)?;
    let _ = (sink, &device.queue);
    Err(device.fault().unwrap_or(GpuError::OutOfMemory))
}

/// Sections of every step after `checkpoint` up to and including the next recorded one, which is the last of them:
/// what [`crate::mesh::Lofter::advance`] wants as history. Bit for bit what the batch computed, on the same device.
///
/// # Errors
/// As [`run_batch`].
pub fn replay(device: &GpuDevice, plan: &Plan, checkpoint: &Checkpoint) -> Result<Vec<Section>, GpuError> {
    let _ = checkpoint;
    device.fits(&[plan])?;
    Err(device.fault().unwrap_or(GpuError::OutOfMemory))
}
