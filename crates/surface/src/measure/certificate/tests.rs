//! Surfaces that pass and surfaces that fail.

use super::samples::{Soup, cube, flipped, folded_tube, tetrahedron, together, torus};
use super::*;
use crate::geometry::tri_tri::{Triangle, meet, meet_beyond_corner, overlap_across_edge};
use crate::model::Ring;
use proptest::prelude::*;

fn judge(soup: &Soup) -> Certificate {
    check_surface(&soup.0, &soup.1, &CheckOptions::default())
}

#[track_caller]
fn assert_fails(soup: &Soup, kind: FailureKind, count: u64) -> Certificate {
    let certificate = judge(soup);
    assert!(!certificate.passed);
    let failure = certificate.failures.iter().find(|f| f.kind == kind);
    assert_eq!(failure.map(|f| f.count), Some(count), "{kind:?} in {:?}", certificate.failures);
    certificate
}

#[track_caller]
fn assert_passes(soup: &Soup) -> Certificate {
    let certificate = judge(soup);
    assert!(certificate.passed, "{:?}", certificate.failures);
    assert!(certificate.closed && certificate.manifold && certificate.oriented);
    certificate
}

#[test]
fn sound_bodies_pass_with_their_measures() {
    let c = assert_passes(&cube(1e-3, [0.0; 3]));
    assert_eq!((c.euler, c.components, c.vertices, c.triangles), (2, 1, 8, 12));
    assert!((c.volume_mm3 - 1.0).abs() < 1e-12 && (c.area_mm2 - 6.0).abs() < 1e-12);
    assert!((c.min_edge_um - 1e3).abs() < 1e-9 && (c.min_angle_deg - 45.0).abs() < 1e-9);
    assert_eq!(c.bounds_um[0], [0.0; 3]);
    assert_eq!((c.quality.edge_ratios[0], c.quality.edge_ratios_to_4, c.quality.least_angles_from_20), (12, 1.0, 1.0));
    assert_eq!(c.quality.least_angles[8..10].iter().sum::<u64>(), 12, "45 degrees");
    assert_eq!(c.min_gap_um, None);
    let (positions, triangles) = cube(1.0, [0.0; 3]);
    let millimetres = check_surface(&positions, &triangles, &CheckOptions { unit_metres: 1e-3, ..Default::default() });
    assert!((millimetres.volume_mm3 - 1.0).abs() < 1e-12 && (millimetres.bounds_um[1][0] - 1e3).abs() < 1e-9);
    assert!((millimetres.area_mm2 - 6.0).abs() < 1e-12 && (millimetres.bodies[0].volume_mm3 - 1.0).abs() < 1e-12);
    let t = assert_passes(&torus(40, 20));
    assert_eq!((t.euler, t.components), (0, 1));
    let t = assert_passes(&tetrahedron(1.0, [5.0; 3]));
    assert!((t.volume_mm3 / 1e9 - 1.0 / 6.0).abs() < 1e-12);
}

#[test]
fn scale_and_place_do_not_matter() {
    for size in [1e-30, 1e-9, 1.0, 1e9, 1e30] {
        assert_passes(&cube(size, [0.0; 3]));
        assert_passes(&cube(size, [size * 1e6; 3]));
        let crossing = together([cube(size, [0.0; 3]), cube(size, [size * 0.5; 3])]);
        assert!(judge(&crossing).triangle_intersections > 0);
    }
}

#[test]
fn separate_and_nested_bodies() {
    let two = assert_passes(&together([cube(1.0, [100.0, 0.0, 0.0]), torus(12, 8)]));
    assert_eq!((two.components, two.euler), (2, 2));
    assert_eq!(two.bodies.iter().map(|b| b.euler).collect::<Vec<_>>(), [2, 0]);
    let cavity = together([cube(4.0, [0.0; 3]), flipped(cube(1.0, [1.5; 3]))]);
    assert!((assert_passes(&cavity).volume_mm3 / 1e9 - 63.0).abs() < 1e-9);
    let beside = together([cube(4.0, [0.0; 3]), flipped(cube(1.0, [9.0; 3]))]);
    assert_fails(&beside, FailureKind::Volume, 1);
    assert_fails(&flipped(cube(4.0, [0.0; 3])), FailureKind::Volume, 1);
    let within = together([cube(4.0, [0.0; 3]), cube(1.0, [1.5; 3])]);
    assert_fails(&within, FailureKind::Overlap, 1);
    // A body in a cavity and a cavity in that body; then a body instead of the inner cavity.
    let shells = [4.0, 3.0, 2.0, 1.0].map(|side| cube(side, [-0.5 * side; 3]));
    let [a, b, c, d] = shells;
    let onion = together([a.clone(), flipped(b.clone()), c.clone(), flipped(d.clone())]);
    assert!((assert_passes(&onion).volume_mm3 / 1e9 - 44.0).abs() < 1e-9);
    assert_fails(&together([a, flipped(b), c, d]), FailureKind::Overlap, 1);
}

#[test]
fn many_components_take_time_for_each_and_not_for_each_pair() {
    // 200,000 separate bodies, and one cavity in one of them.
    let at = |i: u32| [i % 60, i / 60 % 60, i / 3_600].map(|x| 2.0 * f64::from(x));
    let bodies =
        (0..200_000).map(|i| tetrahedron(1.0, at(i))).chain([flipped(tetrahedron(0.1, at(7).map(|x| x + 0.1)))]);
    let found = assert_passes(&together(bodies));
    assert_eq!((found.components, found.bodies.len()), (200_001, 256));
}

#[test]
fn crossing_and_touching_bodies_are_found() {
    let pierced = together([tetrahedron(2.0, [0.0; 3]), tetrahedron(2.0, [0.3, 0.2, 0.1])]);
    assert!(judge(&pierced).triangle_intersections > 2);
    // A corner that touches a face from outside.
    let touching = together([cube(2.0, [0.0; 3]), tetrahedron(1.0, [0.5, 0.25, 2.0])]);
    assert!(judge(&touching).triangle_intersections > 0);
    let tip = |x: f64| {
        let mut tip = flipped(tetrahedron(1.0, [0.0; 3]));
        for p in &mut tip.0 {
            *p = [x - p[0] * 0.5 - p[1] * 0.4, p[1] * 0.3 + 0.7, p[2] * 0.3 + 0.2];
        }
        flipped(tip)
    };
    let face = cube(1.0, [1.0, 0.0, 0.0]);
    let c = judge(&together([face.clone(), flipped(tip(1.0))]));
    assert!(c.triangle_intersections > 0, "vertex on a face");
    let c = judge(&together([face, flipped(tip(1.0 - f64::EPSILON))]));
    assert_eq!(c.triangle_intersections, 0, "one bit apart: {:?}", c.failures);
}

#[test]
fn coplanar_faces_that_overlap_are_found() {
    let stacked = together([cube(2.0, [0.0; 3]), cube(1.0, [0.5, 0.5, 2.0])]);
    assert!(judge(&stacked).triangle_intersections > 0);
}

#[test]
fn folds_onto_a_neighbour_are_found() {
    // Two triangles in one plane over one edge, closed to a body by a common apex.
    let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.2, 1.0, 0.0], [0.4, 0.5, 0.0]];
    let flat = (positions, vec![[0, 1, 2], [1, 0, 3], [1, 3, 2], [3, 0, 2]]);
    assert!(judge(&flat).triangle_intersections > 0);
}

#[test]
fn flipped_and_missing_triangles_are_found() {
    let mut one_flipped = cube(1.0, [0.0; 3]);
    one_flipped.1[3].swap(0, 1);
    let c = assert_fails(&one_flipped, FailureKind::Orientation, 3);
    assert!(!c.oriented && c.closed && c.manifold);
    let mut open = cube(1.0, [0.0; 3]);
    open.1.pop();
    let c = assert_fails(&open, FailureKind::OpenEdges, 3);
    assert!(!c.closed && c.oriented && c.non_manifold_vertices == 0);
    assert_eq!(c.failures.len(), 1);
}

#[test]
fn contacts_at_vertices_and_edges_are_not_manifold() {
    let at_vertex = together([tetrahedron(1.0, [0.0; 3]), tetrahedron(1.0, [1.0, 0.0, 0.0])]);
    let c = assert_fails(&at_vertex, FailureKind::NonManifoldVertices, 1);
    assert_eq!(c.failures[0].places[0].position_um, [1e6, 0.0, 0.0]);
    // Two cubes that share an edge.
    let at_edge = together([cube(1.0, [0.0; 3]), cube(1.0, [1.0, 1.0, 0.0])]);
    assert_fails(&at_edge, FailureKind::NonManifoldEdges, 1);
}

#[test]
fn vertices_in_one_place_that_are_not_one_are_a_meeting() {
    let (positions, triangles) = together([tetrahedron(1.0, [0.0; 3]), tetrahedron(1.0, [1.0, 0.0, 0.0])]);
    let positions = positions.iter().map(|p| p.map(|x| x as f32)).collect();
    let mesh = Mesh { body: crate::model::BodyKind::Lumen, positions, triangles, patches: Vec::new() };
    let c = certify(&mesh, &[]);
    assert!(c.triangle_intersections > 0 && c.components == 2 && !c.passed);
}

#[test]
fn degenerate_and_duplicate_triangles_are_found() {
    let mut c = cube(1.0, [0.0; 3]);
    c.0.push([0.5, 0.0, 0.0]);
    c.1.push([0, 8, 1]);
    assert_fails(&c, FailureKind::DegenerateTriangles, 1);
    let mut twice = cube(1.0, [0.0; 3]);
    twice.1.push(twice.1[0]);
    assert_fails(&twice, FailureKind::DuplicateTriangles, 1);
    let pillow = (vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2], [0, 2, 1]]);
    assert_fails(&pillow, FailureKind::DuplicateTriangles, 1);
}

#[test]
fn copies_are_counted_as_pairs_and_the_first_are_named() {
    let mut thrice = cube(1.0, [0.0; 3]);
    let [a, b, c] = thrice.1[4];
    thrice.1.extend([[b, c, a], [a, c, b], thrice.1[2]]);
    let found = assert_fails(&thrice, FailureKind::DuplicateTriangles, 4);
    assert_eq!((found.duplicate_triangles, found.triangle_intersections), (4, 0));
    let duplicates = found.failures.iter().find(|f| f.kind == FailureKind::DuplicateTriangles).expect("asserted above");
    let named: Vec<_> = duplicates.places.iter().map(|place| place.triangles.clone()).collect();
    assert_eq!(named, [[2, 14], [4, 12], [4, 13], [12, 13]]);
}

#[test]
fn meetings_of_copies_count_for_each_copy() {
    let copies = |n: usize, at: [f64; 3]| together(vec![tetrahedron(2.0, at); n]);
    let once = judge(&together([copies(1, [0.0; 3]), copies(1, [0.3, 0.2, 0.1])])).triangle_intersections;
    let found = judge(&together([copies(2, [0.0; 3]), copies(3, [0.3, 0.2, 0.1])]));
    assert_eq!(found.triangle_intersections, 6 * once);
    assert_eq!(found.duplicate_triangles, 4 + 4 * 3);
}

#[test]
fn many_copies_take_time_for_each_and_not_for_each_pair() {
    let n = 200_000;
    let one = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let pairs = n * (n - 1) / 2;
    let apart = (one.repeat(n as usize), (0..n as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect());
    for soup in [(one, vec![[0, 1, 2]; n as usize]), apart] {
        let found = assert_fails(&soup, FailureKind::DuplicateTriangles, pairs);
        let duplicates =
            found.failures.iter().find(|f| f.kind == FailureKind::DuplicateTriangles).expect("asserted above");
        assert_eq!(duplicates.places.len(), 16);
        assert_eq!((found.triangle_intersections, found.components), (0, 1));
    }
    // Triangles without area are not tested for intersections.
    let line = vec![[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
    assert_fails(&(line, vec![[0, 1, 2]; n as usize]), FailureKind::DegenerateTriangles, n);
}

#[test]
fn the_search_for_meetings_stops_when_it_found_enough_with_any_number_of_threads() {
    // Triangles that all intersect each other: 5 million pairs.
    let n = 3_200u32;
    let corner = |i: u32, k: u32| {
        let angle = std::f64::consts::TAU * (f64::from(i) / f64::from(n) + f64::from(k)) / 3.0;
        [angle.cos(), angle.sin(), f64::from((i * 7 + k * 1_009) % 97) / 97.0 - 0.5]
    };
    let positions = (0..n).flat_map(|i| [0, 1, 2].map(|k| corner(i, k))).collect();
    let soup = (positions, (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect());
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| judge(&soup))
    };
    let found = run(1);
    assert!(found.triangle_intersections > 100_000 && found.triangle_intersections < 1_000_000);
    let failure = found.failures.iter().find(|f| f.kind == FailureKind::TriangleIntersections).expect("they meet");
    assert!(failure.detail.starts_with("at least ") && failure.detail.ends_with("(the search stopped after 100000)"));
    assert_eq!(failure.places.len(), 16);
    assert_eq!(found, run(3));
    assert_eq!(found, run(4));
}

#[test]
fn what_is_no_surface_is_named() {
    let no_indices = (vec![[0.0; 3]; 3], vec![[0, 1, 3]]);
    assert_fails(&no_indices, FailureKind::Indices, 1);
    assert_fails(&Soup::default(), FailureKind::Empty, 1);
    for bad in [f64::NAN, f64::INFINITY, 1e61, 1e-61] {
        let mut soup = cube(1.0, [0.0; 3]);
        soup.0[2][1] = bad;
        assert_fails(&soup, FailureKind::Coordinates, 1);
    }
}

#[test]
fn check_demands_the_euler_number_of_each_component() {
    let (positions, triangles) = torus(12, 8);
    assert!(check_surface(&positions, &triangles, &CheckOptions { euler: Some(0), unit_metres: 1e-3 }).passed);
    let c = check_surface(&positions, &triangles, &CheckOptions { euler: Some(2), ..Default::default() });
    assert_eq!(c.failures.iter().map(|f| f.kind).collect::<Vec<_>>(), [FailureKind::Euler]);
}

#[test]
fn a_folded_tube_passes_with_any_number_of_threads() {
    let (mut mesh, sections) = folded_tube(7, 600, 40, 9);
    let run = |mesh: &Mesh, threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| certify(mesh, &sections))
    };
    let c = run(&mesh, 1);
    assert!(c.passed, "{:?}", c.failures);
    assert_eq!((c.euler, c.components, c.section_crossings), (0, 1, 0));
    let gap = c.min_gap_um.expect("there are sections");
    assert!((gap - brute_gap(&sections)).abs() < 1e-9 * gap);
    assert_eq!(c, run(&mesh, 3));
    // A vertex of one fold pushed through the next.
    let middle = 3 * 640 + 33;
    mesh.positions[middle][1] += 3e-4;
    let c = run(&mesh, 1);
    assert!(c.triangle_intersections > 0);
    let place = &c.failures[0].places[0];
    assert!(place.triangles.len() == 2 && (place.position_um[2] - 900.0).abs() < 301.0, "{place:?}");
    assert_eq!(c, run(&mesh, 2));
}

fn brute_gap(sections: &[Section]) -> f64 {
    let mut least = f64::INFINITY;
    for section in sections {
        let rings = [&section.inner.points, &section.outer.points]
            .map(|r| r.iter().map(|p| p.map(f64::from)).collect::<Vec<_>>());
        for (r, ring) in rings.iter().enumerate() {
            for (i, p) in ring.iter().enumerate() {
                for (s, other) in rings.iter().enumerate() {
                    for j in 0..other.len() {
                        let k = (j + 1) % other.len();
                        if r == s && (i == j || i == k) {
                            continue;
                        }
                        let (a, b) = (other[j], other[k]);
                        let (u, v) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
                        let t = ((u[0] * v[0] + u[1] * v[1]) / (u[0] * u[0] + u[1] * u[1])).clamp(0.0, 1.0);
                        least = least.min((v[0] - t * u[0]).hypot(v[1] - t * u[1]));
                    }
                }
            }
        }
    }
    least
}

fn section(inner: &[[f32; 2]], outer: &[[f32; 2]]) -> Section {
    let ring = |points: &[[f32; 2]]| Ring { ids: (0..points.len() as u32).collect(), points: points.to_vec() };
    Section { z_um: 7.0, inner: ring(inner), outer: ring(outer), ..Section::default() }
}

fn judge_section(inner: &[[f32; 2]], outer: &[[f32; 2]]) -> (u64, Vec<FailureKind>, Option<f64>) {
    let mut failures = Failures::default();
    let found = Contours::of(&[section(inner, outer)]);
    found.report(&mut failures);
    (
        found.crossings(),
        failures.0.iter().map(|f| f.kind).collect(),
        found.gaps_um.iter().copied().flatten().reduce(f64::min),
    )
}

const WALL: [[f32; 2]; 4] = [[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]];

#[test]
fn sections_are_judged() {
    let square = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
    assert_eq!(judge_section(&square, &WALL), (0, vec![], Some(4.0)));
    let bow = [[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0]];
    assert_eq!(judge_section(&bow, &WALL).0, 1);
    let touching = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 0.0], [0.0, 4.0]];
    assert_eq!(judge_section(&touching, &WALL).1, [FailureKind::SectionCrossing]);
    assert_eq!(judge_section(&touching, &WALL).2, Some(0.0));
    let spike = [[0.0, 0.0], [4.0, 0.0], [2.0, 0.0], [2.0, 4.0]];
    assert!(judge_section(&spike, &WALL).0 > 0);
    let outside = square.map(|p| [p[0] + 20.0, p[1]]);
    assert_eq!(judge_section(&outside, &WALL).1, [FailureKind::SectionNesting]);
    let across = square.map(|p| [p[0] + 7.0, p[1]]);
    assert!(judge_section(&across, &WALL).0 >= 2);
    assert_eq!(judge_section(&square[..2], &WALL).1, [FailureKind::SectionRing]);
}

/// Intersections of all pairs of triangles.
fn brute_force((positions, triangles): &Soup) -> u64 {
    let corners = |t: [u32; 3]| Triangle::new(t.map(|v| positions[v as usize]));
    let mut count = 0;
    for (i, &a) in triangles.iter().enumerate() {
        for &b in &triangles[..i] {
            let (ta, tb) = (corners(a), corners(b));
            if ta.is_degenerate() || tb.is_degenerate() {
                continue;
            }
            let free = |t: [u32; 3], other: [u32; 3]| (0..3).find(|&k| !other.contains(&t[k])).expect("a free corner");
            let shared: Vec<_> = (0..3).filter(|&k| b.contains(&a[k])).collect();
            let met = match shared.as_slice() {
                [] => meet(&ta, &tb),
                [k] => meet_beyond_corner(&ta, *k, &tb, (0..3).find(|&l| b[l] == a[*k]).expect("shared")),
                [_, _] => overlap_across_edge(&ta, free(a, b), &tb, free(b, a)),
                _ => false,
            };
            count += u64::from(met);
        }
    }
    count
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn the_hierarchy_finds_what_brute_force_finds(
        points in prop::collection::hash_set(prop::array::uniform3(-20i8..20), 4..60),
        picks in prop::collection::vec((any::<prop::sample::Index>(), any::<[i8; 2]>()), 0..150),
    ) {
        let positions: Vec<[f64; 3]> = points.iter().map(|p| p.map(f64::from)).collect();
        let n = positions.len() as i64;
        let near = |i: usize, d: i8| (i as i64 + i64::from(d) % 4).rem_euclid(n) as u32;
        let mut triangles: Vec<[u32; 3]> = picks.iter().map(|(i, d)| {
            let i = i.index(positions.len());
            [i as u32, near(i, d[0]), near(i, d[1])]
        }).collect();
        triangles.push([0, 1, 2]);
        let soup = (positions, triangles);
        prop_assert_eq!(judge(&soup).triangle_intersections, brute_force(&soup));
    }

    #[test]
    fn meetings_in_a_mutated_tube_are_those_of_all_pairs(
        moves in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>(), 0usize..6, prop::array::uniform3(-1.0f32..1.0)), 1..12),
    ) {
        let (mut mesh, _) = folded_tube(5, 60, 12, 5);
        for (at, other, kind, by) in moves {
            let at = at.index(mesh.positions.len());
            let to = mesh.positions[other.index(mesh.positions.len())];
            let neighbour = mesh.positions[(at + 1) % mesh.positions.len()];
            let moved = |scale: f32| [0, 1, 2].map(|axis| mesh.positions[at][axis] + scale * by[axis]);
            mesh.positions[at] = match kind {
                0 => moved(1e-6),
                1 => moved(1e-4),
                2 => moved(1e-3),
                // Into the plane of another triangle, onto a neighbour, and onto any vertex.
                3 => [to[0], mesh.positions[at][1], mesh.positions[at][2]],
                4 => neighbour,
                _ => to,
            };
        }
        let soup: Soup = (mesh.positions.iter().map(|p| p.map(f64::from)).collect(), mesh.triangles.clone());
        let expected = brute_force(&soup);
        // Keeps vertices at one place separate, which a certificate of a soup would weld.
        prop_assert_eq!(certify_body(&mesh, LengthUnit::Metre).triangle_intersections, expected);
    }

    #[test]
    fn nothing_panics_on_soups(
        positions in prop::collection::vec(prop::array::uniform3(-2i8..2), 0..12),
        triangles in prop::collection::vec(prop::array::uniform3(0u32..12), 0..60),
    ) {
        let positions: Vec<_> = positions.iter().map(|p| p.map(f64::from)).collect();
        let certificate = check_surface(&positions, &triangles, &CheckOptions::default());
        prop_assert_eq!(certificate.passed, certificate.failures.is_empty());
    }
}

#[test]
fn at_most_vertices_of_a_tube_triangles_are_seen_to_be_apart() {
    let (mesh, _) = folded_tube(9, 600, 60, 9);
    let surface = Surface { positions: &mesh.positions, triangles: &mesh.triangles, unit_um: 1e6 };
    let crowded = topology::examine_alone(&surface, &mut Failures::default()).crowded;
    assert!(crowded.len() * 10 < mesh.positions.len(), "{} of {}", crowded.len(), mesh.positions.len());
}

#[test]
fn a_corner_with_many_triangles_takes_time_for_each() {
    // Two cones over a wave, with 200,000 triangles at each tip.
    let n = 200_000u32;
    let rim = (0..n).map(|i| {
        let angle = std::f64::consts::TAU * f64::from(i) / f64::from(n);
        [angle.cos(), angle.sin(), 0.1 * (5.0 * angle).sin()]
    });
    let positions = rim.chain([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0]]).collect();
    let triangles = (0..n).flat_map(|i| [[i, (i + 1) % n, n], [(i + 1) % n, i, n + 1]]).collect();
    // All bounds overlap at the tips, so pairs are not searched here.
    let surface: Soup = (positions, triangles);
    let surface = Surface { positions: &surface.0, triangles: &surface.1, unit_um: 1.0 };
    assert!(topology::examine_alone(&surface, &mut Failures::default()).crowded.is_empty());
}

/// Needles of known angles: the base is 1, the legs are long.
#[test]
fn triangles_are_counted_by_their_angles_and_edge_ratios() {
    for (degrees, angle_bin, ratio_bin) in [(59.0, 11, 0), (31.0, 6, 1), (21.0, 4, 3), (12.0, 2, 7), (2.0, 0, 10)] {
        let legs = 0.5 / (degrees / 2.0_f64).to_radians().sin();
        let height = (legs * legs - 0.25).sqrt();
        let apex = [0.5, height, 0.0];
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], apex];
        let quality = check_surface(&positions, &[[0, 1, 2]], &CheckOptions::default()).quality;
        let (mut angles, mut ratios) = ([0; 12], [0; 11]);
        (angles[angle_bin], ratios[ratio_bin]) = (1, 1);
        assert_eq!((quality.least_angles, quality.edge_ratios), (angles, ratios), "{degrees}");
        assert_eq!(quality.least_angles_from_20, f64::from(u8::from(degrees > 20.0)));
        assert_eq!(quality.edge_ratios_to_4, f64::from(u8::from(legs <= 4.0)));
    }
}
