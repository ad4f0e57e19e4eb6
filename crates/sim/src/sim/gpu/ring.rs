//! The ring of staging buffers through which records are read back, and the timestamps of the device.

use super::device::GpuDevice;
use super::error::GpuError;
use super::memory::Memory;
use super::record::Record;
use super::sizes::Sizes;
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// Longest delay of a mapping after its submission completed.
const ANSWER: Duration = Duration::from_secs(5);
/// Passes of a chunk that can be timed.
const PASSES: u32 = 64;

/// Staging buffers in turn. A record is copied into the next free one, which is mapped after the submission and read in
/// order.
#[derive(Debug)]
pub(super) struct Ring {
    sizes: Sizes,
    free: Vec<wgpu::Buffer>,
    /// Copied to, not yet submitted.
    copied: VecDeque<Slot>,
    /// Submitted, with the mapping requested.
    mapped: VecDeque<(Slot, Receiver<bool>)>,
    clock: Option<Clock>,
    /// Passes of the chunk that is being encoded.
    passes: u32,
}

#[derive(Debug)]
struct Slot {
    buffer: wgpu::Buffer,
    time: i64,
    extent: u32,
    outer_extent: u32,
    bytes: u64,
}

/// Measures the time of passes on the device.
#[derive(Debug)]
struct Clock {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    /// Nanoseconds of a tick.
    period: f64,
    seconds: f64,
    free: Vec<wgpu::Buffer>,
    copied: Option<(wgpu::Buffer, u32)>,
    mapped: VecDeque<(wgpu::Buffer, u32, Receiver<bool>)>,
}

impl Ring {
    pub(super) fn new(device: &GpuDevice, sizes: &Sizes, memory: &Memory) -> Result<Self, GpuError> {
        let timed = device.device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        let clock = if timed { Some(device.attempt(|gpu| Clock::new(gpu, &device.queue))?) } else { None };
        Ok(Self {
            sizes: *sizes,
            free: memory.staging.clone(),
            copied: VecDeque::new(),
            mapped: VecDeque::new(),
            clock,
            passes: 0,
        })
    }

    /// Whether the chunk that is being encoded can have another record.
    pub(super) fn is_free(&self) -> bool {
        !self.free.is_empty() && self.copied.len() < self.sizes.records()
    }

    /// How many more passes the chunk can have.
    pub(super) fn passes_left(&self) -> u32 {
        PASSES - self.passes
    }

    /// Timestamp queries for the next pass.
    pub(super) fn timestamps(&mut self) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let pass = self.passes;
        self.passes += 1;
        self.clock.as_ref().map(|clock| wgpu::ComputePassTimestampWrites {
            query_set: &clock.queries,
            beginning_of_pass_write_index: Some(2 * pass),
            end_of_pass_write_index: Some(2 * pass + 1),
        })
    }

    /// Copies the record of step `time` into a free buffer; [`Ring::is_free`] must hold.
    pub(super) fn copy(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        record: &wgpu::Buffer,
        time: i64,
        extent: u32,
        outer_extent: u32,
    ) {
        let Some(buffer) = self.free.pop() else { return };
        let bytes = 4 * self.sizes.record_words(extent, outer_extent);
        encoder.copy_buffer_to_buffer(record, 0, &buffer, 0, bytes);
        self.copied.push_back(Slot { buffer, time, extent, outer_extent, bytes });
    }

    /// Ends the encoding of a chunk.
    pub(super) fn resolve(&mut self, encoder: &mut wgpu::CommandEncoder) {
        let passes = std::mem::take(&mut self.passes);
        let Some(clock) = &mut self.clock else { return };
        let Some(buffer) = clock.free.pop() else { return };
        encoder.resolve_query_set(&clock.queries, 0..2 * passes, &clock.resolved, 0);
        encoder.copy_buffer_to_buffer(&clock.resolved, 0, &buffer, 0, u64::from(16 * passes));
        clock.copied = Some((buffer, passes));
    }

    /// Requests the mapping of what was submitted.
    pub(super) fn map(&mut self) {
        while let Some(slot) = self.copied.pop_front() {
            let receiver = request(&slot.buffer, slot.bytes);
            self.mapped.push_back((slot, receiver));
        }
        if let Some(clock) = &mut self.clock
            && let Some((buffer, passes)) = clock.copied.take()
        {
            let receiver = request(&buffer, u64::from(16 * passes));
            clock.mapped.push_back((buffer, passes, receiver));
        }
    }

    /// Reads the next record; its submission must be done.
    pub(super) fn take<R>(&mut self, read: impl FnOnce(&Record<'_>) -> R) -> Result<R, GpuError> {
        let (slot, receiver) = self.mapped.pop_front().ok_or_else(|| lost("no record is expected"))?;
        // The submission is complete, but another thread that polls the device may not have run the callback yet.
        if receiver.recv_timeout(ANSWER) != Ok(true) {
            return Err(lost("a staging buffer could not be mapped"));
        }
        let Slot { buffer, time, extent, outer_extent, bytes } = slot;
        let result = look(&buffer, bytes, |words| read(&Record { time, extent, outer_extent, words }))?;
        self.free.push(buffer);
        Ok(result)
    }

    /// Seconds in compute passes, of those timestamps that were read back so far.
    pub(super) fn device_seconds(&mut self) -> Option<f64> {
        let clock = self.clock.as_mut()?;
        clock.collect();
        Some(clock.seconds)
    }

    /// Collects timestamps that were read back.
    pub(super) fn collect(&mut self) {
        if let Some(clock) = &mut self.clock {
            clock.collect();
        }
    }

    /// Frees the memory of the timestamps; the staging buffers belong to [`Memory`].
    pub(super) fn free(&self) {
        if let Some(clock) = &self.clock {
            clock.resolved.destroy();
            clock.queries.destroy();
            clock.free.iter().for_each(wgpu::Buffer::destroy);
            clock.mapped.iter().for_each(|(buffer, ..)| buffer.destroy());
        }
    }
}

impl Clock {
    fn new(gpu: &wgpu::Device, queue: &wgpu::Queue) -> Self {
        use wgpu::BufferUsages as Use;
        let size = u64::from(16 * PASSES);
        let buffer = |usage| {
            gpu.create_buffer(&wgpu::BufferDescriptor { label: Some("time"), size, usage, mapped_at_creation: false })
        };
        Self {
            queries: gpu.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("time"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * PASSES,
            }),
            resolved: buffer(Use::QUERY_RESOLVE | Use::COPY_SRC),
            period: f64::from(queue.get_timestamp_period()),
            seconds: 0.0,
            free: (0..4).map(|_| buffer(Use::MAP_READ | Use::COPY_DST)).collect(),
            copied: None,
            mapped: VecDeque::new(),
        }
    }

    fn collect(&mut self) {
        while let Some((buffer, passes, receiver)) = self.mapped.pop_front() {
            if receiver.try_recv() != Ok(true) {
                // Not mapped yet, or never; the batch does not fail for a missing time.
                self.mapped.push_front((buffer, passes, receiver));
                return;
            }
            let ticks = |w: &[u32]| u64::from(w[0]) | u64::from(w[1]) << 32;
            let sum = |words: &[u32]| -> u64 {
                words.chunks_exact(4).map(|pass| ticks(&pass[2..]).saturating_sub(ticks(pass))).sum()
            };
            let Ok(taken) = look(&buffer, u64::from(16 * passes), sum) else { return };
            self.seconds += taken as f64 * self.period * 1e-9;
            self.free.push(buffer);
        }
    }
}

fn lost(detail: &str) -> GpuError {
    GpuError::Lost { detail: detail.to_owned() }
}

/// Requests the mapping of a buffer; a later poll sends the result.
fn request(buffer: &wgpu::Buffer, bytes: u64) -> Receiver<bool> {
    let (sender, receiver) = channel();
    buffer.map_async(wgpu::MapMode::Read, 0..bytes, move |result| {
        // The receiver is dropped at the end of the batch.
        let _ = sender.send(result.is_ok());
    });
    receiver
}

/// Shows the words of a mapped buffer, which is then unmapped.
fn look<R>(buffer: &wgpu::Buffer, bytes: u64, read: impl FnOnce(&[u32]) -> R) -> Result<R, GpuError> {
    let result = match buffer.get_mapped_range(0..bytes) {
        Ok(view) => read(bytemuck::cast_slice(&view)),
        Err(error) => return Err(lost(&error.to_string())),
    };
    buffer.unmap();
    Ok(result)
}
