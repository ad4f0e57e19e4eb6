//! Triangulation of all that lies to the left of contours, in double precision.

use super::{TriangulateError, constrained, flood, ring_edges};
use crate::geometry::predicates::orient2d;
use spade::Triangulation;

/// Triangulates the region to the left of closed contours that neither touch nor cross each other:
/// the inside of counter-clockwise contours without the inside of clockwise ones, nested to any
/// depth. Indices count the points of all contours in order.
///
/// # Errors
/// Returns an error if the contours do not meet these conditions.
pub fn left_of(contours: &[Vec<[f64; 2]>]) -> Result<Vec<[u32; 3]>, TriangulateError> {
    let points: Vec<[f64; 2]> = contours.iter().flatten().copied().collect();
    let edges = ring_edges(contours.iter().map(Vec::len));
    let cdt = constrained(&points, &edges)?;
    let inside = flood(&cdt, &edges, &vec![true; edges.len()])?;
    let triangles: Vec<[u32; 3]> = (cdt.inner_faces().filter(|face| inside[face.index()]))
        .map(|face| face.vertices().map(|v| v.index() as u32))
        .collect();
    let sound = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| points[i as usize]);
        orient2d(a, b, c) > 0.0
    };
    let holes = contours.iter().filter(|contour| is_clockwise(contour)).count();
    let expected = (points.len() + 2 * holes).saturating_sub(2 * (contours.len() - holes));
    if triangles.len() == expected && triangles.iter().all(sound) {
        Ok(triangles)
    } else {
        Err(TriangulateError::Count { found: triangles.len(), expected })
    }
}

/// True if a contour runs clockwise, which its turn at an extreme point shows exactly.
fn is_clockwise(contour: &[[f64; 2]]) -> bool {
    let n = contour.len();
    let first = (0..n).min_by(|&a, &b| {
        let [p, q] = [contour[a], contour[b]];
        p[0].total_cmp(&q[0]).then(p[1].total_cmp(&q[1]))
    });
    first.is_some_and(|i| orient2d(contour[(i + n - 1) % n], contour[i], contour[(i + 1) % n]) < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(half: f64, is_clockwise: bool) -> Vec<[f64; 2]> {
        let mut square = [[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]].map(|p| p.map(|x| x * half)).to_vec();
        if is_clockwise {
            square.reverse();
        }
        square
    }

    fn area(contours: &[Vec<[f64; 2]>]) -> f64 {
        let points: Vec<[f64; 2]> = contours.concat();
        let triangles = left_of(contours).unwrap();
        triangles.iter().map(|t| t.map(|i| points[i as usize])).map(|[a, b, c]| orient2d(a, b, c) / 2.0).sum()
    }

    #[test]
    fn contours_are_nested_to_any_depth() {
        let rings = [square(4.0, false), square(3.0, true), square(2.0, false), square(1.0, true)];
        assert_eq!(area(&rings), 64.0 - 36.0 + 16.0 - 4.0);
        let mut beside = rings.to_vec();
        beside.push(square(1.0, false).iter().map(|p| [p[0] + 10.0, p[1]]).collect());
        beside.rotate_left(2);
        assert_eq!(area(&beside), 44.0);
        // A corner that is no corner.
        assert_eq!(area(&[vec![[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]]), 4.0);
        assert_eq!(left_of(&[]).unwrap(), [[0; 3]; 0]);
    }

    #[test]
    fn unsound_contours_are_refused() {
        assert!(matches!(left_of(&[square(1.0, true)]), Err(TriangulateError::Count { .. })));
        assert_eq!(left_of(&[square(1.0, false), square(1.0, true)]), Err(TriangulateError::Duplicate));
        let crossed = square(2.0, false).iter().map(|p| [p[0] + 1.0, p[1] + 1.0]).collect();
        assert_eq!(left_of(&[square(2.0, false), crossed]), Err(TriangulateError::Crossing));
        assert_eq!(left_of(&[vec![[f64::NAN; 2], [1.0; 2], [0.0; 2]]]), Err(TriangulateError::Coordinate));
    }
}
