// How long neighbour lists hold: twin of the constants and of `still_holds` in
// src/sim/cpu/neighbours.rs.

// How much further than their range lists reach, µm.
const SKIN: f32 = 24.0;
// Clearances above this many µm are not told apart.
const CLEARANCE_CAP: f32 = 12.0;

// How far every particle must see, whatever its range: the clearances that matter, and the barrier.
fn least_sight(row: u32) -> f32 {
    return max(CLEARANCE_CAP, rows[row].barrier_distance);
}

// How much further a particle must see in row `row` than in row `built`, in which lists were built, µm.
fn widened(member: u32, row: u32, built: u32) -> f32 {
    let now_row = row_index(member, row);
    let built_row = row_index(member, built);
    let wider = max(range_max(now_row) - range_max(built_row), 0.0);
    let widest = bitcast<f32>(atomicLoad(&states[member].widest));
    return max(wider * widest, least_sight(now_row) - least_sight(built_row));
}
