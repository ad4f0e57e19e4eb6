//! Exact orientation predicates: Shewchuk's adaptive predicates (crate `robust`) for plain arrays.
//!
//! The sign of a result is exact for any finite input that does not underflow; coordinates that are
//! zero or of magnitude 1e-60 to 1e60 never do. The magnitude is approximate. All decisions on
//! surfaces use these predicates.

use robust::{Coord, Coord3D};

/// Widens an exported pair of coordinates. Exact.
#[must_use]
#[inline]
pub fn widen2(point: [f32; 2]) -> [f64; 2] {
    point.map(f64::from)
}

/// Side of the directed line `a` → `b` on which `c` lies: positive on the left (a, b, c
/// counter-clockwise), negative on the right, zero on the line. The value is twice the signed area
/// of the triangle.
#[must_use]
#[inline]
pub fn orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    let coord = |p: [f64; 2]| Coord { x: p[0], y: p[1] };
    robust::orient2d(coord(a), coord(b), coord(c))
}

/// Side of the plane through `a`, `b`, `c` on which `d` lies: negative on the side of the normal (b
/// − a) × (c − a), positive on the other side, zero on the plane. The value is six times a signed
/// volume.
#[must_use]
#[inline]
pub fn orient3d(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> f64 {
    let coord = |p: [f64; 3]| Coord3D { x: p[0], y: p[1], z: p[2] };
    robust::orient3d(coord(a), coord(b), coord(c), coord(d))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn left_is_positive() {
        assert!(orient2d([0.0, 0.0], [1.0, 0.0], [0.0, 1.0]) > 0.0);
        assert!(orient2d([0.0, 0.0], [1.0, 0.0], [0.0, -1.0]) < 0.0);
    }

    #[test]
    fn the_side_of_the_normal_is_negative() {
        let (a, b, c) = ([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        assert!(orient3d(a, b, c, [0.0, 0.0, 1.0]) < 0.0);
        assert!(orient3d(a, b, c, [0.0, 0.0, -1.0]) > 0.0);
        assert!(orient3d(a, b, c, [0.3, 0.4, 0.0]) == 0.0);
    }

    #[test]
    fn signs_are_exact_where_plain_arithmetic_is_not() {
        // Points on the line y = x, one of them moved by one unit in the last place.
        let up = f64::from_bits(0.5f64.to_bits() + 1);
        assert!(orient2d([12.0, 12.0], [24.0, 24.0], [0.5, 0.5]) == 0.0);
        assert!(orient2d([12.0, 12.0], [24.0, 24.0], [0.5, up]) > 0.0);
        assert!(orient2d([12.0, 12.0], [24.0, 24.0], [up, 0.5]) < 0.0);
        let flat = |x: f64, y: f64, z: f64| [x, y, z];
        let side =
            |z| orient3d(flat(12.0, 12.0, 12.0), flat(24.0, 24.0, 24.0), flat(0.0, 1.0, 0.5), flat(12.0, 13.0, z));
        assert!(side(12.5) == 0.0);
        let above = f64::from_bits(12.5f64.to_bits() + 1);
        assert!(side(above) * side(12.0) < 0.0);
    }

    #[test]
    fn the_least_f32_does_not_underflow() {
        let (a, b, c) = ([1e-44, 0.0, 0.0], [0.0, 1e-44, 0.0], [0.0, 0.0, 1e-44]);
        assert!(orient3d(a, b, c, [0.0; 3]) != 0.0);
    }
}
