// Recording: packs the state of each member into a contiguous part of the record, which is copied to a staging buffer.
//
// For each member: a header, then the fields of its inner particles (COPIED of them, and the clearance), each `extent`
// words long, then those of its outer particles, each `outer_extent` words long.

@compute @workgroup_size(THREADS)
fn record(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let member = group.y;
    let i = group.x * THREADS + thread;
    let base = member * (HEADER + RECORDED_INNER * now.extent + RECORDED_OUTER * now.outer_extent);
    if i == 0u {
        record_out[base] = states[member].inner;
        record_out[base + 1u] = states[member].outer;
        record_out[base + 2u] = states[member].next_id;
        record_out[base + 3u] = states[member].deferred;
        record_out[base + 4u] = states[member].builds;
        record_out[base + 5u] = atomicLoad(&states[member].shortened);
        record_out[base + 6u] = atomicLoad(&states[member].broken);
        record_out[base + 7u] = atomicLoad(&states[member].full_searches);
    }
    if i < min(states[member].inner, now.extent) {
        for (var field = 0u; field < COPIED; field++) {
            let from_field = select(current(field), rest_field(), field == REST);
            record_out[base + HEADER + field * now.extent + i] = particles[slot(member, from_field, i)];
        }
        record_out[base + HEADER + COPIED * now.extent + i] = particles[slot(member, CLEARANCE, i)];
    }
    if i < min(states[member].outer, now.outer_extent) {
        let first = base + HEADER + RECORDED_INNER * now.extent;
        for (var field = 0u; field < RECORDED_OUTER; field++) {
            let at = (member * WALL_FIELDS + field) * batch.outer_capacity + i;
            record_out[first + field * now.outer_extent + i] = wall[at];
        }
    }
}
