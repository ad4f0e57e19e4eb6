// Neighbour search: for each particle the blocks of segments within its range plus a skin, ascending; counterpart of
// src/sim/cpu/neighbours.rs (`lists`).
//
// It is the first part of the first evaluation of a step: the workgroup of a block rebuilds the lists of its particles if
// those of the member are not valid with a margin, so that the host need not decide. If a list becomes invalid within the
// step nevertheless, `integrate` detects it, and the particle visits all blocks.

// Part of the skin reserved for the moves of the stages of one step, µm.
const SPARE: f32 = 4.0;

// Whether the lists of a member are to be built; all workgroups decide alike.
var<workgroup> stale: u32;
// Bounding boxes of blocks: least x, least y, greatest x, greatest y; one unused entry after every 16, to avoid bank conflicts.
var<workgroup> boxes: array<vec4<f32>, LANES * STRIDE>;
// Number of blocks that each thread has found for its particle.
var<workgroup> found: array<u32, BLOCK_THREADS>;
// The lists, before they are stored four blocks at a time.
var<workgroup> listed: array<u32, LANES * LIST>;

fn extent_slot(member: u32, block: u32) -> u32 {
    return member * (batch.capacity / LANES) + block;
}

// Bounds of the segments of a block. `known`: whether the extents of its particles are those of the last step; they are not
// at the start and after growth.
fn segment_bounds(member: u32, n: u32, block: u32, known: bool) -> vec4<f32> {
    let first = block * LANES;
    let count = min(LANES, n - first);
    // Segments end at the next particle: one more point.
    let end = position(member, select(first + count, 0u, first + count == n));
    var bounds = vec4<f32>(end, end);
    if known {
        let own = extents[extent_slot(member, block)];
        return vec4<f32>(min(own.xy, end), max(own.zw, end));
    }
    for (var k = 0u; k < count; k++) {
        let p = position(member, first + k);
        bounds = vec4<f32>(min(bounds.xy, p), max(bounds.zw, p));
    }
    return bounds;
}

// The first four blocks on the list of particle i.
fn list_slot(member: u32, i: u32) -> u32 {
    return (member * batch.capacity + i) * (LIST / 4u);
}

// Builds the lists of the particles of a block with 16 threads per particle. Reads positions, which no workgroup changes
// in this dispatch, and writes the lists of these particles only.
fn build_lists(member: u32, n: u32, block: u32, thread: u32) {
    let known = states[member].built != NONE;
    let lane = thread % LANES;
    let team = thread - lane;
    let i = block * LANES + thread / LANES;
    let blocks = (n + LANES - 1u) / LANES;
    var p = vec2<f32>(0.0);
    var range = 0.0;
    if i < n {
        let row = row_index(member, now.row);
        p = position(member, i);
        range = max(range_max(row) * load(member, current(SCALE), i), least_sight(row)) + SKIN;
        if lane == 0u {
            set_vector(member, BUILT, i, p);
        }
    }
    let list = (thread / LANES) * LIST;
    var all = 0u;
    for (var tile = 0u; tile < blocks; tile += BLOCK_THREADS) {
        if tile + thread < blocks {
            boxes[(thread / LANES) * STRIDE + lane] = segment_bounds(member, n, tile + thread, known);
        }
        workgroupBarrier();
        // Sixteen blocks per thread, one bit for each that is near enough.
        var near_enough = 0u;
        for (var k = 0u; k < LANES; k++) {
            if i < n && tile + lane * LANES + k < blocks {
                let bounds = boxes[lane * STRIDE + k];
                let d = max(max(bounds.xy - p, p - bounds.zw), vec2<f32>(0.0));
                near_enough |= u32(d.x * d.x + d.y * d.y <= range * range) << k;
            }
        }
        found[thread] = countOneBits(near_enough);
        workgroupBarrier();
        // After the blocks that the threads before it have found.
        var at = all;
        for (var l = 0u; l < LANES; l++) {
            at += select(0u, found[team + l], l < lane);
            all += found[team + l];
        }
        while near_enough != 0u {
            if at < LIST {
                listed[list + at] = tile + lane * LANES + firstTrailingBit(near_enough);
            }
            at++;
            near_enough &= near_enough - 1u;
        }
    }
    workgroupBarrier();
    if i < n {
        if 4u * lane < all {
            // After the end of the list its last block again, which `gather` does not count.
            let at = list + min(4u * lane + vec4<u32>(0u, 1u, 2u, 3u), vec4<u32>(min(all, LIST) - 1u));
            lists[list_slot(member, i) + lane] = vec4<u32>(listed[at.x], listed[at.y], listed[at.z], listed[at.w]);
        }
        if lane == 0u {
            // A count above the capacity marks a list that is not used.
            scalars[slot(member, COUNT, i)] = all;
        }
    }
    // Threads of this workgroup read what other threads of it wrote.
    storageBarrier();
}
