//! Ring of staging buffers through which the host reads records.

use super::error::GpuError;
use super::memory::Memory;
use super::record::Record;
use super::sizes::Sizes;
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// Maximum delay of a mapping after its submission has completed.
const MAPPING_WAIT: Duration = Duration::from_secs(5);

/// Ring of staging buffers. A record is copied into the next free buffer, which is mapped after the
/// submission and read in order.
#[derive(Debug)]
pub(super) struct Ring {
    sizes: Sizes,
    free: Vec<wgpu::Buffer>,
    /// Buffers with a copied record that is not submitted yet.
    copied: VecDeque<Slot>,
    /// Submitted buffers whose mapping is requested.
    mapped: VecDeque<(Slot, Receiver<bool>)>,
}

#[derive(Debug)]
struct Slot {
    buffer: wgpu::Buffer,
    time: i64,
    extents: [u32; 2],
    bytes: u64,
}

impl Ring {
    pub(super) fn new(sizes: &Sizes, memory: &Memory) -> Self {
        Self { sizes: *sizes, free: memory.staging.clone(), copied: VecDeque::new(), mapped: VecDeque::new() }
    }

    /// True if the chunk that is being encoded can have another record.
    pub(super) fn is_free(&self) -> bool {
        !self.free.is_empty() && self.copied.len() < self.sizes.records()
    }

    /// Copies the record of step `time` into a free buffer; [`Ring::is_free`] must hold.
    pub(super) fn copy(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        record: &wgpu::Buffer,
        time: i64,
        extents: [u32; 2],
    ) {
        let Some(buffer) = self.free.pop() else { return };
        let bytes = 4 * self.sizes.record_words(extents);
        encoder.copy_buffer_to_buffer(record, 0, &buffer, 0, bytes);
        self.copied.push_back(Slot { buffer, time, extents, bytes });
    }

    /// Requests the mapping of the submitted buffers.
    pub(super) fn map(&mut self) {
        while let Some(slot) = self.copied.pop_front() {
            let (sender, receiver) = channel();
            slot.buffer.map_async(wgpu::MapMode::Read, 0..slot.bytes, move |result| {
                // The receiver is dropped at the end of the batch.
                let _ = sender.send(result.is_ok());
            });
            self.mapped.push_back((slot, receiver));
        }
    }

    /// Reads the next record. Its submission must be complete.
    pub(super) fn take<R>(&mut self, read: impl FnOnce(&Record<'_>) -> R) -> Result<R, GpuError> {
        let (slot, receiver) = self.mapped.pop_front().ok_or_else(|| lost("no record is expected"))?;
        // The submission is complete, but another thread that polls the device may not have run the
        // callback yet.
        if receiver.recv_timeout(MAPPING_WAIT) != Ok(true) {
            return Err(lost("a staging buffer could not be mapped"));
        }
        let Slot { buffer, time, extents, bytes } = slot;
        let result = {
            let view = buffer.get_mapped_range(0..bytes).map_err(|error| lost(&error.to_string()))?;
            read(&Record { time, extents, words: bytemuck::cast_slice(&view) })
        };
        buffer.unmap();
        self.free.push(buffer);
        Ok(result)
    }
}

fn lost(detail: &str) -> GpuError {
    GpuError::Lost { detail: detail.to_owned() }
}
