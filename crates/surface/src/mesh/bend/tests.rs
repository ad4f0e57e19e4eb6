//! Bent surfaces: what bending preserves, and that mended surfaces do not intersect themselves.

use super::*;
use crate::geometry::course::{RandomCourse, Turn};
use crate::mesh::lean::tests::{leaning, pressed};
use crate::mesh::{intersection, regions};
use crate::model::sample::tube;
use proptest::prelude::*;
use std::collections::HashSet;
use std::f64::consts::PI;

fn volume(mesh: &Mesh) -> f64 {
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| glam::Vec3::from(mesh.positions[v as usize]).as_dvec3());
        a.dot(b.cross(c)) / 6.0
    };
    mesh.triangles.iter().map(of).sum()
}

fn is_closed(mesh: &Mesh) -> bool {
    let edges: HashSet<_> = mesh.triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
    edges.len() == 3 * mesh.triangles.len() && edges.iter().all(|&(a, b)| edges.contains(&(b, a)))
}

#[test]
fn a_bent_tube_keeps_its_volume_and_its_sections() {
    let straight = tube(96, 64, 0.2);
    let course = Course::arc(PI / 2.0, 4000.0, 256, 0.0);
    let bent = bend(&straight, &course);
    // Pappus: the centre of each section is on the centre line.
    assert!((volume(&bent) / volume(&straight) - 1.0).abs() < 1e-3, "{}", volume(&bent) / volume(&straight));
    let distance = |mesh: &Mesh, v: usize, w: usize| {
        glam::Vec3::from(mesh.positions[v]).distance(glam::Vec3::from(mesh.positions[w]))
    };
    for (v, w) in [(0, 48), (96, 120), (64 * 96, 64 * 96 + 20)] {
        assert_eq!(straight.positions[v][2], straight.positions[w][2]);
        assert!((distance(&bent, v, w) - distance(&straight, v, w)).abs() < 1e-9);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn no_edge_is_farther_from_its_image_than_a_hundredth_of_the_radius(
        slabs in 6_u32..80,
        shape in 0_usize..5,
        bend in 0.25..0.75,
        seed in 0_u64..100,
    ) {
        // The outer wall has a radius of 1 mm, and the tightest bend about one of 1 mm / `bend`.
        // All courses have room for the tube, so that few pairs of triangles intersect.
        let radius = 1000.0;
        let tight = radius / bend;
        let length = match shape {
            0 => 4.0 * tight,
            1 => 1.2 * PI * tight,
            _ => 40_000.0,
        };
        let mut mesh = tube(24, slabs, 0.2);
        mesh.positions.iter_mut().for_each(|p| p[2] *= (length / 4000.0) as f32);
        let course = match shape {
            0 => Course::arc(4.0, length, 2048, 0.0),
            1 => Course::sigmoid(1.2, length, 2048, 1.0),
            2 => Course::coil(length / (2.0 * PI * tight), 2500.0, length, 2048, 0.0).unwrap(),
            3 => {
                let random = RandomCourse { seed, wavelength: 25_000.0, tortuosity: 1.2 };
                Course::random(&random, length, 2048, -1.0).unwrap()
            }
            _ => {
                let share = PI * tight / (0.8 * length);
                let turn = |at, toward| Turn { at, angle: PI, toward, share };
                Course::turns(&[turn(0.25, seed as f64), turn(0.75, 1.0)], length, 2048, 0.0)
            }
        };
        let before = mesh.positions.len();
        let (bent, done, _) = bend_apart(&mut mesh, None, &course, &|| false);
        prop_assert_eq!(mesh.positions.len(), before + done.split);
        prop_assert!(is_closed(&bent));
        for edge in mesh.triangles.iter().flat_map(|&triangle| edges_of(triangle)) {
            let [p, q] = [edge.0, edge.1].map(|v| mesh.positions[v as usize].map(f64::from));
            for part in [0.25, 0.5, 0.75] {
                let between = |a: f64, b: f64| a + part * (b - a);
                let straight = [0, 1, 2].map(|axis| between(p[axis], q[axis]));
                let image = DVec3::from(place(&course, straight));
                let chord = DVec3::from(place(&course, p)).lerp(DVec3::from(place(&course, q)), part);
                let off = 1e6 * image.distance(chord);
                prop_assert!(off < 1.01 * image::PART_OF_RADIUS * radius, "{:?}: {} um at {}", edge, off, part);
            }
        }
    }
}

#[test]
fn straight_parts_of_a_course_are_not_split() {
    let mut mesh = tube(24, 20, 0.2);
    mesh.positions.iter_mut().for_each(|p| p[2] *= 10.0);
    let turn = Turn { at: 0.5, angle: PI, toward: 0.0, share: 0.2 };
    let before = mesh.positions.len();
    let (_, done, _) = bend_apart(&mut mesh, None, &Course::turns(&[turn], 40_000.0, 2048, 0.0), &|| false);
    assert!(done.split > 0);
    for p in &mesh.positions[before..] {
        assert!((0.39..0.61).contains(&(f64::from(p[2]) / 0.04)), "{p:?}");
    }
}

#[test]
fn a_surface_that_would_meet_itself_is_refined_until_it_does_not() {
    let (before, lean, z) = leaning();
    // The curve has about 1.25 radii of the widest section, which is twice as tight as allowed.
    let course = Course::arc(6.0, 12_000.0, 512, 0.5);
    let met = intersection::all_pairs(&bend(&before, &course)).len();
    assert!(met > 0, "too mild to test");
    let mut mesh = before.clone();
    let (bent, done, split) = bend_apart(&mut mesh, Some(Leaning { lean: &lean, z }), &course, &|| false);
    assert!((1..=met).contains(&done.met), "{done:?} of {met}");
    // The lean was damped until triangles barely separated, so only rounding keeps some of them
    // apart.
    assert!(done.damped < met / 100, "{done:?}");
    assert!(done.split > 0 && mesh.positions.len() == before.positions.len() + done.split, "{done:?}");
    assert!(intersection::all_pairs(&bent).is_empty(), "{done:?}");
    assert!(bent == bend(&mesh, &course));
    assert!(is_closed(&bent));
    // The straight surface is the same set of points, except for rounding and for places with
    // damped lean.
    let pairs = || before.positions.iter().zip(&mesh.positions);
    assert!(pairs().all(|(before, after)| before[..2] == after[..2]));
    assert!(pairs().filter(|(before, after)| before[2] != after[2]).count() < before.positions.len() / 100);
    assert!((volume(&mesh) / volume(&before) - 1.0).abs() < 1e-5);
    let covered: Vec<usize> = mesh.patches.iter().flat_map(|patch| patch.triangles.clone()).collect();
    assert_eq!(covered, (0..mesh.triangles.len()).collect::<Vec<_>>());
    assert_eq!((split.len(), mesh.positions.len()), (done.split, before.positions.len() + done.split));
    for (m, &(v, w)) in (before.positions.len()..).zip(&split) {
        let [p, q] = [v, w].map(|v| mesh.positions[v as usize].map(f64::from));
        // Along the tube, damping may have separated them.
        assert_eq!(mesh.positions[m][..2], middle(p, q).map(|x| x as f32)[..2]);
    }
    // Rims are unchanged, so lids still fit.
    let regions = regions(&mesh).unwrap();
    assert!(intersection::all_pairs(&bend(&regions, &course)).is_empty());
    assert_eq!(bend_apart(&mut before.clone(), None, &course, &|| true).1.split, 0, "stopped");
}

#[test]
fn triangles_longer_than_the_course_is_wide_are_split_before_they_are_searched() {
    // 400 mm in fifteen windings of 4 mm radius, with fewer than three sections per winding.
    let mut straight = tube(24, 40, 0.2);
    straight.positions.iter_mut().for_each(|p| p[2] *= 100.0);
    let course = Course::coil(15.0, 4000.0, 400_000.0, 4096, 0.0).unwrap();
    let before = volume(&straight);
    let (bent, done, _) = bend_apart(&mut straight, None, &course, &|| false);
    assert!(intersection::all_pairs(&bent).is_empty() && is_closed(&bent), "{done:?}");
    assert!(done.split > 0 && (volume(&bent) / before - 1.0).abs() < 0.1, "{done:?}: {}", volume(&bent) / before);
}

#[test]
fn where_finer_triangles_do_not_help_the_lean_is_damped() {
    let (mut mesh, lean, z) = pressed();
    let course = Course::arc(6.0, 12_000.0, 512, 0.5);
    let before = mesh.clone();
    let (bent, done, _) = bend_apart(&mut mesh, Some(Leaning { lean: &lean, z }), &course, &|| false);
    assert!(done.damped > 0, "too mild to test: {done:?}");
    assert!(intersection::all_pairs(&bent).is_empty() && is_closed(&bent), "{done:?}");
    let moved = |axis: usize| (0..before.positions.len()).any(|v| before.positions[v][axis] != mesh.positions[v][axis]);
    assert!(!moved(0) && !moved(1) && moved(2), "along the tube only");
    let (mut undamped, ..) = pressed();
    let (bent, ..) = bend_apart(&mut undamped, None, &course, &|| false);
    assert!(!intersection::all_pairs(&bent).is_empty(), "needs no damping");
}

#[test]
fn edges_are_halved_in_all_combinations() {
    let all = [(0, 1), (1, 2), (0, 2), (2, 3), (0, 3), (1, 3)];
    let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
    let patches = vec![Patch { kind: crate::model::PatchKind::OuterWall, triangles: 0..4 }];
    let whole = Mesh { body: crate::model::BodyKind::Lumen, positions, triangles, patches };
    for chosen in 0..64_u32 {
        let mut edges: Vec<(u32, u32)> = (0..6).filter(|k| chosen >> k & 1 == 1).map(|k| all[k as usize]).collect();
        edges.sort_unstable();
        let mut mesh = whole.clone();
        halve(&mut mesh, &edges);
        assert!(is_closed(&mesh) && (volume(&mesh) - 1.0 / 6.0).abs() < 1e-7, "{edges:?}");
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (4 + edges.len(), 4 + 2 * edges.len()));
        assert_eq!(mesh.patches[0].triangles, 0..mesh.triangles.len());
    }
}

#[test]
fn triangles_that_are_split_again_and_again_do_not_become_ever_flatter() {
    let height = |mesh: &Mesh| {
        let of = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| glam::Vec3::from(mesh.positions[v as usize]).as_dvec3());
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            (b - a).cross(c - a).length() / (longest * longest)
        };
        mesh.triangles.iter().map(of).fold(f64::INFINITY, f64::min)
    };
    let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.1, 0.2], [0.2, 1.0, 0.4], [0.1, 0.3, 1.1]];
    let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
    let patches = vec![Patch { kind: crate::model::PatchKind::OuterWall, triangles: 0..4 }];
    let mut mesh = Mesh { body: crate::model::BodyKind::Lumen, positions, triangles, patches };
    let first = height(&mesh);
    for round in 0..20 {
        let edge = edges_of(mesh.triangles[0])[round % 3];
        let edges = with_longest(&mesh, vec![edge]);
        assert!(edges.contains(&edge) && edges.is_sorted());
        halve(&mut mesh, &edges);
        assert!(is_closed(&mesh), "round {round}");
    }
    assert!(height(&mesh) > 0.2 * first, "{} of {first}", height(&mesh));
}
