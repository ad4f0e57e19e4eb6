// The outer loop: springs, a pull toward its lobed ellipse, friction. Counterpart of
// crates/sim/src/sim/cpu/outer.rs.
//
// One workgroup per member, which keeps its sums in the shared memory of gather.wgsl. The inner
// loop never reads the outer loop, so a step of the wall may run in parallel with the first
// evaluation of the next step.

// Maximum move in a step along each axis, µm, unless the inner loop forces a larger one.
const MOVE: f32 = 5.0;
// Rest length of the edges over their mean length; below 1, so that the wall is under tension.
const TAUT: f32 = 0.8;
// Pull toward the target per µm of distance.
const PULL: f32 = 0.1;
// Fraction of the angle between two neighbours that each of them may close in a step; below a half.
const CLOSING: f32 = 0.45;
// Fraction of the remainder up to WIDEST by which each of two neighbours may widen their angle in a
// step.
const WIDENING: f32 = 0.25;
// Maximum chord between the directions (unit vectors) of two neighbours: an angle of 106°.
const WIDEST: f32 = 1.6;
// Minimum chord between the directions of two neighbours, over the mean chord.
const NARROWEST: f32 = 0.1;

var<workgroup> wall_burden: f32;

fn wall_slot(member: u32, field: u32, i: u32) -> u32 {
    return (member * WALL_FIELDS + field) * batch.outer_capacity + i;
}

fn wall2(member: u32, field: u32, i: u32) -> vec2<f32> {
    let at = vec2<u32>(wall[wall_slot(member, field, i)], wall[wall_slot(member, field + 1u, i)]);
    return bitcast<vec2<f32>>(at);
}

fn put2(member: u32, field: u32, i: u32, value: vec2<f32>) {
    wall[wall_slot(member, field, i)] = bitcast<u32>(value.x);
    wall[wall_slot(member, field + 1u, i)] = bitcast<u32>(value.y);
}

// Elliptic radius of the lobed target in a direction, in row `at` of the member.
fn wall_target(member: u32, at: u32, direction: vec2<f32>) -> f32 {
    let row = row_index(member, at);
    // Table, after that of the thickness field: order and weight of each lobe, then (cosine, sine)
    // per row and lobe.
    let lobes = member * batch.tables + batch.waves * (2u + batch.events);
    let phases = lobes + 2u * batch.lobes + 2u * batch.lobes * min(at, batch.rows - 1u);
    var power = direction;
    var order = 1u;
    var sum = 0.0;
    for (var l = 0u; l < members[member].lobes; l++) {
        let lobe_order = u32(tables[lobes + 2u * l]);
        while order < lobe_order {
            power = vec2<f32>(
                power.x * direction.x - power.y * direction.y,
                power.x * direction.y + power.y * direction.x,
            );
            order++;
        }
        let phase = vec2<f32>(tables[phases + 2u * l], tables[phases + 2u * l + 1u]);
        sum += tables[lobes + 2u * l + 1u] * (power.x * phase.x - power.y * phase.y);
    }
    var radius = rows[row].r_wall;
    if is_shaped(member) {
        radius += rows[row].r_in * (region_boundary(member, row, wall_depth(row), direction) - 1.0);
    }
    return radius * (1.0 + rows[row].lobing * sum);
}

// Elliptic radius, in a direction, of a wall that just clears the inner loop. `lowest` is a gauge.
fn wall_floor(member: u32, row: u32, lowest: f32, direction: vec2<f32>) -> f32 {
    if !is_shaped(member) {
        return lowest;
    }
    return lowest * region_boundary(member, row, wall_depth(row), direction);
}

fn wall_unit(a: vec2<f32>) -> vec2<f32> {
    return a / max(sqrt(a.x * a.x + a.y * a.y), 1e-6);
}

// Direction of particle i in the flattened plane, from the position in `field`.
fn wall_direction(member: u32, field: u32, i: u32, squash: f32) -> vec2<f32> {
    let p = wall2(member, field, i);
    return wall_unit(vec2<f32>(p.x, p.y / squash));
}

// Chord between two directions.
fn wall_chord(a: vec2<f32>, b: vec2<f32>) -> f32 {
    let d = b - a;
    return sqrt(d.x * d.x + d.y * d.y);
}

// Positive if b lies counter-clockwise of a.
fn wall_cross(a: vec2<f32>, b: vec2<f32>) -> f32 {
    return a.x * b.y - a.y * b.x;
}

// Limit of the direction of a particle in a step, from `own` toward a neighbour. `closing` is the
// chord to this neighbour, `widening` that to the other one.
fn wall_limit(own: vec2<f32>, toward: vec2<f32>, closing: f32, widening: f32, narrowest: f32) -> vec2<f32> {
    let close = CLOSING * max(1.0 - narrowest / closing, 0.0);
    let widen = WIDENING * max(WIDEST - widening, 0.0) / closing;
    return own + min(close, widen) * (toward - own);
}

// Advances the outer loop by the step of row `at`, with the BLOCK_THREADS threads of a workgroup.
fn step_outer(member: u32, at: u32, thread: u32) {
    let n = select(0u, states[member].outer, runs_on(member));
    let row = row_index(member, at);
    let next_row = row_index(member, at + 1u);
    var partial = 0.0;
    for (var i = thread; i < n; i += BLOCK_THREADS) {
        partial += length(wall2(member, WALL_X, (i + 1u) % n) - wall2(member, WALL_X, i));
    }
    // In other outlines, the edges between blocks; `measure_edges` measured the others.
    var reach = 0.0;
    if is_shaped(member) && n > 0u {
        let inner = states[member].inner;
        let flatten = vec2<f32>(1.0, 1.0 / rows[next_row].squash);
        for (var first = LANES * thread; first < inner; first += LANES * BLOCK_THREADS) {
            let i = min(first + LANES, inner) - 1u;
            let a = position(member, i) * flatten;
            let b = position(member, (i + 1u) % inner) * flatten;
            reach = max(reach, region_extent(member, next_row, wall_depth(next_row), a, b).y);
        }
    }
    put_line(thread, vec4<f32>(partial, reach, 0.0, 0.0));
    if thread == 0u {
        let measured = bitcast<f32>(atomicExchange(&states[member].reach, 0u));
        wall_burden = select(sqrt(measured), measured, is_shaped(member));
    }
    workgroupBarrier();
    // Reduces groups of eight threads, then all groups.
    if thread < LANES {
        let one = quads[2u * thread].lines;
        let two = quads[2u * thread + 1u].lines;
        let sum = one[0].x + one[1].x + one[2].x + one[3].x + two[0].x + two[1].x + two[2].x + two[3].x;
        let lower = max(max(one[0].y, one[1].y), max(one[2].y, one[3].y));
        spots[thread] = vec2<f32>(sum, max(lower, max(max(two[0].y, two[1].y), max(two[2].y, two[3].y))));
    }
    workgroupBarrier();
    var perimeter = 0.0;
    var burden = wall_burden;
    for (var t = 0u; t < LANES; t += 4u) {
        perimeter = perimeter + spots[t].x + spots[t + 1u].x + spots[t + 2u].x + spots[t + 3u].x;
        burden = max(burden, max(max(spots[t].y, spots[t + 1u].y), max(spots[t + 2u].y, spots[t + 3u].y)));
    }
    burden += rows[next_row].margin;
    let rest = TAUT * perimeter / f32(n);
    for (var i = thread; i < n; i += BLOCK_THREADS) {
        let d = wall2(member, WALL_X, (i + 1u) % n) - wall2(member, WALL_X, i);
        let v = wall2(member, WALL_VX, (i + 1u) % n) - wall2(member, WALL_VX, i);
        let edge = max(sqrt(d.x * d.x + d.y * d.y), 1e-6);
        let u = d / edge;
        let pull = rows[row].wall_stiffness * (edge - rest) + rows[row].wall_damping * (v.x * u.x + v.y * u.y);
        put2(member, WALL_PULL_X, i, pull * u);
    }
    storageBarrier();
    // With equal spacing, an edge between two particles at elliptic radius r comes as close as
    // r·cos(π/n). 2π/n allows for twice the spacing; the last pass handles wider angles.
    let lowest = burden / max(cos_turns(1.0 / f32(n)), 0.5);
    let squash = rows[next_row].squash;
    let narrowest = NARROWEST * 6.2831853 / f32(n);
    for (var i = thread; i < n; i += BLOCK_THREADS) {
        let p = wall2(member, WALL_X, i);
        let flattened = vec2<f32>(p.x, p.y / squash);
        let elliptic = max(sqrt(flattened.x * flattened.x + flattened.y * flattened.y), 1e-6);
        let unit = flattened / elliptic;
        let wanted = max(wall_target(member, at + 1u, unit), wall_floor(member, next_row, lowest, unit));
        let limit = rows[row].containment;
        let pull = clamp(PULL * (wanted - elliptic), -limit, limit);
        let before = wall2(member, WALL_PULL_X, (i + n - 1u) % n);
        let v0 = wall2(member, WALL_VX, i);
        let force = wall2(member, WALL_PULL_X, i) - before + pull * p / elliptic - rows[row].wall_friction * v0;
        var v = clamp(v0 + force, vec2<f32>(-MOVE), vec2<f32>(MOVE));
        var q = p + v;
        // Holds the particle between its neighbours.
        let own = wall_unit(flattened);
        let behind = wall_direction(member, WALL_X, (i + n - 1u) % n, squash);
        let ahead = wall_direction(member, WALL_X, (i + 1u) % n, squash);
        let chord_behind = wall_chord(behind, own);
        let chord_ahead = wall_chord(own, ahead);
        let last = wall_limit(own, ahead, max(chord_ahead, 1e-9), chord_behind, narrowest);
        let first = wall_limit(own, behind, max(chord_behind, 1e-9), chord_ahead, narrowest);
        let flat_q = vec2<f32>(q.x, q.y / squash);
        let elliptic_q = sqrt(flat_q.x * flat_q.x + flat_q.y * flat_q.y);
        let too_far = wall_cross(last, flat_q) > 0.0;
        if too_far || wall_cross(first, flat_q) < 0.0 {
            let held = elliptic_q * wall_unit(select(first, last, too_far));
            q = vec2<f32>(held.x, held.y * squash);
            v = q - p;
        }
        let least = wall_floor(member, next_row, lowest, wall_unit(vec2<f32>(q.x, q.y / squash)));
        if elliptic_q < least {
            q *= least / max(elliptic_q, 1e-6);
        }
        // A copy, because neighbours still read the old position.
        put2(member, WALL_OLD, i, q);
        put2(member, WALL_VX, i, v);
    }
    storageBarrier();
    // Pushes out particles whose edges would come closer to the axis than the inner loop reaches.
    for (var i = thread; i < n; i += BLOCK_THREADS) {
        let own = wall_direction(member, WALL_OLD, i, squash);
        let behind = wall_direction(member, WALL_OLD, (i + n - 1u) % n, squash);
        let ahead = wall_direction(member, WALL_OLD, (i + 1u) % n, squash);
        let chord = max(wall_chord(behind, own), wall_chord(own, ahead));
        let needed = burden / sqrt(max(1.0 - 0.25 * chord * chord, 0.01));
        let q = wall2(member, WALL_OLD, i);
        let flat_q = vec2<f32>(q.x, q.y / squash);
        if is_shaped(member) {
            let before = wall2(member, WALL_OLD, (i + n - 1u) % n) / vec2<f32>(1.0, squash);
            let after = wall2(member, WALL_OLD, (i + 1u) % n) / vec2<f32>(1.0, squash);
            let depth = wall_depth(next_row);
            let edge_behind = region_extent(member, next_row, depth, before, flat_q).x;
            let nearest = min(edge_behind, region_extent(member, next_row, depth, flat_q, after).x);
            put2(member, WALL_X, i, q * max(burden / max(nearest, 1e-6), 1.0));
            continue;
        }
        let radius = sqrt(flat_q.x * flat_q.x + flat_q.y * flat_q.y);
        put2(member, WALL_X, i, select(q, q * (needed / max(radius, 1e-6)), radius < needed));
    }
}
