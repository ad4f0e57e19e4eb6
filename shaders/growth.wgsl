// Growth: splits edges at their midpoint and gives both halves half of the rest length. Counterpart
// of crates/sim/src/sim/cpu/growth.rs.
//
// `growth` runs the tournaments, one per run of edges, counts the winners before each run, and
// grows the outer loop. `split` then copies every particle to its new index in the other copy,
// followed by the new particle if its edge is split, and evaluates the thickness field. New indices
// follow from the counts, without atomics, so they do not depend on the order of threads.

// A split is deferred if the clearance is below this multiple of the guard's clearance.
const ROOM: f32 = 40.0;
// Growth weight of an edge that grows at the mean rate, and the maximum weight.
const WEIGHT: f32 = 16.0;
const HEAVIEST: f32 = 255.0;
// Particles on either side over which the curvature of a fold tip is measured.
const SPAN: u32 = 3u;

// Prefix sums over the threads, see count_up.
var<workgroup> winners: array<u32, LOOP_THREADS>;
// Length and index of the longest edge that each thread has found in its run of the outer loop.
var<workgroup> longest: array<f32, LOOP_THREADS>;
var<workgroup> longest_edge: array<u32, LOOP_THREADS>;

fn point(member: u32, n: u32, i: u32) -> vec2<f32> {
    return position(member, i % n);
}

fn has_room(member: u32, n: u32, edge: u32) -> bool {
    let least = ROOM * members[member].clearance;
    let next = (edge + 1u) % n;
    let free = load(member, CLEARANCE, edge) >= least && load(member, CLEARANCE, next) >= least;
    return free && length(point(member, n, next) - point(member, n, edge)) >= least;
}

// Score of an edge in a tournament: its length over `edge`, plus the weighted sharpness of
// the fold tip. The loop turns right around the tip of a fold.
fn score(member: u32, n: u32, row: u32, edge: u32) -> f32 {
    let a = point(member, n, edge);
    let b = point(member, n, edge + 1u);
    let t0 = a - point(member, n, edge + n - SPAN);
    let t1 = point(member, n, edge + 1u + SPAN) - b;
    let lengths = max(length(t0) * length(t1), 1e-12);
    let turn = (t0.x * t1.y - t0.y * t1.x) / lengths;
    let along = (t0.x * t1.x + t0.y * t1.y) / lengths;
    let tip = select(0.0, 1.0 - along, turn < 0.0);
    return length(b - a) / rows[row].edge + rows[row].tip_weight * tip;
}

// Returns the edge of a run that wins its tournament, or NONE if no candidate has room.
fn tournament(member: u32, n: u32, row: u32, total: u32, runs: u32, run: u32) -> u32 {
    let first = first_of(member, n, row, share(total, runs, run));
    let end = select(n, first_of(member, n, row, share(total, runs, run + 1u)), run + 1u < runs);
    if first == end {
        return NONE;
    }
    let seed = vec2<u32>(members[member].seed_low, members[member].seed_high);
    var best = NONE;
    var best_score = 0.0;
    for (var c = 0u; c < members[member].candidates; c++) {
        let word = random_words(seed, STREAM_GROWTH, now.event, run * members[member].candidates + c).x;
        let edge = first + random_below(word, end - first);
        let s = score(member, n, row, edge);
        if has_room(member, n, edge) && (best == NONE || s > best_score) {
            best = edge;
            best_score = s;
        }
    }
    return best;
}

// run * total / runs, rounded down; the product itself may overflow.
fn share(total: u32, runs: u32, run: u32) -> u32 {
    return run * (total / runs) + run * (total % runs) / runs;
}

// Tells whether edges have different weights.
fn has_weights(row: u32) -> bool {
    return varies(row) || rows[row].room != 0.0 || rows[row].spare != 0.0;
}

// Weight of an edge in growth.
fn growth_weight(member: u32, n: u32, row: u32, i: u32) -> u32 {
    let around = growth_rate(member, row, vector(member, current_vector(ANCHOR), i));
    let excess = length(point(member, n, i + 1u) - point(member, n, i)) / rows[row].edge - 1.0;
    let rate = exp(around + rows[row].room * excess) * (1.0 - rows[row].spare * load(member, current(CLEFT), i));
    return u32(clamp(WEIGHT * rate + 0.5, 1.0, HEAVIEST));
}

// Sum of the weights of the edges before edge i.
fn lighter(member: u32, row: u32, i: u32) -> u32 {
    if has_weights(row) {
        return scalars[slot(member, LIGHTER, i)];
    }
    return i;
}

// Returns the first edge whose preceding edges have at least this weight together, or n.
fn first_of(member: u32, n: u32, row: u32, weight: u32) -> u32 {
    if !has_weights(row) {
        return weight;
    }
    var low = 0u;
    var high = n;
    while low < high {
        let middle = (low + high) / 2u;
        if lighter(member, row, middle) < weight {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

// Stores the weight before each edge; returns the total weight.
fn weigh(member: u32, n: u32, row: u32, thread: u32) -> u32 {
    let stretch = (n + LOOP_THREADS - 1u) / LOOP_THREADS;
    let first = min(thread * stretch, n);
    let end = select(first, min(first + stretch, n), has_weights(row));
    var own = 0u;
    for (var i = first; i < end; i++) {
        own += growth_weight(member, n, row, i);
    }
    let up_to_here = count_up(thread, own);
    var before = up_to_here - own;
    for (var i = first; i < end; i++) {
        scalars[slot(member, LIGHTER, i)] = before;
        before += growth_weight(member, n, row, i);
    }
    storageBarrier();
    workgroupBarrier();
    return select(n, winners[LOOP_THREADS - 1u], has_weights(row));
}

@compute @workgroup_size(LOOP_THREADS)
fn growth(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let member = group.x;
    let on = runs_on(member);
    let n = states[member].inner;
    let row = row_index(member, now.row);
    let target_count = rows[row].inner_target;
    let runs = select(0u, min(target_count - n, n), target_count > n && on);

    let total = weigh(member, n, row, thread);
    workgroupBarrier();
    // Each thread has consecutive runs, so that winners can be counted in order.
    let stretch = (runs + LOOP_THREADS - 1u) / LOOP_THREADS;
    let first = min(thread * stretch, runs);
    let end = min(first + stretch, runs);
    var won = 0u;
    for (var run = first; run < end; run++) {
        let winner = tournament(member, n, row, total, runs, run);
        scalars[slot(member, WINNER, run)] = winner;
        won += u32(winner != NONE);
    }
    let up_to_here = count_up(thread, won);
    var before = up_to_here - won;
    for (var run = first; run < end; run++) {
        scalars[slot(member, BEFORE, run)] = before;
        before += u32(scalars[slot(member, WINNER, run)] != NONE);
    }

    let outer = states[member].outer;
    let outer_target = rows[row].outer_target;
    let outer_runs = select(0u, min(outer_target - outer, outer), outer_target > outer && on);
    if outer_runs > 0u {
        for (var i = thread; i < outer; i += LOOP_THREADS) {
            for (var field = 0u; field < 5u; field++) {
                wall[wall_slot(member, WALL_OLD + field, i)] = wall[wall_slot(member, field, i)];
            }
        }
    }
    find_longest(member, outer, outer_runs, thread);
    storageBarrier();
    for (var i = thread; i < select(0u, outer, outer_runs > 0u); i += LOOP_THREADS) {
        split_wall(member, outer, outer_runs, i);
    }
    storageBarrier();
    if thread == LOOP_THREADS - 1u && on {
        let all = up_to_here;
        states[member].grown_from = n;
        states[member].runs = runs;
        states[member].weight = total;
        states[member].first_id = states[member].next_id;
        states[member].next_id += all;
        states[member].inner = n + all;
        states[member].outer = outer + outer_runs;
        states[member].deferred += runs - all;
        states[member].built = NONE;
        states[member].built_next = NONE;
        atomicStore(&states[member].widest, bitcast<u32>(1.0));
    }
}

fn wall_slot(member: u32, field: u32, i: u32) -> u32 {
    return (member * WALL_FIELDS + field) * batch.outer_capacity + i;
}

fn old_wall(member: u32, field: u32, i: u32) -> f32 {
    return bitcast<f32>(wall[wall_slot(member, WALL_OLD + field, i)]);
}

// Length of edge i of the outer loop before growth.
fn wall_edge(member: u32, n: u32, i: u32) -> f32 {
    let j = (i + 1u) % n;
    let x = bitcast<f32>(wall[wall_slot(member, WALL_X, j)]) - bitcast<f32>(wall[wall_slot(member, WALL_X, i)]);
    let y = bitcast<f32>(wall[wall_slot(member, WALL_Y, j)]) - bitcast<f32>(wall[wall_slot(member, WALL_Y, i)]);
    return sqrt(x * x + y * y);
}

// Inclusive prefix sum of `won` over the threads.
fn count_up(thread: u32, won: u32) -> u32 {
    var sum = won;
    winners[thread] = sum;
    for (var step = 1u; step < LOOP_THREADS; step *= 2u) {
        workgroupBarrier();
        if thread >= step {
            sum += winners[thread - step];
        }
        workgroupBarrier();
        winners[thread] = sum;
    }
    return sum;
}

// Returns the run, of `runs`, that contains `i` of `total`. The bounds are those of `share`.
fn run_of(total: u32, runs: u32, i: u32) -> u32 {
    var low = 0u;
    var high = runs - 1u;
    while low < high {
        let middle = (low + high + 1u) / 2u;
        if share(total, runs, middle) <= i {
            low = middle;
        } else {
            high = middle - 1u;
        }
    }
    return low;
}

// Finds the longest edge of each run of the outer loop, the first one of equals. Stores it in the
// field of the wall's pulls, which every step overwrites before it reads them.
fn find_longest(member: u32, n: u32, runs: u32, thread: u32) {
    // Several threads search one run; if there are more runs than threads, one thread searches
    // several.
    let share = max(LOOP_THREADS / max(runs, 1u), 1u);
    let lane = thread % share;
    var edge = NONE;
    for (var run = thread / share; run < runs; run += LOOP_THREADS / share) {
        let first = run * n / runs;
        let end = (run + 1u) * n / runs;
        edge = first;
        var most = wall_edge(member, n, first);
        for (var i = first + lane; i < end; i += share) {
            let here = wall_edge(member, n, i);
            if here > most {
                edge = i;
                most = here;
            }
        }
        longest[thread] = most;
        longest_edge[thread] = edge;
        if share == 1u {
            wall[wall_slot(member, WALL_PULL_X, run)] = edge;
        }
    }
    // Tree reduction over the threads of each run.
    for (var step = 1u; step < LOOP_THREADS; step *= 2u) {
        workgroupBarrier();
        if edge != NONE && lane % (2u * step) == 0u && lane + step < share {
            let other = longest[thread + step];
            let other_edge = longest_edge[thread + step];
            if other > longest[thread] || (other == longest[thread] && other_edge < longest_edge[thread]) {
                longest[thread] = other;
                longest_edge[thread] = other_edge;
            }
        }
    }
    if edge != NONE && share > 1u && lane == 0u {
        wall[wall_slot(member, WALL_PULL_X, thread / share)] = longest_edge[thread];
    }
}

// Copies particle i of the outer loop to its new index, followed by the new particle if its edge is
// split.
fn split_wall(member: u32, n: u32, runs: u32, i: u32) {
    let run = run_of(n, runs, i);
    let edge = wall[wall_slot(member, WALL_PULL_X, run)];
    let to = i + run + u32(i > edge);
    for (var field = 0u; field < 5u; field++) {
        wall[wall_slot(member, field, to)] = wall[wall_slot(member, WALL_OLD + field, i)];
    }
    if i == edge {
        // New ids count down from the last run, as on the CPU.
        wall[wall_slot(member, WALL_ID, to + 1u)] = n + runs - 1u - run;
        for (var field = 1u; field < 5u; field++) {
            let middle = 0.5 * (old_wall(member, field, i) + old_wall(member, field, (i + 1u) % n));
            wall[wall_slot(member, field, to + 1u)] = bitcast<u32>(middle);
        }
    }
}

@compute @workgroup_size(THREADS)
fn split(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let member = group.y;
    let i = group.x * THREADS + thread;
    let n = states[member].grown_from;
    if i >= n || !runs_on(member) {
        return;
    }
    let row = row_index(member, now.row);
    let runs = states[member].runs;
    var before = 0u;
    var winner = NONE;
    if runs > 0u {
        let run = run_of(states[member].weight, runs, lighter(member, row, i));
        winner = scalars[slot(member, WINNER, run)];
        before = scalars[slot(member, BEFORE, run)] + u32(winner != NONE && winner < i);
    }
    let splits = winner == i;
    let to = i + before;
    let other = (1u - now.copy) * COPIED_SCALARS;
    let other_vector = (1u - now.copy) * COPIED_VECTORS;
    let rest = load(member, rest_field(), i) * select(1.0, 0.5, splits);
    scalars[slot(member, other + ID, to)] = scalars[slot(member, current(ID), i)];
    scalars[slot(member, other + SIGN, to)] = scalars[slot(member, current(SIGN), i)];
    for (var field = 0u; field < COPIED_VECTORS; field++) {
        set_vector(member, other_vector + field, to, vector(member, current_vector(field), i));
    }
    store(member, next_rest_field(), to, rest);
    let here = position(member, i);
    let own_anchor = vector(member, current_vector(ANCHOR), i);
    let scale = scale_of(member, row, here, own_anchor);
    store(member, other + SCALE, to, scale);
    store(member, other + CLEFT, to, cleft_of(member, row, own_anchor));
    var widest = scale;
    if splits {
        let j = (i + 1u) % n;
        let id = states[member].first_id + before;
        let p = 0.5 * (here + position(member, j));
        let v = 0.5 * (vector(member, current_vector(VELOCITY), i) + vector(member, current_vector(VELOCITY), j));
        scalars[slot(member, other + ID, to + 1u)] = id;
        set_vector(member, other_vector + POSITION, to + 1u, p);
        set_vector(member, other_vector + VELOCITY, to + 1u, v);
        store(member, next_rest_field(), to + 1u, rest);
        var anchor = nearest_on_ellipse(p, rows[row].r_in, rows[row].squash);
        if members[member].clefts > 0u {
            anchor = mean_anchor(own_anchor, vector(member, current_vector(ANCHOR), j));
        } else if is_shaped(member) {
            anchor = region_nearest(member, row, p);
        }
        set_vector(member, other_vector + ANCHOR, to + 1u, anchor);
        store(member, other + SIGN, to + 1u, contortion_sign(member, id));
        let new_scale = scale_of(member, row, p, anchor);
        store(member, other + SCALE, to + 1u, new_scale);
        store(member, other + CLEFT, to + 1u, cleft_of(member, row, anchor));
        widest = max(widest, new_scale);
    }
    atomicMax(&states[member].widest, bitcast<u32>(widest));
}

// Contortion sign of the particle with this id: -1, 1, or 0 for most particles.
fn contortion_sign(member: u32, id: u32) -> f32 {
    let seed = vec2<u32>(members[member].seed_low, members[member].seed_high);
    let w = random_words(seed, STREAM_CONTORTION, id, 0u);
    let contorted = random_unit(w.x) < members[member].contorted;
    return select(0.0, select(1.0, -1.0, (w.y & 1u) == 0u), contorted);
}
