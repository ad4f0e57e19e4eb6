// Neighbour search: for each particle the blocks of segments within its range plus a skin, ascending; twin of
// src/sim/cpu/neighbours.rs (`lists`).
//
// Runs before each step and returns at once while the lists hold with something to spare, so that the host never asks.
// Should they fail within the step all the same, `integrate` sees it and visits all blocks.

override EULER: bool = false;

// Part of the skin kept for what the stages of one step move, µm.
const SPARE: f32 = 4.0;

var<workgroup> stale: u32;
var<workgroup> count_all: u32;
// Bounding boxes of blocks: least x, least y, greatest x, greatest y.
var<workgroup> boxes: array<vec4<f32>, THREADS>;

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

@compute @workgroup_size(THREADS)
fn neighbours(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let member = group.y;
    let i = group.x * THREADS + thread;
    if thread == 0u {
        let first_slot = select(0u, now.row % 2u, EULER);
        let moved = bitcast<f32>(atomicLoad(&states[member].moved[first_slot]));
        let built = states[member].built;
        let holds = built != NONE && 2.0 * sqrt(moved) + widened(member, now.row, built) <= SKIN - SPARE;
        stale = u32(!holds && runs_on(member));
        count_all = states[member].inner;
    }
    let build = workgroupUniformLoad(&stale) != 0u;
    let n = workgroupUniformLoad(&count_all);
    if i < n {
        // What segment i sees in the coming step.
        atomicStore(&near[member * batch.capacity + i], 0u);
    }
    if !build {
        return;
    }
    if i == 0u {
        states[member].built_next = now.row;
        states[member].builds += 1u;
    }
    let blocks = (n + LANES - 1u) / LANES;
    var p = vec2<f32>(0.0);
    var range = 0.0;
    if i < n {
        let row = row_index(member, now.row);
        p = load2(member, current(X), i);
        let reach = range_max(row) * load(member, current(SCALE), i);
        range = max(reach, least_sight(row)) + SKIN;
        store2(member, BUILT_X, i, p);
    }
    let list = (member * batch.capacity + i) * LIST;
    var found = 0u;
    for (var tile = 0u; tile < blocks; tile += THREADS) {
        if tile + thread < blocks {
            boxes[thread] = segment_bounds(member, n, tile + thread);
        }
        workgroupBarrier();
        if i < n {
            for (var k = 0u; k < min(THREADS, blocks - tile); k++) {
                let bounds = boxes[k];
                let d = max(max(bounds.xy - p, p - bounds.zw), vec2<f32>(0.0));
                if d.x * d.x + d.y * d.y <= range * range {
                    if found < LIST {
                        lists[list + found] = tile + k;
                    }
                    found++;
                }
            }
        }
        workgroupBarrier();
    }
    if i < n {
        // More than the list holds: told by the count, and then the list is not used.
        particles[slot(member, COUNT, i)] = found;
    }
}
