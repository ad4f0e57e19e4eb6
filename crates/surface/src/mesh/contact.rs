//! Exact test of whether two triangles of a slab meet outside the vertices and edges that they share.
//!
//! Triangles that share no vertex must not touch; those that share a vertex or an edge must meet in it
//! alone. All results follow from signs of exact predicates. A triangle must not be degenerate; a triangle of a slab has
//! an edge in one of its planes and is degenerate exactly if that edge has zero length.

use crate::geometry::predicates::{orient2d, orient3d};
use crate::geometry::segment::segments_meet;

/// A triangle in space with the identity of its corners.
#[derive(Clone, Copy, Debug)]
pub(super) struct Triangle {
    pub(super) ids: [usize; 3],
    pub(super) corners: [[f64; 3]; 3],
}

/// Whether two triangles meet anywhere except in the vertices they share and the edge between those.
pub(super) fn in_contact(s: &Triangle, t: &Triangle) -> bool {
    let mut shared = [(0, 0); 3];
    let mut count = 0;
    for i in 0..3 {
        for j in 0..3 {
            if s.ids[i] == t.ids[j] {
                shared[count.min(2)] = (i, j);
                count += 1;
            }
        }
    }
    match count {
        0 => disjoint_meet(s, t),
        1 => vertex_meet(s, t, shared[0]),
        2 => {
            let (i, j) = (3 - shared[0].0 - shared[1].0, 3 - shared[0].1 - shared[1].1);
            edge_meet(s.corners[shared[0].0], s.corners[shared[1].0], s.corners[i], t.corners[j])
        }
        _ => true,
    }
}

/// Two triangles over the edge a–b with apices p and q fold onto each other: they lie in one plane, on
/// the same side of the edge.
fn edge_meet(a: [f64; 3], b: [f64; 3], p: [f64; 3], q: [f64; 3]) -> bool {
    if orient3d(a, b, p, q) != 0.0 {
        return false;
    }
    let view = view([a, b, p]);
    let side = |r: [f64; 3]| orient2d(view(a), view(b), view(r));
    (side(p) > 0.0) == (side(q) > 0.0)
}

/// Triangles with one common corner. Their intersection is convex and contains that corner; if it is more
/// than the corner, it reaches the opposite edge of one of them.
fn vertex_meet(s: &Triangle, t: &Triangle, shared: (usize, usize)) -> bool {
    let far_s = [s.corners[(shared.0 + 1) % 3], s.corners[(shared.0 + 2) % 3]];
    let far_t = [t.corners[(shared.1 + 1) % 3], t.corners[(shared.1 + 2) % 3]];
    let sides = |t: &Triangle, far: [[f64; 3]; 2]| far.map(|p| plane_side(t, p));
    let (sides_s, sides_t) = (sides(t, far_s), sides(s, far_t));
    let one_side = |sides: [f64; 2]| sides[0] * sides[1] > 0.0;
    if one_side(sides_s) || one_side(sides_t) {
        return false;
    }
    edge_hits(far_s, sides_s, t) || edge_hits(far_t, sides_t, s)
}

/// Triangles without a common corner.
fn disjoint_meet(s: &Triangle, t: &Triangle) -> bool {
    let sides_s = s.corners.map(|p| plane_side(t, p));
    if one_side(sides_s) {
        return false;
    }
    let sides_t = t.corners.map(|p| plane_side(s, p));
    if one_side(sides_t) {
        return false;
    }
    (0..3).any(|k| {
        let l = (k + 1) % 3;
        edge_hits([s.corners[k], s.corners[l]], [sides_s[k], sides_s[l]], t)
            || edge_hits([t.corners[k], t.corners[l]], [sides_t[k], sides_t[l]], s)
    })
}

fn one_side(sides: [f64; 3]) -> bool {
    sides.iter().all(|&x| x > 0.0) || sides.iter().all(|&x| x < 0.0)
}

/// Side of `p` from the plane of `t`, as a sign: −1, 0 or 1.
#[inline]
fn plane_side(t: &Triangle, p: [f64; 3]) -> f64 {
    sign(orient3d(t.corners[0], t.corners[1], t.corners[2], p))
}

#[inline]
fn sign(x: f64) -> f64 {
    if x > 0.0 {
        1.0
    } else if x < 0.0 {
        -1.0
    } else {
        0.0
    }
}

/// Whether the closed segment `edge`, whose ends lie on the given sides of the plane of `t`, meets the
/// closed triangle `t`.
fn edge_hits(edge: [[f64; 3]; 2], sides: [f64; 2], t: &Triangle) -> bool {
    let [p, q] = edge;
    let [a, b, c] = t.corners;
    if sides[0] * sides[1] > 0.0 {
        return false;
    }
    if sides[0] == 0.0 && sides[1] == 0.0 {
        let view = view(t.corners);
        let (p, q) = (view(p), view(q));
        let [a, b, c] = t.corners.map(&view);
        let around = [(a, b), (b, c), (c, a)];
        let turns = around.map(|(a, b)| orient2d(a, b, p));
        return turns.iter().all(|&x| x >= 0.0)
            || turns.iter().all(|&x| x <= 0.0)
            || around.iter().any(|&(a, b)| segments_meet(a, b, p, q));
    }
    let turns = [(a, b), (b, c), (c, a)].map(|(a, b)| orient3d(p, q, a, b));
    turns.iter().all(|&x| x >= 0.0) || turns.iter().all(|&x| x <= 0.0)
}

/// A projection along an axis that does not collapse the triangle, so it is one-to-one on the plane of the
/// triangle.
fn view(corners: [[f64; 3]; 3]) -> impl Fn([f64; 3]) -> [f64; 2] {
    let onto = |axes: [usize; 2]| move |p: [f64; 3]| [p[axes[0]], p[axes[1]]];
    let axes = [[0, 1], [1, 2], [2, 0]]
        .into_iter()
        .find(|&axes| {
            let [a, b, c] = corners.map(onto(axes));
            orient2d(a, b, c) != 0.0
        })
        .unwrap_or([0, 1]);
    onto(axes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn triangle(ids: [usize; 3], corners: [[f64; 3]; 3]) -> Triangle {
        Triangle { ids, corners }
    }

    fn base() -> Triangle {
        triangle([0, 1, 2], [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    }

    #[test]
    fn without_common_corners() {
        let t = |y0: f64, y1: f64| triangle([3, 4, 5], [[1.0, y0, 0.0], [3.0, y0, 0.0], [1.0, y1, 1.0]]);
        assert!(!in_contact(&base(), &t(0.1, 0.1)));
        assert!(in_contact(&base(), &t(0.1, -1.0)));
        assert!(in_contact(&base(), &t(0.0, 1.0)), "edge on edge");
        assert!(in_contact(&base(), &t(0.0, 0.0)), "in one plane");
        let beside = triangle([3, 4, 5], [[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [5.0, 0.0, 1.0]]);
        assert!(!in_contact(&base(), &beside), "in one plane, apart");
        let through = triangle([3, 4, 5], [[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 1.0]]);
        assert!(in_contact(&base(), &through));
        let touching = triangle([3, 4, 5], [[4.0, 0.0, 0.0], [5.0, 1.0, 0.0], [5.0, 0.0, 1.0]]);
        assert!(in_contact(&base(), &touching), "equal corner, other vertex");
        let inside = triangle([3, 4, 5], [[0.5, 0.0, 0.25], [1.0, 0.0, 0.25], [0.5, 0.0, 0.5]]);
        assert!(in_contact(&base(), &inside), "one within the other");
        assert!(in_contact(&inside, &base()), "one around the other");
    }

    #[test]
    fn with_a_common_corner() {
        let t = |r: [f64; 3], s: [f64; 3]| triangle([0, 7, 8], [[0.0; 3], r, s]);
        assert!(!in_contact(&base(), &t([0.0, 1.0, 0.0], [0.0, 2.0, 1.0])));
        assert!(!in_contact(&base(), &t([-1.0, 0.0, 0.0], [-1.0, 0.0, 1.0])));
        assert!(in_contact(&base(), &t([1.0, 1.0, 0.0], [1.0, -1.0, 1.0])));
        assert!(in_contact(&base(), &t([1.0, 0.0, 0.0], [1.0, 1.0, 0.0])));
        assert!(in_contact(&base(), &t([1.0, 0.0, 0.1], [1.0, 0.0, 2.0])));
        assert!(in_contact(&base(), &t([9.0, 0.0, 0.1], [9.0, 9.0, 0.0])));
    }

    #[test]
    fn with_a_common_edge() {
        let t = |q: [f64; 3]| triangle([1, 0, 7], [[4.0, 0.0, 0.0], [0.0; 3], q]);
        assert!(!in_contact(&base(), &t([0.0, 1e-300, 1.0])));
        assert!(!in_contact(&base(), &t([1.0, 0.0, -1.0])));
        assert!(in_contact(&base(), &t([3.0, 0.0, 5.0])));
    }

    type Integer = [i64; 3];

    fn minus(a: Integer, b: Integer) -> Integer {
        [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
    }

    fn cross(a: Integer, b: Integer) -> Integer {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    }

    /// Separating axes in integers: a second, unrelated answer to whether convex hulls meet.
    fn hulls_meet(s: &[Integer; 3], t: &[Integer; 3]) -> bool {
        let edges = |t: &[Integer; 3]| [0, 1, 2].map(|k| minus(t[(k + 1) % 3], t[k]));
        let (es, et) = (edges(s), edges(t));
        let normals = [cross(es[0], es[1]), cross(et[0], et[1])];
        let mut axes = normals.to_vec();
        for &e in &es {
            axes.extend(et.iter().map(|&f| cross(e, f)));
        }
        for &n in &normals {
            axes.extend(es.iter().chain(&et).map(|&e| cross(n, e)));
        }
        axes.extend(es.iter().chain(&et));
        let span = |axis: &Integer, t: &[Integer; 3]| {
            let at = t.map(|p| (0..3).map(|k| axis[k] * p[k]).sum::<i64>());
            (*at.iter().min().unwrap(), *at.iter().max().unwrap())
        };
        axes.iter().all(|axis| {
            let ((low_s, high_s), (low_t, high_t)) = (span(axis, s), span(axis, t));
            low_s <= high_t && low_t <= high_s
        })
    }

    fn real(p: Integer) -> [f64; 3] {
        p.map(|x| x as f64)
    }

    fn flat(t: &[Integer; 3]) -> bool {
        cross(minus(t[1], t[0]), minus(t[2], t[0])) == [0; 3]
    }

    fn lattice() -> impl Strategy<Value = [Integer; 3]> {
        prop::array::uniform3((0i64..5, 0i64..5, 0i64..3).prop_map(|(x, y, z)| [x, y, z]))
            .prop_filter("has an area", |t| !flat(t))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn separating_axes_agree(s in lattice(), t in lattice()) {
            let found = in_contact(
                &triangle([0, 1, 2], s.map(real)),
                &triangle([3, 4, 5], t.map(real)),
            );
            prop_assert_eq!(found, hulls_meet(&s, &t));
        }

        /// Triangles with a common corner meet beyond it if the opposite edge of one meets the cone of the other.
        #[test]
        fn separating_axes_agree_at_a_common_corner(s in lattice(), t in lattice()) {
            let t = [s[0], t[1], t[2]];
            prop_assume!(!flat(&t));
            let cone = |t: &[Integer; 3]| {
                let far = |p: Integer| [0, 1, 2].map(|k| t[0][k] + 10_000 * (p[k] - t[0][k]));
                [t[0], far(t[1]), far(t[2])]
            };
            let expected = hulls_meet(&[s[1], s[2], s[2]], &cone(&t));
            let found = in_contact(
                &triangle([0, 1, 2], s.map(real)),
                &triangle([4, 5, 0], [t[1], t[2], t[0]].map(real)),
            );
            prop_assert_eq!(found, expected);
        }
    }
}
