// Forces on a particle from its neighbours in the loop and from the containment region. Counterpart
// of crates/sim/src/sim/cpu/local.rs, and of the normals in crates/sim/src/sim/cpu/chain.rs.

// Normal, toward the lumen, of the particle between `before` and `after`.
fn normal_of(before: vec2<f32>, after: vec2<f32>) -> vec2<f32> {
    let t = after - before;
    return vec2<f32>(-t.y, t.x) * inverseSqrt(t.x * t.x + t.y * t.y + 1e-12);
}

// Spring force of the edge from a to b on a.
fn tension(row: u32, a: vec2<f32>, b: vec2<f32>, va: vec2<f32>, vb: vec2<f32>, rest: f32) -> vec2<f32> {
    let d = b - a;
    let length = sqrt(d.x * d.x + d.y * d.y + 1e-12);
    let u = d / length;
    let v = vb - va;
    let closing = v.x * u.x + v.y * u.y;
    return (rows[row].stiffness * (length - rest) + rows[row].damping * closing) * u;
}

// Sum of the local forces on the particle at p between `before` and `after`. `pull` is the spring
// force of its two edges.
fn local_force(
    member: u32,
    row: u32,
    modifier: f32,
    before: vec2<f32>,
    p: vec2<f32>,
    after: vec2<f32>,
    v: vec2<f32>,
    normal: vec2<f32>,
    pull: vec2<f32>,
    direction: vec2<f32>,
    sign: f32,
    cleft: f32,
) -> vec2<f32> {
    // Read early, so that these reads do not wait for that of the region's shape.
    let squash = rows[row].squash;
    let r_in = rows[row].r_in;
    let containment = rows[row].containment;
    let ramp = rows[row].ramp;
    let regulatory = rows[row].regulatory + rows[row].hold * cleft;
    let softening = rows[row].softening;
    let friction = rows[row].friction;
    let second = before - 2.0 * p + after;
    let bend = rows[row].bending * (second.x * normal.x + second.y * normal.y);
    let lean = sign * modifier;
    let radius = sqrt(p.x * p.x + p.y * p.y + 1e-6);
    let flat_y = p.y / squash;
    var gauge = sqrt(p.x * p.x + flat_y * flat_y);
    var r_anchor = r_in;
    if is_shaped(member) {
        gauge = region_gauge(member, row, rows[row].fold, vec2<f32>(p.x, flat_y));
        r_anchor *= region_boundary(member, row, rows[row].fold, direction);
    }
    let inward = containment * clamp((gauge - r_in) / ramp, 0.0, 1.0) / radius;
    let anchor = r_anchor * vec2<f32>(direction.x, squash * direction.y) - p;
    let far = sqrt(anchor.x * anchor.x + anchor.y * anchor.y);
    let tether = regulatory / max(far, softening);
    let ray = vec2<f32>(direction.x, squash * direction.y);
    let along = max(p.x * ray.x + p.y * ray.y, 0.0) / (ray.x * ray.x + ray.y * ray.y);
    let aside = along * ray - p;
    let guide = rows[row].guide / max(sqrt(aside.x * aside.x + aside.y * aside.y), rows[row].reach);
    var force = pull - friction * v + bend * normal - inward * p + tether * anchor + guide * aside;
    if lean != 0.0 {
        let a = before - p;
        let b = after - p;
        let lengths = sqrt(a.x * a.x + a.y * a.y) * sqrt(b.x * b.x + b.y * b.y);
        let cosine = (a.x * b.x + a.y * b.y) / max(lengths, 1e-12);
        let straightness = acos(clamp(cosine, -1.0, 1.0)) * 0.31830988618;
        force += lean * straightness * normal;
    }
    return force;
}
