// Neighbour search: lists, for each block of particles, the segments within the range of one of its
// particles plus a skin, ascending in each slice. Counterpart of
// crates/sim/src/sim/cpu/neighbours.rs. The segments of the block itself and the one before it are
// not listed, because every evaluation visits them.
//
// The search is part of the first evaluation of a step. The workgroup of a block rebuilds its list
// if the lists of the member are not valid with a margin, so the host takes no part in the
// decision. If a list becomes invalid within the step, `integrate` detects it, and the block visits
// all segments.

// Words that hold one bit per thread.
const WORDS: u32 = BLOCK_THREADS / 32u;
// One bit per lane of slice 0.
const SLICE_MASK: u32 = 0xFFFFu / ((1u << SLICES) - 1u);

// One bit for each of the tested blocks that is near …
var<workgroup> near_blocks: array<atomic<u32>, WORDS>;
// … and these blocks, ascending: their number in the upper half, one bit per near segment in the
// lower half.
var<workgroup> candidates: array<atomic<u32>, BLOCK_THREADS>;
// Maximum number of segments of a slice.
var<workgroup> most_listed: atomic<u32>;

fn extent_slot(member: u32, block: u32) -> u32 {
    return member * (batch.capacity / LANES) + block;
}

// Bounds of the segments of a block. `known` tells whether `extents` are those of the last step; at
// the start and after growth they are not.
fn segment_bounds(member: u32, n: u32, block: u32, known: bool) -> vec4<f32> {
    let first = block * LANES;
    let count = min(LANES, n - first);
    // The last segment ends at the first particle of the next block.
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

// Index of the first segment on the list of a slice of a block.
fn list_slot(member: u32, block: u32, slice: u32) -> u32 {
    return ((member * (batch.capacity / LANES) + block) * SLICES + slice) * LIST;
}

// Tells whether segment j begins or ends at a particle of the block that begins with particle
// `first`.
fn is_own(n: u32, first: u32, j: u32) -> bool {
    return (j >= first && j < first + LANES) || j == select(first - 1u, n - 1u, first == 0u);
}

// Position of particle k of the block, and the square of its range with the skin, from the shared
// memory of gather.wgsl. The square is negative if there is no such particle.
fn seeker(k: u32) -> vec3<f32> {
    return quads[k].inverses.xyz;
}

// Tells whether particle k of the block is near the segment that begins at a.
fn is_seeker_near(k: u32, a: vec2<f32>, d: vec2<f32>, inverse: f32) -> bool {
    let own = seeker(k);
    let r = own.xy - a;
    let q = r - clamp((r.x * d.x + r.y * d.y) * inverse, 0.0, 1.0) * d;
    return q.x * q.x + q.y * q.y <= own.z;
}

// Tells whether one of the block's particles is near segment j.
fn is_sought(member: u32, n: u32, j: u32) -> bool {
    let a = position(member, j);
    let segment = segment_between(a, position(member, select(j + 1u, 0u, j + 1u == n)));
    let d = segment.line.zw;
    var sought = false;
    for (var k = 0u; k < LANES; k += 4u) {
        sought |= is_seeker_near(k, a, d, segment.inverse) | is_seeker_near(k + 1u, a, d, segment.inverse)
            | is_seeker_near(k + 2u, a, d, segment.inverse) | is_seeker_near(k + 3u, a, d, segment.inverse);
    }
    return sought;
}

// Builds the list of a block. Reads positions, which no workgroup changes in this dispatch, and
// writes only the list of this block.
fn build_lists(member: u32, n: u32, block: u32, thread: u32) {
    let known = states[member].built != NONE;
    let lane = thread % LANES;
    let slice = lane % SLICES;
    let team = thread / LANES;
    let first = block * LANES;
    let blocks = (n + LANES - 1u) / LANES;
    if thread < LANES {
        var own = vec4<f32>(0.0, 0.0, -1.0, 0.0);
        if first + thread < n {
            let row = row_index(member, now.row);
            let p = position(member, first + thread);
            let scale = load(member, current(SCALE), first + thread);
            let range = max(range_max(row) * scale, least_sight(row)) + SKIN;
            own = vec4<f32>(p, range * range, 0.0);
            set_vector(member, BUILT, first + thread, p);
        }
        quads[thread].inverses = own;
    }
    if thread == 0u {
        atomicStore(&most_listed, 0u);
    }
    workgroupBarrier();
    var box = vec4<f32>(seeker(0u).xy, seeker(0u).xy);
    var square = seeker(0u).z;
    let end = min(LANES, n - first) - 1u;
    for (var k = 1u; k <= end; k += 3u) {
        let p = seeker(k);
        let q = seeker(min(k + 1u, end));
        let r = seeker(min(k + 2u, end));
        box = vec4<f32>(min(min(box.xy, p.xy), min(q.xy, r.xy)), max(max(box.zw, p.xy), max(q.xy, r.xy)));
        square = max(max(square, p.z), max(q.z, r.z));
    }
    let list = list_slot(member, block, slice);
    var count = 0u;
    for (var tile = 0u; tile < blocks; tile += BLOCK_THREADS) {
        if thread < WORDS {
            atomicStore(&near_blocks[thread], 0u);
        }
        workgroupBarrier();
        var is_near = false;
        if tile + thread < blocks {
            let bounds = segment_bounds(member, n, tile + thread, known);
            let d = max(max(bounds.xy - box.zw, box.xy - bounds.zw), vec2<f32>(0.0));
            is_near = d.x * d.x + d.y * d.y <= square;
        }
        if is_near {
            atomicOr(&near_blocks[thread / 32u], 1u << (thread % 32u));
        }
        workgroupBarrier();
        var before = 0u;
        var all = 0u;
        for (var w = 0u; w < WORDS; w++) {
            let bits = atomicLoad(&near_blocks[w]);
            let lower = select(0u, bits & ((1u << (thread % 32u)) - 1u), w == thread / 32u);
            before += countOneBits(select(lower, bits, w < thread / 32u));
            all += countOneBits(bits);
        }
        if is_near {
            atomicStore(&candidates[before], thread << LANES);
        }
        workgroupBarrier();
        for (var c = team; c < all; c += SLICES) {
            let j = (tile + (atomicLoad(&candidates[c]) >> LANES)) * LANES + lane;
            if j < n && !is_own(n, first, j) && is_sought(member, n, j) {
                atomicOr(&candidates[c], 1u << lane);
            }
        }
        workgroupBarrier();
        // The segments of a candidate are stored after those of the candidates before it.
        var next = 0u;
        for (var c = team; c < all; c += SLICES) {
            for (; next < c; next++) {
                count += countOneBits(atomicLoad(&candidates[next]) & (SLICE_MASK << slice));
            }
            let bits = atomicLoad(&candidates[c]);
            let at = count + countOneBits(bits & (SLICE_MASK << slice) & ((1u << lane) - 1u));
            if (bits & (1u << lane)) != 0u && at < LIST {
                lists[list + at] = (tile + (bits >> LANES)) * LANES + lane;
            }
        }
        for (; next < all; next++) {
            count += countOneBits(atomicLoad(&candidates[next]) & (SLICE_MASK << slice));
        }
        workgroupBarrier();
    }
    if thread < SLICES {
        atomicMax(&most_listed, count);
        scalars[slot(member, COUNT, first + thread)] = count;
    }
    workgroupBarrier();
    if thread == 0u {
        // A number above the capacity marks a list that is not used.
        scalars[slot(member, COUNT, first + SLICES)] = atomicLoad(&most_listed);
    }
    // Makes the list visible to the other threads of this workgroup.
    storageBarrier();
}
