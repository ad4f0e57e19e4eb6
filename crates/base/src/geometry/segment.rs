//! Exact tests of segments in the plane.

use super::predicates::orient2d;

/// True if the closed segments `a`–`b` and `c`–`d` have a common point. Segments of length zero
/// count as points.
#[must_use]
#[inline]
pub fn segments_meet(a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]) -> bool {
    // For a point every orientation is zero, the most expensive result of exact arithmetic.
    let parts = |a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]| {
        a != b && {
            let (c_side, d_side) = (orient2d(a, b, c), orient2d(a, b, d));
            (c_side > 0.0 && d_side > 0.0) || (c_side < 0.0 && d_side < 0.0)
        }
    };
    // Boxes first, because most segments are far apart. If neither line separates the ends of the
    // other segment, only collinear segments can be disjoint, and then their boxes are disjoint.
    let boxes_overlap = overlap(a[0], b[0], c[0], d[0]) && overlap(a[1], b[1], c[1], d[1]);
    boxes_overlap && !parts(a, b, c, d) && !parts(c, d, a, b)
}

/// True if `p` lies on the closed segment `a`–`b`.
#[must_use]
#[inline]
pub fn on_segment(a: [f64; 2], b: [f64; 2], p: [f64; 2]) -> bool {
    orient2d(a, b, p) == 0.0 && overlap(a[0], b[0], p[0], p[0]) && overlap(a[1], b[1], p[1], p[1])
}

/// True if the interval from `a` to `b` and the interval from `c` to `d` overlap.
fn overlap(a: f64, b: f64, c: f64, d: f64) -> bool {
    a.min(b) <= c.max(d) && c.min(d) <= a.max(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crossing_touching_and_apart() {
        let (a, b) = ([0.0, 0.0], [4.0, 0.0]);
        assert!(segments_meet(a, b, [1.0, -1.0], [2.0, 1.0]));
        assert!(segments_meet(a, b, [1.0, 0.0], [2.0, 1.0]));
        assert!(segments_meet(a, b, b, [5.0, 1.0]));
        assert!(!segments_meet(a, b, [4.5, -1.0], [4.5, 1.0]));
        assert!(!segments_meet(a, b, [1.0, 1e-300], [2.0, 1.0]));
    }

    #[test]
    fn on_one_line() {
        let (a, b) = ([0.0, 0.0], [4.0, 4.0]);
        assert!(segments_meet(a, b, [3.0, 3.0], [6.0, 6.0]));
        assert!(segments_meet(a, b, [1.0, 1.0], [2.0, 2.0]));
        assert!(!segments_meet(a, b, [5.0, 5.0], [6.0, 6.0]));
        assert!(segments_meet(a, b, [2.0, 2.0], [2.0, 2.0]));
        assert!(!segments_meet(a, b, [2.0, 2.5], [2.0, 2.5]));
    }

    #[test]
    fn points_on_a_segment() {
        assert!(on_segment([0.0, 0.0], [2.0, 4.0], [1.0, 2.0]));
        assert!(!on_segment([0.0, 0.0], [2.0, 4.0], [3.0, 6.0]));
        assert!(!on_segment([0.0, 0.0], [2.0, 4.0], [1.0, 2.0000000001]));
    }
}
