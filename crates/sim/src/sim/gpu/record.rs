//! Reads records, whose layout `record.wgsl` defines.

use super::layout::{HEADER, NONE, RECORDED_INNER, RECORDED_OUTER};
use crate::model::Section;
use crate::sim::{Checkpoint, InnerLoop, OuterLoop, Plan, SimError, Statistics};

/// A record of all members at one step.
#[derive(Debug)]
pub(super) struct Record<'a> {
    pub(super) time: i64,
    /// Numbers of inner and outer particles per member for which the record has room.
    pub(super) extents: [u32; 2],
    pub(super) words: &'a [u32],
}

/// Copy of the part of a record that belongs to one member.
#[derive(Debug)]
pub(super) struct MemberRecord {
    pub(super) particles: u32,
    pub(super) section: Section,
    pub(super) checkpoint: Checkpoint,
    pub(super) statistics: Statistics,
}

impl Record<'_> {
    /// Copies the part of a member.
    ///
    /// # Errors
    /// [`SimError::NotFinite`] if a position of the member is not finite.
    pub(super) fn member(&self, member: usize, plan: &Plan) -> Result<MemberRecord, SimError> {
        let [extent, outer_extent] = self.extents.map(|extent| extent as usize);
        let inner_words = RECORDED_INNER as usize * extent;
        let stride = HEADER as usize + inner_words + RECORDED_OUTER as usize * outer_extent;
        let (header, fields) = self.words[member * stride..(member + 1) * stride].split_at(HEADER as usize);
        let [inner, outer, next_id, deferred, builds, shortened, broken, full_searches] =
            std::array::from_fn(|word| header[word]);
        if broken != NONE {
            return Err(SimError::NotFinite { step: i64::from(broken) - i64::from(plan.burn_in) + 1 });
        }
        let (inner_fields, outer_fields) = fields.split_at(inner_words);
        let field = |k: usize| &inner_fields[k * extent..k * extent + inner as usize];
        let real = |k: usize| -> Vec<f32> { field(k).iter().map(|&word| f32::from_bits(word)).collect() };
        let wall = |k: usize| &outer_fields[k * outer_extent..k * outer_extent + outer as usize];
        let pair = |k: usize| -> Vec<[f32; 2]> {
            wall(k).iter().zip(wall(k + 1)).map(|(&x, &y)| [f32::from_bits(x), f32::from_bits(y)]).collect()
        };
        let checkpoint = Checkpoint {
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
                cleft: real(10),
                next_id,
            },
            outer: OuterLoop { id: wall(0).to_vec(), p: pair(1), v: pair(3) },
            clearance: real(11),
        };
        let statistics = Statistics {
            splits_deferred: deferred.into(),
            splits_missing: plan.missing_splits(inner + outer),
            moves_shortened: shortened.into(),
            list_builds: builds.into(),
            full_searches: full_searches.into(),
        };
        Ok(MemberRecord { particles: inner + outer, section: checkpoint.section(plan), checkpoint, statistics })
    }
}
