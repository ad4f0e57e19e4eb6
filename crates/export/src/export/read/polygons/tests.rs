//! Tests of faces in any plane.

use super::*;
use crate::export::read::surface::Group;
use crate::geometry::vector::{cross, dot, sub};
use proptest::prelude::*;
use std::f64::consts::TAU;

/// Points of the plane, placed in space.
fn placed(points: &[[f64; 2]], turn: [f64; 3]) -> Vec<[f64; 3]> {
    let (sin, cos) = (turn.map(f64::sin), turn.map(f64::cos));
    let place = |[x, y]: [f64; 2]| {
        let (x, y) = (x * cos[0] - y * sin[0], x * sin[0] + y * cos[0]);
        let (y, z) = (y * cos[1], y * sin[1]);
        [x * cos[2] - z * sin[2] + 3.0, y - 5.0, x * sin[2] + z * cos[2] + 7.0]
    };
    points.iter().copied().map(place).collect()
}

fn split(points: Vec<[f64; 3]>) -> Result<Surface, String> {
    let corners: Vec<u32> = (0..points.len() as u32).collect();
    split_corners(points, &corners)
}

fn split_corners(points: Vec<[f64; 3]>, corners: &[u32]) -> Result<Surface, String> {
    let mut surface = Surface { positions: points, ..Surface::default() };
    let mut polygons = Polygons::default();
    polygons.add(&mut surface, corners, 7).unwrap();
    polygons.split(&mut surface, |line| format!("line {line}")).map_err(|error| error.to_string())?;
    Ok(surface)
}

/// Area vector of a closed line or of triangles.
fn area(points: &[[f64; 3]]) -> [f64; 3] {
    let ends = points.iter().cycle().skip(1);
    let terms = points.iter().zip(ends).map(|(&a, &b)| cross(sub(a, points[0]), sub(b, points[0])));
    terms.fold([0.0; 3], |sum, term| [0, 1, 2].map(|k| sum[k] + term[k]))
}

fn length(v: [f64; 3]) -> f64 {
    dot(v, v).sqrt()
}

/// Asserts n − 2 triangles whose areas add up to that of the polygon, all of the same side.
fn assert_covered(points: &[[f64; 3]]) {
    let surface = split(Vec::from(points)).unwrap();
    assert_eq!(surface.triangles.len(), points.len() - 2);
    let whole = length(area(points));
    let parts: f64 = surface.triangles.iter().map(|t| length(area(&t.map(|v| points[v as usize])))).sum();
    assert!((parts / whole - 1.0).abs() < 1e-9, "{parts}, not {whole}");
    assert_eq!(surface.notes, [""; 0]);
}

const ELL: [[f64; 2]; 6] = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]];

#[test]
fn a_face_whose_fan_covers_it_stays_that_fan() {
    for count in [4, 5, 8, 100] {
        let at = |k: usize| TAU * k as f64 / count as f64;
        let round: Vec<[f64; 2]> = (0..count).map(|k| [at(k).cos(), at(k).sin()]).collect();
        let fan: Vec<[u32; 3]> = (2..count as u32).map(|k| [0, k - 1, k]).collect();
        assert_eq!(split(placed(&round, [0.3, 0.8, 1.1])).unwrap().triangles, fan);
    }
    // Concave, but seen from the first corner as a whole.
    assert_eq!(split(placed(&ELL, [0.0; 3])).unwrap().triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]);
}

#[test]
fn a_fan_that_leaves_the_face_is_replaced() {
    let mut ell = ELL;
    ell.rotate_left(1);
    assert_covered(&placed(&ell, [0.0; 3]));
    assert_covered(&placed(&ell, [1.0, 2.0, 3.0]));
    // A quadrilateral has one other fan.
    let arrow = [[0.0, 1.0], [-1.0, -1.0], [0.0, 0.0], [1.0, -1.0]];
    assert_eq!(split(placed(&arrow, [0.0; 3])).unwrap().triangles, [[0, 1, 2], [0, 2, 3]]);
    let mut arrow = arrow;
    arrow.rotate_left(1);
    assert_eq!(split(placed(&arrow, [0.0; 3])).unwrap().triangles, [[1, 2, 3], [1, 3, 0]]);
}

#[test]
fn a_spiral_around_its_first_corner_is_no_fan() {
    // Every triangle of the fan is counter-clockwise, but together they turn by more than a full
    // turn.
    let at = |angle: f64, r: f64| [r * angle.cos(), r * angle.sin()];
    let mut spiral: Vec<[f64; 2]> = (0..12).map(|k| at(0.6 * f64::from(k), 1.0 + 0.3 * f64::from(k))).collect();
    spiral.insert(0, [0.0, 0.0]);
    let refused = split(placed(&spiral, [0.2, 0.4, 0.6])).unwrap_err();
    assert!(refused.starts_with("line 7: the face of 13 corners crosses or touches itself"), "{refused}");
}

#[test]
fn corners_on_straight_edges_make_no_triangle_without_area() {
    let points = [[1.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [0.0, 1.0], [0.0, 0.0]];
    assert_covered(&placed(&points, [0.0; 3]));
    assert_covered(&placed(&points, [0.7, 0.9, 0.1]));
}

#[test]
fn repeated_corners_add_nothing() {
    let mut points = placed(&ELL[..4], [0.0; 3]);
    points.push(points[3]);
    points.push(points[0]);
    let surface = split(points).unwrap();
    assert_eq!(surface.triangles, [[0, 1, 2], [0, 2, 3]]);
    let surface = split(placed(&[[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [1.0, 0.0]], [0.0; 3])).unwrap();
    assert_eq!(surface.triangles, [[0; 3]; 0]);
    let note = "1 face has fewer than three different corners and is passed over (first: line 7)";
    assert_eq!(surface.notes, [note]);
    // The certificate judges a triangle that repeats a vertex.
    let mut surface = Surface { positions: placed(&ELL[..2], [0.0; 3]), ..Surface::default() };
    let mut polygons = Polygons::default();
    polygons.add(&mut surface, &[0, 1, 1], 1).unwrap();
    polygons.split(&mut surface, |line| format!("line {line}")).unwrap();
    assert_eq!((surface.triangles, surface.notes), (vec![[0, 1, 1]], Vec::new()));
}

#[test]
fn groups_follow_the_triangles() {
    let points = placed(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0], [2.0, 1.0]], [0.0; 3]);
    let mut surface = Surface { positions: points, ..Surface::default() };
    let mut polygons = Polygons::default();
    for (place, face) in [&[0, 1, 2, 3][..], &[0, 1, 2, 4, 3], &[2, 4, 2, 4], &[0, 1, 2]].iter().enumerate() {
        let first = surface.triangles.len();
        polygons.add(&mut surface, face, place as u64).unwrap();
        surface.groups.push(Group { name: place.to_string().into(), triangles: first..surface.triangles.len() });
    }
    polygons.split(&mut surface, |face| format!("face {face}")).unwrap();
    assert_eq!(surface.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [0, 1, 2]]);
    let groups: Vec<_> = surface.groups.iter().map(|group| (&*group.name, group.triangles.clone())).collect();
    assert_eq!(groups, [("0", 0..2), ("1", 2..4), ("3", 4..5)]);
}

#[test]
fn a_hole_on_a_bridge_stays_open() {
    // The corners of the bridge are other vertices at the same positions.
    let flat = [
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
    let points = placed(&flat, [0.0, 0.5, 0.25]);
    let surface = split(points.clone()).unwrap();
    let parts: f64 = surface.triangles.iter().map(|t| length(area(&t.map(|v| points[v as usize])))).sum();
    assert_eq!(surface.triangles.len(), 8);
    assert!((parts / 24.0 - 1.0).abs() < 1e-12, "{parts}");
}

#[test]
fn unsound_flat_faces_are_refused_and_others_named() {
    let bow = [[0.0, 0.0], [3.0, 3.0], [3.0, 0.0], [0.0, 2.0]];
    let refused = split(placed(&bow, [0.0; 3])).unwrap_err();
    assert!(refused.starts_with("line 7: the face of 4 corners crosses or touches itself on the edge"), "{refused}");
    // Both halves of this one have the same area, so that it has none.
    let refused = split(placed(&[[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]], [0.5; 3])).unwrap_err();
    assert!(refused.contains("crosses or touches itself"), "{refused}");
    // The first one, bent out of its plane so that it does not cross itself.
    let mut bent = placed(&bow, [0.0; 3]);
    bent[1][2] += 1.0;
    let surface = split(bent).unwrap();
    assert_eq!(surface.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert!(surface.notes[0].starts_with("1 face is not flat: a corner lies more than a thousandth"));
    assert!(surface.notes[0].ends_with("(first: line 7)"));
}

#[test]
fn faces_that_cannot_be_judged_stay_fans() {
    let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    for spoil in [f64::NAN, f64::INFINITY, 1e200] {
        let mut points = placed(&square, [0.0; 3]);
        points[1][0] = spoil;
        assert_eq!(split(points).unwrap().triangles, [[0, 1, 2], [0, 2, 3]]);
    }
    let line = placed(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]], [0.4, 0.5, 0.6]);
    assert_eq!(split(line).unwrap().triangles, [[0, 1, 2], [0, 2, 3]]);
    // Coordinates too small for the triangulation count as zero.
    let tiny: Vec<[f64; 3]> = ELL.iter().cycle().skip(1).take(6).map(|p| [p[0], p[1], 1e-300]).collect();
    assert_eq!(split(tiny).unwrap().triangles.len(), 4);
}

#[test]
fn a_face_of_a_million_corners_is_a_fan_or_refused() {
    let round = |count: usize, inner: f64| {
        let at = |k: usize| {
            let (angle, r) = (TAU * k as f64 / count as f64, if k.is_multiple_of(2) { 1.0 } else { inner });
            [r * angle.cos(), r * angle.sin()]
        };
        placed(&(0..count).map(at).collect::<Vec<_>>(), [0.0; 3])
    };
    assert_eq!(split(round(20_000, 0.6)).unwrap().triangles.len(), 19_998);
    let million = split(round(1_000_000, 1.0)).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(million.triangles.last(), Some(&[0, 999_998, 999_999]));
    let refused = split(round(1_000_000, 0.6)).unwrap_err();
    let start = "line 7: the face of 1000000 corners is concave, and at most 30000 corners of a concave face are read";
    assert!(refused.starts_with(start), "{refused}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn stars_in_any_plane_are_covered(
        radii in prop::collection::vec(0.2_f64..2.0, 5..120),
        turn in prop::array::uniform3(-3.0_f64..3.0),
    ) {
        let n = radii.len() as f64;
        let at = |(k, r): (usize, &f64)| [r * (TAU * k as f64 / n).cos(), r * (TAU * k as f64 / n).sin()];
        assert_covered(&placed(&radii.iter().enumerate().map(at).collect::<Vec<_>>(), turn));
    }

    #[test]
    fn combs_in_any_plane_are_covered(
        heights in prop::collection::vec(0.05_f64..20.0, 1..60),
        turn in prop::array::uniform3(-3.0_f64..3.0),
        start in any::<prop::sample::Index>(),
    ) {
        let mut points = vec![[0.0, -1.0], [heights.len() as f64, -1.0]];
        for (k, &height) in heights.iter().enumerate().rev() {
            let x = k as f64;
            points.extend([[x + 0.9, 0.0], [x + 0.6, height], [x + 0.4, height], [x + 0.1, 0.0]]);
        }
        let start = start.index(points.len());
        points.rotate_left(start);
        assert_covered(&placed(&points, turn));
    }

    #[test]
    fn any_corners_stay_in_range(
        points in prop::collection::vec(prop::array::uniform3(-2_i8..3), 1..8),
        corners in prop::collection::vec(any::<prop::sample::Index>(), 0..9),
    ) {
        let corners: Vec<u32> = corners.iter().map(|index| index.index(points.len()) as u32).collect();
        if let Ok(surface) = split_corners(points.iter().map(|p| p.map(f64::from)).collect(), &corners) {
            prop_assert!(surface.triangles.as_flattened().iter().all(|corner| corners.contains(corner)));
            prop_assert!(surface.triangles.len() <= corners.len().saturating_sub(2));
        }
    }
}
