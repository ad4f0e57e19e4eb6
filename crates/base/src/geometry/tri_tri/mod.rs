//! Exact intersection tests of two triangles in space.
//!
//! Triangles are closed sets and must not be degenerate (see [`Triangle::is_degenerate`]). A
//! floating-point filter decides nearly all cases, [`orient3d`] and [`orient2d`] the rest. The
//! range of coordinates is that of [`crate::geometry::predicates`].

use super::predicates::{orient2d, orient3d};
use super::segment::segments_meet;
use super::vector::{cross, dot, sub};

type P2 = [f64; 2];
type P3 = [f64; 3];

/// A triangle with its normal, for the filter.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// Corners.
    pub points: [P3; 3],
    normal: P3,
    /// Rounding error of the filter divided by the distance (maximum norm) from `points[0]`.
    error_per_distance: f64,
}

#[inline]
fn max_norm(a: P3) -> f64 {
    a[0].abs().max(a[1].abs()).max(a[2].abs())
}

impl Triangle {
    /// Computes the normal and the error bound.
    #[inline]
    #[must_use]
    pub fn new(points: [P3; 3]) -> Self {
        let (u, v) = (sub(points[1], points[0]), sub(points[2], points[0]));
        // The determinant of three vectors of maximum norms l, m, n, computed from rounded
        // differences, is off by less than 48 half-ulps of l·m·n = 5.4e-15·l·m·n.
        Self { points, normal: cross(u, v), error_per_distance: 1e-14 * max_norm(u) * max_norm(v) }
    }

    /// Side of the triangle's plane on which `q` lies: the exact sign of [`orient3d`] of the
    /// corners and `q`.
    #[inline]
    #[must_use]
    pub fn side(&self, q: P3) -> f64 {
        let d = sub(q, self.points[0]);
        let det = dot(self.normal, d);
        if det.abs() > self.error_per_distance * max_norm(d) {
            -det
        } else {
            orientation(self.points[0], self.points[1], self.points[2], q)
        }
    }

    /// True if the filter proves that a triangle with these corners lies on one side of this
    /// triangle's plane, which it touches in common vertices at most. `of_this` and `of_other` are
    /// the numbers of the vertices. If so, [`meet_in_mesh`] is false.
    #[inline(always)]
    #[must_use]
    pub fn clears_in_mesh(&self, of_this: [u32; 3], points: [P3; 3], of_other: [u32; 3]) -> bool {
        let (mut below, mut above, mut commons) = (true, true, 0);
        for (q, vertex) in points.into_iter().zip(of_other) {
            let is_common = of_this.into_iter().fold(false, |is, of_this| is | (of_this == vertex));
            let d = sub(q, self.points[0]);
            let det = dot(self.normal, d);
            let error = self.error_per_distance * max_norm(d);
            below &= is_common | (-det > error);
            above &= is_common | (det > error);
            commons += u32::from(is_common);
        }
        (below | above) & (commons < 3)
    }

    /// True if the corners are collinear or coincide. Exact.
    #[inline]
    #[must_use]
    pub fn is_degenerate(&self) -> bool {
        // The bound of a determinant is one of its cofactors as well.
        max_norm(self.normal) <= self.error_per_distance && self.projection_axis().is_none()
    }

    /// Finds an axis along which the triangle can be projected without becoming degenerate.
    fn projection_axis(&self) -> Option<usize> {
        let n = self.normal.map(f64::abs);
        let best = if n[0] > n[1] && n[0] > n[2] { 0 } else { 1 + usize::from(n[2] > n[1]) };
        [best, (best + 1) % 3, (best + 2) % 3].into_iter().find(|&axis| {
            let [a, b, c] = self.points.map(|p| project(p, axis));
            orient2d(a, b, c) != 0.0
        })
    }

    /// Intersection of the triangle with an axis-parallel plane that it touches from one side: an
    /// edge, or a corner twice. `None` if the triangle lies in the plane.
    fn edge_in_plane(&self, axis: usize, value: f64) -> Option<[P2; 2]> {
        let mut on = self.points.into_iter().filter(|p| p[axis] == value).map(|p| project(p, axis));
        let first = on.next()?;
        let second = on.next().unwrap_or(first);
        on.next().is_none().then_some([first, second])
    }

    /// True if both points lie strictly on the same side of the triangle's plane.
    #[inline]
    fn clears(&self, points: [P3; 2]) -> bool {
        are_clear(points.map(|p| self.side(p)))
    }

    /// True if the closed segment from `p` to `q` intersects the triangle.
    #[must_use]
    pub fn meets_segment(&self, p: P3, q: P3) -> bool {
        self.meets([p, q], [self.side(p), self.side(q)])
    }

    /// Like [`Self::meets_segment`], with the sides of both ends given.
    fn meets(&self, [p, q]: [P3; 2], [side_p, side_q]: [f64; 2]) -> bool {
        if (side_p > 0.0 && side_q > 0.0) || (side_p < 0.0 && side_q < 0.0) {
            return false;
        }
        let [a, b, c] = self.points;
        if side_p == 0.0 && side_q == 0.0 {
            let axis = self.projection_axis().expect("a triangle that is tested for contact is not degenerate");
            return meets_segment_2d(
                [project(a, axis), project(b, axis), project(c, axis)],
                project(p, axis),
                project(q, axis),
            );
        }
        // The line intersects the plane in one point. The point is inside if the line passes all
        // edges on the same side.
        let (s, t, u) = (orientation(p, q, a, b), orientation(p, q, b, c), orientation(p, q, c, a));
        (s >= 0.0 && t >= 0.0 && u >= 0.0) || (s <= 0.0 && t <= 0.0 && u <= 0.0)
    }
}

/// True if all points, given by their sides, lie strictly on the same side.
fn are_clear<const N: usize>(sides: [f64; N]) -> bool {
    sides.iter().all(|&side| side > 0.0) || sides.iter().all(|&side| side < 0.0)
}

/// [`orient3d`] with a shortcut for four points in an axis-parallel plane. Sections lie in such
/// planes, and zero is the most expensive result of exact arithmetic.
#[inline]
fn orientation(a: P3, b: P3, c: P3, d: P3) -> f64 {
    if (0..3).any(|axis| a[axis] == d[axis] && b[axis] == d[axis] && c[axis] == d[axis]) {
        return 0.0;
    }
    orient3d(a, b, c, d)
}

/// Drops coordinate `axis`.
#[inline]
fn project(p: P3, axis: usize) -> P2 {
    match axis {
        0 => [p[1], p[2]],
        1 => [p[2], p[0]],
        _ => [p[0], p[1]],
    }
}

fn meets_segment_2d(t: [P2; 3], p: P2, q: P2) -> bool {
    let inside = |x: P2| {
        let s = [orient2d(t[0], t[1], x), orient2d(t[1], t[2], x), orient2d(t[2], t[0], x)];
        s.iter().all(|&v| v >= 0.0) || s.iter().all(|&v| v <= 0.0)
    };
    inside(p) || (0..3).any(|i| segments_meet(t[i], t[(i + 1) % 3], p, q))
}

/// True if two triangles intersect.
#[must_use]
pub fn meet(a: &Triangle, b: &Triangle) -> bool {
    for axis in 0..3 {
        for (a, b) in [(a, b), (b, a)] {
            // Plain comparisons, because `max` and `min` treat NaN specially.
            let top = a.points.iter().fold(f64::NEG_INFINITY, |top, p| if p[axis] > top { p[axis] } else { top });
            let bottom = b.points.iter().fold(f64::INFINITY, |low, p| if p[axis] < low { p[axis] } else { low });
            if top < bottom {
                return false;
            }
            if top == bottom
                && let (Some([p, q]), Some([r, s])) = (a.edge_in_plane(axis, top), b.edge_in_plane(axis, top))
            {
                return segments_meet(p, q, r, s);
            }
        }
    }
    let (sides_a, sides_b) = (a.points.map(|p| b.side(p)), b.points.map(|p| a.side(p)));
    if are_clear(sides_a) || are_clear(sides_b) {
        return false;
    }
    // If triangles intersect, an edge of one intersects the other.
    let edges = |t: &Triangle, sides: [f64; 3], other: &Triangle| {
        (0..3).any(|i| {
            let j = (i + 1) % 3;
            other.meets([t.points[i], t.points[j]], [sides[i], sides[j]])
        })
    };
    edges(a, sides_a, b) || edges(b, sides_b, a)
}

/// True if two triangles that share the corner `a.points[i]` = `b.points[j]` have another common
/// point.
#[must_use]
pub fn meet_beyond_corner(a: &Triangle, i: usize, b: &Triangle, j: usize) -> bool {
    let corner = a.points[i];
    let (a1, a2) = (a.points[(i + 1) % 3], a.points[(i + 2) % 3]);
    let (b1, b2) = (b.points[(j + 1) % 3], b.points[(j + 2) % 3]);
    for axis in 0..3 {
        let v = corner[axis];
        let (a_low, a_high) = (a1[axis].min(a2[axis]), a1[axis].max(a2[axis]));
        let (b_low, b_high) = (b1[axis].min(b2[axis]), b1[axis].max(b2[axis]));
        let parted = (a_high <= v && b_low >= v) || (a_low >= v && b_high <= v);
        if !parted {
            continue;
        }
        // An axis-parallel plane through the corner separates the triangles and contains all common
        // points.
        let on_plane = |p: P3, q: P3| match (p[axis] == v, q[axis] == v) {
            (false, false) => Some(None),
            (true, false) => Some(Some(project(p, axis))),
            (false, true) => Some(Some(project(q, axis))),
            (true, true) => None,
        };
        match (on_plane(a1, a2), on_plane(b1, b2)) {
            (Some(None), _) | (_, Some(None)) => return false,
            (Some(Some(p)), Some(Some(q))) => {
                let o = project(corner, axis);
                let same_way = |i: usize| (p[i] > o[i] && q[i] > o[i]) || (p[i] < o[i] && q[i] < o[i]);
                return orient2d(o, p, q) == 0.0 && (same_way(0) || same_way(1));
            }
            _ => {}
        }
    }
    if b.clears([a1, a2]) || a.clears([b1, b2]) {
        return false;
    }
    // A ray from the corner inside both triangles leaves one of them through the edge opposite to
    // the corner.
    b.meets_segment(a1, a2) || a.meets_segment(b1, b2)
}

/// True if two triangles that share an edge have other common points, that is, if they are folded
/// flat onto each other. `a.points[i]` and `b.points[j]` are the corners off the shared edge.
#[must_use]
pub fn overlap_across_edge(a: &Triangle, i: usize, b: &Triangle, j: usize) -> bool {
    let far = b.points[j];
    if a.side(far) != 0.0 {
        return false;
    }
    let axis = a.projection_axis().expect("a triangle that is tested for contact is not degenerate");
    let (u, v) = (project(a.points[(i + 1) % 3], axis), project(a.points[(i + 2) % 3], axis));
    (orient2d(u, v, project(a.points[i], axis)) > 0.0) == (orient2d(u, v, project(far, axis)) > 0.0)
}

/// True if two triangles of a mesh intersect outside the vertices and edges that they share, or
/// have the same three vertices. `ta` and `tb` are the numbers of their vertices.
#[inline]
#[must_use]
pub fn meet_in_mesh((a, ta): (&Triangle, [u32; 3]), (b, tb): (&Triangle, [u32; 3])) -> bool {
    // Bit 3i + j: corner i of the first triangle is corner j of the second.
    let mut same = 0u32;
    for (i, a) in ta.iter().enumerate() {
        for (j, b) in tb.iter().enumerate() {
            same |= u32::from(a == b) << (3 * i + j);
        }
    }
    match same.count_ones() {
        0 => meet(a, b),
        1 => {
            let bit = same.trailing_zeros() as usize;
            meet_beyond_corner(a, bit / 3, b, bit % 3)
        }
        2 => {
            let apart = |mask: u32, step: u32| (0..3).find(|i| same & (mask << (step * i)) == 0).unwrap_or(0) as usize;
            overlap_across_edge(a, apart(0b111, 3), b, apart(0b1_001_001, 1))
        }
        _ => true,
    }
}

#[cfg(test)]
mod tests;
