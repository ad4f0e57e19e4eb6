//! Tests of thinned levels on lofts whose contours gain vertices, turn, and fold.

use super::super::tests::{check_closed, file, read_level, shapes};
use super::super::{FullSurface, Level, assembled, levels_of};
use super::*;
use crate::geometry::distance::squared_distance;
use crate::model::{Ring, Section};
use oviduct_surface::mesh::Lofter;
use proptest::prelude::*;
use std::f64::consts::TAU;

/// A loft of `slabs` slabs, and its rows. Its inner wall has `folds` folds, which become higher and
/// turn by `twist` radians, and `n` vertices at first. It gains vertices from section to section,
/// mostly on one side.
fn grown(n: usize, slabs: usize, folds: f64, twist: f64) -> (Mesh, Rows) {
    let mut inner: Vec<(u32, f64)> = (0..n).map(|i| (i as u32, TAU * i as f64 / n as f64)).collect();
    let outer: Vec<(u32, f64)> = (0..24).map(|i| (i, TAU * f64::from(i) / 24.0)).collect();
    let mut sections = Vec::new();
    for k in 0..=slabs {
        let along = k as f64 / slabs as f64;
        let ring = |angles: &[(u32, f64)], radius: &dyn Fn(f64) -> f64, turn: f64| Ring {
            ids: angles.iter().map(|(id, _)| *id).collect(),
            points: angles
                .iter()
                .map(|&(_, angle)| {
                    let (sin, cos) = libm::sincos(angle + turn);
                    [cos, sin].map(|x| (x * radius(angle)) as f32)
                })
                .collect(),
        };
        let folded = |angle: f64| 500.0 + 120.0 * along * along * libm::cos(folds * angle);
        sections.push(Section {
            step: k as f64,
            z_um: 40.0 * k as f64,
            added: false,
            inner: ring(&inner, &folded, twist * along),
            outer: ring(&outer, &|_| 800.0 + 40.0 * along, 0.0),
        });
        for j in 0..2 {
            let at = (k * k * 7 + j * 31) % (inner.len() * 2 / 3 + j);
            let (from, to) = (inner[at].1, inner.get(at + 1).map_or(TAU, |next| next.1));
            inner.insert(at + 1, (inner.len() as u32, f64::midpoint(from, to)));
        }
    }
    let mut lofter = Lofter::new(sections[0].clone()).unwrap();
    for section in &sections[1..] {
        assert!(lofter.try_advance(section).unwrap().is_some(), "the walls of {} meet", section.step);
    }
    lofter.finish_with_rows().unwrap()
}

fn made(mesh: &Mesh, rows: &Rows, targets: [usize; 2]) -> Vec<Level> {
    levels_of(mesh, Some(rows), targets, &|| false).unwrap()
}

/// Checks that levels are closed surfaces with the ends of the full surface, within their numbers
/// of triangles.
fn check(mesh: &Mesh, levels: &[Level], targets: [usize; 2]) {
    let mut ends = Vec::new();
    for (level, target) in levels.iter().zip([mesh.triangles.len(), targets[0], targets[1]]) {
        let read = read_level(&file(level)).unwrap();
        check_closed(&read);
        assert_eq!((read.positions.len(), read.triangles.len()), (level.report.vertices, level.report.triangles));
        assert!(level.report.triangles <= target, "{:?} of {target}", level.report);
        let mut shapes = shapes(&read, |v| read.positions[v as usize]);
        ends.push([PatchKind::CapIsthmus, PatchKind::CapAmpulla].map(|cap| shapes.remove(cap.name()).unwrap()));
    }
    assert!(ends.iter().all(|other| *other == ends[0]), "the ends differ between levels");
}

/// Maximum distance in both directions between the walls of a level and of the full surface, µm, by
/// exhaustive search.
fn distance_um(mesh: &Mesh, level: &Mesh) -> f64 {
    let corners = |mesh: &Mesh, kind: PatchKind| -> Vec<[[f64; 3]; 3]> {
        mesh.patch(kind).iter().map(|t| t.map(|v| mesh.positions[v as usize].map(f64::from))).collect()
    };
    let farthest = |samples: &[[f64; 3]], triangles: &[[[f64; 3]; 3]]| {
        let nearest = |p: &[f64; 3]| triangles.iter().map(|t| squared_distance(*p, *t)).fold(f64::INFINITY, f64::min);
        samples.iter().map(nearest).fold(0.0, f64::max).sqrt()
    };
    let of_wall = |kind| {
        let (full, coarse) = (corners(mesh, kind), corners(level, kind));
        let mean =
            |points: &[[f64; 3]]| [0, 1, 2].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64);
        let samples = |t: &[[f64; 3]; 3]| [mean(&[t[0], t[1]]), mean(&[t[1], t[2]]), mean(&[t[2], t[0]]), mean(t)];
        let back: Vec<[f64; 3]> = coarse.iter().flat_map(samples).collect();
        farthest(full.as_flattened(), &coarse).max(farthest(&back, &full))
    };
    WALLS.map(of_wall).into_iter().fold(0.0, f64::max) * 1e6
}

#[test]
fn a_level_is_about_as_close_as_one_of_collapsed_edges_and_its_file_is_smaller() {
    let (mesh, rows) = grown(100, 40, 9.0, 0.4);
    let targets = [mesh.triangles.len() / 5, mesh.triangles.len() / 12];
    let thinned = made(&mesh, &rows, targets);
    check(&mesh, &thinned, targets);
    let collapsed = levels_of(&mesh, None, targets, &|| false).unwrap();
    for (thinned, collapsed) in thinned.iter().zip(&collapsed).skip(1) {
        let (thinned_file, collapsed_file) = (file(thinned), file(collapsed));
        let exact = distance_um(&mesh, &read_level(&thinned_file).unwrap());
        let of_collapses = distance_um(&mesh, &read_level(&collapsed_file).unwrap());
        assert!(exact <= 2.0 * of_collapses, "{exact} and {of_collapses}: {:?}", thinned.report);
        // Every second vertex and triangle is measured.
        let stated = thinned.report.distance_um;
        assert!(stated > 0.8 * exact && stated < exact + 1.0, "{exact}: {:?}", thinned.report);
        assert!(thinned_file.len() < collapsed_file.len(), "{} and {}", thinned_file.len(), collapsed_file.len());
    }
}

#[test]
fn levels_use_their_numbers_of_triangles() {
    let (mesh, rows) = grown(100, 40, 9.0, 0.4);
    let count = mesh.triangles.len();
    for target in [count / 3, count / 10] {
        let level = &made(&mesh, &rows, [target; 2])[1];
        assert!(level.report.triangles >= target * 4 / 5, "{target}: {:?}", level.report);
    }
    assert!(made(&mesh, &rows, [count; 2]).iter().all(|level| level.report.triangles == count));
    // Rows and columns of the ends remain.
    let least = &made(&mesh, &rows, [1, 1])[2];
    let ends: usize =
        rows.walls.iter().map(|wall| 2 * (wall.expanded().row(0).len() + wall.expanded().columns())).sum();
    assert!(least.report.triangles >= ends && least.report.triangles < ends * 2, "{ends}: {:?}", least.report);
}

#[test]
fn a_straight_surface_needs_no_rows() {
    let (mesh, rows) = grown(60, 40, 0.0, 0.0);
    let thinning = Thinning::new(&mesh, &rows);
    assert!(thinning.walls[1].sagittas.of_row(20).iter().all(|distance| *distance < 1e-8));
    let outer = &thinning.build(1e-7)[1];
    assert_eq!(outer.len(), 48, "two rows of 24 vertices are joined");
}

#[test]
fn bytes_do_not_depend_on_threads() {
    let (mesh, rows) = grown(90, 30, 7.0, 0.3);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| made(&mesh, &rows, [3000, 1000]).iter().map(file).collect::<Vec<_>>())
    };
    assert!(on(1) == on(4));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn levels_of_any_loft_are_closed(
        n in 4usize..120,
        slabs in 1usize..40,
        folds in 2u32..9,
        twist in -0.5..0.5,
        shares in [0.02..0.9, 0.02..0.9],
    ) {
        let (mesh, rows) = grown(n, slabs, f64::from(folds), twist);
        let thinning = Thinning::new(&mesh, &rows);
        let full = FullSurface::new(&mesh);
        for share in shares {
            let level = thinning.level((mesh.triangles.len() as f64 * share) as usize);
            check_closed(&assembled(&full, &level).0);
        }
    }
}
