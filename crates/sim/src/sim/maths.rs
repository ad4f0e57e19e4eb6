//! Small functions that return the same bits on every machine and that the compiler can vectorize
//! in loops.

/// Limit of random fields, in standard deviations.
pub(crate) const CUT: f32 = 2.0;

/// cos(2π·x) with an absolute error below 1e-6 for |x| < 1e4. Uses only additions and
/// multiplications.
#[inline(always)]
pub(crate) fn cos_turns(x: f32) -> f32 {
    // Reduces x to a quarter turn around the nearest half turn: cos(2π(k/2 + r)) = (−1)^k cos(2πr),
    // |r| ≤ 1/4.
    let k = round(2.0 * x);
    let r = x - 0.5 * k;
    let odd = k - 2.0 * round(0.5 * k - 0.25);
    let sign = 1.0 - 2.0 * odd.abs();
    let s = r * r;
    // Taylor series of cos(2πr) in r², up to r¹².
    let p = 7.903_536_4;
    let p = p * s - 26.426_257;
    let p = p * s + 60.244_64;
    let p = p * s - 85.456_82;
    let p = p * s + 64.939_39;
    let p = p * s - 19.739_21;
    sign * (p * s + 1.0)
}

/// Fractional part of a number of turns.
pub(crate) fn fraction(turns: f64) -> f32 {
    (turns - turns.floor()) as f32
}

/// Nearest integer, by adding and subtracting 1.5·2²³; exact for |x| < 2²².
#[inline(always)]
fn round(x: f32) -> f32 {
    const MAGIC: f32 = 12_582_912.0;
    (x + MAGIC) - MAGIC
}

/// Maximum of two numbers as one instruction. NaN is not handled.
#[inline(always)]
pub(crate) fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Minimum of two numbers as one instruction. NaN is not handled.
#[inline(always)]
pub(crate) fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Maximum of `n` nonnegative values, 0 without values. The order of comparison does not affect the
/// result, so the values are compared in lanes.
#[inline(always)]
pub(crate) fn greatest(n: usize, value: impl Fn(usize) -> f32) -> f32 {
    const LANES: usize = 16;
    let mut lanes = [0.0f32; LANES];
    let whole = n - n % LANES;
    for i in (0..whole).step_by(LANES) {
        for (l, lane) in lanes.iter_mut().enumerate() {
            *lane = max(*lane, value(i + l));
        }
    }
    for i in whole..n {
        lanes[0] = max(lanes[0], value(i));
    }
    lanes.into_iter().fold(0.0, max)
}

/// Direction cosines of the point of an ellipse nearest to `p`; the point is `(r·cos,
/// squash·r·sin)`.
///
/// Iterates on the centre of curvature. This needs no trigonometry, and a few iterations suffice
/// even near the axes.
pub(crate) fn nearest_on_ellipse(p: [f32; 2], r: f32, squash: f32) -> [f32; 2] {
    let (a, b) = (f64::from(r), f64::from(r) * f64::from(squash));
    let (px, py) = (f64::from(p[0]).abs(), f64::from(p[1]).abs());
    let (mut tx, mut ty) = (std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::FRAC_1_SQRT_2);
    for _ in 0..6 {
        let (ex, ey) = ((a * a - b * b) * tx * tx * tx / a, (b * b - a * a) * ty * ty * ty / b);
        let (rx, ry) = (a * tx - ex, b * ty - ey);
        let (qx, qy) = (px - ex, py - ey);
        let radius = (rx * rx + ry * ry).sqrt();
        let distance = (qx * qx + qy * qy).sqrt().max(1e-12);
        tx = ((qx * radius / distance + ex) / a).clamp(0.0, 1.0);
        ty = ((qy * radius / distance + ey) / b).clamp(0.0, 1.0);
        let norm = (tx * tx + ty * ty).sqrt().max(1e-12);
        tx /= norm;
        ty /= norm;
    }
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    [(tx * sign(p[0])) as f32, (ty * sign(p[1])) as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cosine_is_close_to_f64() {
        for i in -40_000..40_000 {
            let x = i as f32 * 0.000_37;
            let exact = (std::f64::consts::TAU * f64::from(x)).cos();
            assert!((f64::from(cos_turns(x)) - exact).abs() < 2e-6, "x = {x}");
        }
    }

    #[test]
    fn nearest_point_of_an_ellipse_is_nearest() {
        let (r, squash) = (500.0f32, 0.88f32);
        for i in 0..200 {
            let angle = i as f32 * 0.031_7;
            let scale = 0.2 + (i % 13) as f32 * 0.1;
            let p = [r * scale * angle.cos(), r * scale * angle.sin()];
            let t = nearest_on_ellipse(p, r, squash);
            let distance = |c: f64, s: f64| {
                let (dx, dy) = (f64::from(r) * c - f64::from(p[0]), f64::from(r * squash) * s - f64::from(p[1]));
                (dx * dx + dy * dy).sqrt()
            };
            let found = distance(f64::from(t[0]), f64::from(t[1]));
            let best = (0..20_000)
                .map(|k| f64::from(k) * std::f64::consts::TAU / 20_000.0)
                .map(|a| distance(a.cos(), a.sin()))
                .fold(f64::INFINITY, f64::min);
            assert!(found < best + 0.05, "point {p:?}: {found} against {best}");
        }
    }
}
