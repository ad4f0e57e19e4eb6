// Clefts between primary folds, by the direction of an anchor. Counterpart of
// crates/sim/src/sim/cpu/clefts.rs.

// Share of a cleft of a particle with this anchor: 1 at the bottom, 0 far from all clefts.
fn cleft_of(member: u32, row: u32, anchor: vec2<f32>) -> f32 {
    if members[member].clefts == 0u {
        return 0.0;
    }
    let first = member * batch.tables + batch.clefts;
    let number = min(rows[row].clefts, f32(members[member].clefts));
    let whole = u32(number);
    var least = FAR_FROM_CLEFTS;
    for (var k = 0u; k < whole; k++) {
        least = min(least, from_cleft(row, first + 2u * k, anchor));
    }
    var share = exp(-least);
    let part = number - f32(whole);
    if part > 0.0 {
        share = max(share, part * exp(-min(from_cleft(row, first + 2u * whole, anchor), FAR_FROM_CLEFTS)));
    }
    return share;
}

// Squared distance, in widths of a cleft, beyond which a cleft does not act.
const FAR_FROM_CLEFTS: f32 = 80.0;

// Squared distance of an anchor from the cleft at this place of the tables, in widths of a cleft.
fn from_cleft(row: u32, at: u32, anchor: vec2<f32>) -> f32 {
    let aside = (anchor - vec2<f32>(tables[at], tables[at + 1u])) / rows[row].cleft_width;
    return aside.x * aside.x + aside.y * aside.y;
}

// Direction of the mean of two anchors.
fn mean_anchor(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> {
    let middle = 0.5 * (a + b);
    return middle / max(sqrt(middle.x * middle.x + middle.y * middle.y), 1e-6);
}
