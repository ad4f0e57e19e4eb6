//! Constrained Delaunay triangulation of regions bounded by contours, such as the caps of a surface
//! (the paper, section 3.1, used FIST).
//!
//! The triangles cover exactly the region, are counter-clockwise and use only the given points.
//! Every edge of the contours is an edge of exactly one triangle. Only this module names `spade`.

use spade::handles::FixedVertexHandle;
use spade::{AngleLimit, ConstrainedDelaunayTriangulation, Point2, RefinementParameters, Triangulation};

use super::predicates::{orient2d, widen2};

mod polygon;
mod region;

pub use polygon::{PolygonError, polygon};
pub use region::left_of;

/// Reasons why a region could not be triangulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TriangulateError {
    /// A coordinate is not finite, or outside the range of exact arithmetic.
    #[error("a coordinate is not finite, or too large or too small for exact arithmetic")]
    Coordinate,
    /// Two points are equal.
    #[error("two points of the contours are equal")]
    Duplicate,
    /// Two edges of the contours cross.
    #[error("two edges of the contours cross")]
    Crossing,
    /// The number of triangles is wrong for the region: a contour is clockwise, or the contours are
    /// not nested.
    #[error("the triangulation has {found} triangles; the region requires {expected}")]
    Count {
        /// Number of triangles found.
        found: usize,
        /// Number of triangles required by Euler's formula.
        expected: usize,
    },
}

type Cdt = ConstrainedDelaunayTriangulation<Point2<f64>>;

/// A triangulated region with the neighbours of each triangle.
#[derive(Clone, Debug)]
pub struct Linked {
    /// Counter-clockwise triangles.
    pub triangles: Vec<[u32; 3]>,
    /// Triangles across the edges 0–1, 1–2 and 2–0, or [`NO_NEIGHBOUR`] at a contour.
    pub neighbours: Vec<[u32; 3]>,
}

/// Stands for the outside of the region in [`Linked::neighbours`].
pub const NO_NEIGHBOUR: u32 = u32::MAX;

/// Triangulates the inside of a simple, counter-clockwise contour of n points into n − 2 triangles.
///
/// # Errors
/// Returns an error if the contour does not meet these conditions.
pub fn disc(contour: &[[f32; 2]]) -> Result<Vec<[u32; 3]>, TriangulateError> {
    let n = contour.len();
    triangulate_region(&[contour], &[true], n.saturating_sub(2))
}

/// Triangulates the annulus between two nested, simple, counter-clockwise contours into as many
/// triangles as there are points. Indices count the points of `inner` first, then those of `outer`.
///
/// # Errors
/// Returns an error if the contours do not meet these conditions.
pub fn annulus(inner: &[[f32; 2]], outer: &[[f32; 2]]) -> Result<Vec<[u32; 3]>, TriangulateError> {
    triangulate_region(&[inner, outer], &[false, true], inner.len() + outer.len())
}

/// Triangulates the inside of `outer` without the inside of `holes`. All contours must be simple,
/// counter-clockwise and disjoint. Indices count the points of the holes first, in order, then
/// those of `outer`.
///
/// # Errors
/// Returns an error if the contours do not meet these conditions.
pub fn perforated(holes: &[&[[f32; 2]]], outer: &[[f32; 2]]) -> Result<Linked, TriangulateError> {
    let contours: Vec<&[[f32; 2]]> = holes.iter().copied().chain([outer]).collect();
    let mut left = vec![false; holes.len()];
    left.push(true);
    let points: usize = contours.iter().map(|contour| contour.len()).sum();
    let (cdt, inside) = triangulate_hull(&contours, &left)?;
    let linked = link_faces(&cdt, &inside);
    let expected = (points + 2 * holes.len()).saturating_sub(2);
    let found = linked.triangles.len();
    if found == expected { Ok(linked) } else { Err(TriangulateError::Count { found, expected }) }
}

/// A region triangulated with additional points inside.
#[derive(Clone, Debug)]
pub struct Refined {
    /// The additional points, numbered after the points of the contours.
    pub added: Vec<[f32; 2]>,
    /// Counter-clockwise triangles.
    pub triangles: Vec<[u32; 3]>,
}

/// Triangulates the region of [`perforated`] with additional points. It keeps the edges of the
/// contours and, as far as they permit, avoids angles below 27° and areas above `area`.
///
/// # Errors
/// Returns an error if the contours do not meet the conditions.
pub fn refined(holes: &[&[[f32; 2]]], outer: &[[f32; 2]], area: f64) -> Result<Refined, TriangulateError> {
    let contours: Vec<&[[f32; 2]]> = holes.iter().copied().chain([outer]).collect();
    let mut left = vec![false; holes.len()];
    left.push(true);
    let (mut cdt, _) = triangulate_hull(&contours, &left)?;
    let given = cdt.num_vertices();
    let parameters = RefinementParameters::new()
        .exclude_outer_faces(true)
        .keep_constraint_edges()
        .with_max_allowed_area(area)
        .with_min_required_area(area * 1e-3)
        .with_angle_limit(AngleLimit::from_deg(27.0))
        .with_max_additional_vertices(20 * given + 100_000);
    cdt.refine(parameters);
    let inside = flood(&cdt, &ring_edges(contours.iter().map(|ring| ring.len())), &left_of_edges(&contours, &left))?;
    let faces = || cdt.inner_faces().filter(|face| inside[face.index()]);
    // Points outside the region are dropped.
    let mut number: Vec<u32> =
        (0..given as u32).chain(std::iter::repeat_n(u32::MAX, cdt.num_vertices() - given)).collect();
    let mut added = Vec::new();
    let mut points: Vec<[f64; 2]> = contours.iter().copied().flatten().copied().map(widen2).collect();
    let mut triangles = Vec::new();
    for face in faces() {
        triangles.push(face.vertices().map(|v| {
            let slot = &mut number[v.index()];
            if *slot == u32::MAX {
                *slot = (given + added.len()) as u32;
                let p = v.position();
                let rounded = [p.x as f32, p.y as f32];
                added.push(rounded);
                points.push(widen2(rounded));
            }
            *slot
        }));
    }
    let expected = (given + 2 * added.len() + 2 * holes.len()).saturating_sub(2);
    let sound = triangles.iter().filter(|t| {
        let [a, b, c] = t.map(|i| points[i as usize]);
        orient2d(a, b, c) > 0.0
    });
    match sound.count() {
        found if found == expected && found == triangles.len() => Ok(Refined { added, triangles }),
        found => Err(TriangulateError::Count { found, expected }),
    }
}

/// Edges of contours with these numbers of points, as pairs of point numbers.
fn ring_edges(lengths: impl Iterator<Item = usize>) -> Vec<[usize; 2]> {
    let mut edges = Vec::new();
    for n in lengths {
        let base = edges.len();
        edges.extend((0..n).map(|i| [base + i, base + (i + 1) % n]));
    }
    edges
}

/// For each edge, true if the region lies left of it.
fn left_of_edges(contours: &[&[[f32; 2]]], left: &[bool]) -> Vec<bool> {
    contours.iter().zip(left).flat_map(|(contour, &left)| std::iter::repeat_n(left, contour.len())).collect()
}

/// Triangulates the region that lies left of the contours marked in `left`, and right of the
/// others.
fn triangulate_region(
    contours: &[&[[f32; 2]]],
    left: &[bool],
    expected: usize,
) -> Result<Vec<[u32; 3]>, TriangulateError> {
    let (cdt, inside) = triangulate_hull(contours, left)?;
    let triangles: Vec<[u32; 3]> = cdt
        .inner_faces()
        .filter(|face| inside[face.index()])
        .map(|face| face.vertices().map(|v| v.index() as u32))
        .collect();
    let points: Vec<[f64; 2]> = contours.iter().copied().flatten().copied().map(widen2).collect();
    let sound = triangles.iter().all(|t| {
        let [a, b, c] = t.map(|i| points[i as usize]);
        orient2d(a, b, c) > 0.0
    });
    if triangles.len() == expected && sound {
        Ok(triangles)
    } else {
        Err(TriangulateError::Count { found: triangles.len(), expected })
    }
}

/// Triangulates the convex hull, with the edges of the contours among its edges. Returns the
/// triangulation and, for each face, whether it belongs to the region.
fn triangulate_hull(contours: &[&[[f32; 2]]], left: &[bool]) -> Result<(Cdt, Vec<bool>), TriangulateError> {
    let points: Vec<[f64; 2]> = contours.iter().copied().flatten().copied().map(widen2).collect();
    let (edges, inside_left) = (ring_edges(contours.iter().map(|ring| ring.len())), left_of_edges(contours, left));
    let cdt = constrained(&points, &edges)?;
    let inside = flood(&cdt, &edges, &inside_left)?;
    Ok((cdt, inside))
}

/// Triangulates the convex hull of different points, with these edges among its own.
fn constrained(points: &[[f64; 2]], edges: &[[usize; 2]]) -> Result<Cdt, TriangulateError> {
    let mut conflict = false;
    let vertices = points.iter().map(|p| Point2::new(p[0], p[1])).collect();
    let cdt = Cdt::try_bulk_load_cdt(vertices, edges.to_vec(), |_| conflict = true)
        .map_err(|_| TriangulateError::Coordinate)?;
    if cdt.num_vertices() != points.len() {
        return Err(TriangulateError::Duplicate);
    }
    if conflict || cdt.num_constraints() != edges.len() {
        return Err(TriangulateError::Crossing);
    }
    Ok(cdt)
}

/// Marks the faces that are connected to the inner side of a contour edge without crossing one.
fn flood(cdt: &Cdt, edges: &[[usize; 2]], inside_left: &[bool]) -> Result<Vec<bool>, TriangulateError> {
    let handle = FixedVertexHandle::from_index;
    let mut inside = vec![false; cdt.num_all_faces()];
    let mut queue = Vec::new();
    for (&[a, b], &left) in edges.iter().zip(inside_left) {
        let edge = cdt
            .get_edge_from_neighbors(handle(a), handle(b))
            .filter(|edge| edge.is_constraint_edge())
            .ok_or(TriangulateError::Crossing)?;
        let edge = if left { edge } else { edge.rev() };
        // A clockwise contour may have no triangle there.
        if let Some(face) = edge.face().as_inner()
            && !std::mem::replace(&mut inside[face.index()], true)
        {
            queue.push(face);
        }
    }
    while let Some(face) = queue.pop() {
        for edge in face.adjacent_edges() {
            if edge.is_constraint_edge() {
                continue;
            }
            if let Some(next) = edge.rev().face().as_inner()
                && !std::mem::replace(&mut inside[next.index()], true)
            {
                queue.push(next);
            }
        }
    }
    Ok(inside)
}

/// Faces of the region with their neighbours, in the order of the triangulation.
fn link_faces(cdt: &Cdt, inside: &[bool]) -> Linked {
    let mut number = vec![NO_NEIGHBOUR; inside.len()];
    for (k, face) in cdt.inner_faces().filter(|face| inside[face.index()]).enumerate() {
        number[face.index()] = k as u32;
    }
    let mut linked = Linked { triangles: Vec::new(), neighbours: Vec::new() };
    for face in cdt.inner_faces().filter(|face| inside[face.index()]) {
        let edges = face.adjacent_edges();
        linked.triangles.push(edges.map(|edge| edge.from().index() as u32));
        linked.neighbours.push(edges.map(|edge| {
            let beyond = edge.rev().face().as_inner().filter(|_| !edge.is_constraint_edge());
            beyond.map_or(NO_NEIGHBOUR, |face| number[face.index()])
        }));
    }
    linked
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    fn circle(n: usize, radius: f32, lobes: f32) -> Vec<[f32; 2]> {
        (0..n)
            .map(|i| {
                let angle = std::f32::consts::TAU * i as f32 / n as f32;
                let r = radius * (1.0 + 0.4 * (lobes * angle).sin());
                [r * angle.cos() * 1e-6, r * angle.sin() * 1e-6]
            })
            .collect()
    }

    fn area(points: &[[f32; 2]], triangles: &[[u32; 3]]) -> f64 {
        let corners = triangles.iter().map(|t| t.map(|i| widen2(points[i as usize])));
        corners.map(|[a, b, c]| 0.5 * orient2d(a, b, c)).sum()
    }

    /// Every contour edge once forward (or, for holes, once backward), every other edge in both
    /// directions.
    fn check_edges(triangles: &[[u32; 3]], boundary: &[[u32; 2]]) {
        let mut count: HashMap<[u32; 2], i32> = HashMap::new();
        for t in triangles {
            for k in 0..3 {
                *count.entry([t[k], t[(k + 1) % 3]]).or_default() += 1;
            }
        }
        assert!(count.values().all(|&c| c == 1));
        let mut open: Vec<[u32; 2]> = count.keys().copied().filter(|&[a, b]| !count.contains_key(&[b, a])).collect();
        open.sort_unstable();
        let mut boundary = boundary.to_vec();
        boundary.sort_unstable();
        assert_eq!(open, boundary);
    }

    #[test]
    fn a_lobed_annulus() {
        let (inner, outer) = (circle(160, 500.0, 9.0), circle(40, 1200.0, 0.0));
        let triangles = annulus(&inner, &outer).unwrap();
        assert_eq!(triangles.len(), 200);
        let mut boundary: Vec<[u32; 2]> = (0..160).map(|i| [(i + 1) % 160, i]).collect();
        boundary.extend((0..40).map(|i| [160 + i, 160 + (i + 1) % 40]));
        check_edges(&triangles, &boundary);
        let all: Vec<[f32; 2]> = inner.iter().chain(&outer).copied().collect();
        let expected = super::super::polygon::signed_area(&outer) - super::super::polygon::signed_area(&inner);
        assert!((area(&all, &triangles) / expected - 1.0).abs() < 1e-9);
    }

    #[test]
    fn neighbours_share_an_edge() {
        let shifted = |x: f32| circle(40, 200.0, 0.0).iter().map(|p| [p[0] + x, p[1]]).collect::<Vec<_>>();
        let (holes, outer) = ([shifted(-4e-4), shifted(4e-4)], circle(60, 1200.0, 0.0));
        let found = perforated(&[&holes[0], &holes[1]], &outer).unwrap();
        assert_eq!(found.triangles.len(), 140 + 2);
        let mut contour = 0;
        for (t, neighbours) in found.triangles.iter().zip(&found.neighbours) {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                let Some(n) = found.triangles.get(neighbours[k] as usize) else {
                    contour += 1;
                    continue;
                };
                assert!((0..3).any(|j| n[j] == b && n[(j + 1) % 3] == a));
            }
        }
        assert_eq!(contour, 140);
        assert!(perforated(&[&holes[0], &holes[0]], &outer).is_err());
    }

    #[test]
    fn a_lobed_disc() {
        let contour = circle(160, 500.0, 9.0);
        let triangles = disc(&contour).unwrap();
        assert_eq!(triangles.len(), 158);
        let boundary: Vec<[u32; 2]> = (0..160).map(|i| [i, (i + 1) % 160]).collect();
        check_edges(&triangles, &boundary);
    }

    #[test]
    fn unsound_contours_are_refused() {
        let mut contour = circle(12, 500.0, 0.0);
        contour.swap(3, 7);
        assert_eq!(disc(&contour), Err(TriangulateError::Crossing));
        let mut contour = circle(12, 500.0, 0.0);
        contour[3] = contour[7];
        assert_eq!(disc(&contour), Err(TriangulateError::Duplicate));
        let mut contour = circle(12, 500.0, 0.0);
        contour.reverse();
        assert!(disc(&contour).is_err());
        let contour = circle(12, 500.0, 0.0);
        assert!(annulus(&circle(12, 900.0, 0.0), &contour).is_err());
        assert!(disc(&[[f32::NAN, 0.0], [1.0, 0.0], [0.0, 1.0]]).is_err());
    }
}
