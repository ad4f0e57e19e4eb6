//! Vectors of the plane and of space as plain arrays. Results are the same on all machines: sums
//! run from the first coordinate to the last, and only IEEE operations and `libm` are used.

/// `a` − `b`.
#[must_use]
#[inline(always)]
pub fn sub<const N: usize>(a: [f64; N], b: [f64; N]) -> [f64; N] {
    std::array::from_fn(|k| a[k] - b[k])
}

/// The point at the fraction `t` of the way from `a` to `b`.
#[must_use]
#[inline(always)]
pub fn lerp<const N: usize>(a: [f64; N], b: [f64; N], t: f64) -> [f64; N] {
    std::array::from_fn(|k| a[k] + (b[k] - a[k]) * t)
}

/// Scalar product.
#[must_use]
#[inline(always)]
pub fn dot<const N: usize>(a: [f64; N], b: [f64; N]) -> f64 {
    (1..N).fold(a[0] * b[0], |sum, k| sum + a[k] * b[k])
}

/// Length. Squares must neither overflow nor vanish; `hypot` rounds differently between C
/// libraries.
#[must_use]
#[inline(always)]
pub fn norm<const N: usize>(v: [f64; N]) -> f64 {
    dot(v, v).sqrt()
}

/// Distance of two points.
#[must_use]
#[inline(always)]
pub fn distance<const N: usize>(a: [f64; N], b: [f64; N]) -> f64 {
    norm(sub(b, a))
}

/// Vector product in space.
#[must_use]
#[inline(always)]
pub fn cross(u: [f64; 3], v: [f64; 3]) -> [f64; 3] {
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

/// Vector product in the plane: positive if `v` points to the left of `u`.
#[must_use]
#[inline(always)]
pub fn cross2(u: [f64; 2], v: [f64; 2]) -> f64 {
    u[0] * v[1] - u[1] * v[0]
}

/// Angle from direction `u` to direction `v`, counter-clockwise positive, in radians.
#[must_use]
pub fn angle(u: [f64; 2], v: [f64; 2]) -> f64 {
    libm::atan2(cross2(u, v), dot(u, v))
}

/// Squared distance of `p` from the segment from `a` to `b`, which may be a point.
#[must_use]
#[inline(always)]
pub fn squared_distance_to_segment<const N: usize>(p: [f64; N], a: [f64; N], b: [f64; N]) -> f64 {
    squared_distance_up_to(1.0, p, a, b)
}

/// Squared distance of `p` from the ray from `a` through `b`, which may be a point.
#[must_use]
#[inline(always)]
pub fn squared_distance_to_ray<const N: usize>(p: [f64; N], a: [f64; N], b: [f64; N]) -> f64 {
    squared_distance_up_to(f64::INFINITY, p, a, b)
}

/// Squared distance of `p` from the points `a` + t (`b` − `a`) with t from 0 to `end`.
#[inline(always)]
fn squared_distance_up_to<const N: usize>(end: f64, p: [f64; N], a: [f64; N], b: [f64; N]) -> f64 {
    let (ab, ap) = (sub(b, a), sub(p, a));
    let square = dot(ab, ab);
    let t = if square > 0.0 { (dot(ap, ab) / square).clamp(0.0, end) } else { 0.0 };
    let rest: [f64; N] = std::array::from_fn(|k| ap[k] - ab[k] * t);
    dot(rest, rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_from_segments_and_rays() {
        let (a, b) = ([0.0, 0.0], [2.0, 0.0]);
        let found = [[1.0, 3.0], [5.0, 4.0], [-3.0, 4.0]].map(|p| squared_distance_to_segment(p, a, b));
        assert_eq!(found, [9.0, 25.0, 25.0]);
        assert_eq!(squared_distance_to_ray([5.0, 4.0], a, b), 16.0);
        assert_eq!(squared_distance_to_segment([1.0, 2.0, 2.0], [0.0; 3], [0.0; 3]), 9.0);
    }

    #[test]
    fn products_and_angles_turn_counter_clockwise() {
        let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        assert_eq!((cross(x, y), cross(y, z), cross(z, x)), (z, x, y));
        assert_eq!(cross2([1.0, 0.0], [0.0, 1.0]), 1.0);
        assert_eq!(angle([1.0, 0.0], [0.0, 2.0]), std::f64::consts::FRAC_PI_2);
        assert_eq!((dot(x, lerp(x, y, 0.25)), distance(x, [1.0, 3.0, 4.0])), (0.75, 5.0));
    }
}
