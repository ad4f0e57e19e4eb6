//! Orientation tests whose sign is exact (adaptive arithmetic of the `robust` crate).
//!
//! Exact for coordinates that are zero or of magnitude 1e-60 to 1e60: within these bounds no product
//! of three coordinate differences, nor the rounding error of one, leaves the range of f64.

use robust::{Coord, Coord3D};

/// Positive where `a`, `b`, `c` turn left, negative where they turn right, zero exactly where they are collinear.
#[inline]
#[must_use]
pub fn orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    let coord = |p: [f64; 2]| Coord { x: p[0], y: p[1] };
    robust::orient2d(coord(a), coord(b), coord(c))
}

/// Positive where `d` lies below the plane through `a`, `b`, `c` (counter-clockwise seen from above),
/// negative where it lies above, zero exactly where the four are coplanar.
#[inline]
#[must_use]
pub fn orient3d(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> f64 {
    let coord = |p: [f64; 3]| Coord3D { x: p[0], y: p[1], z: p[2] };
    robust::orient3d(coord(a), coord(b), coord(c), coord(d))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_follow_the_right_hand() {
        assert!(orient2d([0.0, 0.0], [1.0, 0.0], [0.0, 1.0]) > 0.0);
        let (a, b, c) = ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        assert!(orient3d(a, b, c, [0.0, 0.0, -1.0]) > 0.0);
        assert!(orient3d(a, b, c, [0.0, 0.0, 1.0]) < 0.0);
    }

    #[test]
    fn the_last_bit_counts() {
        let up = 1.0 + f64::EPSILON;
        assert_eq!(orient2d([0.0, 0.0], [3.0, 3.0], [1.0, 1.0]), 0.0);
        assert!(orient2d([0.0, 0.0], [3.0, 3.0], [1.0, up]) > 0.0);
        let (a, b, c) = ([1e-44, 0.0, 0.0], [0.0, 1e-44, 0.0], [0.0, 0.0, 1e-44]);
        assert!(orient3d(a, b, c, [0.0; 3]) != 0.0, "no underflow at the least f32");
    }
}
