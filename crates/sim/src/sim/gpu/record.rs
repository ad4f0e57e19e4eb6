//! Reads a record as packed by `record.wgsl`.

use super::layout::{HEADER, NONE, RECORDED_INNER, RECORDED_OUTER};
use crate::model::Section;
use crate::sim::{Checkpoint, InnerLoop, OuterLoop, Plan, SimError, Statistics};

/// A record of all members at one step.
#[derive(Debug)]
pub(super) struct Record<'a> {
    pub(super) time: i64,
    /// Particles of each loop for which it has room.
    pub(super) extent: u32,
    pub(super) outer_extent: u32,
    pub(super) words: &'a [u32],
}

/// What a record holds of a member, copied.
#[derive(Debug)]
pub(super) struct Arrival {
    pub(super) particles: u32,
    pub(super) section: Section,
    pub(super) checkpoint: Checkpoint,
    pub(super) statistics: Statistics,
}

/// The part of a record for one member.
struct Entry<'a> {
    time: i64,
    header: &'a [u32],
    inner: &'a [u32],
    outer: &'a [u32],
    extent: usize,
    outer_extent: usize,
}

impl<'a> Record<'a> {
    /// Copies the part of a member; the error is that of one with a position that is not finite.
    pub(super) fn arrival(&self, member: usize, plan: &Plan) -> Result<Arrival, SimError> {
        let entry = self.member(member);
        if let Some(error) = entry.fault(plan) {
            return Err(error);
        }
        let checkpoint = entry.checkpoint();
        let section = checkpoint.section(plan);
        Ok(Arrival { particles: entry.particles(), section, checkpoint, statistics: entry.statistics(plan) })
    }

    fn member(&self, member: usize) -> Entry<'a> {
        let (extent, outer_extent) = (self.extent as usize, self.outer_extent as usize);
        let inner = RECORDED_INNER as usize * extent;
        let stride = HEADER as usize + inner + RECORDED_OUTER as usize * outer_extent;
        let (header, fields) = self.words[member * stride..(member + 1) * stride].split_at(HEADER as usize);
        let (inner, outer) = fields.split_at(inner);
        Entry { time: self.time, header, inner, outer, extent, outer_extent }
    }
}

impl Entry<'_> {
    /// Particles of both loops.
    fn particles(&self) -> u32 {
        self.header[0] + self.header[1]
    }

    /// The error of a member with a position that is not finite.
    fn fault(&self, plan: &Plan) -> Option<SimError> {
        let row = self.header[6];
        (row != NONE).then(|| SimError::NotFinite { step: i64::from(row) - i64::from(plan.burn_in) + 1 })
    }

    fn statistics(&self, plan: &Plan) -> Statistics {
        let last = plan.at(i64::from(plan.steps));
        Statistics {
            splits_deferred: u64::from(self.header[3]),
            splits_missing: u64::from((last.inner_target + last.outer_target).saturating_sub(self.particles())),
            moves_shortened: u64::from(self.header[5]),
            list_builds: u64::from(self.header[4]),
            full_searches: u64::from(self.header[7]),
        }
    }

    fn checkpoint(&self) -> Checkpoint {
        let (n, outer) = (self.header[0] as usize, self.header[1] as usize);
        let field = |k: usize| &self.inner[k * self.extent..k * self.extent + n];
        let real = |k: usize| -> Vec<f32> { field(k).iter().map(|&w| f32::from_bits(w)).collect() };
        let wall = |k: usize, i: usize| self.outer[k * self.outer_extent + i];
        let pair = |k: usize| -> Vec<[f32; 2]> {
            (0..outer).map(|i| [f32::from_bits(wall(k, i)), f32::from_bits(wall(k + 1, i))]).collect()
        };
        Checkpoint {
            time: self.time,
            inner: InnerLoop {
                id: field(0).to_vec(),
                x: real(1),
                y: real(2),
                vx: real(3),
                vy: real(4),
                rest: real(5),
                anchor_x: real(6),
                anchor_y: real(7),
                sign: real(8),
                scale: real(9),
                next_id: self.header[2],
            },
            outer: OuterLoop { id: (0..outer).map(|i| wall(0, i)).collect(), p: pair(1), v: pair(3) },
            clearance: real(10),
        }
    }
}
