//! Whether two triangles in space meet, decided exactly.
//!
//! Triangles are closed sets and must not be degenerate (see [`Triangle::is_degenerate`]). A floating-point filter decides
//! nearly all cases; [`orient3d`] and [`orient2d`] decide the others.
//! The bounds on coordinates are those of [`crate::geometry::predicates`].

use super::predicates::{orient2d, orient3d};

type P2 = [f64; 2];
type P3 = [f64; 3];

/// A triangle with the data of its plane for the filter.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// Corners.
    pub points: [P3; 3],
    normal: P3,
    /// Rounding error of the filter per unit of distance (maximum norm) from `points[0]`.
    error: f64,
}

#[inline]
fn sub(a: P3, b: P3) -> P3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline]
fn max_norm(a: P3) -> f64 {
    a[0].abs().max(a[1].abs()).max(a[2].abs())
}

impl Triangle {
    /// Prepares a triangle.
    #[inline]
    #[must_use]
    pub fn new(points: [P3; 3]) -> Self {
        let (u, v) = (sub(points[1], points[0]), sub(points[2], points[0]));
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        // The determinant of three vectors of maximum norms l, m, n, computed from rounded differences, is off by
        // less than 48 half-ulps of l·m·n = 5.4e-15·l·m·n.
        Self { points, normal, error: 1e-14 * max_norm(u) * max_norm(v) }
    }

    /// The side of the plane of the triangle on which `q` lies: the sign of [`orient3d`] of the corners and `q`, exact.
    #[inline]
    #[must_use]
    pub fn side(&self, q: P3) -> f64 {
        let d = sub(q, self.points[0]);
        let det = self.normal[0] * d[0] + self.normal[1] * d[1] + self.normal[2] * d[2];
        if det.abs() > self.error * max_norm(d) {
            -det
        } else {
            orientation(self.points[0], self.points[1], self.points[2], q)
        }
    }

    /// Whether its corners are collinear (or coincide), exactly.
    #[must_use]
    pub fn is_degenerate(&self) -> bool {
        self.projection().is_none()
    }

    /// An axis along which the triangle can be flattened without becoming degenerate.
    fn projection(&self) -> Option<usize> {
        let n = self.normal.map(f64::abs);
        let best = if n[0] > n[1] && n[0] > n[2] { 0 } else { 1 + usize::from(n[2] > n[1]) };
        [best, (best + 1) % 3, (best + 2) % 3].into_iter().find(|&axis| {
            let [a, b, c] = self.points.map(|p| flat(p, axis));
            orient2d(a, b, c) != 0.0
        })
    }

    /// The intersection of the triangle with an axis-parallel plane that it touches from one side: a corner (twice) or an
    /// edge; none if it lies in the plane.
    fn edge_in_plane(&self, axis: usize, value: f64) -> Option<[P2; 2]> {
        let mut on = self.points.into_iter().filter(|p| p[axis] == value).map(|p| flat(p, axis));
        let first = on.next()?;
        let second = on.next().unwrap_or(first);
        on.next().is_none().then_some([first, second])
    }

    /// Whether both points lie strictly on one side of the plane.
    #[inline]
    fn clears(&self, points: [P3; 2]) -> bool {
        are_clear(points.map(|p| self.side(p)))
    }

    /// Whether the closed segment from `p` to `q` has a point in common with the triangle.
    #[must_use]
    pub fn meets_segment(&self, p: P3, q: P3) -> bool {
        self.meets([p, q], [self.side(p), self.side(q)])
    }

    /// The same if the sides of its ends are known.
    fn meets(&self, [p, q]: [P3; 2], [side_p, side_q]: [f64; 2]) -> bool {
        if (side_p > 0.0 && side_q > 0.0) || (side_p < 0.0 && side_q < 0.0) {
            return false;
        }
        let [a, b, c] = self.points;
        if side_p == 0.0 && side_q == 0.0 {
            let axis = self.projection().expect("a triangle that is tested for contact is not degenerate");
            return meets_segment_2d([flat(a, axis), flat(b, axis), flat(c, axis)], flat(p, axis), flat(q, axis));
        }
        // The line meets the plane in one point, which is inside if the line passes all edges on the same side.
        let (s, t, u) = (orientation(p, q, a, b), orientation(p, q, b, c), orientation(p, q, c, a));
        (s >= 0.0 && t >= 0.0 && u >= 0.0) || (s <= 0.0 && t <= 0.0 && u <= 0.0)
    }
}

/// Whether all points, of which these are the sides, lie strictly on one side.
fn are_clear<const N: usize>(sides: [f64; N]) -> bool {
    sides.iter().all(|&side| side > 0.0) || sides.iter().all(|&side| side < 0.0)
}

/// [`orient3d`], with a shortcut for four points of an axis-parallel plane: sections lie in such planes, and zero is the
/// most expensive result of exact arithmetic.
#[inline]
fn orientation(a: P3, b: P3, c: P3, d: P3) -> f64 {
    if (0..3).any(|axis| a[axis] == d[axis] && b[axis] == d[axis] && c[axis] == d[axis]) {
        return 0.0;
    }
    orient3d(a, b, c, d)
}

/// Drops coordinate `axis`.
#[inline]
fn flat(p: P3, axis: usize) -> P2 {
    match axis {
        0 => [p[1], p[2]],
        1 => [p[2], p[0]],
        _ => [p[0], p[1]],
    }
}

/// Whether two closed segments of the plane have a point in common, exactly; either may be a point.
#[must_use]
pub fn segments_meet(a: P2, b: P2, c: P2, d: P2) -> bool {
    // Of a point every orientation is zero: the most expensive result of exact arithmetic.
    let parts = |a: P2, b: P2, c: P2, d: P2| {
        a != b && {
            let (abc, abd) = (orient2d(a, b, c), orient2d(a, b, d));
            (abc > 0.0 && abd > 0.0) || (abc < 0.0 && abd < 0.0)
        }
    };
    // Boxes decide first, as most segments are far apart. If neither line separates the ends of the other segment, only collinear
    // segments can be disjoint, and their boxes are.
    let overlap = |i: usize| a[i].min(b[i]) <= c[i].max(d[i]) && c[i].min(d[i]) <= a[i].max(b[i]);
    overlap(0) && overlap(1) && !parts(a, b, c, d) && !parts(c, d, a, b)
}

fn meets_segment_2d(t: [P2; 3], p: P2, q: P2) -> bool {
    let inside = |x: P2| {
        let s = [orient2d(t[0], t[1], x), orient2d(t[1], t[2], x), orient2d(t[2], t[0], x)];
        s.iter().all(|&v| v >= 0.0) || s.iter().all(|&v| v <= 0.0)
    };
    inside(p) || (0..3).any(|i| segments_meet(t[i], t[(i + 1) % 3], p, q))
}

/// Whether two triangles have any point in common.
#[must_use]
pub fn meet(a: &Triangle, b: &Triangle) -> bool {
    for axis in 0..3 {
        for (a, b) in [(a, b), (b, a)] {
            // Comparisons rather than `max` and `min`, which treat NaN apart.
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
    // If triangles meet, an edge of one meets the other.
    let edges = |t: &Triangle, sides: [f64; 3], other: &Triangle| {
        (0..3).any(|i| {
            let j = (i + 1) % 3;
            other.meets([t.points[i], t.points[j]], [sides[i], sides[j]])
        })
    };
    edges(a, sides_a, b) || edges(b, sides_b, a)
}

/// Whether two triangles that share the corner `a.points[i]` = `b.points[j]` have any other point in common.
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
        // An axis-parallel plane through the corner separates them and contains all common points.
        let on_plane = |p: P3, q: P3| match (p[axis] == v, q[axis] == v) {
            (false, false) => Some(None),
            (true, false) => Some(Some(flat(p, axis))),
            (false, true) => Some(Some(flat(q, axis))),
            (true, true) => None,
        };
        match (on_plane(a1, a2), on_plane(b1, b2)) {
            (Some(None), _) | (_, Some(None)) => return false,
            (Some(Some(p)), Some(Some(q))) => {
                let o = flat(corner, axis);
                let same_way = |i: usize| (p[i] > o[i] && q[i] > o[i]) || (p[i] < o[i] && q[i] < o[i]);
                return orient2d(o, p, q) == 0.0 && (same_way(0) || same_way(1));
            }
            _ => {}
        }
    }
    if b.clears([a1, a2]) || a.clears([b1, b2]) {
        return false;
    }
    // A ray from the corner inside both leaves one of them through the edge opposite to the corner.
    b.meets_segment(a1, a2) || a.meets_segment(b1, b2)
}

/// Whether two triangles that share an edge have other points in common, that is, whether they are folded flat onto each
/// other. `a.points[i]` and `b.points[j]` are the corners off the shared edge.
#[must_use]
pub fn overlap_across_edge(a: &Triangle, i: usize, b: &Triangle, j: usize) -> bool {
    let far = b.points[j];
    if a.side(far) != 0.0 {
        return false;
    }
    let axis = a.projection().expect("a triangle that is tested for contact is not degenerate");
    let (u, v) = (flat(a.points[(i + 1) % 3], axis), flat(a.points[(i + 2) % 3], axis));
    (orient2d(u, v, flat(a.points[i], axis)) > 0.0) == (orient2d(u, v, flat(far, axis)) > 0.0)
}

/// Whether two triangles of a mesh, given with the numbers of their vertices, have points in common besides the vertices and
/// edges that they share; so do triangles of the same three vertices.
#[inline]
#[must_use]
pub fn meet_in_mesh((a, ta): (&Triangle, [u32; 3]), (b, tb): (&Triangle, [u32; 3])) -> bool {
    // Bit 3i + j: corner i of the first is corner j of the second.
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
