// The outer loop: spring, containment to its own lobed ellipse, friction; twin of src/sim/cpu/outer.rs.
//
// One workgroup a member. The inner loop never asks where the outer one is, so that a step of the wall may run beside
// the first evaluation of the next step.

// Least thickness of the wall, µm.
const MARGIN: f32 = 20.0;
// Greatest move in a step, µm, where the inner loop does not demand more.
const MOVE: f32 = 5.0;
// Rest length of the edges over their mean length.
const TAUT: f32 = 0.8;
// Pull toward the target per µm of distance.
const PULL: f32 = 0.1;

var<workgroup> wall_lengths: array<f32, LOOP_THREADS>;
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

// Elliptic radius of the lobed wall in a direction, in row `at` of the member's.
fn wall_target(member: u32, at: u32, direction: vec2<f32>) -> f32 {
    let row = row_index(member, at);
    // Tables, behind the thickness field's: order and weight of each lobe, then (cosine, sine) of each row and lobe.
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
    return rows[row].r_wall * (1.0 + rows[row].lobing * sum);
}

// Does the step of row `at` with the threads of a workgroup, `BLOCK_THREADS` of them.
fn step_outer(member: u32, at: u32, thread: u32) {
    let n = select(0u, states[member].outer, runs_on(member));
    let row = row_index(member, at);
    let next_row = row_index(member, at + 1u);
    var partial = 0.0;
    for (var i = thread; i < n; i += LOOP_THREADS) {
        partial += length(wall2(member, WALL_X, (i + 1u) % n) - wall2(member, WALL_X, i));
    }
    wall_lengths[thread] = partial;
    if thread == 0u {
        wall_burden = sqrt(bitcast<f32>(atomicExchange(&states[member].reach, 0u)));
    }
    workgroupBarrier();
    var perimeter = 0.0;
    for (var t = 0u; t < LOOP_THREADS; t++) {
        perimeter += wall_lengths[t];
    }
    let rest = TAUT * perimeter / f32(n);
    for (var i = thread; i < n; i += LOOP_THREADS) {
        let d = wall2(member, WALL_X, (i + 1u) % n) - wall2(member, WALL_X, i);
        let v = wall2(member, WALL_VX, (i + 1u) % n) - wall2(member, WALL_VX, i);
        let edge = max(sqrt(d.x * d.x + d.y * d.y), 1e-6);
        let u = d / edge;
        let pull = rows[row].wall_stiffness * (edge - rest) + rows[row].wall_damping * (v.x * u.x + v.y * u.y);
        put2(member, WALL_PULL_X, i, pull * u);
    }
    storageBarrier();
    // An edge between particles at elliptic radius r comes as near as r·cos(π/n); the loop is spaced evenly within a
    // factor of two, hence 2π/n.
    let lowest = (wall_burden + MARGIN) / max(cos_turns(1.0 / f32(n)), 0.5);
    let squash = rows[next_row].squash;
    for (var i = thread; i < n; i += LOOP_THREADS) {
        let p = wall2(member, WALL_X, i);
        let flattened = vec2<f32>(p.x, p.y / squash);
        let elliptic = max(sqrt(flattened.x * flattened.x + flattened.y * flattened.y), 1e-6);
        let wanted = max(wall_target(member, at + 1u, flattened / elliptic), lowest);
        let limit = rows[row].containment;
        let pull = clamp(PULL * (wanted - elliptic), -limit, limit);
        let before = wall2(member, WALL_PULL_X, (i + n - 1u) % n);
        let v0 = wall2(member, WALL_VX, i);
        let force = wall2(member, WALL_PULL_X, i) - before + pull * p / elliptic - rows[row].wall_friction * v0;
        let v = clamp(v0 + force, vec2<f32>(-MOVE), vec2<f32>(MOVE));
        var q = p + v;
        let flat_q = vec2<f32>(q.x, q.y / squash);
        let elliptic_q = sqrt(flat_q.x * flat_q.x + flat_q.y * flat_q.y);
        if elliptic_q < lowest {
            q *= lowest / max(elliptic_q, 1e-6);
        }
        put2(member, WALL_X, i, q);
        put2(member, WALL_VX, i, v);
    }
}
