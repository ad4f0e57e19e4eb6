// Time integration (paper, section 3), and the guard that keeps walls from crossing. Counterpart of
// crates/sim/src/sim/cpu/integrate.rs.
//
// A dispatch is one evaluation of all forces. The first evaluation of a step rebuilds stale
// neighbour lists. A workgroup computes a block of 16 particles: 8 threads per particle sum the
// forces of segments (gather.wgsl), threads of other subgroups then compute the local forces and
// the sway, and one thread per particle adds everything up. It moves the particle to the next
// stage, in a buffer that this dispatch does not read.
//
// Two costs decide the layout. Shared memory limits the number of workgroups of a multiprocessor,
// so arrays serve more than one purpose. With few workgroups, an evaluation takes as long as its
// longest chain of dependent reads: state of the member; list, rows and chain; listed segments;
// velocities and fields. WebGPU bounds every loop by a 64-bit counter, so short loops are unrolled
// by hand.
//
// A step of the outer loop runs in a separate workgroup, in the first dispatch of the next step.
// This is safe because no stage of the inner loop reads the wall, and the first evaluation changes
// nothing that the wall reads (`reach`, rows, tables, whether the member runs). Before a growth
// event or a record the step runs alone, in the same pipeline, because a second compilation may
// round differently.

// Index of the evaluation within the step: 0 to 3. Euler has only evaluation 0.
override EVALUATION: u32 = 0u;
override EULER: bool = false;

// Fraction of the distance between two walls that one side may use in a step.
const SHARE: f32 = 0.45;
// Minimum and maximum of the limit of a move, µm.
const LEAST_MOVE: f32 = 1e-5;
const GREATEST_MOVE: f32 = 5.0;
// Distance, in slices, between the threads that compute different parts of an evaluation. It puts
// the parts into different subgroups.
const APART: u32 = SLICES / 4u;

// Bits of the maximum squared displacement of a particle, since the lists were built and since the
// step began.
var<workgroup> far: atomic<u32>;
var<workgroup> strayed: atomic<u32>;
// Bits of the maximum squared elliptic radius, or of the maximum gauge in other outlines; number of
// moves that the guard shortened.
var<workgroup> wide: atomic<u32>;
var<workgroup> shortened: atomic<u32>;
// Positions at the end of the step; partial sums of the outer loop.
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

@compute @workgroup_size(BLOCK_THREADS)
fn integrate(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let member = group.y;
    if EVALUATION == 0u && now.outer != 0u && group.x == 0u {
        step_outer(member, now.row - 1u, thread);
        return;
    }
    let block = group.x - now.outer;
    let n = select(0u, states[member].inner, runs_on(member));
    let row = row_index(member, now.row);
    let team = thread / LANES;
    let part = thread % LANES;
    let i = block * LANES + part;
    gather(member, n, row, block, thread);
    // Parts that do not depend on these sums, each in its own subgroup; then one thread per
    // particle.
    var own: Own;
    if i < n {
        if thread < LANES {
            own = own_of(member, n, i);
        } else if team == APART {
            let force = local_forces(member, n, row, i, part);
            quads[part].inverses.x = force.x;
            quads[part].inverses.y = force.y;
        } else if team == 2u * APART {
            // A nested condition: otherwise the subgroup of the local forces would read the row
            // first.
            if rows[row].sway != 0.0 {
                if EVALUATION == 0u {
                    set_vector(member, SWAY, i, sway(member, now.row, position(member, i)));
                }
                let force = vector(member, SWAY, i);
                quads[part].inverses.z = force.x;
                quads[part].inverses.w = force.y;
            }
        } else if EVALUATION == 0u && team == 3u * APART {
            // Clears the entry of segment i for the next step, which reuses that of the previous
            // step.
            atomicStore(&near[near_slot(member, now.row + 1u, i)], 0u);
        }
    }
    workgroupBarrier();
    if thread < LANES {
        if i < n {
            advance(member, own, i, thread);
        }
    } else if EVALUATION == 0u && team == APART && i < n {
        // The clearance of the vertex only: that of its segments needs all workgroups.
        store(member, CLEARANCE, i, nearest(part));
    }
    workgroupBarrier();
    if EVALUATION == 3u {
        measure_edges(member, n, block, thread);
        workgroupBarrier();
    }
    if thread == 0u && block == 0u && n > 0u {
        // Clears the slot of the previous evaluation, which nothing reads after this dispatch.
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

// Second half of an Euler step. Its guard needs the clearances from all workgroups of `integrate`.
@compute @workgroup_size(BLOCK_THREADS)
fn guard(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let member = group.y;
    let block = group.x;
    let n = select(0u, states[member].inner, runs_on(member));
    let i = block * LANES + thread;
    if thread == 0u {
        clear_summary();
    }
    workgroupBarrier();
    if thread < LANES {
        if i < n {
            let own = own_of(member, n, i);
            let free = clearance(member, n, i);
            store(member, CLEARANCE, i, free);
            conclude(member, own, free, i, thread, own.sum, own.sum);
        }
    }
    workgroupBarrier();
    measure_edges(member, n, block, thread);
    workgroupBarrier();
    if i == 0u && n > 0u {
        states[member].built = states[member].built_next;
    }
    if block * LANES < n {
        summarize(member, n, block, thread);
    }
}

// Forces on particle i from its neighbours in the loop and from the region.
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
    let cleft = load(member, current(CLEFT), i);
    return local_force(member, row, modifier, p0, p1, p2, v1, normal_of(p0, p2), pull, direction, sign, cleft);
}

// Inputs of the last part of an evaluation for one particle, read while other threads still gather.
struct Own {
    // Position and velocity at the start of the step; `here` is the velocity of this evaluation.
    position: vec2<f32>,
    velocity: vec2<f32>,
    here: vec2<f32>,
    sum: vec2<f32>,
    first: vec2<f32>,
    middle: vec2<f32>,
    built: vec2<f32>,
    // Rest length after this step.
    rest: f32,
    clearance: f32,
    // The guard's clearance, and the squash of the next step.
    kept: f32,
    squash: f32,
    is_shaped: bool,
    sways: bool,
}

fn own_of(member: u32, n: u32, i: u32) -> Own {
    var own: Own;
    own.sways = rows[row_index(member, now.row)].sway != 0.0;
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
        let row = row_index(member, now.row);
        let rest = load(member, rest_field(), i);
        own.rest = rest + rows[row].relaxation * (rows[row].edge - rest);
        own.kept = members[member].clearance;
        own.squash = rows[row_index(member, now.row + 1u)].squash;
        own.is_shaped = is_shaped(member);
    }
    if EVALUATION == 1u {
        own.clearance = clearance(member, n, i);
    }
    if EVALUATION == 3u {
        own.clearance = load(member, CLEARANCE, i);
    }
    return own;
}

// Shortens a displacement to `limit` if it is longer.
fn within(displacement: vec2<f32>, limit: f32) -> vec2<f32> {
    let distance = sqrt(displacement.x * displacement.x + displacement.y * displacement.y);
    return select(1.0, limit / distance, distance > limit) * displacement;
}

// Moves particle i to the next stage, by at most the maximum move of a step.
fn advance(member: u32, own: Own, i: u32, thread: u32) {
    var a = reduced(thread) + quads[thread].inverses.xy;
    if own.sways {
        a += quads[thread].inverses.zw;
    }
    if EULER {
        set_vector(member, SUM, i, own.here + a);
        return;
    }
    if EVALUATION == 3u {
        let v = own.velocity + (own.first + 2.0 * own.middle + a) * (1.0 / 6.0);
        conclude(member, own, own.clearance, i, thread, own.sum * (1.0 / 6.0), v);
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
    atomicMax(&strayed, bitcast<u32>(stray.x * stray.x + stray.y * stray.y));
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
    atomicMax(&far, bitcast<u32>(d.x * d.x + d.y * d.y));
}

// Combines the clearances of the vertex and of its two segments at the first evaluation.
fn clearance(member: u32, n: u32, i: u32) -> f32 {
    let before = select(i - 1u, n - 1u, i == 0u);
    let one = atomicLoad(&near[near_slot(member, now.row, before)]);
    let segments = max(one, atomicLoad(&near[near_slot(member, now.row, i)]));
    let greatest = max(load(member, CLEARANCE, i), bitcast<f32>(segments));
    return 1.0 / max(greatest, 1.0 / CLEARANCE_CAP);
}

// Ends the step of particle i: moves it by `sum`, shortened as its clearance requires.
fn conclude(member: u32, own: Own, free: f32, i: u32, thread: u32, sum: vec2<f32>, velocity: vec2<f32>) {
    let room = SHARE * (free - own.kept);
    let limit = clamp(room, LEAST_MOVE, GREATEST_MOVE);
    let move_length = sqrt(sum.x * sum.x + sum.y * sum.y);
    let cut = move_length > limit;
    let factor = select(1.0, limit / move_length, cut);
    let p = own.position + factor * sum;
    set_vector(member, current_vector(POSITION), i, p);
    set_vector(member, current_vector(VELOCITY), i, factor * velocity);
    store(member, next_rest_field(), i, own.rest);
    if !is_finite(p.x) || !is_finite(p.y) {
        atomicMin(&states[member].broken, now.row);
    }
    let d = p - own.built;
    atomicMax(&far, bitcast<u32>(d.x * d.x + d.y * d.y));
    if !own.is_shaped {
        // The wall uses the squash of the next step.
        let flat_y = p.y / own.squash;
        atomicMax(&wide, bitcast<u32>(p.x * p.x + flat_y * flat_y));
    }
    if cut {
        atomicAdd(&shortened, 1u);
    }
    spots[thread] = p;
}

// Measures the maximum gauge of the block's edges at the end of a step, for outlines other than the
// ellipse: an edge may leave a region that is not convex although its ends lie inside. `step_outer`
// measures the edges between blocks.
fn measure_edges(member: u32, n: u32, block: u32, thread: u32) {
    let part = thread % LANES;
    if thread / LANES != 3u * APART || part + 1u == LANES || block * LANES + part + 1u >= n || !is_shaped(member) {
        return;
    }
    let row = row_index(member, now.row + 1u);
    let flatten = vec2<f32>(1.0, 1.0 / rows[row].squash);
    let gauges = region_extent(member, row, wall_depth(row), spots[part] * flatten, spots[part + 1u] * flatten);
    atomicMax(&wide, bitcast<u32>(gauges.y));
}

fn clear_summary() {
    atomicStore(&far, 0u);
    atomicStore(&strayed, 0u);
    atomicStore(&wide, 0u);
    atomicStore(&shortened, 0u);
}

// Writes the maxima and the bounds of a block, with threads of different subgroups.
fn summarize(member: u32, n: u32, block: u32, thread: u32) {
    let last = EULER || EVALUATION == 3u;
    if thread == 0u {
        atomicMax(&states[member].moved[moved_slot(EVALUATION + 1u)], atomicLoad(&far));
        if !last {
            atomicMax(&states[member].strayed[now.row % 2u], atomicLoad(&strayed));
        }
    }
    if last && thread == APART * LANES {
        atomicMax(&states[member].reach, atomicLoad(&wide));
        let cuts = atomicLoad(&shortened);
        if cuts > 0u {
            atomicAdd(&states[member].shortened, cuts);
        }
    }
    if last && thread == 2u * APART * LANES {
        let end = min(LANES, n - block * LANES) - 1u;
        var extent = vec4<f32>(spots[0], spots[0]);
        for (var l = 0u; l <= end; l += 4u) {
            let a = vec4<f32>(spots[l], spots[min(l + 1u, end)]);
            let b = vec4<f32>(spots[min(l + 2u, end)], spots[min(l + 3u, end)]);
            let low = min(a, b);
            let high = max(a, b);
            extent = vec4<f32>(min(extent.xy, min(low.xy, low.zw)), max(extent.zw, max(high.xy, high.zw)));
        }
        extents[extent_slot(member, block)] = extent;
    }
}
