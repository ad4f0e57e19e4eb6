//! Triangulation of one polygon in double precision, such as a face of a file.

use spade::handles::FixedVertexHandle;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};
use std::collections::{HashMap, VecDeque};

/// Reasons why a polygon could not be triangulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PolygonError {
    /// A coordinate is not finite, or outside the range of exact arithmetic.
    #[error("a coordinate is not finite, or too large or too small for exact arithmetic")]
    Coordinate,
    /// An edge crosses another one, or a corner lies on it.
    #[error("the edge that begins at corner {corner} crosses or touches another edge")]
    Crossing {
        /// Number of the corner.
        corner: usize,
    },
    /// The polygon runs around a part of the plane clockwise, or more than once.
    #[error("the polygon overlaps itself, or is clockwise, at corner {corner}")]
    Overlap {
        /// Number of a corner of that part.
        corner: usize,
    },
}

type Cdt = ConstrainedDelaunayTriangulation<Point2<f64>>;

/// Triangulates the inside of a counter-clockwise polygon. Triangles are counter-clockwise and name
/// corners; every edge of the polygon is an edge of exactly one triangle.
///
/// A simple polygon of n corners has n − 2 triangles. Corners at the same position count as one
/// point, of which triangles name the first corner. The polygon may therefore run along an edge in
/// both directions, as polygons do whose holes are joined to their outline.
///
/// The time grows faster than the number of corners, most where many corners lie on one circle:
/// 100,000 take two seconds, a million a minute.
///
/// # Errors
/// Returns an error if edges cross, a corner lies on an edge, or the polygon is clockwise.
pub fn polygon(corners: &[[f64; 2]]) -> Result<Vec<[u32; 3]>, PolygonError> {
    let Ring { points, first, edges } = Ring::new(corners);
    let mut conflict = None;
    let pairs = edges.iter().map(|edge| [edge.from, edge.to]).collect();
    let vertices = points.iter().map(|p| Point2::new(p[0], p[1])).collect();
    let cdt = Cdt::try_bulk_load_cdt(vertices, pairs, |pair| conflict = conflict.or(Some(pair[0])))
        .map_err(|_| PolygonError::Coordinate)?;
    if let Some(point) = conflict {
        return Err(PolygonError::Crossing { corner: first.get(point).map_or(0, |&corner| corner as usize) });
    }
    let turns = turns(&cdt, &edges)?;
    let winding = winding(&cdt, &turns);
    let mut triangles = Vec::with_capacity(corners.len().saturating_sub(2));
    for face in cdt.inner_faces() {
        let corners = face.vertices().map(|v| first[v.index()]);
        match winding[face.index()] {
            0 => {}
            1 => triangles.push(corners),
            _ => return Err(PolygonError::Overlap { corner: corners[0] as usize }),
        }
    }
    Ok(triangles)
}

/// A polygon as different points and different edges.
struct Ring {
    points: Vec<[f64; 2]>,
    /// First corner at each point.
    first: Vec<u32>,
    edges: Vec<Edge>,
}

/// Edge between different points, `from` the one at which the polygon is less often.
struct Edge {
    from: usize,
    to: usize,
    /// How often the polygon runs along the edge, less how often it runs against it.
    turns: i32,
    /// Corner at which the edge begins.
    corner: usize,
}

impl Ring {
    fn new(corners: &[[f64; 2]]) -> Self {
        let (mut points, mut first, mut visits) = (Vec::new(), Vec::new(), Vec::new());
        let mut known: HashMap<[u64; 2], usize> = HashMap::with_capacity(corners.len());
        let point_of: Vec<usize> = (0_u32..)
            .zip(corners)
            .map(|(corner, p)| {
                // Adding zero turns −0 into 0.
                let point = *known.entry(p.map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
                    points.push(*p);
                    first.push(corner);
                    visits.push(0_u32);
                    points.len() - 1
                });
                visits[point] += 1;
                point
            })
            .collect();
        let ends = point_of.iter().cycle().skip(1);
        let mut all: Vec<Edge> = point_of
            .iter()
            .zip(ends)
            .enumerate()
            .map(|(corner, (&from, &to))| {
                if (visits[from], from) <= (visits[to], to) {
                    Edge { from, to, turns: 1, corner }
                } else {
                    Edge { from: to, to: from, turns: -1, corner }
                }
            })
            .filter(|edge| edge.from != edge.to)
            .collect();
        all.sort_by_key(|edge| (edge.from, edge.to));
        all.dedup_by(|next, edge| {
            let same = (next.from, next.to) == (edge.from, edge.to);
            edge.turns += if same { next.turns } else { 0 };
            same
        });
        Self { points, first, edges: all }
    }
}

/// For each undirected edge, how often the polygon runs along it from its lower to its higher
/// point.
fn turns(cdt: &Cdt, edges: &[Edge]) -> Result<Vec<i32>, PolygonError> {
    let handle = FixedVertexHandle::from_index;
    let mut turns = vec![0; cdt.num_undirected_edges()];
    for edge in edges {
        // An edge on which another corner lies is not an edge of the triangulation.
        let found = cdt
            .get_edge_from_neighbors(handle(edge.from), handle(edge.to))
            .filter(|edge| edge.is_constraint_edge())
            .ok_or(PolygonError::Crossing { corner: edge.corner })?;
        turns[found.as_undirected().fix().index()] = if edge.from < edge.to { edge.turns } else { -edge.turns };
    }
    Ok(turns)
}

/// How often the polygon runs around each face, counter-clockwise.
fn winding(cdt: &Cdt, turns: &[i32]) -> Vec<i32> {
    let mut winding = vec![None; cdt.num_all_faces()];
    let outer = cdt.outer_face();
    winding[outer.index()] = Some(0);
    let mut queue: VecDeque<_> = cdt.convex_hull().collect();
    while let Some(edge) = queue.pop_front() {
        // The face of an edge lies on its left, and is known.
        let other = edge.rev();
        let (Some(known), None) = (winding[edge.face().index()], winding[other.face().index()]) else { continue };
        let along = if edge.from().index() < edge.to().index() { 1 } else { -1 };
        winding[other.face().index()] = Some(known - along * turns[edge.as_undirected().fix().index()]);
        if let Some(face) = other.face().as_inner() {
            queue.extend(face.adjacent_edges());
        }
    }
    winding.into_iter().map(Option::unwrap_or_default).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::predicates::orient2d;
    use proptest::prelude::*;
    use std::f64::consts::TAU;

    fn doubled(points: &[[f64; 2]]) -> f64 {
        let ends = points.iter().cycle().skip(1);
        points.iter().zip(ends).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum()
    }

    /// Twice the area of the triangles, all of which must be counter-clockwise.
    fn covered(points: &[[f64; 2]], triangles: &[[u32; 3]]) -> f64 {
        let of = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| points[v as usize]);
            let area = orient2d(a, b, c);
            assert!(area > 0.0, "{t:?}");
            area
        };
        triangles.iter().map(of).sum()
    }

    fn check(points: &[[f64; 2]]) {
        let triangles = polygon(points).unwrap();
        assert_eq!(triangles.len(), points.len() - 2);
        let (expected, found) = (doubled(points), covered(points, &triangles));
        assert!((found / expected - 1.0).abs() < 1e-9, "{found}, not {expected}");
    }

    /// A comb with teeth of the given heights.
    fn comb(heights: &[f64]) -> Vec<[f64; 2]> {
        let width = heights.len() as f64;
        let mut points = vec![[0.0, -1.0], [width, -1.0]];
        for (k, &height) in heights.iter().enumerate().rev() {
            let x = k as f64;
            points.extend([[x + 1.0, 0.0], [x + 0.6, height], [x + 0.4, height]]);
        }
        points.push([0.0, 0.0]);
        points
    }

    #[test]
    fn corners_on_a_straight_edge_are_kept() {
        check(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 2.0], [0.0, 2.0], [0.0, 1.0]]);
    }

    #[test]
    fn a_hole_that_a_bridge_joins_to_the_outline_stays_open() {
        // A square of 4 × 4 with a square hole of 2 × 2.
        let points = [
            [0.0, 0.0],
            [4.0, 0.0],
            [4.0, 4.0],
            [0.0, 4.0],
            [0.0, 0.0],
            [1.0, 1.0],
            [1.0, 3.0],
            [3.0, 3.0],
            [3.0, 1.0],
            [1.0, 1.0],
        ];
        let triangles = polygon(&points).unwrap();
        assert_eq!((triangles.len(), covered(&points, &triangles)), (8, 24.0));
        assert!(triangles.iter().flatten().all(|&v| v != 4 && v != 9), "{triangles:?}");
    }

    #[test]
    fn a_spike_adds_nothing_outside() {
        let points = [[0.0, 0.0], [2.0, 0.0], [3.0, 0.0], [2.0, 0.0], [0.0, 2.0]];
        assert_eq!(polygon(&points).unwrap().len(), 1);
    }

    #[test]
    fn unsound_polygons_are_refused_with_a_corner() {
        let bow = [[0.0, 0.0], [3.0, 3.0], [3.0, 0.0], [0.0, 2.0]];
        assert!(matches!(polygon(&bow), Err(PolygonError::Crossing { .. })));
        let touching = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 0.0], [0.0, 4.0]];
        assert_eq!(polygon(&touching), Err(PolygonError::Crossing { corner: 0 }));
        let mut clockwise = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        clockwise.reverse();
        assert!(matches!(polygon(&clockwise), Err(PolygonError::Overlap { .. })));
        let eight = [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [2.0, 0.0], [1.0, 1.0], [0.0, 2.0]];
        assert!(matches!(polygon(&eight), Err(PolygonError::Overlap { .. })), "one lobe is clockwise");
        assert_eq!(polygon(&[[f64::NAN, 0.0], [1.0, 0.0], [0.0, 1.0]]), Err(PolygonError::Coordinate));
        assert_eq!(polygon(&[]), Ok(Vec::new()));
        assert_eq!(polygon(&[[1.0, 2.0]; 5]), Ok(Vec::new()));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn stars_of_any_radii_are_covered(radii in prop::collection::vec(0.1_f64..3.0, 5..200)) {
            let n = radii.len() as f64;
            let at = |(k, r): (usize, &f64)| {
                let angle = TAU * k as f64 / n;
                [7.0 + r * angle.cos(), r * angle.sin() - 3.0]
            };
            check(&radii.iter().enumerate().map(at).collect::<Vec<_>>());
        }

        #[test]
        fn combs_of_any_heights_are_covered(heights in prop::collection::vec(0.01_f64..50.0, 1..100)) {
            check(&comb(&heights));
        }

        #[test]
        fn corners_on_a_lattice_never_panic(points in prop::collection::vec((0_i8..5, 0_i8..5), 0..12)) {
            let points: Vec<[f64; 2]> = points.iter().map(|&(x, y)| [f64::from(x), f64::from(y)]).collect();
            if let Ok(triangles) = polygon(&points) {
                prop_assert!((covered(&points, &triangles) - doubled(&points)).abs() < 1e-9);
            }
        }
    }
}
