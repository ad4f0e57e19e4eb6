// How long neighbour lists are valid: counterpart of the constants and of `still_holds` in
// src/sim/cpu/neighbours.rs.

// Distance by which lists reach beyond the range, µm.
const SKIN: f32 = 20.0;
// Larger clearances count as this one, µm.
const CLEARANCE_CAP: f32 = 12.0;

// Distance within which every particle must find segments, whatever its range: for clearances and the barrier.
fn least_sight(row: u32) -> f32 {
    return max(CLEARANCE_CAP, rows[row].barrier_distance);
}

// Increase of the distance within which a particle must find segments from row `built`, in which lists were built, to row
// `row`, µm.
fn widened(member: u32, row: u32, built: u32) -> f32 {
    let now_row = row_index(member, row);
    let built_row = row_index(member, built);
    let wider = max(range_max(now_row) - range_max(built_row), 0.0);
    let widest = bitcast<f32>(atomicLoad(&states[member].widest));
    return max(wider * widest, least_sight(now_row) - least_sight(built_row));
}
