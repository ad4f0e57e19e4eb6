// Small functions, counterparts of crates/sim/src/sim/maths.rs. min and max are built in.

// Nearest integer. The CPU adds and subtracts 1.5·2²³, which a shader compiler may optimise away.
fn nearest_integer(x: f32) -> f32 {
    return floor(x + 0.5);
}

// cos(2π·x) with an absolute error below 2e-6 for |x| < 1e4. The error of the built-in cosine may
// reach 5e-4.
fn cos_turns(x: f32) -> f32 {
    let k = nearest_integer(2.0 * x);
    let r = x - 0.5 * k;
    let odd = k - 2.0 * nearest_integer(0.5 * k - 0.25);
    let sign = 1.0 - 2.0 * abs(odd);
    let s = r * r;
    var p = 7.9035364;
    p = p * s - 26.426257;
    p = p * s + 60.24464;
    p = p * s - 85.45682;
    p = p * s + 64.93939;
    p = p * s - 19.73921;
    return sign * (p * s + 1.0);
}

fn signum(v: f32) -> f32 {
    return select(1.0, -1.0, v < 0.0);
}

// Direction cosines of the point of an ellipse nearest to p; the point is (r·cos, squash·r·sin).
// Computed in units of r, because WGSL has no f64.
fn nearest_on_ellipse(p: vec2<f32>, r: f32, squash: f32) -> vec2<f32> {
    let axes = vec2<f32>(1.0, squash);
    let q = abs(p) / r;
    let evolute = vec2<f32>(1.0 - squash * squash, (squash * squash - 1.0) / squash);
    var t = vec2<f32>(0.70710678);
    for (var i = 0; i < 6; i++) {
        let e = evolute * t * t * t;
        let radius = length(axes * t - e);
        let distance = max(length(q - e), 1e-12);
        t = clamp(((q - e) * (radius / distance) + e) / axes, vec2<f32>(0.0), vec2<f32>(1.0));
        t /= max(length(t), 1e-12);
    }
    return t * vec2<f32>(signum(p.x), signum(p.y));
}
