//! Contractions of folded tubes.

use super::*;
use crate::mesh::lean::tests::leaning;
use crate::mesh::{Lofter, intersection};
use crate::model::Section;
use crate::model::sample;

/// A straight tube of 21 sections, 10 mm long, and its contraction.
fn tube() -> (Mesh, Contraction) {
    let section = |k: u32| Section { z_um: 500.0 * f64::from(k), ..sample::section(240, f64::from(k), 0.0) };
    let mut lofter = Lofter::new(section(0)).unwrap();
    (1..=20).for_each(|k| drop(lofter.advance(&[section(k)]).unwrap()));
    let station = |z_um| Station {
        z_um,
        base_um2: 1.0e6 * std::f64::consts::PI * 0.64,
        closure: 0.5,
        shortening: 0.15,
        wavelength_um: 5000.0,
    };
    let stations = vec![station(0.0), station(10_000.0)];
    let by = Contraction { stations, phase: 0.25, to_uterus: true, ends_um: 1000.0 };
    (lofter.finish().unwrap(), by)
}

fn heights(mesh: &Mesh) -> Vec<f32> {
    mesh.positions.iter().map(|p| p[2]).collect()
}

fn volume(mesh: &Mesh) -> f64 {
    let corner = |v: u32| glam::Vec3::from(mesh.positions[v as usize]).as_dvec3();
    1e9 * mesh.triangles.iter().map(|t| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))) / 6.0).sum::<f64>()
}

#[test]
fn tissue_keeps_its_volume_while_the_lumen_closes_and_the_tube_shortens() {
    let (mesh, by) = tube();
    let z = heights(&mesh);
    let rest = Rest { straight: &mesh, z: &z, split: &[], lean: None, course: None };
    let mut tube = Contracting::new(rest, &by);
    let (tissue, lumen) = (volume(&mesh), lumen_mm3(&mesh));
    let mut crests = Vec::new();
    for k in 0..8 {
        let frame = tube.frame(f64::from(k) / 8.0, &|| false);
        assert_eq!(frame.mesh.triangles, mesh.triangles);
        assert!(intersection::all_pairs(&frame.mesh).is_empty());
        assert!((volume(&frame.mesh) / tissue - 1.0).abs() < 0.01, "{} of {tissue}", volume(&frame.mesh));
        assert!(lumen_mm3(&frame.mesh) < 0.9 * lumen && frame.closed > 0.3 && frame.narrowed > 0.0);
        assert!(frame.length_um < 9_700.0);
        let low = frame.mesh.positions.iter().map(|p| p[2]).fold(f32::MAX, f32::min);
        assert_eq!(low, 0.0, "the isthmus end stays");
        let height = |section: &usize| tube.wave.rise(*section, f64::from(k) / 8.0);
        crests.push((3..13).max_by(|a, b| height(a).total_cmp(&height(b))).unwrap());
    }
    let falls = crests.windows(2).filter(|pair| pair[1] < pair[0]).count();
    assert!(falls >= 6, "toward the uterus: {crests:?}");
    assert_eq!(tube.done().met, 0);
    // After one period the surface is unchanged.
    let [first, last] = [0.0, 1.0].map(|time| tube.place(time).mesh);
    let apart = first.positions.iter().flatten().zip(last.positions.iter().flatten()).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f32::max) < 1e-9);
}

#[test]
fn nothing_moves_without_a_wave() {
    let (mesh, mut by) = tube();
    by.stations.iter_mut().for_each(|station| (station.closure, station.shortening) = (0.0, 0.0));
    let z = heights(&mesh);
    let mut tube = Contracting::new(Rest { straight: &mesh, z: &z, split: &[], lean: None, course: None }, &by);
    let frame = tube.frame(0.3, &|| false);
    let apart = frame.mesh.positions.iter().flatten().zip(mesh.positions.iter().flatten()).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f32::max) < 2e-9);
}

/// Contraction of the leaning tube.
fn by_of(closure: f64) -> Contraction {
    let station = |z_um: f64| Station {
        z_um,
        base_um2: 1e6 * std::f64::consts::PI,
        closure,
        shortening: 0.05 * closure,
        wavelength_um: 6000.0,
    };
    Contraction { stations: vec![station(0.0), station(12_000.0)], phase: 0.0, to_uterus: false, ends_um: 1000.0 }
}

/// Asserts that four frames do not intersect themselves, keep the tissue, and close more than
/// `share` of the lumen somewhere.
fn contracts(rest: Rest<'_>, tissue: f64, closed: f64) -> Contracted {
    let triangles = rest.straight.triangles.clone();
    let mut tube = Contracting::new(rest, &by_of(0.4));
    for k in 0..4 {
        let frame = tube.frame(f64::from(k) / 4.0, &|| false);
        assert_eq!(frame.mesh.triangles, triangles);
        assert!(intersection::all_pairs(&frame.mesh).is_empty());
        assert!((volume(&frame.mesh) / tissue - 1.0).abs() < 0.01, "{} of {tissue}", volume(&frame.mesh));
        assert!(frame.closed > closed, "{}", frame.closed);
    }
    tube.done()
}

#[test]
fn a_leaning_tube_contracts_without_contact() {
    let (mesh, lean, z) = leaning();
    let done =
        contracts(Rest { straight: &mesh, z: &z, split: &[], lean: Some(&lean), course: None }, volume(&mesh), 0.35);
    assert!(done.met > 0, "too mild to test");
    assert!(done.least_factor > 0.9, "{done:?}");
}

#[test]
fn a_bent_tube_contracts_without_contact() {
    let (mut mesh, lean, z) = leaning();
    let course = Course::arc(3.0, 12_000.0, 512, 0.5);
    let leaning = bend::Leaning { lean: &lean, z: z.clone() };
    let (bent, _, split) = bend::bend_apart(&mut mesh, Some(leaning), &course, &|| false);
    assert!(!split.is_empty() && intersection::all_pairs(&bent).is_empty(), "too mild to test");
    let rest = || Rest { straight: &mesh, z: &z, split: &split, lean: Some(&lean), course: Some(&course) };
    let is_across = |&&(v, w): &&(u32, u32)| (v.max(w) as usize) < z.len() && z[v as usize] == z[w as usize];
    assert!(split.iter().filter(is_across).count() > 0, "too mild to test");
    let mut of_levels: Vec<u32> =
        levels(&rest()).into_iter().flat_map(|level| [level.inner, level.outer].concat()).collect();
    of_levels.sort_unstable();
    assert!(of_levels.into_iter().eq(0..z.len() as u32), "each vertex is in one contour");
    // Its few long triangles leave less room for the wave than a full-size model does.
    contracts(rest(), volume(&bent), 0.1);
    let still = Contracting::new(rest(), &by_of(0.0)).place(0.3).mesh;
    let apart = still.positions.iter().flatten().zip(bent.positions.iter().flatten()).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f32::max) < 4e-9);
}

#[test]
fn a_surface_whose_wave_is_dropped_is_the_one_at_rest() {
    let (mesh, lean, z) = leaning();
    let rest = Rest { straight: &mesh, z: &z, split: &[], lean: Some(&lean), course: None };
    let mut tube = Contracting::new(rest, &by_of(0.4));
    let pairs = [[0, 1], [5000, 5001]];
    (0..=GIVE_UP_ROUND).for_each(|round| tube.damp(&pairs, round));
    assert_eq!(tube.done().least_factor, 0.0);
    assert_eq!(tube.place(0.3).mesh.positions, mesh.positions);
}
