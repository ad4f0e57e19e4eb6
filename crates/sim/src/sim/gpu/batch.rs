//! Runs a batch of simulations of similar size together: each dispatch covers all members.
//!
//! The host reads only recorded sections, as checkpoints. Few slabs need the steps between two
//! sections; for these, [`replay`] repeats the steps from the checkpoint below the slab. The replay
//! produces the same bits, because results depend neither on the other members nor on the time when
//! neighbour lists were built.

use super::course::Course;
use super::device::GpuDevice;
use super::error::GpuError;
use super::memory::Memory;
use super::pace::{FIRST_STEPS, Patience, SubmissionSizer};
use super::record::MemberRecord;
use super::ring::Ring;
use super::sizes::Sizes;
use crate::clock::Stopwatch;
use crate::model::Section;
use crate::sim::cpu::CpuSimulation;
use crate::sim::{Checkpoint, Plan, SimError, Statistics};
use std::collections::VecDeque;
use std::mem::{offset_of, size_of};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Counts and times of a batch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BatchReport {
    /// Number of dispatches.
    pub dispatches: u64,
    /// Number of submissions to the queue.
    pub submissions: u64,
    /// Bytes that the host read.
    pub bytes_back: u64,
    /// Seconds that the host spent reading records and passing them to the sink. The device
    /// computes in the meantime, as long as the ring of staging buffers has room.
    pub host_seconds: f64,
    /// Seconds from the first submission to the last section.
    pub seconds: f64,
}

/// Receiver of the results of a batch. `M` is the state of a simulation at a section.
///
/// All methods are called on the thread of [`run_batch`]. While one of them runs, the device
/// executes the queued commands, and idles once the ring of staging buffers is full.
pub trait BatchSink<M = Checkpoint> {
    /// Receives the next recorded section of a member, in order: at step 0, at each multiple of
    /// `record_every`, and at the last step.
    ///
    /// `checkpoint` is the state at that section. If the slab up to the *next* section cannot be
    /// lofted directly, [`replay`] computes the sections of all steps in between from this
    /// checkpoint. Keep a checkpoint until the slab above it is accepted.
    fn section(&mut self, member: usize, section: Section, checkpoint: M);
    /// Receives the current step of a member. Called after each submission, about every 50 ms.
    fn progress(&mut self, member: usize, step: i64, particles: u32);
    /// Returns true if a member shall stop. Called at least every 0.2 s unless another method takes
    /// longer. The other members continue, and no further call concerns the stopped member.
    fn cancelled(&mut self, member: usize) -> bool;
    /// Reports that a member cannot continue. The other members do.
    fn failed(&mut self, member: usize, error: SimError);
    /// Reports that a member has reached its last step. Called after its last section.
    fn finished(&mut self, member: usize, statistics: Statistics);
}

/// Runs `plans` together to their ends. The sections of a member do not depend on the other
/// members.
///
/// # Errors
/// - [`GpuError::Unfit`], and [`GpuError::OutOfMemory`] if the memory of the batch cannot be
///   allocated, before any call of the sink. Nothing stays allocated, so a smaller batch may
///   succeed.
/// - [`GpuError::Lost`], also after [`super::GpuOptions::stall`] without a completed submission,
///   and [`GpuError::Refused`] at any time. Members without a call of `finished` or `failed` must
///   then be run elsewhere from their beginning.
///
/// The memory of the batch is freed in every case.
pub fn run_batch(device: &GpuDevice, plans: &[Plan], sink: &mut dyn BatchSink) -> Result<BatchReport, GpuError> {
    device.fits(&plans.iter().collect::<Vec<_>>())?;
    let starts = device.each(plans, |_, plan| CpuSimulation::new(plan.clone(), 1).checkpoint());
    let last = i64::from(plans[0].steps);
    let course = Course::new(plans, &starts, last, false);
    run(device, plans, &starts, course, None, sink)
}

/// Computes the sections of every step after `checkpoint` up to and including the next recorded
/// one: the history that `mesh::Lofter::advance` takes. On the same device, the bits are those of
/// the batch. Other batches may run at the same time.
///
/// # Errors
/// As [`run_batch`]; [`GpuError::Unfit`] also for a checkpoint without a recorded section after it.
pub fn replay(device: &GpuDevice, plan: &Plan, checkpoint: &Checkpoint) -> Result<Vec<Section>, GpuError> {
    let last = (checkpoint.time + 1..=i64::from(plan.steps)).find(|&t| plan.records_at(t));
    let last = last.ok_or_else(|| GpuError::Unfit { detail: "the checkpoint is at the end".to_owned() })?;
    let mut sections = Vec::new();
    let (plans, checkpoints) = (std::slice::from_ref(plan), std::slice::from_ref(checkpoint));
    // States are dropped immediately, because a slab may have many steps.
    let mut keep = RecordEveryStep(|_: usize, section: Section, _: Checkpoint| sections.push(section));
    repeat(device, plans, checkpoints, last, &mut keep)?;
    Ok(sections)
}

/// Advances the members from their checkpoints, which must be at the same step, to step `last`.
/// Returns the states after every step, one per member.
///
/// # Errors
/// As [`run_batch`].
pub fn advance(
    device: &GpuDevice,
    plans: &[Plan],
    checkpoints: &[Checkpoint],
    last: i64,
) -> Result<Vec<Vec<Checkpoint>>, GpuError> {
    let mut states: Vec<Vec<Checkpoint>> = Vec::new();
    let keep = |member: usize, _: Section, checkpoint: Checkpoint| {
        if member == 0 {
            states.push(Vec::new());
        }
        if let Some(states) = states.last_mut() {
            states.push(checkpoint);
        }
    };
    repeat(device, plans, checkpoints, last, &mut RecordEveryStep(keep))?;
    Ok(states)
}

/// Runs members from their checkpoints to step `last` and records every state.
fn repeat(
    device: &GpuDevice,
    plans: &[Plan],
    checkpoints: &[Checkpoint],
    last: i64,
    sink: &mut dyn BatchSink,
) -> Result<(), GpuError> {
    device.fits(&plans.iter().collect::<Vec<_>>())?;
    let same = checkpoints.len() == plans.len() && checkpoints.windows(2).all(|w| w[0].time == w[1].time);
    if !same {
        return Err(GpuError::Unfit { detail: "checkpoints of different steps".to_owned() });
    }
    let course = Course::new(plans, checkpoints, last, true);
    let steps = last - course.time();
    run(device, plans, checkpoints, course, Some(steps), sink).map(drop)
}

/// Executes `course`. `replayed` is the number of steps if every step is recorded.
fn run(
    device: &GpuDevice,
    plans: &[Plan],
    starts: &[Checkpoint],
    course: Course,
    replayed: Option<i64>,
    sink: &mut dyn BatchSink,
) -> Result<BatchReport, GpuError> {
    device.check()?;
    let sizes = Sizes::new(&plans.iter().collect::<Vec<_>>(), plans.len());
    let sizes = replayed.map_or(sizes, |steps| sizes.replaying(steps));
    let memory = Memory::new(device, &sizes)?;
    let ring = Ring::new(&sizes, &memory);
    memory.fill(device, &sizes, plans, starts)?;
    // A step of few members is no faster than a step of many.
    let first = if course.replays() { device.steps.load(Ordering::Relaxed) } else { FIRST_STEPS };
    let run = Run {
        device,
        plans,
        course,
        memory,
        ring,
        running: vec![true; plans.len()],
        particles: starts.iter().map(|s| (s.inner.len() + s.outer.len()) as u32).collect(),
        in_flight: VecDeque::new(),
        pace: SubmissionSizer::new(first),
        patience: Patience::new(device.stall()),
        watch: Stopwatch::start(),
        report: BatchReport::default(),
    };
    run.drive(sink)
}

/// Sink of a run that records every step: passes every section and state to a closure.
struct RecordEveryStep<F>(F);

impl<F: FnMut(usize, Section, Checkpoint)> BatchSink for RecordEveryStep<F> {
    fn section(&mut self, member: usize, section: Section, checkpoint: Checkpoint) {
        (self.0)(member, section, checkpoint);
    }
    fn progress(&mut self, _: usize, _: i64, _: u32) {}
    fn cancelled(&mut self, _: usize) -> bool {
        false
    }
    fn failed(&mut self, _: usize, _: SimError) {}
    fn finished(&mut self, _: usize, _: Statistics) {}
}

/// Maximum number of chunks in flight: one runs while the next is prepared.
const IN_FLIGHT: usize = 2;
/// Maximum wait before the sink is asked again which members to cancel.
const ASK: Duration = Duration::from_millis(100);

/// A running batch.
struct Run<'a> {
    device: &'a GpuDevice,
    plans: &'a [Plan],
    course: Course,
    memory: Memory,
    ring: Ring,
    /// Running members, and the last known number of particles of each member.
    running: Vec<bool>,
    particles: Vec<u32>,
    in_flight: VecDeque<Chunk>,
    pace: SubmissionSizer,
    patience: Patience,
    watch: Stopwatch,
    report: BatchReport,
}

/// The steps of one submission.
struct Chunk {
    submission: wgpu::SubmissionIndex,
    /// Last step of the chunk, and its number of steps.
    time: i64,
    steps: i64,
    submitted: f64,
    /// Number of records that the chunk copies.
    records: usize,
}

impl Drop for Run<'_> {
    fn drop(&mut self) {
        self.memory.free();
        self.device.tidy();
    }
}

impl Run<'_> {
    fn drive(mut self, sink: &mut dyn BatchSink) -> Result<BatchReport, GpuError> {
        loop {
            self.ask(sink);
            if !self.running.contains(&true) {
                break;
            }
            while self.in_flight.len() < IN_FLIGHT && self.submit()? {}
            let Some(chunk) = self.in_flight.front() else { break };
            let wait = self.patience.wait(ASK);
            if !self.device.wait(&chunk.submission, wait)? {
                if self.patience.exhausted_by(wait) {
                    return Err(self.device.abandon());
                }
                continue;
            }
            self.patience.progress();
            if let Some(chunk) = self.in_flight.pop_front() {
                self.pace.chunk(chunk.steps, chunk.submitted, self.watch.seconds());
                if !self.course.replays() {
                    self.device.steps.store(self.pace.steps(), Ordering::Relaxed);
                }
                let begun = self.watch.seconds();
                for _ in 0..chunk.records {
                    let (device, plans, running) = (self.device, self.plans, &self.running);
                    let (time, bytes, members) = self.ring.take(|record| {
                        let members = device.each(plans, |m, plan| running[m].then(|| record.member(m, plan)));
                        (record.time, 4 * record.words.len() as u64, members)
                    })?;
                    self.report.bytes_back += bytes;
                    self.deliver(time, members, sink);
                }
                for member in (0..self.plans.len()).filter(|&m| self.running[m]) {
                    sink.progress(member, chunk.time, self.particles[member]);
                }
                let busy = self.watch.seconds() - begun;
                self.report.host_seconds += busy;
                self.pace.busy(busy);
            }
        }
        self.report.seconds = self.watch.seconds();
        Ok(self.report)
    }

    /// Stops the members that the sink cancels.
    fn ask(&mut self, sink: &mut dyn BatchSink) {
        for member in 0..self.plans.len() {
            if self.running[member] && sink.cancelled(member) {
                self.stop(member);
            }
        }
    }

    fn stop(&mut self, member: usize) {
        use super::layout::Status;
        self.running[member] = false;
        let at = member * size_of::<Status>() + offset_of!(Status, halted);
        self.device.queue.write_buffer(&self.memory.states, at as u64, bytemuck::bytes_of(&1u32));
    }

    /// Submits the next chunk. Returns false if no steps are left or no staging buffer is free.
    fn submit(&mut self) -> Result<bool, GpuError> {
        let begin = self.course.time();
        let mut encoder = self.device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let (mut records, mut stretches) = (0, 0);
        let end = begin + self.pace.steps();
        while let Some((next, recorded)) = self.course.next_stretch(end) {
            if recorded && !self.ring.is_free() {
                break;
            }
            stretches += 1;
            self.report.dispatches +=
                self.course.encode(&mut encoder, &self.device.pipelines, &self.memory.group, next, recorded);
            if recorded {
                records += 1;
                self.ring.copy(&mut encoder, &self.memory.record, next, self.course.extents());
            }
        }
        if stretches == 0 {
            return Ok(false);
        }
        let submission = self.device.queue.submit([encoder.finish()]);
        self.ring.map();
        self.device.check()?;
        self.report.submissions += 1;
        let time = self.course.time();
        let submitted = self.watch.seconds();
        self.in_flight.push_back(Chunk { submission, time, steps: time - begin, submitted, records });
        Ok(true)
    }

    fn deliver(&mut self, time: i64, members: Vec<Option<Result<MemberRecord, SimError>>>, sink: &mut dyn BatchSink) {
        for (member, record) in members.into_iter().enumerate() {
            let Some(record) = record else { continue };
            let MemberRecord { particles, section, checkpoint, statistics } = match record {
                Ok(record) => record,
                Err(error) => {
                    self.stop(member);
                    sink.failed(member, error);
                    continue;
                }
            };
            self.particles[member] = particles;
            sink.progress(member, time, particles);
            sink.section(member, section, checkpoint);
            if time == self.course.last() {
                self.running[member] = false;
                sink.finished(member, statistics);
            }
        }
    }
}
