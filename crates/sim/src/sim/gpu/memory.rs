//! Buffers of a batch, and their contents at the start.

use super::device::GpuDevice;
use super::error::GpuError;
use super::layout::{
    Batch, CLEARANCE, COPIED_SCALARS, COPIED_VECTORS, Member, NONE, RECORDED_OUTER, SCALARS, Status, VECTORS,
    WALL_FIELDS,
};
use super::sizes::Sizes;
use crate::sim::cpu::coefficients;
use crate::sim::maths::fraction;
use crate::sim::{Checkpoint, Plan, StepRow};
use std::f64::consts::TAU;
use std::mem::size_of;

/// Clearance of a particle whose clearance is unknown, µm; permits every move.
const UNKNOWN_CLEARANCE: f32 = 1e9;

/// Buffers of a batch.
#[derive(Debug)]
pub(super) struct Memory {
    pub(super) states: wgpu::Buffer,
    pub(super) record: wgpu::Buffer,
    pub(super) staging: Vec<wgpu::Buffer>,
    pub(super) group: wgpu::BindGroup,
    /// Storage buffers in the order of their bindings, then the constants of the batch.
    buffers: Vec<wgpu::Buffer>,
}

impl Memory {
    /// Allocates the buffers without writing to them. The queue holds a written buffer until the
    /// next submission, so a batch of half the size would not get the memory of a failed one.
    ///
    /// # Errors
    /// [`GpuError::OutOfMemory`]; nothing stays allocated.
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
        let (record, states) = (buffers[10].clone(), buffers[3].clone());
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
        device.attempt(|_| self.write(device, sizes, plans, starts))
    }

    fn write(&self, device: &GpuDevice, sizes: &Sizes, plans: &[Plan], starts: &[Checkpoint]) {
        let buffers = &self.buffers;
        let write = |buffer: &wgpu::Buffer, word: u64, data: &[u32]| {
            device.queue.write_buffer(buffer, 4 * word, bytemuck::cast_slice(data));
        };
        write(&buffers[11], 0, bytemuck::cast_slice(&[sizes.batch]));
        // The device is idle during this, so all threads prepare the tables.
        let tables = device.each(plans, |_, plan| tables(plan, &sizes.batch));
        for (m, ((plan, start), tables)) in plans.iter().zip(starts).zip(&tables).enumerate() {
            let m = m as u64;
            let at = |words: u32| m * u64::from(words);
            write(
                &buffers[0],
                at(sizes.batch.rows * (size_of::<StepRow>() / 4) as u32),
                bytemuck::cast_slice(&plan.rows),
            );
            write(&buffers[1], at((size_of::<Member>() / 4) as u32), bytemuck::cast_slice(&[member(plan)]));
            write(&buffers[2], at(sizes.batch.tables), bytemuck::cast_slice(tables));
            write(&buffers[3], at((size_of::<Status>() / 4) as u32), bytemuck::cast_slice(&[status(start)]));
            let capacity = sizes.batch.capacity;
            write(&buffers[4], at(SCALARS * capacity), &inner_scalars(start, capacity as usize));
            let known = clearances(start);
            write(&buffers[4], at(SCALARS * capacity) + u64::from(CLEARANCE * capacity), bytemuck::cast_slice(&known));
            let vectors = inner_vectors(start, capacity as usize);
            write(&buffers[5], at(2 * VECTORS * capacity), bytemuck::cast_slice(&vectors));
            let outer_capacity = sizes.batch.outer_capacity;
            write(&buffers[9], at(WALL_FIELDS * outer_capacity), &outer_fields(start, outer_capacity as usize));
        }
    }

    /// Frees the memory, even if other handles to the buffers exist.
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
        modes: plan.modes.len() as u32,
        directions: plan.spokes.len() as u32,
        clefts: plan.clefts.len() as u32,
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

fn inner_scalars(start: &Checkpoint, capacity: usize) -> Vec<u32> {
    let s = &start.inner;
    let reals = [&s.rest, &s.sign, &s.scale, &s.cleft].map(|field| bytemuck::cast_slice(field));
    let fields = std::iter::once(&s.id[..]).chain(reals);
    let mut words = vec![0; COPIED_SCALARS as usize * capacity];
    for (to, field) in words.chunks_exact_mut(capacity).zip(fields) {
        to[..s.len()].copy_from_slice(field);
    }
    words
}

fn inner_vectors(start: &Checkpoint, capacity: usize) -> Vec<[f32; 2]> {
    let s = &start.inner;
    let fields = [(&s.x, &s.y), (&s.vx, &s.vy), (&s.anchor_x, &s.anchor_y)];
    let mut vectors = vec![[0.0; 2]; COPIED_VECTORS as usize * capacity];
    for (to, (x, y)) in vectors.chunks_exact_mut(capacity).zip(fields) {
        for ((to, &x), &y) in to.iter_mut().zip(x).zip(y) {
            *to = [x, y];
        }
    }
    vectors
}

/// One clearance per particle; an unknown clearance permits every move.
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

/// Tables of a member, in this order:
///
/// - wave vectors, and phases of each event and wave;
/// - orders and weights of the lobes, and phases of each row and lobe;
/// - wave vectors and directions of the sway, and phases of each row and flow;
/// - coefficients of the variety of each event and mode;
/// - directions of the outline;
/// - directions of the clefts.
fn tables(plan: &Plan, batch: &Batch) -> Vec<f32> {
    let [waves, lobes, flows] = [batch.waves, batch.lobes, batch.flows].map(|count| count as usize);
    let mut words = vec![0.0f32; batch.tables as usize];
    let (vectors, rest) = words.split_at_mut(2 * waves);
    let (phases, rest) = rest.split_at_mut(waves * batch.events as usize);
    let (shapes, rest) = rest.split_at_mut(2 * lobes);
    let (turns, rest) = rest.split_at_mut(2 * lobes * batch.rows as usize);
    let (vectors_of_flows, rest) = rest.split_at_mut(4 * flows);
    let (phases_of_flows, rest) = rest.split_at_mut(flows * batch.rows as usize);
    let (around, rest) = rest.split_at_mut((batch.outline - batch.around) as usize);
    let (outline, clefts) = rest.split_at_mut((batch.clefts - batch.outline) as usize);
    let directions = plan.clefts.as_flattened();
    clefts[..directions.len()].copy_from_slice(directions);
    for (words, spoke) in outline.chunks_exact_mut(4).zip(&plan.spokes) {
        words.copy_from_slice(&[spoke.ellipse, spoke.outline, spoke.fold, spoke.turn]);
    }
    if !plan.modes.is_empty() {
        for (event, of_event) in around.chunks_exact_mut(6 * batch.modes as usize).enumerate() {
            let coefficients = coefficients(plan, event as i64 * i64::from(plan.grow_every));
            let coefficients = coefficients.as_flattened().as_flattened();
            of_event[..coefficients.len()].copy_from_slice(coefficients);
        }
    }
    for (w, wave) in plan.waves.iter().enumerate() {
        vectors[2 * w..2 * w + 2].copy_from_slice(&wave.k);
        for event in 0..batch.events as usize {
            let time = (event * plan.grow_every as usize) as f64;
            phases[event * waves + w] = fraction(wave.phase + wave.drift * time);
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
    for (f, flow) in plan.flows.iter().enumerate() {
        vectors_of_flows[4 * f..4 * f + 4].copy_from_slice(&[flow.k, flow.direction].concat());
        for row in 0..plan.rows.len() {
            let time = row as f64 - f64::from(plan.burn_in);
            phases_of_flows[row * flows + f] = fraction(flow.phase + flow.frequency * time);
        }
    }
    words
}
