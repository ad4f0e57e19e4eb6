//! The buffers of a batch: how large they are, and what they hold at the start.

use super::device::GpuDevice;
use super::error::GpuError;
use super::layout::{
    Batch, CLEARANCE, COPIED, FIELDS, HEADER, LIST, Member, NONE, RECORDED_INNER, RECORDED_OUTER, Status, WALL_FIELDS,
};
use crate::sim::layout::LANES;
use crate::sim::{Checkpoint, Plan, StepRow};
use std::f64::consts::TAU;
use std::mem::size_of;

/// Bytes that the staging buffers of a batch may take together, where fewer than [`LEAST_RING`] do not take more.
const RING_BYTES: u64 = 256 << 20;
/// Least and greatest number of staging buffers: half of them are filled by the device while half are read.
const LEAST_RING: u64 = 4;
const GREATEST_RING: u64 = 32;
/// Clearance of particles of which none is known, µm: room for everything.
const UNKNOWN_CLEARANCE: f32 = 1e9;

/// Sizes of a batch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub(super) members: usize,
    pub(super) batch: Batch,
}

impl Sizes {
    /// The sizes of a batch of `members` of which `plans` are the largest.
    pub(super) fn new(plans: &[&Plan], members: usize) -> Self {
        let most = |of: &dyn Fn(&Plan) -> usize| plans.iter().map(|p| of(p)).max().unwrap_or(0);
        let target = |p: &Plan, loop_: usize| {
            let targets = p.rows.iter().map(|r| [r.inner_target, r.outer_target][loop_]);
            targets.max().unwrap_or(0).max(p.start[loop_]) as usize
        };
        let capacity = most(&|p| target(p, 0)).next_multiple_of(LANES);
        let outer_capacity = most(&|p| target(p, 1)).next_multiple_of(LANES);
        let (rows, events) = (most(&|p| p.rows.len()), most(&|p| (p.steps / p.grow_every) as usize + 1));
        let (waves, lobes) = (most(&|p| p.waves.len()), most(&|p| p.lobes.len()));
        let tables = (waves * (2 + events) + 2 * lobes * (1 + rows)).max(1);
        let word = |x: usize| u32::try_from(x).unwrap_or(u32::MAX);
        Self {
            members,
            batch: Batch {
                capacity: word(capacity),
                outer_capacity: word(outer_capacity),
                rows: word(rows),
                events: word(events),
                waves: word(waves),
                lobes: word(lobes),
                tables: word(tables),
                padding: 0,
            },
        }
    }

    /// Words of a record with room for `extent` inner and `outer_extent` outer particles a member.
    pub(super) fn record_words(&self, extent: u32, outer_extent: u32) -> u64 {
        let words = HEADER + RECORDED_INNER * extent + RECORDED_OUTER * outer_extent;
        self.members as u64 * u64::from(words)
    }

    /// Number of staging buffers.
    pub(super) fn ring(&self) -> usize {
        (RING_BYTES / self.record_bytes().max(1)).clamp(LEAST_RING, GREATEST_RING) as usize
    }

    /// Bytes of the largest record.
    fn record_bytes(&self) -> u64 {
        4 * self.record_words(self.batch.capacity, self.batch.outer_capacity)
    }

    /// Bytes of all buffers together.
    pub(super) fn total_bytes(&self) -> u64 {
        self.bytes().iter().map(|(_, bytes)| bytes).sum::<u64>() + self.ring() as u64 * self.record_bytes()
    }

    /// Bytes of each storage buffer, in the order of their bindings from 1 on.
    pub(super) fn bytes(&self) -> [(&'static str, u64); 9] {
        let b = &self.batch;
        let each = |words: u64| 4 * words * self.members as u64;
        let [capacity, outer] = [b.capacity, b.outer_capacity].map(u64::from);
        [
            ("rows", each(u64::from(b.rows) * (size_of::<StepRow>() / 4) as u64)),
            ("members", each((size_of::<Member>() / 4) as u64)),
            ("tables", each(u64::from(b.tables))),
            ("states", each((size_of::<Status>() / 4) as u64)),
            ("particles", each(u64::from(FIELDS) * capacity)),
            ("near", each(2 * capacity)),
            ("lists", each(u64::from(LIST) * capacity)),
            ("wall", each(u64::from(WALL_FIELDS) * outer)),
            ("record", self.record_bytes()),
        ]
    }

    /// Whether shaders can address it all and the limits of the device hold.
    pub(super) fn check(&self, limits: &wgpu::Limits) -> Result<(), GpuError> {
        let unfit = |detail: String| Err(GpuError::Unfit { detail });
        // Runs of the tournaments are cut with products of two counts.
        if self.batch.capacity > 65_520 || self.batch.outer_capacity > 65_520 {
            return unfit("more than 65,520 particles in a loop".to_owned());
        }
        if self.members > limits.max_compute_workgroups_per_dimension as usize {
            return unfit(format!("{} simulations are more than one dispatch can hold", self.members));
        }
        let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        for (name, bytes) in self.bytes() {
            // Words are counted with 32 bits.
            if bytes > most || bytes / 4 > u64::from(u32::MAX) {
                return unfit(format!("{bytes} bytes of {name}; the adapter can bind {most}"));
            }
        }
        Ok(())
    }
}

/// The buffers of a batch.
#[derive(Debug)]
pub(super) struct Memory {
    pub(super) states: wgpu::Buffer,
    pub(super) record: wgpu::Buffer,
    pub(super) staging: Vec<wgpu::Buffer>,
    pub(super) group: wgpu::BindGroup,
    /// The storage buffers in the order of their bindings, and the constants of the batch.
    buffers: Vec<wgpu::Buffer>,
}

impl Memory {
    /// Allocates the buffers. Nothing is written yet: what has been written to stays with the queue until the next
    /// submission, so that a batch of half the size would not find the memory that this one did not get.
    ///
    /// # Errors
    /// [`GpuError::OutOfMemory`]; what was allocated by then is given back.
    pub(super) fn new(device: &GpuDevice, sizes: &Sizes) -> Result<Self, GpuError> {
        device.room_for(sizes.total_bytes())?;
        device.attempt(|gpu| Self::allocate(gpu, device, sizes))
    }

    fn allocate(gpu: &wgpu::Device, device: &GpuDevice, sizes: &Sizes) -> Self {
        use wgpu::BufferUsages as Use;
        let buffer = |label, size, usage| {
            gpu.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
        };
        let uniform = buffer("batch", size_of::<Batch>() as u64, Use::UNIFORM | Use::COPY_DST);
        let mut buffers: Vec<wgpu::Buffer> = sizes
            .bytes()
            .into_iter()
            .map(|(label, size)| buffer(label, size, Use::STORAGE | Use::COPY_DST | Use::COPY_SRC))
            .collect();
        let staging =
            (0..sizes.ring()).map(|_| buffer("staging", sizes.record_bytes(), Use::MAP_READ | Use::COPY_DST)).collect();
        let entries: Vec<wgpu::BindGroupEntry<'_>> = std::iter::once(&uniform)
            .chain(&buffers)
            .zip(0..)
            .map(|(buffer, binding)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let group = gpu.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("batch"),
            layout: &device.pipelines.layout,
            entries: &entries,
        });
        let (record, states) = (buffers[8].clone(), buffers[3].clone());
        buffers.push(uniform);
        Self { states, record, staging, group, buffers }
    }

    /// Fills the buffers.
    pub(super) fn fill(
        &self,
        device: &GpuDevice,
        sizes: &Sizes,
        plans: &[Plan],
        starts: &[Checkpoint],
    ) -> Result<(), GpuError> {
        device.attempt(|_| self.write(&device.queue, sizes, plans, starts))
    }

    fn write(&self, queue: &wgpu::Queue, sizes: &Sizes, plans: &[Plan], starts: &[Checkpoint]) {
        let buffers = &self.buffers;
        let write = |buffer: &wgpu::Buffer, word: u64, data: &[u32]| {
            queue.write_buffer(buffer, 4 * word, bytemuck::cast_slice(data));
        };
        write(&buffers[9], 0, bytemuck::cast_slice(&[sizes.batch]));
        for (m, (plan, start)) in plans.iter().zip(starts).enumerate() {
            let m = m as u64;
            let at = |words: u32| m * u64::from(words);
            write(
                &buffers[0],
                at(sizes.batch.rows * (size_of::<StepRow>() / 4) as u32),
                bytemuck::cast_slice(&plan.rows),
            );
            write(&buffers[1], at((size_of::<Member>() / 4) as u32), bytemuck::cast_slice(&[member(plan)]));
            write(&buffers[2], at(sizes.batch.tables), bytemuck::cast_slice(&tables(plan, &sizes.batch)));
            write(&buffers[3], at((size_of::<Status>() / 4) as u32), bytemuck::cast_slice(&[status(start)]));
            let capacity = sizes.batch.capacity;
            write(&buffers[4], at(FIELDS * capacity), &inner_fields(start, capacity as usize));
            let known = clearances(start);
            write(&buffers[4], at(FIELDS * capacity) + u64::from(CLEARANCE * capacity), bytemuck::cast_slice(&known));
            let outer_capacity = sizes.batch.outer_capacity;
            write(&buffers[7], at(WALL_FIELDS * outer_capacity), &outer_fields(start, outer_capacity as usize));
        }
    }

    /// Gives the memory back, whatever still refers to it.
    pub(super) fn free(&self) {
        self.buffers.iter().chain(&self.staging).for_each(wgpu::Buffer::destroy);
    }
}

fn member(plan: &Plan) -> Member {
    Member {
        seed_low: plan.seed as u32,
        seed_high: (plan.seed >> 32) as u32,
        candidates: plan.candidates,
        lobes: plan.lobes.len() as u32,
        contorted: plan.contorted,
        clearance: plan.clearance,
    }
}

fn status(start: &Checkpoint) -> Status {
    Status {
        inner: start.inner.len() as u32,
        outer: start.outer.len() as u32,
        next_id: start.inner.next_id,
        broken: NONE,
        widest: start.inner.scale.iter().fold(1.0f32, |a, &b| a.max(b)).to_bits(),
        built: NONE,
        built_next: NONE,
        ..Status::default()
    }
}

fn inner_fields(start: &Checkpoint, capacity: usize) -> Vec<u32> {
    let s = &start.inner;
    let mut words = vec![0; COPIED as usize * capacity];
    words[..s.len()].copy_from_slice(&s.id);
    let fields = [&s.x, &s.y, &s.vx, &s.vy, &s.rest, &s.anchor_x, &s.anchor_y, &s.sign, &s.scale];
    for (k, field) in fields.into_iter().enumerate() {
        let first = (k + 1) * capacity;
        words[first..first + s.len()].copy_from_slice(bytemuck::cast_slice(field));
    }
    words
}

/// As many clearances as there are particles; those that are not known let everything happen.
fn clearances(start: &Checkpoint) -> Vec<f32> {
    let mut known = start.clearance.clone();
    known.resize(start.inner.len(), UNKNOWN_CLEARANCE);
    known
}

fn outer_fields(start: &Checkpoint, capacity: usize) -> Vec<u32> {
    let s = &start.outer;
    let mut words = vec![0; RECORDED_OUTER as usize * capacity];
    for i in 0..s.len() {
        let values = [s.id[i], s.p[i][0].to_bits(), s.p[i][1].to_bits(), s.v[i][0].to_bits(), s.v[i][1].to_bits()];
        for (k, value) in values.into_iter().enumerate() {
            words[k * capacity + i] = value;
        }
    }
    words
}

/// Wave vectors, phases of each event and wave, orders and weights of the lobes, phases of each row and lobe.
fn tables(plan: &Plan, batch: &Batch) -> Vec<f32> {
    let (waves, lobes) = (batch.waves as usize, batch.lobes as usize);
    let mut words = vec![0.0f32; batch.tables as usize];
    let (vectors, rest) = words.split_at_mut(2 * waves);
    let (phases, rest) = rest.split_at_mut(waves * batch.events as usize);
    let (shapes, turns) = rest.split_at_mut(2 * lobes);
    for (w, wave) in plan.waves.iter().enumerate() {
        vectors[2 * w..2 * w + 2].copy_from_slice(&wave.k);
        for event in 0..batch.events as usize {
            let time = (event * plan.grow_every as usize) as f64;
            let turns = wave.phase + wave.drift * time;
            phases[event * waves + w] = (turns - turns.floor()) as f32;
        }
    }
    for (l, lobe) in plan.lobes.iter().enumerate() {
        shapes[2 * l] = lobe.order as f32;
        shapes[2 * l + 1] = lobe.weight;
        for row in 0..plan.rows.len() {
            let time = row as f64 - f64::from(plan.burn_in);
            let angle = TAU * (lobe.phase + lobe.drift * time);
            let at = 2 * (row * lobes + l);
            turns[at..at + 2].copy_from_slice(&[libm::cos(angle) as f32, libm::sin(angle) as f32]);
        }
    }
    words
}
