// Sums the forces of segments on the particles of a block, and finds their clearances. Counterpart
// of the loop over pairs in crates/sim/src/sim/cpu/pairs.rs.
//
// A particle has one thread per slice; segment j is in slice j mod 8. The segments on the list of
// the block are copied to shared memory, 16 of each slice at a time. Each thread first visits the
// segments of the block itself, then those of its slice, in ascending order. The sums therefore
// depend neither on the list nor on the step in which it was built. A block whose list is invalid
// or was too long visits all segments, with the same sums.

// Coordinate of the segments that pad a slice, µm. They lie beyond all ranges, so they add zeros.
const DISTANT: f32 = 1e15;

// Four segments, and the inverses of their squared lengths.
struct SegmentQuad {
    lines: array<vec4<f32>, 4>,
    inverses: vec4<f32>,
}

// Positions of the particle before the block, of the block, and of the particle after it.
var<workgroup> chain: array<vec2<f32>, LANES + 2>;
// Segments of each slice, 16 at a time. Later, `lines` hold the sums of each thread, `inverses` the
// local force and the sway of each particle.
var<workgroup> quads: array<SegmentQuad, BLOCK_THREADS / 4>;
// 1 if a particle of the block moved too far for its list.
var<workgroup> astray: atomic<u32>;

// Index of the maximum 1/d of a segment. Even and odd rows have separate entries, so that one is
// cleared while the other is used.
fn near_slot(member: u32, row: u32, i: u32) -> u32 {
    return (2u * member + row % 2u) * batch.capacity + i;
}

// Stores the line of a thread: a segment, or its sums.
fn put_line(thread: u32, line: vec4<f32>) {
    quads[thread / 4u].lines[thread % 4u] = line;
}

fn line_of(thread: u32) -> vec4<f32> {
    return quads[thread / 4u].lines[thread % 4u];
}

// Force on a particle: the sum over its slices.
fn reduced(part: u32) -> vec2<f32> {
    let lower = line_of(part).xy + line_of(part + LANES).xy + line_of(part + 2u * LANES).xy + line_of(part + 3u * LANES).xy;
    return lower + line_of(part + 4u * LANES).xy + line_of(part + 5u * LANES).xy + line_of(part + 6u * LANES).xy
        + line_of(part + 7u * LANES).xy;
}

// Maximum 1/d of a particle over its slices.
fn nearest(part: u32) -> f32 {
    var greatest = 0.0;
    for (var s = 0u; s < SLICES; s += 2u) {
        greatest = max(greatest, max(line_of(s * LANES + part).z, line_of((s + 1u) * LANES + part).z));
    }
    return greatest;
}

// Both ends of segment j at this evaluation; of the last segment if there is no segment j.
fn ends_of(member: u32, n: u32, j: u32) -> vec4<f32> {
    let begin = min(j, n - 1u);
    return vec4<f32>(source(member, begin), source(member, select(begin + 1u, 0u, begin + 1u == n)));
}

// Sums the forces of a slice on a particle. The first evaluation also finds the clearance.
fn gather(member: u32, n: u32, row: u32, block: u32, thread: u32) {
    let first = block * LANES;
    if first >= n {
        return;
    }
    let slice = thread / LANES;
    let part = thread % LANES;
    let i = first + part;
    // All of the following are read before any is used, so that no read waits for another. Two
    // listed segments are read whether the list has so many or not.
    let along = first + min(thread, LANES + 1u);
    let place = select(along - 1u, n - 1u, along == 0u);
    let link = source(member, select(place, place - n, place >= n));
    let list = list_slot(member, block, slice);
    var listed = lists[list + part];
    var upcoming = lists[list + LANES + part];
    var count = scalars[slot(member, COUNT, first + slice)];
    // Segments of the slice that has the most.
    var most = scalars[slot(member, COUNT, first + SLICES)];
    var terms = pair_terms(row, load(member, current(SCALE), min(i, n - 1u)));
    let motion = motion_of(member);
    if thread == 0u {
        clear_summary();
        atomicStore(&astray, 0u);
    }
    if EVALUATION == 0u && is_stale(motion) {
        build_lists(member, n, block, thread);
        if thread == 0u && block == 0u {
            states[member].built_next = now.row;
            states[member].builds += 1u;
        }
        listed = lists[list + part];
        upcoming = lists[list + LANES + part];
        count = scalars[slot(member, COUNT, first + slice)];
        most = scalars[slot(member, COUNT, first + SLICES)];
    }
    var all = most > LIST;
    if EVALUATION != 0u && motion.moved > motion.allowed {
        workgroupBarrier();
        if thread < LANES && i < n && is_astray(member, motion.allowed, i) {
            atomicStore(&astray, 1u);
        }
        workgroupBarrier();
        all |= atomicLoad(&astray) != 0u;
    }
    if all {
        most = (n + SLICES - 1u) / SLICES;
        count = (n + SLICES - 1u - slice) / SLICES;
    }
    let reader = Reader(all, slice, list);
    var j = select(listed, slice + part * SLICES, all);
    var ends = ends_of(member, n, j);
    if thread < LANES + 2u {
        chain[thread] = link;
    }
    // The segments of the block are summed while the first listed segments are read.
    workgroupBarrier();
    // A lane without a particle is placed beyond all ranges.
    terms.p = select(vec2<f32>(-DISTANT), chain[part + 1u], i < n);
    terms.side = -terms.half * normal_of(chain[part], chain[part + 2u]);
    var sum = own_segments(member, n, terms, first, slice, part);
    for (var begin = 0u; begin < most; begin += LANES) {
        var segment = Segment(vec4<f32>(DISTANT, DISTANT, 0.0, 0.0), 0.0);
        if begin + part < count && !(all && is_own(n, first, j)) {
            segment = segment_between(ends.xy, ends.zw);
        }
        put_line(thread, segment.line);
        quads[thread / 4u].inverses[thread % 4u] = segment.inverse;
        workgroupBarrier();
        if begin + LANES < most {
            j = select(upcoming, (begin + LANES + part) * SLICES + slice, all);
            ends = ends_of(member, n, j);
            upcoming = lists[list + min(begin + 2u * LANES, LIST - LANES) + part];
        }
        // Entries beyond the last segment add zeros.
        if begin < count {
            sum = with_quad(member, terms, sum, reader, begin, 0u);
        }
        if begin + 4u < count {
            sum = with_quad(member, terms, sum, reader, begin + 4u, 4u);
        }
        if begin + 8u < count {
            sum = with_quad(member, terms, sum, reader, begin + 8u, 8u);
        }
        if begin + 12u < count {
            sum = with_quad(member, terms, sum, reader, begin + 12u, 12u);
        }
        workgroupBarrier();
    }
    put_line(thread, vec4<f32>(sum.force, sum.greatest, 0.0));
    if all && thread == 0u {
        atomicAdd(&states[member].full_searches, 1u);
    }
}

// The segments of a slice that a block visits: all, or those on its list.
struct Reader {
    all: bool,
    slice: u32,
    list: u32,
}

fn segment_number(reader: Reader, k: u32) -> u32 {
    if reader.all {
        return k * SLICES + reader.slice;
    }
    return lists[reader.list + k];
}

// Sum of the forces so far, and the maximum 1/d.
struct PairSum {
    force: vec2<f32>,
    greatest: f32,
}

fn added(sum: PairSum, force: vec3<f32>) -> PairSum {
    if EVALUATION != 0u {
        return PairSum(sum.force + force.xy, 0.0);
    }
    return PairSum(sum.force + force.xy, max(sum.greatest, force.z));
}

// Tells whether a particle at distance 1/inverse can decide the clearance of a segment.
fn is_close(inverse: f32) -> bool {
    return EVALUATION == 0u && inverse > 1.0 / CLEARANCE_CAP;
}

// Records 1/d of segment j for the clearance of its ends.
fn note_near(member: u32, j: u32, inverse: f32) {
    if is_close(inverse) {
        atomicMax(&near[near_slot(member, now.row, j)], bitcast<u32>(inverse));
    }
}

// Adds the forces of the segments k to k + 3 of a slice, which are `at` and following in shared
// memory. Four at a time, the arithmetic of one segment hides the latency of another.
fn with_quad(member: u32, terms: PairTerms, sum: PairSum, reader: Reader, k: u32, at: u32) -> PairSum {
    let place = (reader.slice * LANES + at) / 4u;
    let inverses = quads[place].inverses;
    let a = pair_force(terms, Segment(quads[place].lines[0], inverses.x));
    let b = pair_force(terms, Segment(quads[place].lines[1], inverses.y));
    let c = pair_force(terms, Segment(quads[place].lines[2], inverses.z));
    let d = pair_force(terms, Segment(quads[place].lines[3], inverses.w));
    // Rarely true, so one test covers four segments.
    if is_close(max(max(a.z, b.z), max(c.z, d.z))) {
        note_near(member, segment_number(reader, k), a.z);
        note_near(member, segment_number(reader, k + 1u), b.z);
        note_near(member, segment_number(reader, k + 2u), c.z);
        note_near(member, segment_number(reader, k + 3u), d.z);
    }
    return added(added(added(added(sum, a), b), c), d);
}

// Sums the segments of the block and the one before it, except those that end at the particle.
fn own_segments(member: u32, n: u32, terms: PairTerms, first: u32, slice: u32, part: u32) -> PairSum {
    var sum = with_own(member, n, terms, PairSum(vec2<f32>(0.0), 0.0), first, slice, part);
    sum = with_own(member, n, terms, sum, first, slice + SLICES, part);
    if slice == 0u {
        sum = with_own(member, n, terms, sum, first, 2u * SLICES, part);
    }
    return sum;
}

// Adds segment k of these, which ends at particle k of the block. In a loop of one block the first
// and the last segment are the same.
fn with_own(member: u32, n: u32, terms: PairTerms, sum: PairSum, first: u32, k: u32, part: u32) -> PairSum {
    let is_one = n <= LANES;
    if first + k > n || k == part || k == part + 1u || (is_one && (k == 0u || (k == n && part == 0u))) {
        return sum;
    }
    let force = pair_force(terms, segment_between(chain[k], chain[k + 1u]));
    note_near(member, select(first + k - 1u, n - 1u, first + k == 0u), force.z);
    return added(sum, force);
}
