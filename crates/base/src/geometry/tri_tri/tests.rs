//! Intersection of triangles, compared with the separating axis theorem in integer arithmetic.

use super::*;
use proptest::prelude::*;

type I3 = [i64; 3];

fn isub(a: I3, b: I3) -> I3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn icross(a: I3, b: I3) -> I3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// True if two convex polygons (or segments) intersect: no axis normal to a facet of their
/// difference separates them.
fn reference(a: &[I3], b: &[I3]) -> bool {
    let edges = |p: &[I3]| (0..p.len()).map(|i| isub(p[(i + 1) % p.len()], p[i])).collect::<Vec<_>>();
    let (ea, eb) = (edges(a), edges(b));
    let normals = [icross(ea[0], ea[1]), icross(eb[0], eb[1])];
    let mut axes: Vec<I3> = normals.to_vec();
    axes.extend(ea.iter().flat_map(|&u| eb.iter().map(move |&v| icross(u, v))));
    for n in normals {
        axes.extend(ea.iter().chain(&eb).map(|&e| icross(n, e)));
    }
    let range = |p: &[I3], n: I3| {
        let dots = p.iter().map(|q| q.iter().zip(n).map(|(x, y)| i128::from(*x) * i128::from(y)).sum::<i128>());
        (dots.clone().min().expect("points"), dots.max().expect("points"))
    };
    !axes.into_iter().any(|n| {
        let ((a0, a1), (b0, b1)) = (range(a, n), range(b, n));
        a1 < b0 || b1 < a0
    })
}

fn triangle(p: [I3; 3]) -> Triangle {
    Triangle::new(p.map(|q| q.map(|x| x as f64)))
}

/// [`meet_in_mesh`]. The filter for meshes must not contradict it.
fn meet_as_mesh((a, na): (&Triangle, [u32; 3]), (b, nb): (&Triangle, [u32; 3])) -> bool {
    let meets = meet_in_mesh((a, na), (b, nb));
    assert!(!meets || !a.clears_in_mesh(na, b.points, nb) && !b.clears_in_mesh(nb, a.points, na));
    meets
}

fn point(n: i64) -> impl Strategy<Value = I3> {
    prop::array::uniform3(-n..=n)
}

/// The part of a triangle beyond the midpoints of the two edges at its first corner, scaled by 2.
fn beyond_the_middle(t: [I3; 3]) -> [I3; 4] {
    let add = |a: I3, b: I3| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
    [add(t[0], t[1]), add(t[1], t[1]), add(t[2], t[2]), add(t[0], t[2])]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn meet_is_exact(a in prop::array::uniform3(point(3)), b in prop::array::uniform3(point(3))) {
        let (ta, tb) = (triangle(a), triangle(b));
        prop_assume!(!ta.is_degenerate() && !tb.is_degenerate());
        prop_assert_eq!(meet(&ta, &tb), reference(&a, &b));
        prop_assert_eq!(meet(&tb, &ta), reference(&a, &b));
        prop_assert_eq!(meet_as_mesh((&ta, [0, 1, 2]), (&tb, [3, 4, 5])), reference(&a, &b));
        prop_assert!(meet_as_mesh((&ta, [0, 1, 2]), (&ta, [1, 2, 0])), "the same vertices");
    }

    #[test]
    fn meet_is_exact_in_a_plane(a in prop::array::uniform6(-4i64..=4), b in prop::array::uniform6(-4i64..=4)) {
        // The plane z = x + 2y.
        let lift = |c: [i64; 6]| [0, 1, 2].map(|i| [c[2 * i], c[2 * i + 1], c[2 * i] + 2 * c[2 * i + 1]]);
        let (a, b) = (lift(a), lift(b));
        let (ta, tb) = (triangle(a), triangle(b));
        prop_assume!(!ta.is_degenerate() && !tb.is_degenerate());
        prop_assert_eq!(meet(&ta, &tb), reference(&a, &b));
    }

    #[test]
    fn corners_are_exact(v in point(2), a in prop::array::uniform2(point(3)), b in prop::array::uniform2(point(3)),
                         i in 0usize..3, j in 0usize..3) {
        let (mut a, mut b) = ([v, a[0], a[1]], [v, b[0], b[1]]);
        let double = |t: [I3; 3]| t.map(|p| p.map(|x| 2 * x));
        let expected = reference(&beyond_the_middle(a), &double(b)) || reference(&double(a), &beyond_the_middle(b));
        a.rotate_right(i);
        b.rotate_right(j);
        let (ta, tb) = (triangle(a), triangle(b));
        prop_assume!(!ta.is_degenerate() && !tb.is_degenerate());
        prop_assert_eq!(meet_beyond_corner(&ta, i, &tb, j), expected);
        let (mut na, mut nb) = ([0, 1, 2], [0, 3, 4]);
        na.rotate_right(i);
        nb.rotate_right(j);
        prop_assert_eq!(meet_as_mesh((&ta, na), (&tb, nb)), expected);
    }

    #[test]
    fn edges_are_exact(u in point(2), v in point(2), a in point(2), b in point(2), i in 0usize..3, j in 0usize..3) {
        let (ta, tb) = (triangle([u, v, a]), triangle([b, v, u]));
        prop_assume!(!ta.is_degenerate() && !tb.is_degenerate());
        let (na, nb) = (icross(isub(v, u), isub(a, u)), icross(isub(v, u), isub(b, u)));
        let folded = icross(na, nb) == [0, 0, 0] && na.iter().zip(nb).map(|(x, y)| x * y).sum::<i64>() > 0;
        prop_assert_eq!(overlap_across_edge(&ta, 2, &tb, 0), folded);
        let (mut a, mut na, mut b, mut nb) = ([u, v, a], [0, 1, 2], [b, v, u], [3, 1, 0]);
        a.rotate_right(i);
        na.rotate_right(i);
        b.rotate_right(j);
        nb.rotate_right(j);
        prop_assert_eq!(meet_as_mesh((&triangle(a), na), (&triangle(b), nb)), folded);
    }

    #[test]
    fn scale_does_not_matter(a in prop::array::uniform3(point(3)), b in prop::array::uniform3(point(3)), e in -120i32..120) {
        let scaled = |p: [I3; 3]| Triangle::new(p.map(|q| q.map(|x| x as f64 * f64::powi(2.0, e))));
        prop_assume!(!triangle(a).is_degenerate() && !triangle(b).is_degenerate());
        prop_assert_eq!(meet(&scaled(a), &scaled(b)), reference(&a, &b));
    }
}

#[test]
fn a_triangle_without_area_is_degenerate() {
    let of = |c: f64| Triangle::new([[0.1, 0.2, 0.7], [0.3, 0.6, 0.1], [0.2, c, 0.4]].map(|p| p.map(|x| x * 1e-5)));
    let [a, b, _] = of(0.4).points;
    let middle = [0, 1, 2].map(|axis| 0.5 * (a[axis] + b[axis]));
    let third = Triangle::new([a, b, [b[0] + (b[0] - a[0]), b[1] + (b[1] - a[1]), b[2] + (b[2] - a[2])]]);
    for t in [of(0.4), of(0.400_000_1), Triangle::new([a, b, middle]), Triangle::new([a, a, b]), third] {
        assert_eq!(t.is_degenerate(), t.projection_axis().is_none());
    }
    assert!(Triangle::new([a, a, b]).is_degenerate() && !of(0.5).is_degenerate());
}

#[test]
fn one_bit_decides() {
    let floor = Triangle::new([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let above = |z: f32| Triangle::new([[0.2, 0.2, f64::from(z)], [0.3, 0.2, 1.0], [0.2, 0.3, 1.0]]);
    assert!(meet(&floor, &above(0.0)));
    assert!(!meet(&floor, &above(f32::from_bits(1))));
    assert!(meet(&floor, &above(-f32::from_bits(1))));
}
