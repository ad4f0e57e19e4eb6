// The sway: a slow flow that carries fronds sideways. Counterpart of
// crates/sim/src/sim/cpu/sway.rs.

// Gauges in units of R_in: the flow has its full strength up to the first, and is 0 from the
// second.
const SWAYS: f32 = 0.55;
const STILL: f32 = 0.95;

// Force of the sway, in the step of row `at`, on a particle that starts the step at p.
fn sway(member: u32, at: u32, p: vec2<f32>) -> vec2<f32> {
    let row = row_index(member, at);
    // Table, after that of the lobes: wave vector and direction of each flow, then a phase per row
    // and flow.
    let flows = member * batch.tables + batch.waves * (2u + batch.events) + 2u * batch.lobes * (1u + batch.rows);
    let phases = flows + 4u * batch.flows + batch.flows * min(at, batch.rows - 1u);
    var sum = vec2<f32>(0.0);
    for (var f = 0u; f < batch.flows; f++) {
        let flow = flows + 4u * f;
        let wave = cos_turns(p.x * tables[flow] + p.y * tables[flow + 1u] + tables[phases + f]);
        sum += vec2<f32>(tables[flow + 2u], tables[flow + 3u]) * wave;
    }
    let flat_y = p.y / rows[row].squash;
    var radius = sqrt(p.x * p.x + flat_y * flat_y) / rows[row].r_in;
    if is_shaped(member) {
        radius = region_gauge(member, row, rows[row].fold, vec2<f32>(p.x, flat_y)) / rows[row].r_in;
    }
    let still = clamp((radius - SWAYS) / (STILL - SWAYS), 0.0, 1.0);
    let strength = rows[row].sway * sqrt(2.0 / f32(batch.flows));
    return strength * (1.0 - still * still * (3.0 - 2.0 * still)) * sum;
}
