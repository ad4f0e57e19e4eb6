// Validity of neighbour lists. Counterpart of `used_up` in crates/sim/src/sim/cpu/neighbours.rs.

// Distance by which lists reach beyond the range of the forces, µm.
const SKIN: f32 = 20.0;
// Part of the skin that is reserved for stages that move farther than those of the last step, µm.
const SPARE: f32 = 1.0;
// Maximum clearance, µm; larger ones are lowered to it.
const CLEARANCE_CAP: f32 = 12.0;

// Distance within which every particle must find segments whatever its range, for clearances and
// the barrier.
fn least_sight(row: u32) -> f32 {
    return max(CLEARANCE_CAP, rows[row].barrier_distance);
}

// Increase of the distance within which a particle must find segments, from row `built`, in which
// the lists were built, to row `row`, µm.
fn widened(member: u32, row: u32, built: u32) -> f32 {
    let now_row = row_index(member, row);
    let built_row = row_index(member, built);
    let wider = max(range_max(now_row) - range_max(built_row), 0.0);
    let widest = bitcast<f32>(atomicLoad(&states[member].widest));
    return max(wider * widest, least_sight(now_row) - least_sight(built_row));
}

// Slot of the displacement at an evaluation. Euler has one evaluation per step and uses two slots
// alternately.
fn moved_slot(evaluation: u32) -> u32 {
    if EULER {
        return (now.row + evaluation) % 2u;
    }
    return evaluation % 4u;
}

// Quantities that decide whether lists are valid, µm. All threads read the same values, because
// only later dispatches change them.
struct Motion {
    // Maximum displacement of a particle of the member since its lists were built.
    moved: f32,
    // Displacement up to which the list of a block is valid: it, `moved` and the growth of the
    // ranges together stay within the skin. Negative if there are no lists.
    allowed: f32,
    // Maximum distance of a stage of the last step from the start of that step.
    strayed: f32,
}

fn motion_of(member: u32) -> Motion {
    var built = states[member].built_next;
    var strayed = 0.0;
    if EVALUATION == 0u {
        built = states[member].built;
        strayed = sqrt(bitcast<f32>(atomicLoad(&states[member].strayed[(now.row + 1u) % 2u])));
    }
    let moved = sqrt(bitcast<f32>(atomicLoad(&states[member].moved[moved_slot(EVALUATION)])));
    let allowed = SKIN - 0.01 - widened(member, now.row, built) - moved;
    return Motion(select(moved, 0.0, built == NONE), select(allowed, -1.0, built == NONE), strayed);
}

// Tells whether lists must be rebuilt before this step. Its stages are assumed to move particles,
// those of the block and others, about as far as those of the last step did.
fn is_stale(motion: Motion) -> bool {
    return !(motion.allowed - motion.moved >= 2.0 * motion.strayed + SPARE);
}

// Tells whether particle i moved too far for the list of its block.
fn is_astray(member: u32, allowed: f32, i: u32) -> bool {
    let d = source(member, i) - vector(member, BUILT, i);
    return sqrt(d.x * d.x + d.y * d.y) > allowed;
}
