//! Data structures shared by shaders and host: the counterpart of `shaders/shared/layout.wgsl`.
//! `tests/whole/shaders.rs` compares both.

use bytemuck::{Pod, Zeroable};

/// Number of partial sums of a force: segment j is summed in slice j mod `SLICES`.
pub const SLICES: u32 = 8;
/// Number of threads of a workgroup that computes a block of [`crate::sim::LANES`] particles: one
/// per particle and slice.
pub const BLOCK_THREADS: u32 = 128;
/// Number of threads of a workgroup that computes one particle per thread.
pub const THREADS: u32 = 64;
/// Number of threads of a workgroup that grows a whole loop.
pub const LOOP_THREADS: u32 = 256;
/// Number of segments of a slice for which the neighbour list of a block has room. A block that
/// needs more visits all segments.
pub const LIST: u32 = 64;
/// Index that stands for no row or no edge.
pub const NONE: u32 = u32::MAX;
/// Number of words of a record before its fields.
pub const HEADER: u32 = 8;
/// Number of fields of an inner particle in a record: the fields that growth copies, and the
/// clearance.
pub const RECORDED_INNER: u32 = 12;
/// Number of fields of an outer particle in a record.
pub const RECORDED_OUTER: u32 = 5;
/// Number of scalars of an inner particle that growth copies.
pub const COPIED_SCALARS: u32 = 5;
/// Index of the scalar with the clearance.
pub const CLEARANCE: u32 = 10;
/// Number of scalars of an inner particle.
pub const SCALARS: u32 = 15;
/// Number of vectors of an inner particle that growth copies.
pub const COPIED_VECTORS: u32 = 3;
/// Number of vectors of an inner particle.
pub const VECTORS: u32 = 15;
/// Number of fields of an outer particle.
pub const WALL_FIELDS: u32 = 12;

/// Constants of a batch, the same for all members.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Batch {
    /// Number of inner particles for which a member has room.
    pub capacity: u32,
    /// Number of outer particles for which a member has room.
    pub outer_capacity: u32,
    /// Number of rows per member.
    pub rows: u32,
    /// Number of growth events.
    pub events: u32,
    /// Number of cosines of the thickness field.
    pub waves: u32,
    /// Number of lobes for which a member has room.
    pub lobes: u32,
    /// Number of words of the tables of a member.
    pub tables: u32,
    /// Number of cosines of the sway.
    pub flows: u32,
    /// Number of modes of the variety around the wall for which a member has room.
    pub modes: u32,
    /// Index of the modes in the tables of a member.
    pub around: u32,
    /// Index of the directions of outlines in the tables of a member.
    pub outline: u32,
    /// Index of the directions of clefts in the tables of a member.
    pub clefts: u32,
}

/// Constants of a member.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Member {
    /// Lower half of the seed.
    pub seed_low: u32,
    /// Upper half of the seed.
    pub seed_high: u32,
    /// Number of candidates in a growth tournament.
    pub candidates: u32,
    /// Number of lobes of the outer wall.
    pub lobes: u32,
    /// Fraction of contorted particles.
    pub contorted: f32,
    /// Minimum clearance, µm.
    pub clearance: f32,
    /// Number of modes of the variety around the wall.
    pub modes: u32,
    /// Number of directions of the gauge of the region; 0 if the region is the ellipse.
    pub directions: u32,
    /// Number of directions of clefts; 0 if the model has none.
    pub clefts: u32,
}

/// State of a member, except its particles.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Status {
    /// Number of particles of the inner loop.
    pub inner: u32,
    /// Number of particles of the outer loop.
    pub outer: u32,
    /// The next id.
    pub next_id: u32,
    /// Number of splits deferred to a later growth event.
    pub deferred: u32,
    /// Number of builds of the neighbour lists.
    pub builds: u32,
    /// Number of moves that the guard shortened.
    pub shortened: u32,
    /// First row after which a position was not finite, or [`NONE`].
    pub broken: u32,
    /// 1 if the host stopped the member.
    pub halted: u32,
    /// Bits of the maximum squared displacement since the lists were built, at each evaluation.
    pub moved: [u32; 4],
    /// Bits of the maximum squared distance of a stage from the start of its step, in even and in
    /// odd rows.
    pub strayed: [u32; 2],
    /// Bits of the maximum squared elliptic radius, or of the maximum gauge if the region is not
    /// the ellipse.
    pub reach: u32,
    /// Bits of the maximum range scale, at least 1.
    pub widest: u32,
    /// Row in which the lists were built, at the start of a step.
    pub built: u32,
    /// Row in which the lists were built, after the first evaluation.
    pub built_next: u32,
    /// Number of particles before the last growth event.
    pub grown_from: u32,
    /// Number of runs of the last growth event.
    pub runs: u32,
    /// Weight of all edges at the last growth event.
    pub weight: u32,
    /// Id of the first particle that the last growth event added.
    pub first_id: u32,
    /// Number of blocks that visited all segments, counted at each evaluation.
    pub full_searches: u32,
}

/// Constants of a dispatch.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Now {
    /// Row of the step.
    pub row: u32,
    /// Index of the current copy of the particles.
    pub copy: u32,
    /// Index of the current copy of the rest lengths.
    pub rest: u32,
    /// Ordinal of the growth event.
    pub event: u32,
    /// Number of inner particles for which a record has room.
    pub extent: u32,
    /// Number of outer particles for which a record has room.
    pub outer_extent: u32,
    /// 1 if the first workgroup of each member computes the last step of its outer loop.
    pub outer: u32,
}
