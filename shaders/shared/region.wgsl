// The region that contains the folds, for outlines other than the ellipse. Counterpart of
// crates/sim/src/sim/region.rs.

// Directions in the table of a gauge, and in a quadrant of it.
const DIRECTIONS: u32 = 256u;
const QUADRANT: u32 = 64u;

fn is_shaped(member: u32) -> bool {
    return members[member].directions != 0u;
}

// Gauge in direction i, with transverse folds of this depth.
fn spoke_gauge(member: u32, row: u32, depth: f32, i: u32) -> f32 {
    // Table, per direction: gauge of the ellipse, difference to the outline, height and phase of a
    // fold.
    let at = member * batch.tables + batch.outline + 4u * (i % DIRECTIONS);
    let wave = 0.5 + 0.5 * cos_turns(tables[at + 3u] + rows[row].fold_phase);
    let pulse = wave * wave * (wave * wave);
    let raised = depth / (1.0 - depth);
    return (tables[at] + rows[row].outline * tables[at + 1u]) * (1.0 + raised * tables[at + 2u] * pulse);
}

// Point of the diamond |x| + |y| = 1 in direction i.
fn spoke_direction(i: u32) -> vec2<f32> {
    let along = f32(i % QUADRANT) / f32(QUADRANT);
    switch (i / QUADRANT) % 4u {
        case 0u: { return vec2<f32>(1.0 - along, along); }
        case 1u: { return vec2<f32>(-along, 1.0 - along); }
        case 2u: { return vec2<f32>(along - 1.0, -along); }
        default: { return vec2<f32>(along, along - 1.0); }
    }
}

// Place of p on the diamond: index of the direction at or before it, plus the fraction of the way
// to the next direction.
fn spoke_place(p: vec2<f32>) -> f32 {
    let part = abs(p.y) / max(abs(p.x) + abs(p.y), 1e-12);
    let upper = select(part, 2.0 - part, p.x < 0.0);
    let lower = select(4.0 - part, 2.0 + part, p.x < 0.0);
    return f32(QUADRANT) * select(upper, lower, p.y < 0.0);
}

// Gauge of a point of the flattened plane.
fn region_gauge(member: u32, row: u32, depth: f32, p: vec2<f32>) -> f32 {
    let place = spoke_place(p);
    let i = min(u32(place), DIRECTIONS - 1u);
    let part = place - f32(i);
    let a = spoke_gauge(member, row, depth, i);
    let b = spoke_gauge(member, row, depth, i + 1u);
    return (abs(p.x) + abs(p.y)) * (a + part * (b - a));
}

// Distance from the axis to the boundary in a direction of the flattened plane, in units of R_in.
fn region_boundary(member: u32, row: u32, depth: f32, unit: vec2<f32>) -> f32 {
    return 1.0 / max(region_gauge(member, row, depth, unit), 1e-6);
}

fn spoke_cross(a: vec2<f32>, b: vec2<f32>) -> f32 {
    return a.x * b.y - a.y * b.x;
}

// Depth of the transverse folds that the wall follows.
fn wall_depth(row: u32) -> f32 {
    return rows[row].fold * rows[row].fold_of_wall;
}

// Minimum and maximum gauge on the segment from p to q. They lie at its ends or where it crosses a
// tabulated direction.
fn region_extent(member: u32, row: u32, depth: f32, p: vec2<f32>, q: vec2<f32>) -> vec2<f32> {
    let ends = vec2<f32>(region_gauge(member, row, depth, p), region_gauge(member, row, depth, q));
    var least = min(ends.x, ends.y);
    var most = max(ends.x, ends.y);
    let turned = spoke_cross(p, q) < 0.0;
    let a = select(p, q, turned);
    let b = select(q, p, turned);
    let first = u32(spoke_place(a)) + 1u;
    let crossed = (u32(spoke_place(b)) + 1u + DIRECTIONS - first) % DIRECTIONS;
    for (var i = first; i < first + crossed; i++) {
        let d = spoke_direction(i % DIRECTIONS);
        let before = spoke_cross(a, d);
        let after = spoke_cross(d, b);
        if before >= 0.0 && after >= 0.0 && before + after > 0.0 {
            let at = a + (before / (before + after)) * (b - a);
            let gauge = (abs(at.x) + abs(at.y)) * spoke_gauge(member, row, depth, i);
            least = min(least, gauge);
            most = max(most, gauge);
        }
    }
    return vec2<f32>(least, most);
}

// Corner i of the boundary, a polygon.
fn region_corner(member: u32, row: u32, i: u32) -> vec2<f32> {
    let scale = rows[row].r_in / spoke_gauge(member, row, rows[row].fold, i);
    return scale * vec2<f32>(1.0, rows[row].squash) * spoke_direction(i % DIRECTIONS);
}

// Direction, in the flattened plane, of the boundary point nearest to p.
fn region_nearest(member: u32, row: u32, p: vec2<f32>) -> vec2<f32> {
    var best = 3e38;
    var at = vec2<f32>(rows[row].r_in, 0.0);
    var a = region_corner(member, row, 0u);
    for (var i = 1u; i <= DIRECTIONS; i++) {
        let b = region_corner(member, row, i);
        let edge = b - a;
        let along = (p.x - a.x) * edge.x + (p.y - a.y) * edge.y;
        let t = clamp(along / max(edge.x * edge.x + edge.y * edge.y, 1e-12), 0.0, 1.0);
        let q = a + t * edge;
        let distance = (p.x - q.x) * (p.x - q.x) + (p.y - q.y) * (p.y - q.y);
        if distance < best {
            best = distance;
            at = q;
        }
        a = b;
    }
    let flat = vec2<f32>(at.x, at.y / rows[row].squash);
    return flat / max(sqrt(flat.x * flat.x + flat.y * flat.y), 1e-6);
}
