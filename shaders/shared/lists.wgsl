// How long neighbour lists hold: twin of the constants and of `still_holds` in src/sim/cpu/neighbours.rs.

// How much further than their range lists reach, µm.
const SKIN: f32 = 24.0;
// Clearances above this many µm are not told apart.
const CLEARANCE_CAP: f32 = 12.0;

// Whether the lists built in row `built` hold in row `row` for particles that moved by at most the root of `moved`.
fn lists_hold(member: u32, row: u32, built: u32, moved: f32, skin: f32) -> bool {
    if built == NONE {
        return false;
    }
    let wider = max(range_max(row_index(member, row)) - range_max(row_index(member, built)), 0.0);
    let widened = wider * bitcast<f32>(atomicLoad(&states[member].widest));
    return 2.0 * sqrt(moved) + widened <= skin;
}
