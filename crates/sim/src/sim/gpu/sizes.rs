//! Sizes of the buffers of a batch, and the check against the limits of a device.

use super::error::GpuError;
use super::layout::{
    Batch, HEADER, LIST, Member, RECORDED_INNER, RECORDED_OUTER, SCALARS, SLICES, Status, VECTORS, WALL_FIELDS,
};
use crate::sim::layout::LANES;
use crate::sim::{Plan, StepRow};
use std::mem::size_of;

/// Bytes of all staging buffers of a batch, unless [`LEAST_RING`] buffers take more.
const RING_BYTES: u64 = 256 << 20;
/// Minimum and maximum number of staging buffers.
const LEAST_RING: u64 = 4;
const GREATEST_RING: u64 = 32;

/// Sizes of a batch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub(super) members: usize,
    pub(super) batch: Batch,
    /// Number of records that one submission may have, if it is not half of the staging buffers.
    records: Option<usize>,
}

impl Sizes {
    /// Sizes of a batch of `members`, the largest of which are `plans`.
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
        let flows = most(&|p| p.flows.len());
        let modes = most(&|p| p.modes.len());
        let around = waves * (2 + events) + 2 * lobes * (1 + rows) + flows * (4 + rows);
        let outline = around + 6 * modes * events;
        let clefts = outline + 4 * most(&|p| p.spokes.len());
        let tables = (clefts + 2 * most(&|p| p.clefts.len())).max(1);
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
                flows: word(flows),
                modes: word(modes),
                around: word(around),
                outline: word(outline),
                clefts: word(clefts),
            },
            records: None,
        }
    }

    /// Sizes for a replay of `steps`, each with a record: in one submission if they fit.
    pub(super) fn replaying(self, steps: i64) -> Self {
        Self { records: Some(self.most_staging().min(steps.max(1) as usize)), ..self }
    }

    /// Number of words of a record with room for `extent` inner and `outer_extent` outer particles
    /// per member.
    pub(super) fn record_words(&self, [extent, outer_extent]: [u32; 2]) -> u64 {
        let words = HEADER + RECORDED_INNER * extent + RECORDED_OUTER * outer_extent;
        self.members as u64 * u64::from(words)
    }

    /// Number of staging buffers.
    pub(super) fn ring(&self) -> usize {
        self.records.unwrap_or_else(|| self.most_staging())
    }

    /// Number of records that a submission may have: half of the staging buffers, so that the
    /// device can use the other half while the host reads these. A replay may fill all buffers.
    pub(super) fn records(&self) -> usize {
        self.records.unwrap_or_else(|| self.most_staging() / 2)
    }

    fn most_staging(&self) -> usize {
        (RING_BYTES / self.record_bytes().max(1)).clamp(LEAST_RING, GREATEST_RING) as usize
    }

    /// Bytes of the largest record.
    pub(super) fn record_bytes(&self) -> u64 {
        4 * self.record_words([self.batch.capacity, self.batch.outer_capacity])
    }

    /// Bytes of all buffers together.
    pub(super) fn total_bytes(&self) -> u64 {
        self.bytes().iter().map(|(_, bytes)| bytes).sum::<u64>() + self.ring() as u64 * self.record_bytes()
    }

    /// Name and bytes of each storage buffer, in the order of the bindings, which begin at 1.
    pub(super) fn bytes(&self) -> [(&'static str, u64); 11] {
        let b = &self.batch;
        let each = |words: u64| 4 * words * self.members as u64;
        let [capacity, outer] = [b.capacity, b.outer_capacity].map(u64::from);
        [
            ("rows", each(u64::from(b.rows) * (size_of::<StepRow>() / 4) as u64)),
            ("members", each((size_of::<Member>() / 4) as u64)),
            ("tables", each(u64::from(b.tables))),
            ("states", each((size_of::<Status>() / 4) as u64)),
            ("scalars", each(u64::from(SCALARS) * capacity)),
            ("vectors", each(2 * u64::from(VECTORS) * capacity)),
            ("extents", each(4 * capacity / LANES as u64)),
            ("near", each(2 * capacity)),
            ("lists", each(u64::from(SLICES * LIST) * capacity / LANES as u64)),
            ("wall", each(u64::from(WALL_FIELDS) * outer)),
            ("record", self.record_bytes()),
        ]
    }

    /// Checks the sizes against the limits of the indices of shaders and of the device.
    pub(super) fn check(&self, limits: &wgpu::Limits) -> Result<(), GpuError> {
        let unfit = |detail: String| Err(GpuError::Unfit { detail });
        // The shaders split runs by products of two counts, which must fit 32 bits.
        if self.batch.capacity > 65_520 || self.batch.outer_capacity > 65_520 {
            return unfit("more than 65,520 particles in a loop".to_owned());
        }
        if self.members > limits.max_compute_workgroups_per_dimension as usize {
            return unfit(format!("{} simulations are more than one dispatch can hold", self.members));
        }
        let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        for (name, bytes) in self.bytes() {
            // Shaders index words with 32 bits.
            if bytes > most || bytes / 4 > u64::from(u32::MAX) {
                return unfit(format!("{bytes} bytes of {name}; the adapter can bind {most}"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::{ModelSpec, preset};
    use serde_json::json;

    #[test]
    fn a_slab_is_replayed_in_one_submission() {
        let patch = json!({ "steps": 100, "particles": { "total": { "keys": [[0, 180], [1, 400]] } } });
        let plan = Plan::new(&ModelSpec::resolve(preset("pig").unwrap(), &patch).unwrap(), 1);
        let sizes = Sizes::new(&[&plan], 1);
        assert_eq!((sizes.ring(), sizes.records()), (32, 16));
        for (steps, records) in [(10, 10), (32, 32), (33, 32), (1000, 32)] {
            let replaying = sizes.replaying(steps);
            assert_eq!((replaying.ring(), replaying.records()), (records, records));
            assert!(replaying.total_bytes() <= sizes.total_bytes());
        }
    }
}
