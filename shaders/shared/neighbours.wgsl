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

fn segment_bounds(member: u32, n: u32, block: u32) -> vec4<f32> {
    let first = block * LANES;
    // Segments end at the next particle: one more point.
    let count = min(LANES, n - first) + 1u;
    var bounds = vec4<f32>(load2(member, current(X), first), load2(member, current(X), first));
    for (var k = 1u; k < count; k++) {
        let j = first + k;
        let p = load2(member, current(X), select(j, 0u, j == n));
        bounds = vec4<f32>(min(bounds.xy, p), max(bounds.zw, p));
    }
    return bounds;
}

// Builds the lists of the particles of a block with 16 threads per particle. Reads positions, which no workgroup changes
// in this dispatch, and writes the lists of these particles only.
fn build_lists(member: u32, n: u32, block: u32, thread: u32) {
    let lane = thread % LANES;
    let team = thread - lane;
    let i = block * LANES + thread / LANES;
    let blocks = (n + LANES - 1u) / LANES;
    var p = vec2<f32>(0.0);
    var range = 0.0;
    if i < n {
        let row = row_index(member, now.row);
        p = load2(member, current(X), i);
        range = max(range_max(row) * load(member, current(SCALE), i), least_sight(row)) + SKIN;
        if lane == 0u {
            store2(member, BUILT_X, i, p);
        }
    }
    let list = (member * batch.capacity + i) * LIST;
    var all = 0u;
    for (var tile = 0u; tile < blocks; tile += BLOCK_THREADS) {
        if tile + thread < blocks {
            boxes[(thread / LANES) * STRIDE + lane] = segment_bounds(member, n, tile + thread);
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
                lists[list + at] = tile + lane * LANES + firstTrailingBit(near_enough);
            }
            at++;
            near_enough &= near_enough - 1u;
        }
    }
    if i < n && lane == 0u {
        // A count above the capacity marks a list that is not used.
        particles[slot(member, COUNT, i)] = all;
    }
    // Threads of this workgroup read what other threads of it wrote.
    storageBarrier();
}
