// Constants, structures, bindings and the layout of a particle's fields, shared by all stages.
// Counterpart of crates/sim/src/sim/gpu/layout.rs and crates/sim/src/sim/layout.rs;
// tests/whole/shaders.rs compares them.

// Particles of a block.
const LANES: u32 = 16u;
// Partial sums of a force. Segment j is summed in slice j mod SLICES.
const SLICES: u32 = 8u;
// Threads of a workgroup that computes a block: one per particle and slice.
const BLOCK_THREADS: u32 = 128u;
// Threads of a workgroup in which each thread computes one particle.
const THREADS: u32 = 64u;
// Threads of a workgroup that grows a whole loop.
const LOOP_THREADS: u32 = 256u;
// Capacity of a slice of a block's list, in segments. A block that needs more visits all segments.
const LIST: u32 = 64u;
// Stands for no row or no edge.
const NONE: u32 = 0xFFFFFFFFu;
// Words of the header of a record, and numbers of fields of the inner and of the outer loop after
// it.
const HEADER: u32 = 8u;
const RECORDED_INNER: u32 = 12u;
const RECORDED_OUTER: u32 = 5u;

// Parameters of a step, documented at sim::layout::StepRow.
struct StepRow {
    stiffness: f32,
    damping: f32,
    relaxation: f32,
    edge: f32,
    friction: f32,
    bending: f32,
    containment: f32,
    ramp: f32,
    squash: f32,
    r_in: f32,
    r_wall: f32,
    regulatory: f32,
    softening: f32,
    contortion: array<f32, 3>,
    repulsion: f32,
    range_mean: f32,
    range_half: f32,
    barrier: f32,
    barrier_distance: f32,
    variation: f32,
    tip_weight: f32,
    lobing: f32,
    wall_stiffness: f32,
    wall_damping: f32,
    wall_friction: f32,
    sway: f32,
    asymmetry: f32,
    height: f32,
    thickness: f32,
    shift: array<f32, 2>,
    outline: f32,
    fold: f32,
    fold_of_wall: f32,
    fold_phase: f32,
    margin: f32,
    clefts: f32,
    hold: f32,
    cleft_width: f32,
    spare: f32,
    guide: f32,
    reach: f32,
    room: f32,
    inner_target: u32,
    outer_target: u32,
}

// Constants of a GPU batch: capacities, and places in the tables.
struct Batch {
    // Capacity of a member for particles of the inner and of the outer loop.
    capacity: u32,
    outer_capacity: u32,
    // Rows per member.
    rows: u32,
    // Capacity of a member's tables for growth events, cosines of the thickness field, and lobes.
    events: u32,
    waves: u32,
    lobes: u32,
    // Size of a member's tables, words.
    tables: u32,
    // Cosines of the sway.
    flows: u32,
    // Modes of the variety around the wall, and their place in the tables of a member.
    modes: u32,
    around: u32,
    // Place of the directions of outlines in the tables of a member.
    outline: u32,
    // Place of the directions of clefts in the tables of a member.
    clefts: u32,
}

// Constants of a member, one model of the GPU batch.
struct Member {
    seed_low: u32,
    seed_high: u32,
    candidates: u32,
    lobes: u32,
    contorted: f32,
    clearance: f32,
    modes: u32,
    // Directions of the region's gauge; 0 if it is the ellipse.
    directions: u32,
    // Directions of clefts; 0 if the model has none.
    clefts: u32,
}

// State of a member, except for its particles.
struct Status {
    // Number of particles of each loop.
    inner: u32,
    outer: u32,
    next_id: u32,
    // Statistics.
    deferred: u32,
    builds: u32,
    shortened: atomic<u32>,
    // First row after which a position was not finite, or NONE.
    broken: atomic<u32>,
    // 1 if the host stopped the member.
    halted: u32,
    // Bits of the maximum squared displacement since the lists were built, at each evaluation of a
    // step.
    moved: array<atomic<u32>, 4>,
    // Bits of the maximum squared distance of a stage from the start of its step, in even and in
    // odd rows.
    strayed: array<atomic<u32>, 2>,
    // Bits of the maximum squared elliptic radius of the inner loop, or of its maximum gauge in
    // other outlines.
    reach: atomic<u32>,
    // Bits of the maximum range scale, at least 1.
    widest: atomic<u32>,
    // Row in which the lists were built, as of the start of a step and as of its first evaluation.
    built: u32,
    built_next: u32,
    // Last growth event: particles before it, runs into which it divided the loop, weight of all
    // edges.
    grown_from: u32,
    runs: u32,
    weight: u32,
    // Id of the first particle that the last growth event added.
    first_id: u32,
    // Number of blocks that visited all segments, over all evaluations.
    full_searches: atomic<u32>,
}

// Constants of a dispatch.
struct Now {
    // Row of the step.
    row: u32,
    // Current copy of the particles: 0 or 1.
    copy: u32,
    // Current copy of the rest lengths: 0 or 1. They change in every step, while neighbours read
    // them.
    rest: u32,
    // Index of the growth event.
    event: u32,
    // Capacity of a record for particles of the inner and of the outer loop.
    extent: u32,
    outer_extent: u32,
    // 1 if the first workgroup of each member computes the last step of the outer loop.
    outer: u32,
}

@group(0) @binding(0) var<uniform> batch: Batch;
@group(0) @binding(1) var<storage, read> rows: array<StepRow>;
@group(0) @binding(2) var<storage, read> members: array<Member>;
@group(0) @binding(3) var<storage, read> tables: array<f32>;
@group(0) @binding(4) var<storage, read_write> states: array<Status>;
@group(0) @binding(5) var<storage, read_write> scalars: array<u32>;
@group(0) @binding(6) var<storage, read_write> vectors: array<vec2<f32>>;
// Bounds of the particles of each block (minimum x, y, maximum x, y), written at the end of each
// step.
@group(0) @binding(7) var<storage, read_write> extents: array<vec4<f32>>;
// Bits of the maximum 1/d of each segment of a member: first of even rows, then of odd rows.
@group(0) @binding(8) var<storage, read_write> near: array<atomic<u32>>;
@group(0) @binding(9) var<storage, read_write> lists: array<u32>;
@group(0) @binding(10) var<storage, read_write> wall: array<u32>;
@group(0) @binding(11) var<storage, read_write> record_out: array<u32>;
var<immediate> now: Now;

// Scalars of an inner particle that growth copies. Each has two copies.
const ID: u32 = 0u;
const REST: u32 = 1u;
const SIGN: u32 = 2u;
const SCALE: u32 = 3u;
const CLEFT: u32 = 4u;
const COPIED_SCALARS: u32 = 5u;
// Scalars with one copy, after both copies of the others: clearance at the start of the last step;
// segments on the list of a block (per slice, then their maximum) …
const CLEARANCE: u32 = 10u;
const COUNT: u32 = 11u;
// … per run of a growth event, the edge to split or NONE, and the splits in earlier runs …
const WINNER: u32 = 12u;
const BEFORE: u32 = 13u;
// … and the weight of all earlier edges at a growth event.
const LIGHTER: u32 = 14u;
const SCALARS: u32 = 15u;

// Vectors of an inner particle: first those that growth copies, with two copies each.
const POSITION: u32 = 0u;
const VELOCITY: u32 = 1u;
const ANCHOR: u32 = 2u;
const COPIED_VECTORS: u32 = 3u;
// Positions and velocities of two stages …
const STAGE: u32 = 6u;
// … weighted sum of stage velocities, acceleration of stage 1, sum of those of stages 2 and 3 …
const SUM: u32 = 10u;
const FIRST: u32 = 11u;
const MIDDLE: u32 = 12u;
// … position when the lists were built, and force of the sway in this step.
const BUILT: u32 = 13u;
const SWAY: u32 = 14u;
const VECTORS: u32 = 15u;

// Fields of a particle of the outer loop.
const WALL_ID: u32 = 0u;
const WALL_X: u32 = 1u;
const WALL_Y: u32 = 2u;
const WALL_VX: u32 = 3u;
const WALL_VY: u32 = 4u;
const WALL_PULL_X: u32 = 5u;
const WALL_PULL_Y: u32 = 6u;
// Copies of the first five fields while the loop grows; new positions during a step of the wall.
const WALL_OLD: u32 = 7u;
const WALL_FIELDS: u32 = 12u;

fn slot(member: u32, field: u32, i: u32) -> u32 {
    return (member * SCALARS + field) * batch.capacity + i;
}

fn load(member: u32, field: u32, i: u32) -> f32 {
    return bitcast<f32>(scalars[slot(member, field, i)]);
}

fn store(member: u32, field: u32, i: u32, value: f32) {
    scalars[slot(member, field, i)] = bitcast<u32>(value);
}

fn vector_slot(member: u32, field: u32, i: u32) -> u32 {
    return (member * VECTORS + field) * batch.capacity + i;
}

fn vector(member: u32, field: u32, i: u32) -> vec2<f32> {
    return vectors[vector_slot(member, field, i)];
}

fn set_vector(member: u32, field: u32, i: u32, value: vec2<f32>) {
    vectors[vector_slot(member, field, i)] = value;
}

// Fields of a scalar and of a vector in the current copy.
fn current(field: u32) -> u32 {
    return now.copy * COPIED_SCALARS + field;
}

fn current_vector(field: u32) -> u32 {
    return now.copy * COPIED_VECTORS + field;
}

fn position(member: u32, i: u32) -> vec2<f32> {
    return vector(member, current_vector(POSITION), i);
}

// Fields of the current and of the next rest lengths.
fn rest_field() -> u32 {
    return now.rest * COPIED_SCALARS + REST;
}

fn next_rest_field() -> u32 {
    return (1u - now.rest) * COPIED_SCALARS + REST;
}

// Index of row `row` of a member, or of its last row.
fn row_index(member: u32, row: u32) -> u32 {
    return member * batch.rows + min(row, batch.rows - 1u);
}

// Tells whether a member is computed: the host did not stop it, and all its positions are finite.
fn runs_on(member: u32) -> bool {
    // Two reads before one test, so that neither waits for the other.
    let halted = states[member].halted;
    let broken = atomicLoad(&states[member].broken);
    return (halted == 0u) & (broken == NONE);
}

// Maximum range of the self-intersection force at scale 1.
fn range_max(row: u32) -> f32 {
    return rows[row].range_mean + abs(rows[row].range_half);
}
