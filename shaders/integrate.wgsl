// Time integration (paper, section 3) and the guard that prevents walls from crossing: counterpart of
// src/sim/cpu/integrate.rs.
//
// A dispatch is one evaluation of all forces; the first of a step rebuilds neighbour lists that are no longer valid.
// A workgroup computes a block of 16 particles with 8 threads per particle, one for each slice: segment j is in slice j mod 8. The
// segments on the block's list are copied to shared memory, some at a time; each thread visits those of its slice, ascending, after
// those of the block itself. So sums depend neither on the list nor on when it was built. Then threads of other subgroups compute
// the local forces and the sway, and one thread per particle adds everything and moves the particle to the next stage, in a buffer
// that this dispatch does not read. A block whose list is invalid, or was too long, visits all segments, with the same sums.
//
// How many workgroups a multiprocessor holds depends on their shared memory, so arrays serve more than one purpose.
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
// Coordinate of segments that fill the rest of a slice, µm: beyond all ranges, so that they add zeros.
const DISTANT: f32 = 1e15;

// Segments of a slice in shared memory.
const SHELF: u32 = 24u;
// Parts of an evaluation that threads of different subgroups compute are this many slices apart.
const APART: u32 = SLICES / 4u;

// Positions of the particle before the block, its own, and the one after it.
var<workgroup> chain: array<vec2<f32>, LANES + 2>;
// Segments of each slice, some at a time; then the partial sum of a force and the greatest 1/d by slice and particle.
var<workgroup> lines: array<vec4<f32>, SLICES * SHELF>;
var<workgroup> inverses: array<f32, SLICES * SHELF>;
// For each particle: squared displacement since the lists were built, and since the step began; squared elliptic radius, whether
// its move was shortened.
var<workgroup> far: array<f32, LANES>;
var<workgroup> strayed: array<f32, LANES>;
var<workgroup> wide: array<f32, LANES>;
var<workgroup> shortened: array<u32, LANES>;
// Whether each particle moved too far for the list of its block.
var<workgroup> astray: array<u32, LANES>;
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
    // A list is valid if the particles of its block moved by no more than this: both displacements and the growth of the
    // ranges together are within the skin.
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
    // The stages of this step move particles, the block's own and others, about as far as those of the last one.
    let strayed = sqrt(bitcast<f32>(atomicLoad(&states[member].strayed[(now.row + 1u) % 2u])));
    if EVALUATION == 0u && !(built != NONE && own - moved >= 2.0 * strayed + SPARE) {
        // Their state after the build.
        return Look(n, 0.0, SKIN - 0.01, true);
    }
    return Look(n, select(0.0, moved, built != NONE), own, false);
}

// Whether particle i moved too far for the list of its block.
fn is_astray(member: u32, look: Look, i: u32) -> bool {
    let d = source(member, i) - vector(member, BUILT, i);
    return sqrt(d.x * d.x + d.y * d.y) > look.own;
}

// The sum of the slices of a particle.
fn reduced(part: u32) -> vec2<f32> {
    var sum = lines[part].xy;
    for (var s = 1u; s < SLICES; s++) {
        sum += lines[s * LANES + part].xy;
    }
    return sum;
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
    let part = thread % LANES;
    let i = block * LANES + part;
    gather(member, n, row, look, block, thread);
    // What does not depend on these sums, by a part of one subgroup each; then one thread per particle.
    var own: Own;
    if i < n {
        if thread < LANES {
            own = own_of(member, n, i);
        } else if team == APART {
            local_sum[part] = local_forces(member, n, row, i, part);
        } else if team == 2u * APART && rows[row].sway != 0.0 {
            if EVALUATION == 0u {
                set_vector(member, SWAY, i, sway(member, now.row, position(member, i)));
            }
            sway_sum[part] = vector(member, SWAY, i);
        } else if EVALUATION == 0u && team == 3u * APART {
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
    } else if EVALUATION == 0u && team == APART && i < n {
        var greatest = 0.0;
        for (var s = 0u; s < SLICES; s++) {
            greatest = max(greatest, lines[s * LANES + part].z);
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
            atomicStore(&states[member].strayed[(now.row + 1u) % 2u], 0u);
        }
    }
    if !EULER && block * LANES < n {
        summarize(member, n, block, thread);
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

// Segment j at this evaluation.
fn segment_of(member: u32, n: u32, j: u32) -> Segment {
    return segment_between(source(member, j), source(member, select(j + 1u, 0u, j + 1u == n)));
}

// Sums the forces of a slice on a particle; at the first evaluation also the clearance.
fn gather(member: u32, n: u32, row: u32, look: Look, block: u32, thread: u32) {
    let first = block * LANES;
    if first >= n {
        return;
    }
    let slice = thread / LANES;
    let part = thread % LANES;
    let i = first + part;
    if thread < LANES + 2u {
        chain[thread] = source(member, (first + n - 1u + thread) % n);
    }
    var reader = Reader(false, slice, list_slot(member, block, slice));
    var count = scalars[slot(member, COUNT, first + slice)];
    // Of the slice with the most segments.
    var most = scalars[slot(member, COUNT, first + SLICES)];
    reader.all = most > LIST;
    if look.moved > look.own {
        if thread < LANES {
            astray[thread] = u32(i < n && is_astray(member, look, i));
        }
        workgroupBarrier();
        for (var l = 0u; l < LANES; l++) {
            reader.all |= astray[l] != 0u;
        }
    }
    if reader.all {
        most = (n + SLICES - 1u) / SLICES;
        count = (n + SLICES - 1u - slice) / SLICES;
    }
    var terms: PairTerms;
    var sum = PairSum(vec2<f32>(0.0), 0.0);
    for (var begin = 0u; begin < max(most, 1u); begin += SHELF) {
        workgroupBarrier();
        for (var k = part; k < min(SHELF, count - min(begin, count)); k += LANES) {
            let j = segment_number(reader, begin + k);
            var segment = Segment(vec4<f32>(DISTANT, DISTANT, 0.0, 0.0), 0.0);
            if !reader.all || !is_own(n, first, j) {
                segment = segment_of(member, n, j);
            }
            lines[slice * SHELF + k] = segment.line;
            inverses[slice * SHELF + k] = segment.inverse;
        }
        workgroupBarrier();
        if begin == 0u {
            let normal = normal_of(chain[part], chain[part + 2u]);
            terms = pair_terms(row, chain[part + 1u], normal, load(member, current(SCALE), min(i, n - 1u)));
            sum = own_segments(member, n, terms, first, slice, part);
        }
        let end = select(0u, min(SHELF, count - min(begin, count)), i < n);
        var k = 0u;
        // Two at a time, so that the arithmetic of one hides the latency of the other.
        for (; k + 1u < end; k += 2u) {
            sum = with_listed(member, terms, sum, reader, begin, k);
            sum = with_listed(member, terms, sum, reader, begin, k + 1u);
        }
        if k < end {
            sum = with_listed(member, terms, sum, reader, begin, k);
        }
    }
    workgroupBarrier();
    lines[thread] = vec4<f32>(sum.force, sum.greatest, 0.0);
    if reader.all && thread == 0u {
        atomicAdd(&states[member].full_searches, 1u);
    }
}

// Which segments of a slice a block visits: all, or those on its list.
struct Reader {
    all: bool,
    slice: u32,
    list: u32,
}

fn segment_number(reader: Reader, k: u32) -> u32 {
    if reader.all {
        return k * SLICES + reader.slice;
    }
    return lists[reader.list + k];
}

// Force of the segments so far, and the greatest 1/d.
struct PairSum {
    force: vec2<f32>,
    greatest: f32,
}

fn added(sum: PairSum, force: vec3<f32>) -> PairSum {
    if EVALUATION != 0u {
        return PairSum(sum.force + force.xy, 0.0);
    }
    return PairSum(sum.force + force.xy, max(sum.greatest, force.z));
}

// Whether the clearance of the ends of a segment depends on a particle this near.
fn is_close(inverse: f32) -> bool {
    return EVALUATION == 0u && inverse > 1.0 / CLEARANCE_CAP;
}

// The sum with the force of a segment in shared memory.
fn with_listed(member: u32, terms: PairTerms, sum: PairSum, reader: Reader, begin: u32, k: u32) -> PairSum {
    let at = reader.slice * SHELF + k;
    let force = pair_force(terms, Segment(lines[at], inverses[at]));
    if is_close(force.z) {
        atomicMax(&near[near_slot(member, now.row, segment_number(reader, begin + k))], bitcast<u32>(force.z));
    }
    return added(sum, force);
}

// The sum of the segments of the block and of the one before it, other than those that end at the particle.
fn own_segments(member: u32, n: u32, terms: PairTerms, first: u32, slice: u32, part: u32) -> PairSum {
    var sum = PairSum(vec2<f32>(0.0), 0.0);
    let count = select(0u, min(LANES, n - first), first + part < n);
    // Segment k of these ends at particle k of the block. In a loop of one block the first and the last are the same one.
    for (var k = select(slice, slice + SLICES, slice == 0u && n <= LANES); k <= count; k += SLICES) {
        if k % n != part && k != part + 1u && count > 0u {
            let force = pair_force(terms, segment_between(chain[k], chain[k + 1u]));
            if is_close(force.z) {
                atomicMax(&near[near_slot(member, now.row, (first + n - 1u + k) % n)], bitcast<u32>(force.z));
            }
            sum = added(sum, force);
        }
    }
    return sum;
}

// Forces on particle i from its neighbours in the chain and from the region.
fn local_forces(member: u32, n: u32, row: u32, i: u32, part: u32) -> vec2<f32> {
    let before = select(i - 1u, n - 1u, i == 0u);
    let after = select(i + 1u, 0u, i + 1u == n);
    let p0 = chain[part];
    let p1 = chain[part + 1u];
    let p2 = chain[part + 2u];
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
    var a = reduced(thread) + local_sum[thread];
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
    let stray = p - own.position;
    strayed[thread] = stray.x * stray.x + stray.y * stray.y;
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
    strayed[thread] = 0.0;
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
    if last && thread == APART * LANES {
        var reach = 0.0;
        for (var l = 0u; l < LANES; l++) {
            reach = max(reach, wide[l]);
        }
        atomicMax(&states[member].reach, bitcast<u32>(reach));
    }
    if !last && thread == APART * LANES {
        var greatest = 0.0;
        for (var l = 0u; l < LANES; l++) {
            greatest = max(greatest, strayed[l]);
        }
        atomicMax(&states[member].strayed[now.row % 2u], bitcast<u32>(greatest));
    }
    if last && thread == 2u * APART * LANES {
        var cuts = 0u;
        for (var l = 0u; l < LANES; l++) {
            cuts += shortened[l];
        }
        if cuts > 0u {
            atomicAdd(&states[member].shortened, cuts);
        }
    }
    if last && thread == 3u * APART * LANES {
        var extent = vec4<f32>(spots[0], spots[0]);
        for (var l = 1u; l < min(LANES, n - block * LANES); l++) {
            extent = vec4<f32>(min(extent.xy, spots[l]), max(extent.zw, spots[l]));
        }
        extents[extent_slot(member, block)] = extent;
    }
}
