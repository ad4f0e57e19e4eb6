//! Data structures shared by shaders and host: the counterpart of `shaders/shared/layout.wgsl`. `tests/whole/shaders.rs` compares
//! them.

use bytemuck::{Pod, Zeroable};

/// Partial sums of a force: segment j is summed in slice j mod `SLICES`.
pub const SLICES: u32 = 8;
/// Threads of a workgroup that computes a block of [`crate::sim::LANES`] particles, one per particle and slice.
pub const BLOCK_THREADS: u32 = 128;
/// Threads of a workgroup that compute one particle each.
pub const THREADS: u32 = 64;
/// Threads of a workgroup that grows a whole loop.
pub const LOOP_THREADS: u32 = 256;
/// Segments of a slice that the neighbour list of a block can hold; a block that needs more visits all segments.
pub const LIST: u32 = 64;
/// No row, no edge.
pub const NONE: u32 = u32::MAX;
/// Words of a record before its fields.
pub const HEADER: u32 = 8;
/// Fields of an inner particle in a record: what growth copies, and the clearance.
pub const RECORDED_INNER: u32 = 11;
/// Fields of an outer particle in a record.
pub const RECORDED_OUTER: u32 = 5;
/// Scalars of an inner particle that growth copies.
pub const COPIED_SCALARS: u32 = 4;
/// The scalar with the clearance.
pub const CLEARANCE: u32 = 8;
/// Scalars of an inner particle.
pub const SCALARS: u32 = 13;
/// Vectors of an inner particle that growth copies.
pub const COPIED_VECTORS: u32 = 3;
/// Vectors of an inner particle.
pub const VECTORS: u32 = 15;
/// Fields of an outer particle.
pub const WALL_FIELDS: u32 = 12;

/// The same for all members of a batch.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Batch {
    /// Inner particles for which a member has room.
    pub capacity: u32,
    /// Outer particles for which a member has room.
    pub outer_capacity: u32,
    /// Rows per member.
    pub rows: u32,
    /// Growth events.
    pub events: u32,
    /// Cosines of the thickness field.
    pub waves: u32,
    /// Lobes for which a member has room.
    pub lobes: u32,
    /// Words of a member's tables.
    pub tables: u32,
    /// Cosines of the sway.
    pub flows: u32,
    /// Modes of the variety around the wall for which a member has room.
    pub modes: u32,
    /// Where they begin in the tables of a member.
    pub around: u32,
    /// Where the directions of outlines begin in them.
    pub outline: u32,
}

/// Constants of a member.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Member {
    /// Lower half of the seed.
    pub seed_low: u32,
    /// Upper half of the seed.
    pub seed_high: u32,
    /// Candidates of a growth tournament.
    pub candidates: u32,
    /// Lobes of the outer wall.
    pub lobes: u32,
    /// Fraction of contorted particles.
    pub contorted: f32,
    /// Least clearance, µm.
    pub clearance: f32,
    /// Modes of the variety around the wall.
    pub modes: u32,
    /// Directions of the region's gauge; 0 if it is the ellipse.
    pub directions: u32,
}

/// State of a member besides its particles.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Status {
    /// Particles of the inner loop.
    pub inner: u32,
    /// Particles of the outer loop.
    pub outer: u32,
    /// The next id.
    pub next_id: u32,
    /// Splits postponed to a later growth event.
    pub deferred: u32,
    /// Builds of the neighbour lists.
    pub builds: u32,
    /// Moves shortened by the guard.
    pub shortened: u32,
    /// First row after which a position was not finite, or [`NONE`].
    pub broken: u32,
    /// Whether the host stopped the member.
    pub halted: u32,
    /// Bits of the greatest squared displacement since the lists were built, at each evaluation.
    pub moved: [u32; 4],
    /// Bits of the greatest squared distance of a stage from the start of its step, in even and in odd rows.
    pub strayed: [u32; 2],
    /// Bits of the greatest squared elliptic radius, or the greatest gauge if the region is not the ellipse.
    pub reach: u32,
    /// Bits of the greatest range scale, at least 1.
    pub widest: u32,
    /// Row in which the lists were built, at the start of a step.
    pub built: u32,
    /// Row in which the lists were built, after the first evaluation.
    pub built_next: u32,
    /// Particles before the last growth event.
    pub grown_from: u32,
    /// Runs of the last growth event.
    pub runs: u32,
    /// Weight of all edges at the last growth event.
    pub weight: u32,
    /// Id of the first particle that it added.
    pub first_id: u32,
    /// Blocks that visited all segments, counted at each evaluation.
    pub full_searches: u32,
}

/// Constants of a dispatch.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Now {
    /// Row of the step.
    pub row: u32,
    /// Which copy of the particles is current.
    pub copy: u32,
    /// Which copy of the rest lengths is current.
    pub rest: u32,
    /// Ordinal of the growth event.
    pub event: u32,
    /// Inner particles for which a record has room.
    pub extent: u32,
    /// Outer particles for which a record has room.
    pub outer_extent: u32,
    /// 1 if the first workgroup of each member computes the last step of its outer loop.
    pub outer: u32,
}
