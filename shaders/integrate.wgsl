// Time integration (paper, section 3) and the guard that prevents walls from crossing: counterpart of
// src/sim/cpu/integrate.rs.
//
// A dispatch is one evaluation of all forces; the first of a step rebuilds neighbour lists that are no longer valid.
// A workgroup computes a block of 16 particles with 16 threads per particle: thread (particle, lane) gathers from segment
// `lane` of each listed block, in ascending order, so that partial sums run in lane j mod 16 and are reduced in the
// order of the CPU. One thread per particle then adds the local forces and moves the particle to the next stage, in a
// buffer that this dispatch does not read. A list that is invalid, or was too long, is not used: its particle visits
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
// For the member: its particles, or 0 if it is not computed, and which of its lists are valid.
var<workgroup> member_count: u32;
var<workgroup> member_trust: Trust;

// Field of the positions of this evaluation: x; y, vx, vy are the next fields.
fn source() -> u32 {
    if EVALUATION == 0u {
        return current(X);
    }
    return STAGE + 4u * ((EVALUATION + 1u) % 2u);
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

// Which lists of a member are valid at this evaluation.
struct Trust {
    // The greatest displacement of a particle since the lists were built, µm.
    moved: f32,
    // A list is valid if its own particle moved by no more than this: both displacements and the growth of the ranges
    // together are within the skin.
    own: f32,
}

// Reads the state of the member for all threads of a workgroup. All workgroups decide alike whether lists are stale: the
// state read at the first evaluation changes in later dispatches only.
fn look_at_member(member: u32, block: u32) {
    let n = select(0u, states[member].inner, runs_on(member));
    var built = states[member].built_next;
    if EVALUATION == 0u {
        built = states[member].built;
    }
    let moved = sqrt(bitcast<f32>(atomicLoad(&states[member].moved[moved_slot(EVALUATION)])));
    var lists = Trust(0.0, -1.0);
    if built != NONE {
        lists = Trust(moved, SKIN - 0.01 - widened(member, now.row, built) - moved);
    }
    let holds_on = lists.own - lists.moved >= SPARE - 0.01;
    if EVALUATION == 0u && !holds_on {
        // Their state after the build.
        lists = Trust(0.0, SKIN - 0.01);
    }
    member_count = n;
    member_trust = lists;
    stale = u32(block * LANES < n && !holds_on);
}

// Whether the list of particle i, which is at `p`, is valid.
fn holds(member: u32, lists: Trust, i: u32, p: vec2<f32>) -> bool {
    if lists.moved <= lists.own {
        return true;
    }
    let d = p - load2(member, BUILT_X, i);
    return sqrt(d.x * d.x + d.y * d.y) <= lists.own;
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
    let block_index = group.x - now.outer;
    if thread == 0u {
        look_at_member(member, block_index);
    }
    workgroupBarrier();
    let n = member_count;
    let trusted = member_trust;
    if EVALUATION == 0u && workgroupUniformLoad(&stale) != 0u {
        build_lists(member, n, block_index, thread);
        if thread == 0u && block_index == 0u {
            states[member].built_next = now.row;
            states[member].builds += 1u;
        }
    }
    let row = row_index(member, now.row);
    let from_field = source();

    let gatherer = block_index * LANES + thread / LANES;
    if gatherer < n {
        gather(member, n, row, from_field, trusted, gatherer, thread);
    } else {
        searched[thread / LANES] = 0u;
    }
    workgroupBarrier();
    let i = block_index * LANES + thread;
    if thread < LANES {
        far[thread] = 0.0;
        wide[thread] = 0.0;
        shortened[thread] = 0u;
        if i < n {
            if EVALUATION == 0u {
                // Clears the entry of segment i for the next step; that of the previous step is not read any more.
                atomicStore(&near[near_slot(member, now.row + 1u, i)], 0u);
            }
            advance(member, n, row, from_field, i, thread);
        }
    }
    workgroupBarrier();
    if thread == 0u && block_index == 0u && n > 0u {
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
    if !EULER && block_index * LANES < n {
        summarize(member, thread);
    }
    if thread == 3u * THREADS {
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
    let n = select(0u, states[member].inner, runs_on(member));
    let i = group.x * LANES + thread;
    if thread < LANES {
        far[thread] = 0.0;
        wide[thread] = 0.0;
        shortened[thread] = 0u;
        if i < n {
            keep_clearance(member, n, i);
        }
    }
    workgroupBarrier();
    if thread < LANES && i < n {
        conclude(member, row_index(member, now.row), i, thread, load2(member, SUM_X, i), load2(member, SUM_X, i));
    }
    workgroupBarrier();
    if i == 0u && n > 0u {
        states[member].built = states[member].built_next;
    }
    if group.x * LANES < n {
        summarize(member, thread);
    }
}

// Sums the forces of segment `thread` mod 16 of each block on particle i; at the first evaluation also the clearance.
fn gather(member: u32, n: u32, row: u32, from_field: u32, trusted: Trust, i: u32, thread: u32) {
    let lane = thread % LANES;
    let before = select(i - 1u, n - 1u, i == 0u);
    let after = select(i + 1u, 0u, i + 1u == n);
    let normal = normal_of(load2(member, from_field, before), load2(member, from_field, after));
    let p = load2(member, from_field, i);
    let terms = pair_terms(row, p, normal, load(member, current(SCALE), i));
    let listed = particles[slot(member, COUNT, i)];
    let use_list = listed <= LIST && holds(member, trusted, i, p);
    let blocks = (n + LANES - 1u) / LANES;
    let count = select(blocks, listed, use_list);
    let list = (member * batch.capacity + i) * LIST;
    var sum = vec2<f32>(0.0);
    var greatest = 0.0;
    for (var k = 0u; k < count; k++) {
        var block = k;
        if use_list {
            block = lists[list + k];
        }
        let j = block * LANES + lane;
        if j < n && j != i && j != before {
            let next = select(j + 1u, 0u, j + 1u == n);
            let force = pair_force(terms, load2(member, from_field, j), load2(member, from_field, next));
            sum += force.xy;
            if EVALUATION == 0u {
                greatest = max(greatest, force.z);
                // Segments farther away affect no clearance.
                if force.z > 1.0 / CLEARANCE_CAP {
                    atomicMax(&near[near_slot(member, now.row, j)], bitcast<u32>(force.z));
                }
            }
        }
    }
    let at = (thread / LANES) * STRIDE + lane;
    lane_sum[at] = sum;
    lane_near[at] = greatest;
    if lane == 0u {
        searched[thread / LANES] = u32(!use_list);
    }
}

// Adds the local forces on particle i and moves it to the next stage.
fn advance(member: u32, n: u32, row: u32, from_field: u32, i: u32, thread: u32) {
    let before = select(i - 1u, n - 1u, i == 0u);
    let after = select(i + 1u, 0u, i + 1u == n);
    let p0 = load2(member, from_field, before);
    let p1 = load2(member, from_field, i);
    let p2 = load2(member, from_field, after);
    let v0 = load2(member, from_field + 2u, before);
    let v1 = load2(member, from_field + 2u, i);
    let v2 = load2(member, from_field + 2u, after);
    let pull = tension(row, p1, p2, v1, v2, load(member, rest_field(), i))
        - tension(row, p0, p1, v0, v1, load(member, rest_field(), before));
    let modifier = rows[row].contortion[(EVALUATION + 1u) / 2u];
    let direction = load2(member, current(ANCHOR_X), i);
    let sign = load(member, current(SIGN), i);
    let first = thread * STRIDE;
    var a = reduced(first)
        + local_force(member, row, modifier, p0, p1, p2, v1, normal_of(p0, p2), pull, direction, sign);
    if rows[row].sway != 0.0 {
        if EVALUATION == 0u {
            store2(member, SWAY_X, i, sway(member, now.row, p1));
        }
        a += load2(member, SWAY_X, i);
    }

    if EVALUATION == 0u {
        var greatest = 0.0;
        for (var l = 0u; l < LANES; l++) {
            greatest = max(greatest, lane_near[first + l]);
        }
        // The clearance of the vertex; those of its segments need all workgroups.
        store(member, CLEARANCE, i, greatest);
    }
    if EULER {
        store2(member, SUM_X, i, v1 + a);
        return;
    }
    let start = load2(member, current(X), i);
    let start_v = load2(member, current(VX), i);
    if EVALUATION == 3u {
        let sum = load2(member, SUM_X, i) * (1.0 / 6.0);
        let middle = load2(member, MIDDLE_X, i);
        let v = start_v + (load2(member, FIRST_X, i) + 2.0 * middle + a) * (1.0 / 6.0);
        conclude(member, row, i, thread, sum, v);
        return;
    }
    if EVALUATION == 1u {
        keep_clearance(member, n, i);
    }
    let h = select(0.5, 1.0, EVALUATION == 2u);
    let weight = select(2.0, 1.0, EVALUATION == 2u);
    let to_field = STAGE + 4u * (EVALUATION % 2u);
    let p = start + h * v1;
    let v = start_v + h * a;
    store2(member, to_field, i, p);
    store2(member, to_field + 2u, i, v);
    if EVALUATION == 0u {
        store2(member, SUM_X, i, v1 + weight * v);
        store2(member, FIRST_X, i, a);
    } else {
        store2(member, SUM_X, i, load2(member, SUM_X, i) + weight * v);
        store2(member, MIDDLE_X, i, select(a, load2(member, MIDDLE_X, i) + a, EVALUATION == 2u));
    }
    let d = p - load2(member, BUILT_X, i);
    far[thread] = d.x * d.x + d.y * d.y;
}

// Combines the clearances of vertex and segments at the first evaluation into that of particle i.
fn keep_clearance(member: u32, n: u32, i: u32) {
    let before = select(i - 1u, n - 1u, i == 0u);
    let one = atomicLoad(&near[near_slot(member, now.row, before)]);
    let segments = max(one, atomicLoad(&near[near_slot(member, now.row, i)]));
    let greatest = max(load(member, CLEARANCE, i), bitcast<f32>(segments));
    store(member, CLEARANCE, i, 1.0 / max(greatest, 1.0 / CLEARANCE_CAP));
}

// Moves particle i by `sum`, shortened as its clearance requires, and relaxes its rest length.
fn conclude(member: u32, row: u32, i: u32, thread: u32, sum: vec2<f32>, velocity: vec2<f32>) {
    let room = SHARE * (load(member, CLEARANCE, i) - members[member].clearance);
    let limit = clamp(room, LEAST_MOVE, GREATEST_MOVE);
    let move_length = sqrt(sum.x * sum.x + sum.y * sum.y);
    let cut = move_length > limit;
    let factor = select(1.0, limit / move_length, cut);
    let p = load2(member, current(X), i) + factor * sum;
    store2(member, current(X), i, p);
    store2(member, current(VX), i, factor * velocity);
    let rest = load(member, rest_field(), i);
    store(member, next_rest_field(), i, rest + rows[row].relaxation * (rows[row].edge - rest));
    if !is_finite(p.x) || !is_finite(p.y) {
        atomicMin(&states[member].broken, now.row);
    }
    let d = p - load2(member, BUILT_X, i);
    far[thread] = d.x * d.x + d.y * d.y;
    // The wall uses the squash of the step that begins.
    let flat_y = p.y / rows[row_index(member, now.row + 1u)].squash;
    wide[thread] = p.x * p.x + flat_y * flat_y;
    shortened[thread] = u32(cut);
}

// Writes the maxima of a block with three threads of different subgroups.
fn summarize(member: u32, thread: u32) {
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
}
