// The sums of the forces of segments on the particles of a block, and the clearances: the loop over pairs of src/sim/cpu/pairs.rs.
//
// A particle has one thread for each slice: segment j is in slice j mod 8. The segments on the block's list are copied to shared memory,
// 16 of each slice at a time; each thread visits those of its slice, ascending, after those of the block itself. So sums depend
// neither on the list nor on when it was built. A block whose list is invalid, or was too long, visits all segments, with the same sums.

// Coordinate of segments that fill the rest of a slice, µm: beyond all ranges, so that they add zeros.
const DISTANT: f32 = 1e15;

// SegmentQuad segments, and the inverses of their squared lengths.
struct SegmentQuad {
    lines: array<vec4<f32>, 4>,
    inverses: vec4<f32>,
}

// Positions of the particle before the block, its own, and the one after it.
var<workgroup> chain: array<vec2<f32>, LANES + 2>;
// Segments of each slice, 16 at a time. Then `lines` hold what each thread has summed, `inverses` the local force and the sway of
// each particle.
var<workgroup> quads: array<SegmentQuad, BLOCK_THREADS / 4>;
// Whether a particle moved too far for the list of its block.
var<workgroup> astray: atomic<u32>;

// Index of the greatest 1/d of a segment: rows alternate, so that one is cleared while the other is used.
fn near_slot(member: u32, row: u32, i: u32) -> u32 {
    return (2u * member + row % 2u) * batch.capacity + i;
}

// Stores the line of a thread: a segment, or what it has summed.
fn put_line(thread: u32, line: vec4<f32>) {
    quads[thread / 4u].lines[thread % 4u] = line;
}

fn line_of(thread: u32) -> vec4<f32> {
    return quads[thread / 4u].lines[thread % 4u];
}

// The sum of the slices of a particle.
fn reduced(part: u32) -> vec2<f32> {
    let lower = line_of(part).xy + line_of(part + LANES).xy + line_of(part + 2u * LANES).xy + line_of(part + 3u * LANES).xy;
    return lower + line_of(part + 4u * LANES).xy + line_of(part + 5u * LANES).xy + line_of(part + 6u * LANES).xy
        + line_of(part + 7u * LANES).xy;
}

// The greatest 1/d of a particle.
fn nearest(part: u32) -> f32 {
    var greatest = 0.0;
    for (var s = 0u; s < SLICES; s += 2u) {
        greatest = max(greatest, max(line_of(s * LANES + part).z, line_of((s + 1u) * LANES + part).z));
    }
    return greatest;
}

// Both ends of segment j at this evaluation, of any segment if there is none of this number.
fn ends_of(member: u32, n: u32, j: u32) -> vec4<f32> {
    let begin = min(j, n - 1u);
    return vec4<f32>(source(member, begin), source(member, select(begin + 1u, 0u, begin + 1u == n)));
}

// Sums the forces of a slice on a particle; at the first evaluation also the clearance.
fn gather(member: u32, n: u32, row: u32, block: u32, thread: u32) {
    let first = block * LANES;
    if first >= n {
        return;
    }
    let slice = thread / LANES;
    let part = thread % LANES;
    let i = first + part;
    // All of these are read before any is used, so that none waits for another: the place of a link of the chain, from the particle
    // before the block to the one after it; the number of listed segments, and two of them, whether there are so many or not.
    let along = first + min(thread, LANES + 1u);
    let place = select(along - 1u, n - 1u, along == 0u);
    let link = source(member, select(place, place - n, place >= n));
    let list = list_slot(member, block, slice);
    var listed = lists[list + part];
    var upcoming = lists[list + LANES + part];
    var count = scalars[slot(member, COUNT, first + slice)];
    // Of the slice with the most segments.
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
    // While the first segments are read, those of the block.
    workgroupBarrier();
    // A lane without a particle is beyond all ranges.
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
        // Those behind the last one add zeros.
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

// Which segments of a slice a block visits: all, or those on its list.
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

// Force of the segments so far, and the greatest 1/d.
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

// Whether the clearance of the ends of a segment depends on a particle this near.
fn is_close(inverse: f32) -> bool {
    return EVALUATION == 0u && inverse > 1.0 / CLEARANCE_CAP;
}

// Notes 1/d of segment j.
fn note_near(member: u32, j: u32, inverse: f32) {
    if is_close(inverse) {
        atomicMax(&near[near_slot(member, now.row, j)], bitcast<u32>(inverse));
    }
}

// The sum with the forces of entries k to k + 3 of a slice, number `at` and following in shared memory. The arithmetic of one hides the
// latency of another.
fn with_quad(member: u32, terms: PairTerms, sum: PairSum, reader: Reader, k: u32, at: u32) -> PairSum {
    let place = (reader.slice * LANES + at) / 4u;
    let inverses = quads[place].inverses;
    let a = pair_force(terms, Segment(quads[place].lines[0], inverses.x));
    let b = pair_force(terms, Segment(quads[place].lines[1], inverses.y));
    let c = pair_force(terms, Segment(quads[place].lines[2], inverses.z));
    let d = pair_force(terms, Segment(quads[place].lines[3], inverses.w));
    // Seldom is any of them.
    if is_close(max(max(a.z, b.z), max(c.z, d.z))) {
        note_near(member, segment_number(reader, k), a.z);
        note_near(member, segment_number(reader, k + 1u), b.z);
        note_near(member, segment_number(reader, k + 2u), c.z);
        note_near(member, segment_number(reader, k + 3u), d.z);
    }
    return added(added(added(added(sum, a), b), c), d);
}

// The sum of the segments of the block and of the one before it, other than those that end at the particle.
fn own_segments(member: u32, n: u32, terms: PairTerms, first: u32, slice: u32, part: u32) -> PairSum {
    var sum = with_own(member, n, terms, PairSum(vec2<f32>(0.0), 0.0), first, slice, part);
    sum = with_own(member, n, terms, sum, first, slice + SLICES, part);
    if slice == 0u {
        sum = with_own(member, n, terms, sum, first, 2u * SLICES, part);
    }
    return sum;
}

// Segment k of these ends at particle k of the block. In a loop of one block the first and the last are the same one.
fn with_own(member: u32, n: u32, terms: PairTerms, sum: PairSum, first: u32, k: u32, part: u32) -> PairSum {
    let is_one = n <= LANES;
    if first + k > n || k == part || k == part + 1u || (is_one && (k == 0u || (k == n && part == 0u))) {
        return sum;
    }
    let force = pair_force(terms, segment_between(chain[k], chain[k + 1u]));
    note_near(member, select(first + k - 1u, n - 1u, first + k == 0u), force.z);
    return added(sum, force);
}
