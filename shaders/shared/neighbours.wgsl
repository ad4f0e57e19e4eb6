// Neighbour search: for each particle the blocks of segments within its range plus a skin, ascending; twin of
// src/sim/cpu/neighbours.rs (`lists`).
//
// The first evaluation of a step begins with it: the workgroup of a block builds the lists of its own particles where
// those of the member hold no longer with something to spare, so that the host never asks. Should a list fail within
// the step all the same, `integrate` sees it, and its particle visits all blocks.

// Part of the skin kept for what the stages of one step move, µm.
const SPARE: f32 = 4.0;

// Whether the lists of a member are to be built: decided by each workgroup alike.
var<workgroup> stale: u32;
// Bounding boxes of blocks: least x, least y, greatest x, greatest y; one unused after 16, against bank conflicts.
var<workgroup> boxes: array<vec4<f32>, LANES * STRIDE>;
// Blocks that each thread has found for its particle.
var<workgroup> found: array<u32, BLOCK_THREADS>;

fn segment_bounds(member: u32, n: u32, block: u32) -> vec4<f32> {
    let first = block * LANES;
    // Segments run to the next particle: one point more.
    let count = min(LANES, n - first) + 1u;
    var bounds = vec4<f32>(load2(member, current(X), first), load2(member, current(X), first));
    for (var k = 1u; k < count; k++) {
        let j = first + k;
        let p = load2(member, current(X), select(j, 0u, j == n));
        bounds = vec4<f32>(min(bounds.xy, p), max(bounds.zw, p));
    }
    return bounds;
}

// Builds the lists of the particles of a block, 16 threads a particle. Reads positions, which no workgroup changes
// meanwhile, and writes what belongs to these particles alone.
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
        // Sixteen blocks a thread, a bit for each that is near enough.
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
        // Behind what the threads before it have found.
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
        // More than the list holds: told by the count, and then the list is not used.
        particles[slot(member, COUNT, i)] = all;
    }
    // The threads of this workgroup read what others of it wrote.
    storageBarrier();
}
