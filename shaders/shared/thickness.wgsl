// Scale of the force ranges: the thickness field at a point, times the variety around the wall.
// Counterpart of crates/sim/src/sim/cpu/thickness.rs.

// Random fields are clamped to this many standard deviations.
const CUT: f32 = 2.0;

fn scale_of(member: u32, row: u32, p: vec2<f32>, anchor: vec2<f32>) -> f32 {
    let scale = thickness(member, row, p);
    if varies(row) {
        return scale * ranges(member, row, anchor);
    }
    return scale;
}

fn thickness(member: u32, row: u32, p: vec2<f32>) -> f32 {
    let amplitude = rows[row].variation;
    if amplitude == 0.0 {
        return 1.0;
    }
    // Table: wave vectors, then a phase per event and wave.
    let base = member * batch.tables;
    let phases = base + 2u * batch.waves + now.event * batch.waves;
    var z = 0.0;
    for (var w = 0u; w < batch.waves; w++) {
        let k = vec2<f32>(tables[base + 2u * w], tables[base + 2u * w + 1u]);
        z += cos_turns(p.x * k.x + p.y * k.y + tables[phases + w]);
    }
    let norm = sqrt(2.0 / f32(batch.waves));
    return exp(amplitude * clamp(norm * z, -CUT, CUT));
}
