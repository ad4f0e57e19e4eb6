// The self-intersection force with its two ranges, the barrier, and the clearance. Counterpart of
// crates/sim/src/sim/cpu/pairs.rs.

// Minimum squared distance; smaller ones are raised to it.
const TINY: f32 = 1e-12;

// A segment: its start and the vector to its end in `line`, and the inverse of its squared length.
struct Segment {
    line: vec4<f32>,
    inverse: f32,
}

fn segment_between(a: vec2<f32>, b: vec2<f32>) -> Segment {
    let d = b - a;
    return Segment(vec4<f32>(a, d), 1.0 / (d.x * d.x + d.y * d.y + TINY));
}

// Inputs of the force on one particle, except for the segments. The range is mean + half across the
// lumen and mean - half across tissue.
struct PairTerms {
    p: vec2<f32>,
    mean: f32,
    half: f32,
    side: vec2<f32>,
    repulsion: f32,
    barrier: f32,
    barrier_reach: f32,
}

// Fills the fields that do not depend on positions.
fn pair_terms(row: u32, scale: f32) -> PairTerms {
    return PairTerms(
        vec2<f32>(0.0),
        scale * rows[row].range_mean,
        scale * rows[row].range_half,
        vec2<f32>(0.0),
        rows[row].repulsion,
        rows[row].barrier,
        rows[row].barrier * rows[row].barrier_distance,
    );
}

// Returns the force of a segment, and 1/d.
fn pair_force(t: PairTerms, segment: Segment) -> vec3<f32> {
    let d = segment.line.zw;
    let r = t.p - segment.line.xy;
    let along = clamp((r.x * d.x + r.y * d.y) * segment.inverse, 0.0, 1.0);
    let q = r - along * d;
    let square = max(q.x * q.x + q.y * q.y, TINY);
    let inverse = inverseSqrt(square);
    let distance = square * inverse;
    let range = t.mean + (t.side.x * q.x + t.side.y * q.y) * inverse;
    let inverse_range = 1.0 / range;
    let soft = t.repulsion * inverse_range * max(1.0 - distance * inverse_range, 0.0);
    let hard = max(t.barrier_reach * inverse - t.barrier, 0.0);
    return vec3<f32>((soft + hard) * inverse * q, inverse);
}
