//! Closed contours in the plane: signed areas, and exact tests of simplicity, containment and
//! nesting in near-linear time.
//!
//! Contours are the f32 points as exported. Before any test they are widened to f64, which is
//! exact.

use super::blocks::{Blocks, Rect};
use super::predicates::{orient2d, widen2};
use super::segment::{on_segment, segments_meet};

/// Index of the point after point `i` on its ring, where `len` points are the `inner` points of one
/// ring and then those of another.
#[must_use]
#[inline]
pub fn next_on_rings(i: usize, inner: usize, len: usize) -> usize {
    match i + 1 {
        next if next == inner => 0,
        next if next == len => inner,
        next => next,
    }
}

/// Reasons why a contour is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ContourError {
    /// Fewer than three points, or a coordinate that is not finite.
    #[error("a contour needs at least three points, all finite")]
    Malformed,
    /// Two consecutive points are equal.
    #[error("edge {edge} has no length, at ({:e}, {:e})", at[0], at[1])]
    EmptyEdge {
        /// Number of the edge.
        edge: usize,
        /// Point, in the unit of the contour.
        at: [f32; 2],
    },
    /// Two edges intersect, other than neighbours in their common point.
    #[error("edges {} and {} intersect, at ({:e}, {:e})", edges[0], edges[1], at[0], at[1])]
    Crossing {
        /// Numbers of the edges. In two contours: of the inner, then of the outer contour.
        edges: [usize; 2],
        /// First point of the first edge, in the unit of the contour.
        at: [f32; 2],
    },
    /// The contour is clockwise.
    #[error("the contour is not counter-clockwise")]
    Clockwise,
    /// The inner contour does not lie inside the outer contour.
    #[error("the inner contour lies outside the outer one")]
    NotNested,
}

/// Position of a point relative to a contour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Containment {
    /// Inside.
    Inside,
    /// On an edge or a vertex.
    Boundary,
    /// Outside.
    Outside,
}

/// Area inside a contour, positive if the contour is counter-clockwise. Rounded.
#[must_use]
pub fn signed_area(points: &[[f32; 2]]) -> f64 {
    let Some(&origin) = points.first() else {
        return 0.0;
    };
    let from_origin = |p: [f32; 2]| {
        let (p, o) = (widen2(p), widen2(origin));
        [p[0] - o[0], p[1] - o[1]]
    };
    let doubled: f64 = edges(points)
        .map(|(a, b)| {
            let (a, b) = (from_origin(a), from_origin(b));
            a[0] * b[1] - a[1] * b[0]
        })
        .sum();
    0.5 * doubled
}

/// Position of `point` relative to a simple contour. Exact.
#[must_use]
pub fn locate(points: &[[f32; 2]], point: [f32; 2]) -> Containment {
    locate_among(edges(points).map(|(a, b)| (widen2(a), widen2(b))), widen2(point))
}

/// Like [`locate`], for points in double precision.
#[must_use]
pub fn locate_wide(points: &[[f64; 2]], point: [f64; 2]) -> Containment {
    locate_among(edges(points), point)
}

fn locate_among(edges: impl Iterator<Item = ([f64; 2], [f64; 2])>, p: [f64; 2]) -> Containment {
    let mut inside = false;
    for (a, b) in edges {
        if a[0].max(b[0]) < p[0] && !(a[1] == p[1] && b[1] == p[1]) {
            continue;
        }
        if on_segment(a, b, p) {
            return Containment::Boundary;
        }
        if (a[1] > p[1]) != (b[1] > p[1]) {
            // The edge passes the height of the point. It does so to the right of the point if the
            // point is left of the upward edge.
            let side = orient2d(a, b, p);
            if (b[1] > a[1]) == (side > 0.0) {
                inside = !inside;
            }
        }
    }
    if inside { Containment::Inside } else { Containment::Outside }
}

/// Checks that a contour is simple: no two edges intersect, except neighbours in their common
/// point. Exact.
///
/// # Errors
/// Returns the first fault found: [`ContourError::Malformed`], [`ContourError::EmptyEdge`] or
/// [`ContourError::Crossing`].
pub fn check_simple(points: &[[f32; 2]]) -> Result<(), ContourError> {
    let n = points.len();
    if n < 3 || points.iter().flatten().any(|x| !x.is_finite()) {
        return Err(ContourError::Malformed);
    }
    if let Some(edge) = edges(points).position(|(a, b)| a == b) {
        return Err(ContourError::EmptyEdge { edge, at: points[edge] });
    }
    let end = |edge: usize| widen2(points[(edge + 1) % n]);
    if n == 3 && orient2d(widen2(points[0]), end(0), end(1)) == 0.0 {
        return Err(ContourError::Crossing { edges: [0, 1], at: points[0] });
    }
    let mut crossing = None;
    edge_blocks(points).pairs(|i, j| {
        if crossing.is_some() || n == 3 {
            return;
        }
        let (a, b, c, d) = (widen2(points[i]), end(i), widen2(points[j]), end(j));
        let meet = if j == i + 1 {
            on_segment(a, b, d) || on_segment(c, d, a)
        } else if (j + 1) % n == i {
            on_segment(a, b, c) || on_segment(c, d, b)
        } else {
            segments_meet(a, b, c, d)
        };
        if meet {
            crossing = Some([i, j]);
        }
    });
    match crossing {
        None => Ok(()),
        Some(edges) => Err(ContourError::Crossing { edges, at: points[edges[0]] }),
    }
}

/// Checks that a contour is simple and counter-clockwise. Exact.
///
/// # Errors
/// Returns an error of [`check_simple`], or [`ContourError::Clockwise`].
pub fn check_contour(points: &[[f32; 2]]) -> Result<(), ContourError> {
    check_simple(points)?;
    // The lowest, then leftmost vertex is a corner of the convex hull, so the turn there is strict.
    let n = points.len();
    let lowest = (0..n)
        .min_by(|&i, &j| {
            let key = |k: usize| (points[k][1], points[k][0]);
            key(i).partial_cmp(&key(j)).unwrap_or(std::cmp::Ordering::Equal)
        })
        .unwrap_or(0);
    let at = |k: usize| widen2(points[k % n]);
    let turn = orient2d(at(lowest + n - 1), at(lowest), at(lowest + 1));
    if turn > 0.0 { Ok(()) } else { Err(ContourError::Clockwise) }
}

/// Checks that two simple contours are nested: no edges intersect and `inner` lies inside `outer`.
/// Exact.
///
/// # Errors
/// Returns [`ContourError::Crossing`] if edges intersect, otherwise [`ContourError::NotNested`].
pub fn check_nested(inner: &[[f32; 2]], outer: &[[f32; 2]]) -> Result<(), ContourError> {
    let blocks = edge_blocks(outer);
    for (i, (a, b)) in edges(inner).enumerate() {
        let mut crossing = None;
        blocks.query(&Rect::around(&[a, b]), |j| {
            let (c, d) = (outer[j], outer[(j + 1) % outer.len()]);
            if segments_meet(widen2(a), widen2(b), widen2(c), widen2(d)) {
                crossing = crossing.or(Some(j));
            }
        });
        if let Some(j) = crossing {
            return Err(ContourError::Crossing { edges: [i, j], at: a });
        }
    }
    match inner.first().map(|&p| locate(outer, p)) {
        Some(Containment::Inside) => Ok(()),
        _ => Err(ContourError::NotNested),
    }
}

/// Edges of a closed contour; the last leads from the last point to the first.
pub(super) fn edges<T: Copy>(points: &[[T; 2]]) -> impl Iterator<Item = ([T; 2], [T; 2])> {
    let ends = points.iter().cycle().skip(1);
    points.iter().zip(ends).map(|(&a, &b)| (a, b))
}

fn edge_blocks(points: &[[f32; 2]]) -> Blocks {
    let rects: Vec<Rect> = edges(points).map(|(a, b)| Rect::around(&[a, b])).collect();
    Blocks::new(&rects)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SQUARE: [[f32; 2]; 4] = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];

    #[test]
    fn a_square() {
        assert_eq!(check_contour(&SQUARE), Ok(()));
        assert_eq!(signed_area(&SQUARE), 16.0);
        let mut turned = SQUARE;
        turned.reverse();
        assert_eq!(check_contour(&turned), Err(ContourError::Clockwise));
        assert_eq!(locate(&SQUARE, [1.0, 1.0]), Containment::Inside);
        assert_eq!(locate(&SQUARE, [4.0, 1.0]), Containment::Boundary);
        assert_eq!(locate(&SQUARE, [0.0, 0.0]), Containment::Boundary);
        assert_eq!(locate(&SQUARE, [-1.0, 0.0]), Containment::Outside);
        assert_eq!(locate(&SQUARE, [5.0, 4.0]), Containment::Outside);
    }

    #[test]
    fn triangles() {
        let mut triangle = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        assert_eq!(check_contour(&triangle), Ok(()));
        triangle[2] = [0.5, 0.0];
        assert!(matches!(check_simple(&triangle), Err(ContourError::Crossing { .. })));
    }

    #[test]
    fn bows_spikes_and_pinches_are_refused() {
        let bow = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
        let spike = [[0.0, 0.0], [4.0, 0.0], [2.0, 0.0], [2.0, 3.0]];
        let pinch = [[0.0, 0.0], [2.0, 0.0], [1.0, 1.0], [2.0, 2.0], [0.0, 2.0], [1.0, 1.0]];
        let there_and_back = [[0.0, 0.0], [4.0, 0.0], [0.0, 0.0], [2.0, 3.0]];
        for points in [&bow[..], &spike, &pinch, &there_and_back] {
            assert!(matches!(check_simple(points), Err(ContourError::Crossing { .. })), "{points:?}");
        }
        let doubled = [[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        assert!(matches!(check_simple(&doubled), Err(ContourError::EmptyEdge { edge: 1, .. })));
        assert_eq!(check_simple(&SQUARE[..2]), Err(ContourError::Malformed));
        assert_eq!(check_simple(&[[0.0, 0.0], [f32::NAN, 0.0], [0.0, 1.0]]), Err(ContourError::Malformed));
    }

    #[test]
    fn nesting() {
        let inside = SQUARE.map(|p| p.map(|x| 1.0 + x / 4.0));
        let apart = SQUARE.map(|p| p.map(|x| 9.0 + x));
        let touching = SQUARE.map(|p| p.map(|x| x / 4.0));
        assert_eq!(check_nested(&inside, &SQUARE), Ok(()));
        assert_eq!(check_nested(&SQUARE, &inside), Err(ContourError::NotNested));
        assert_eq!(check_nested(&apart, &SQUARE), Err(ContourError::NotNested));
        assert!(matches!(check_nested(&touching, &SQUARE), Err(ContourError::Crossing { .. })));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]
        #[test]
        fn small_lattice_contours_agree_with_all_pairs(
            points in prop::collection::vec((0u8..7, 0u8..7), 4..9)
        ) {
            let points: Vec<[f32; 2]> =
                points.iter().map(|&(x, y)| [f32::from(x), f32::from(y)]).collect();
            let n = points.len();
            let wide = |k: usize| widen2(points[k % n]);
            let mut sound = (0..n).all(|i| points[i] != points[(i + 1) % n]);
            for i in 0..n {
                for j in i + 1..n {
                    sound &= if (j + 1) % n == i || j == i + 1 {
                        let (p, v, q) = if j == i + 1 { (i, j, j + 1) } else { (j, i, i + 1) };
                        let (p, v, q) = (wide(p), wide(v), wide(q));
                        let dot = (p[0] - v[0]) * (q[0] - v[0]) + (p[1] - v[1]) * (q[1] - v[1]);
                        !(orient2d(p, v, q) == 0.0 && dot > 0.0)
                    } else {
                        !segments_meet(wide(i), wide(i + 1), wide(j), wide(j + 1))
                    };
                }
            }
            prop_assert_eq!(check_simple(&points).is_ok(), sound);
            if sound {
                prop_assert_eq!(check_contour(&points).is_ok(), signed_area(&points) > 0.0);
            }
        }
    }
}
