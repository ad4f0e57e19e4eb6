// Variety around the wall: growth rate and force ranges by the angle of an anchor. Counterpart of
// crates/sim/src/sim/cpu/variety.rs.

// Random functions at an angle: side, height, thickness, shift.
fn around(member: u32, anchor: vec2<f32>) -> vec4<f32> {
    // Table, per event and mode: cosine and sine coefficients of height, thickness and shift.
    let first = member * batch.tables + batch.around + now.event * batch.modes * 6u;
    let count = members[member].modes;
    var turn = vec2<f32>(1.0, 0.0);
    var side = 0.0;
    var sums = vec3<f32>(0.0);
    for (var k = 0u; k < count; k++) {
        turn = vec2<f32>(turn.x * anchor.x - turn.y * anchor.y, turn.y * anchor.x + turn.x * anchor.y);
        let at = first + 6u * k;
        let height = tables[at] * turn.x + tables[at + 1u] * turn.y;
        if k == 0u {
            side = height;
        } else {
            sums.x += height;
        }
        sums.y += tables[at + 2u] * turn.x + tables[at + 3u] * turn.y;
        sums.z += tables[at + 4u] * turn.x + tables[at + 5u] * turn.y;
    }
    let counts = vec3<f32>(f32(count - 1u), f32(count), f32(count));
    return vec4<f32>(side, clamp(sums * sqrt(2.0 / counts), vec3<f32>(-CUT), vec3<f32>(CUT)));
}

fn varies(row: u32) -> bool {
    return rows[row].asymmetry != 0.0 || rows[row].height != 0.0 || rows[row].thickness != 0.0
        || rows[row].shift[0] != 0.0 || rows[row].shift[1] != 0.0;
}

// Logarithm of the growth rate of an edge whose first particle has this anchor.
fn growth_rate(member: u32, row: u32, anchor: vec2<f32>) -> f32 {
    if !varies(row) {
        return 0.0;
    }
    let at = around(member, anchor);
    return rows[row].asymmetry * at.x + rows[row].height * at.y + rows[row].shift[0] * at.w;
}

// Factor on the force ranges of a particle with this anchor.
fn ranges(member: u32, row: u32, anchor: vec2<f32>) -> f32 {
    let at = around(member, anchor);
    return exp(rows[row].thickness * at.z + rows[row].shift[1] * at.w);
}
