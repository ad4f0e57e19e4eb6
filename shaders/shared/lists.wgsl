// How long neighbour lists hold: twin of the constants and of `still_holds` in src/sim/cpu/neighbours.rs.

// How much further than their range lists reach, µm.
const SKIN: f32 = 24.0;
// Clearances above this many µm are not told apart.
const CLEARANCE_CAP: f32 = 12.0;

// How far every particle must see, whatever its range: the clearances that matter, and the barrier.
fn least_sight(row: u32) -> f32 {
    return max(CLEARANCE_CAP, rows[row].barrier_distance);
}

// Whether the lists built in row `built` hold in row `row` for particles that moved by at most the root of `moved`.
fn lists_hold(member: u32, row: u32, built: u32, moved: f32, skin: f32) -> bool {
    if built == NONE {
        return false;
    }
    let now_row = row_index(member, row);
    let built_row = row_index(member, built);
    let wider = max(range_max(now_row) - range_max(built_row), 0.0);
    let widest = bitcast<f32>(atomicLoad(&states[member].widest));
    let widened = max(wider * widest, least_sight(now_row) - least_sight(built_row));
    return 2.0 * sqrt(moved) + widened <= skin;
}
