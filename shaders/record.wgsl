// Recording: packs the state of each member into a contiguous part of the record, which the host
// copies to a staging buffer.
//
// The part of a member has a header, then the fields of its inner particles (id, x, y, velocity,
// rest length, anchor, sign, scale, cleft, clearance), each `extent` words long, then the fields of
// its outer particles, each `outer_extent` words long.

fn keep_vector(at: u32, value: vec2<f32>) {
    record_out[at] = bitcast<u32>(value.x);
    record_out[at + now.extent] = bitcast<u32>(value.y);
}

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
        let at = base + HEADER + i;
        record_out[at] = scalars[slot(member, current(ID), i)];
        keep_vector(at + now.extent, position(member, i));
        keep_vector(at + 3u * now.extent, vector(member, current_vector(VELOCITY), i));
        record_out[at + 5u * now.extent] = scalars[slot(member, rest_field(), i)];
        keep_vector(at + 6u * now.extent, vector(member, current_vector(ANCHOR), i));
        record_out[at + 8u * now.extent] = scalars[slot(member, current(SIGN), i)];
        record_out[at + 9u * now.extent] = scalars[slot(member, current(SCALE), i)];
        record_out[at + 10u * now.extent] = scalars[slot(member, current(CLEFT), i)];
        record_out[at + 11u * now.extent] = scalars[slot(member, CLEARANCE, i)];
    }
    if i < min(states[member].outer, now.outer_extent) {
        let first = base + HEADER + RECORDED_INNER * now.extent;
        for (var field = 0u; field < RECORDED_OUTER; field++) {
            let at = (member * WALL_FIELDS + field) * batch.outer_capacity + i;
            record_out[first + field * now.outer_extent + i] = wall[at];
        }
    }
}
