//! Sequence of dispatches of a batch: the dispatches of each step, their order and their
//! workgroups.

use super::layout::{Now, THREADS};
use super::pipelines::Pipelines;
use crate::sim::layout::LANES;
use crate::sim::{Checkpoint, Plan};
use crate::spec::Integrator;

/// Current step of a batch, and the dispatches that follow.
#[derive(Debug)]
pub(super) struct Course {
    members: u32,
    burn_in: i64,
    grow_every: i64,
    record_every: i64,
    integrator: Integrator,
    /// Maximum numbers of particles of a member after the growth event of each row.
    most: Vec<[u32; 2]>,
    /// Maximum numbers of particles of a member at the start.
    most_at_start: [u32; 2],
    time: i64,
    last: i64,
    /// True if every step is recorded.
    every_step: bool,
    /// True until the start is recorded.
    opening: bool,
    copy: u32,
    rest: u32,
    /// True if the outer loop is one step behind: its step then runs in the same dispatch as the
    /// next step of the inner loop.
    outer_due: bool,
}

impl Course {
    /// The course from `starts`, which are all at the same step, to step `last`. With `every_step`,
    /// every state after the first one is recorded.
    pub(super) fn new(plans: &[Plan], starts: &[Checkpoint], last: i64, every_step: bool) -> Self {
        let (plan, start) = (&plans[0], &starts[0]);
        let most_at_start = starts
            .iter()
            .map(|s| [s.inner.len() as u32, s.outer.len() as u32])
            .fold([0; 2], |a, b| [a[0].max(b[0]), a[1].max(b[1])]);
        let mut most = Vec::with_capacity(plan.rows.len());
        let mut highest = most_at_start;
        for row in 0..plan.rows.len() {
            if row as i64 >= start.time + i64::from(plan.burn_in) {
                for plan in plans {
                    let row = &plan.rows[row];
                    highest = [highest[0].max(row.inner_target), highest[1].max(row.outer_target)];
                }
            }
            most.push(highest);
        }
        Self {
            members: plans.len() as u32,
            burn_in: i64::from(plan.burn_in),
            grow_every: i64::from(plan.grow_every),
            record_every: i64::from(plan.record_every),
            integrator: plan.integrator,
            most,
            most_at_start,
            time: start.time,
            last,
            every_step,
            opening: !every_step && start.time == 0,
            copy: 0,
            rest: 0,
            outer_due: false,
        }
    }

    /// Step after the dispatches encoded so far.
    pub(super) fn time(&self) -> i64 {
        self.time
    }

    /// Last step.
    pub(super) fn last(&self) -> i64 {
        self.last
    }

    /// True if every step is recorded.
    pub(super) fn replays(&self) -> bool {
        self.every_step
    }

    /// Numbers of particles of both loops for which a record of the current step has room.
    pub(super) fn extents(&self) -> [u32; 2] {
        self.most_before(self.time)
    }

    /// Maximum numbers of particles before the growth event of step `time`.
    fn most_before(&self, time: i64) -> [u32; 2] {
        let row = time + self.burn_in - 1;
        if row < 0 { self.most_at_start } else { self.most[(row as usize).min(self.most.len() - 1)] }
    }

    fn records_at(&self, time: i64) -> bool {
        self.every_step || time >= 0 && (time % self.record_every == 0 || time == self.last)
    }

    /// End of the next stretch of steps without a record inside, at most `end`, and whether a
    /// record follows the stretch.
    pub(super) fn next_stretch(&self, end: i64) -> Option<(i64, bool)> {
        if self.opening {
            return Some((self.time, true));
        }
        let end = end.min(self.last);
        if self.time >= end {
            return None;
        }
        let recorded = (self.time + 1..=end).find(|&t| self.records_at(t));
        Some((recorded.unwrap_or(end), recorded.is_some()))
    }

    /// Encodes the steps up to `next` as one pass, followed by a record if `recorded`. Returns the
    /// number of dispatches.
    pub(super) fn encode(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        pipelines: &Pipelines,
        group: &wgpu::BindGroup,
        next: i64,
        recorded: bool,
    ) -> u64 {
        let mut pass =
            Pass { pass: encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()), dispatches: 0 };
        pass.pass.set_bind_group(0, group, &[]);
        while self.time < next {
            self.step(&mut pass, pipelines);
        }
        if recorded {
            self.opening = false;
            self.finish_outer(&mut pass, pipelines);
            let [extent, outer_extent] = self.extents();
            let now = Now { extent, outer_extent, ..self.now() };
            let groups = extent.max(outer_extent).div_ceil(THREADS);
            pass.dispatch(&pipelines.record, &now, groups, self.members);
        }
        pass.dispatches
    }

    fn now(&self) -> Now {
        Now { row: (self.time + self.burn_in) as u32, copy: self.copy, rest: self.rest, ..Now::default() }
    }

    fn step(&mut self, pass: &mut Pass<'_>, pipelines: &Pipelines) {
        let members = self.members;
        if self.time >= 0 && self.time % self.grow_every == 0 {
            let now = Now { event: (self.time / self.grow_every) as u32, ..self.now() };
            let before = self.most_before(self.time)[0];
            self.finish_outer(pass, pipelines);
            pass.dispatch(&pipelines.growth, &now, members, 1);
            pass.dispatch(&pipelines.split, &now, before.div_ceil(THREADS), members);
            self.copy = 1 - self.copy;
            self.rest = 1 - self.rest;
        }
        let now = self.now();
        let particles = self.most_before(self.time + 1)[0];
        let blocks = particles.div_ceil(LANES as u32);
        let (first, others) = self.stages(pipelines);
        let outer = u32::from(std::mem::replace(&mut self.outer_due, true));
        pass.dispatch(first, &Now { outer, ..now }, outer + blocks, members);
        for stage in others {
            pass.dispatch(stage, &now, blocks, members);
        }
        self.rest = 1 - self.rest;
        self.time += 1;
    }

    /// Advances the outer loop by the step that it is behind, before growth or a record. Uses the
    /// pipeline of the other steps, because a driver might compile another pipeline to code with
    /// different rounding.
    fn finish_outer(&mut self, pass: &mut Pass<'_>, pipelines: &Pipelines) {
        if std::mem::take(&mut self.outer_due) {
            pass.dispatch(self.stages(pipelines).0, &Now { outer: 1, ..self.now() }, 1, self.members);
        }
    }

    /// Pipelines of the evaluations of a step: the first, and the others.
    fn stages<'a>(&self, pipelines: &'a Pipelines) -> (&'a wgpu::ComputePipeline, &'a [wgpu::ComputePipeline]) {
        let (first, others) = match self.integrator {
            Integrator::Euler => pipelines.euler.split_at(1),
            Integrator::Rk4 => pipelines.integrate.split_at(1),
        };
        (&first[0], others)
    }
}

/// A compute pass that counts its dispatches.
struct Pass<'a> {
    pass: wgpu::ComputePass<'a>,
    dispatches: u64,
}

impl Pass<'_> {
    fn dispatch(&mut self, pipeline: &wgpu::ComputePipeline, now: &Now, x: u32, y: u32) {
        self.pass.set_pipeline(pipeline);
        self.pass.set_immediates(0, bytemuck::bytes_of(now));
        self.pass.dispatch_workgroups(x, y, 1);
        self.dispatches += 1;
    }
}
