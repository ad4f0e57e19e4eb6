// Time integration (paper, section 3) and the guard that prevents walls from crossing: counterpart of
// src/sim/cpu/integrate.rs.
//
// A dispatch is one evaluation of all forces; the first of a step rebuilds neighbour lists that are no longer valid.
// A workgroup computes a block of 16 particles with 16 threads per particle: thread (particle, lane) gathers from segment
// `lane` of each listed block, in ascending order, so that partial sums run in lane j mod 16 and are reduced in the
// order of the CPU. Meanwhile threads of other subgroups compute the local forces and the sway. One thread per particle then
// adds them and moves the particle to the next stage, in a buffer that this dispatch does not read. A list that is invalid, or was too long, is not used: its particle visits
// all blocks, with the same sums.
//
// The step of the outer loop runs in the dispatch of the first evaluation of the next step, in a workgroup of its own: no
// stage of the inner loop reads the wall, and the first evaluation changes nothing that the wall reads (`reach`, rows,
// tables, whether the member runs). Before a growth event or a record it runs alone, by the same pipeline, so that its
// bits do not depend on how a driver compiles it twice.

// Index of the evaluation within the step: 0 to 3; Euler has the first only.
override EVALUATION: u32 = 0u;
override EULER: bool = false;

// Fraction of the free distance by which one side may move.
const SHARE: f32 = 0.45;
// Least and greatest limit of a move, µm.
const LEAST_MOVE: f32 = 1e-5;
const GREATEST_MOVE: f32 = 5.0;
// Stride of the partial sums of a particle in shared memory: one unused word, to avoid bank conflicts.
const STRIDE: u32 = 17u;

var<workgroup> lane_sum: array<vec2<f32>, LANES * STRIDE>;
var<workgroup> lane_near: array<f32, LANES * STRIDE>;
// For each particle: squared displacement since the lists were built, squared elliptic radius, whether its move was
// shortened.
var<workgroup> far: array<f32, LANES>;
var<workgroup> wide: array<f32, LANES>;
var<workgroup> shortened: array<u32, LANES>;
// Whether each particle visited all blocks.
var<workgroup> searched: array<u32, LANES>;
// Local forces and sway of each particle.
var<workgroup> local_sum: array<vec2<f32>, LANES>;
var<workgroup> sway_sum: array<vec2<f32>, LANES>;
// Where each particle is at the end of the step.
var<workgroup> spots: array<vec2<f32>, LANES>;

// Positions of this evaluation.
fn source(member: u32, i: u32) -> vec2<f32> {
    if EVALUATION == 0u {
        return position(member, i);
    }
    return vector(member, STAGE + 2u * ((EVALUATION + 1u) % 2u), i);
}

// Velocities of this evaluation.
fn source_velocity(member: u32, i: u32) -> vec2<f32> {
    if EVALUATION == 0u {
        return vector(member, current_vector(VELOCITY), i);
    }
    return vector(member, STAGE + 2u * ((EVALUATION + 1u) % 2u) + 1u, i);
}

// Index of the greatest 1/d of a segment: rows alternate, so that one is cleared while the other is used.
fn near_slot(member: u32, row: u32, i: u32) -> u32 {
    return (2u * member + row % 2u) * batch.capacity + i;
}

// Slot of the displacement at an evaluation. Euler, with one evaluation per step, alternates.
fn moved_slot(evaluation: u32) -> u32 {
    if EULER {
        return (now.row + evaluation) % 2u;
    }
    return evaluation % 4u;
}

// The state of a member at this evaluation. All threads read it, so that none waits for another.
struct Look {
    // Its particles, or 0 if it is not computed.
    count: u32,
    // The greatest displacement of a particle since the lists were built, µm.
    moved: f32,
    // A list is valid if its own particle moved by no more than this: both displacements and the growth of the ranges
    // together are within the skin.
    own: f32,
    // Whether the lists are to be built first. All workgroups decide alike: the state read at the first evaluation changes
    // in later dispatches only.
    stale: bool,
}

fn look_at_member(member: u32) -> Look {
    let n = select(0u, states[member].inner, runs_on(member));
    var built = states[member].built_next;
    if EVALUATION == 0u {
        built = states[member].built;
    }
    let moved = sqrt(bitcast<f32>(atomicLoad(&states[member].moved[moved_slot(EVALUATION)])));
    var own = -1.0;
    if built != NONE {
        own = SKIN - 0.01 - widened(member, now.row, built) - moved;
    }
    if EVALUATION == 0u && !(built != NONE && own - moved >= SPARE - 0.01) {
        // Their state after the build.
        return Look(n, 0.0, SKIN - 0.01, true);
    }
    return Look(n, select(0.0, moved, built != NONE), own, false);
}

// Whether the list of particle i, which is at `p`, is valid.
fn holds(member: u32, look: Look, i: u32, p: vec2<f32>) -> bool {
    if look.moved <= look.own {
        return true;
    }
    let d = p - vector(member, BUILT, i);
    return sqrt(d.x * d.x + d.y * d.y) <= look.own;
}

// Reduces the 16 partial sums of a particle, from f on, in the order of the CPU: by halves. Written out, so that no array
// is indexed dynamically.
fn reduced(f: u32) -> vec2<f32> {
    let a = (lane_sum[f] + lane_sum[f + 8u]) + (lane_sum[f + 4u] + lane_sum[f + 12u]);
    let b = (lane_sum[f + 2u] + lane_sum[f + 10u]) + (lane_sum[f + 6u] + lane_sum[f + 14u]);
    let c = (lane_sum[f + 1u] + lane_sum[f + 9u]) + (lane_sum[f + 5u] + lane_sum[f + 13u]);
    let d = (lane_sum[f + 3u] + lane_sum[f + 11u]) + (lane_sum[f + 7u] + lane_sum[f + 15u]);
    return (a + b) + (c + d);
}

@compute @workgroup_size(BLOCK_THREADS)
fn integrate(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let member = group.y;
    if EVALUATION == 0u && now.outer != 0u && group.x == 0u {
        step_outer(member, now.row - 1u, thread);
        return;
    }
    let block = group.x - now.outer;
    let look = look_at_member(member);
    let n = look.count;
    if EVALUATION == 0u {
        if thread == 0u {
            stale = u32(look.stale && block * LANES < n);
        }
        if workgroupUniformLoad(&stale) != 0u {
            build_lists(member, n, block, thread);
            if thread == 0u && block == 0u {
                states[member].built_next = now.row;
                states[member].builds += 1u;
            }
        }
    }
    let row = row_index(member, now.row);
    let team = thread / LANES;
    let gatherer = block * LANES + team;
    if gatherer < n {
        gather(member, n, row, look, gatherer, thread);
    } else {
        searched[team] = 0u;
    }
    // What does not depend on these sums, by the first half of one subgroup each; then one thread per particle.
    let part = thread % LANES;
    let i = block * LANES + part;
    var own: Own;
    if i < n {
        if thread < LANES {
            own = own_of(member, n, i);
        } else if team == THREADS / LANES {
            local_sum[part] = local_forces(member, n, row, i);
        } else if team == 2u * THREADS / LANES && rows[row].sway != 0.0 {
            if EVALUATION == 0u {
                set_vector(member, SWAY, i, sway(member, now.row, position(member, i)));
            }
            sway_sum[part] = vector(member, SWAY, i);
        } else if EVALUATION == 0u && team == 3u * THREADS / LANES {
            // Clears the entry of segment i for the next step; that of the previous step is not read any more.
            atomicStore(&near[near_slot(member, now.row + 1u, i)], 0u);
        }
    }
    workgroupBarrier();
    if thread < LANES {
        clear_summary(thread);
        if i < n {
            advance(member, row, own, i, thread);
        }
    } else if EVALUATION == 0u && team == THREADS / LANES && i < n {
        var greatest = 0.0;
        for (var l = 0u; l < LANES; l++) {
            greatest = max(greatest, lane_near[part * STRIDE + l]);
        }
        // The clearance of the vertex; those of its segments need all workgroups.
        store(member, CLEARANCE, i, greatest);
    }
    workgroupBarrier();
    if thread == 0u && block == 0u && n > 0u {
        // The slot of the previous evaluation is not read any more.
        if !EULER {
            atomicStore(&states[member].moved[(EVALUATION + 3u) % 4u], 0u);
        } else {
            atomicStore(&states[member].moved[moved_slot(1u)], 0u);
        }
        if EVALUATION == 1u {
            states[member].built = states[member].built_next;
        }
    }
    if !EULER && block * LANES < n {
        summarize(member, n, block, thread);
    }
    if thread == LANES {
        var any = 0u;
        for (var l = 0u; l < LANES; l++) {
            any |= searched[l];
        }
        if any != 0u {
            atomicAdd(&states[member].full_searches, 1u);
        }
    }
}

// Second half of an Euler step: its guard needs the clearances from all workgroups of `integrate`.
@compute @workgroup_size(BLOCK_THREADS)
fn guard(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let member = group.y;
    let block = group.x;
    let n = select(0u, states[member].inner, runs_on(member));
    let i = block * LANES + thread;
    if thread < LANES {
        clear_summary(thread);
        if i < n {
            let own = own_of(member, n, i);
            let free = clearance(member, n, i);
            store(member, CLEARANCE, i, free);
            conclude(member, row_index(member, now.row), own, free, i, thread, own.sum, own.sum);
        }
    }
    workgroupBarrier();
    if i == 0u && n > 0u {
        states[member].built = states[member].built_next;
    }
    if block * LANES < n {
        summarize(member, n, block, thread);
    }
}

// Sums the forces of segment `thread` mod 16 of each block on particle i; at the first evaluation also the clearance.
fn gather(member: u32, n: u32, row: u32, look: Look, i: u32, thread: u32) {
    let lane = thread % LANES;
    let before = select(i - 1u, n - 1u, i == 0u);
    let after = select(i + 1u, 0u, i + 1u == n);
    let p = source(member, i);
    let normal = normal_of(source(member, before), source(member, after));
    let terms = pair_terms(row, p, normal, load(member, current(SCALE), i));
    let on_list = scalars[slot(member, COUNT, i)];
    let use_list = on_list <= LIST && holds(member, look, i, p);
    let count = select((n + LANES - 1u) / LANES, on_list, use_list);
    let list = list_slot(member, i);
    var sum = PairSum(vec2<f32>(0.0), 0.0);
    // Four blocks at a time, so that their loads are in flight together.
    for (var k = 0u; k < count; k += 4u) {
        let ordinal = k + vec4<u32>(0u, 1u, 2u, 3u);
        var blocks = ordinal;
        if use_list {
            blocks = lists[list + k / 4u];
        }
        let j = blocks * LANES + lane;
        let counts = (ordinal < vec4<u32>(count)) & (j < vec4<u32>(n)) & (j != vec4<u32>(i)) & (j != vec4<u32>(before));
        // Those that do not count are read where there is something to read.
        let first = select(vec4<u32>(i), j, counts);
        let next = select(first + 1u, vec4<u32>(0u), first + 1u == vec4<u32>(n));
        let a0 = source(member, first.x);
        let a1 = source(member, first.y);
        let a2 = source(member, first.z);
        let a3 = source(member, first.w);
        let b0 = source(member, next.x);
        let b1 = source(member, next.y);
        let b2 = source(member, next.z);
        let b3 = source(member, next.w);
        sum = with_segment(member, terms, sum, counts.x, first.x, a0, b0);
        sum = with_segment(member, terms, sum, counts.y, first.y, a1, b1);
        sum = with_segment(member, terms, sum, counts.z, first.z, a2, b2);
        sum = with_segment(member, terms, sum, counts.w, first.w, a3, b3);
    }
    let at = (thread / LANES) * STRIDE + lane;
    lane_sum[at] = sum.force;
    lane_near[at] = sum.greatest;
    if lane == 0u {
        searched[thread / LANES] = u32(!use_list);
    }
}

// Force of the segments so far, and the greatest 1/d.
struct PairSum {
    force: vec2<f32>,
    greatest: f32,
}

// The sum with segment j from a to b, if it counts.
fn with_segment(member: u32, terms: PairTerms, sum: PairSum, counts: bool, j: u32, a: vec2<f32>, b: vec2<f32>) -> PairSum {
    if !counts {
        return sum;
    }
    let force = pair_force(terms, a, b);
    if EVALUATION != 0u {
        return PairSum(sum.force + force.xy, 0.0);
    }
    // Segments farther away affect no clearance.
    if force.z > 1.0 / CLEARANCE_CAP {
        atomicMax(&near[near_slot(member, now.row, j)], bitcast<u32>(force.z));
    }
    return PairSum(sum.force + force.xy, max(sum.greatest, force.z));
}

// Forces on particle i from its neighbours in the chain and from the region.
fn local_forces(member: u32, n: u32, row: u32, i: u32) -> vec2<f32> {
    let before = select(i - 1u, n - 1u, i == 0u);
    let after = select(i + 1u, 0u, i + 1u == n);
    let p0 = source(member, before);
    let p1 = source(member, i);
    let p2 = source(member, after);
    let v0 = source_velocity(member, before);
    let v1 = source_velocity(member, i);
    let v2 = source_velocity(member, after);
    let pull = tension(row, p1, p2, v1, v2, load(member, rest_field(), i))
        - tension(row, p0, p1, v0, v1, load(member, rest_field(), before));
    let modifier = rows[row].contortion[(EVALUATION + 1u) / 2u];
    let direction = vector(member, current_vector(ANCHOR), i);
    let sign = load(member, current(SIGN), i);
    return local_force(member, row, modifier, p0, p1, p2, v1, normal_of(p0, p2), pull, direction, sign);
}

// What the last part of an evaluation needs of a particle, read while others still gather.
struct Own {
    // At the start of the step, and the velocity of this evaluation.
    position: vec2<f32>,
    velocity: vec2<f32>,
    here: vec2<f32>,
    sum: vec2<f32>,
    first: vec2<f32>,
    middle: vec2<f32>,
    built: vec2<f32>,
    rest: f32,
    clearance: f32,
}

fn own_of(member: u32, n: u32, i: u32) -> Own {
    var own: Own;
    own.position = position(member, i);
    own.built = vector(member, BUILT, i);
    own.here = source_velocity(member, i);
    if EVALUATION != 0u || EULER {
        own.sum = vector(member, SUM, i);
    }
    if EVALUATION != 0u {
        own.velocity = vector(member, current_vector(VELOCITY), i);
        own.middle = vector(member, MIDDLE, i);
    } else {
        own.velocity = own.here;
    }
    if EVALUATION == 3u {
        own.first = vector(member, FIRST, i);
    }
    if EVALUATION == 3u || EULER {
        own.rest = load(member, rest_field(), i);
    }
    if EVALUATION == 1u {
        own.clearance = clearance(member, n, i);
    }
    if EVALUATION == 3u {
        own.clearance = load(member, CLEARANCE, i);
    }
    return own;
}

// A displacement, shortened to `limit` if it is longer.
fn within(displacement: vec2<f32>, limit: f32) -> vec2<f32> {
    let distance = sqrt(displacement.x * displacement.x + displacement.y * displacement.y);
    return select(1.0, limit / distance, distance > limit) * displacement;
}

// Moves particle i to the next stage, at most as far as it can move in a step.
fn advance(member: u32, row: u32, own: Own, i: u32, thread: u32) {
    var a = reduced(thread * STRIDE) + local_sum[thread];
    if rows[row].sway != 0.0 {
        a += sway_sum[thread];
    }
    if EULER {
        set_vector(member, SUM, i, own.here + a);
        return;
    }
    if EVALUATION == 3u {
        let v = own.velocity + (own.first + 2.0 * own.middle + a) * (1.0 / 6.0);
        conclude(member, row, own, own.clearance, i, thread, own.sum * (1.0 / 6.0), v);
        return;
    }
    if EVALUATION == 1u {
        store(member, CLEARANCE, i, own.clearance);
    }
    let h = select(0.5, 1.0, EVALUATION == 2u);
    let weight = select(2.0, 1.0, EVALUATION == 2u);
    let to = STAGE + 2u * (EVALUATION % 2u);
    let p = own.position + within(h * own.here, GREATEST_MOVE);
    let v = own.velocity + h * a;
    set_vector(member, to, i, p);
    set_vector(member, to + 1u, i, v);
    if EVALUATION == 0u {
        set_vector(member, SUM, i, own.here + weight * v);
        set_vector(member, FIRST, i, a);
    } else {
        set_vector(member, SUM, i, own.sum + weight * v);
        set_vector(member, MIDDLE, i, select(a, own.middle + a, EVALUATION == 2u));
    }
    let d = p - own.built;
    far[thread] = d.x * d.x + d.y * d.y;
}

// Combines the clearances of vertex and segments at the first evaluation into that of particle i.
fn clearance(member: u32, n: u32, i: u32) -> f32 {
    let before = select(i - 1u, n - 1u, i == 0u);
    let one = atomicLoad(&near[near_slot(member, now.row, before)]);
    let segments = max(one, atomicLoad(&near[near_slot(member, now.row, i)]));
    let greatest = max(load(member, CLEARANCE, i), bitcast<f32>(segments));
    return 1.0 / max(greatest, 1.0 / CLEARANCE_CAP);
}

// Moves particle i by `sum`, shortened as its clearance requires, and relaxes its rest length.
fn conclude(member: u32, row: u32, own: Own, free: f32, i: u32, thread: u32, sum: vec2<f32>, velocity: vec2<f32>) {
    let room = SHARE * (free - members[member].clearance);
    let limit = clamp(room, LEAST_MOVE, GREATEST_MOVE);
    let move_length = sqrt(sum.x * sum.x + sum.y * sum.y);
    let cut = move_length > limit;
    let factor = select(1.0, limit / move_length, cut);
    let p = own.position + factor * sum;
    set_vector(member, current_vector(POSITION), i, p);
    set_vector(member, current_vector(VELOCITY), i, factor * velocity);
    store(member, next_rest_field(), i, own.rest + rows[row].relaxation * (rows[row].edge - own.rest));
    if !is_finite(p.x) || !is_finite(p.y) {
        atomicMin(&states[member].broken, now.row);
    }
    let d = p - own.built;
    far[thread] = d.x * d.x + d.y * d.y;
    // The wall uses the squash of the step that begins.
    let flat_y = p.y / rows[row_index(member, now.row + 1u)].squash;
    wide[thread] = p.x * p.x + flat_y * flat_y;
    shortened[thread] = u32(cut);
    spots[thread] = p;
}

fn clear_summary(thread: u32) {
    far[thread] = 0.0;
    wide[thread] = 0.0;
    shortened[thread] = 0u;
}

// Writes the maxima and the extent of a block with threads of different subgroups.
fn summarize(member: u32, n: u32, block: u32, thread: u32) {
    let last = EULER || EVALUATION == 3u;
    if thread == 0u {
        var moved = 0.0;
        for (var l = 0u; l < LANES; l++) {
            moved = max(moved, far[l]);
        }
        atomicMax(&states[member].moved[moved_slot(EVALUATION + 1u)], bitcast<u32>(moved));
    }
    if last && thread == THREADS {
        var reach = 0.0;
        for (var l = 0u; l < LANES; l++) {
            reach = max(reach, wide[l]);
        }
        atomicMax(&states[member].reach, bitcast<u32>(reach));
    }
    if last && thread == 2u * THREADS {
        var cuts = 0u;
        for (var l = 0u; l < LANES; l++) {
            cuts += shortened[l];
        }
        if cuts > 0u {
            atomicAdd(&states[member].shortened, cuts);
        }
    }
    if last && thread == 3u * THREADS {
        var extent = vec4<f32>(spots[0], spots[0]);
        for (var l = 1u; l < min(LANES, n - block * LANES); l++) {
            extent = vec4<f32>(min(extent.xy, spots[l]), max(extent.zw, spots[l]));
        }
        extents[extent_slot(member, block)] = extent;
    }
}
