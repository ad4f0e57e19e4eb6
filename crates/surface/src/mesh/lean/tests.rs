//! Displacement of a surface whose folds swirl.

use super::*;
use crate::mesh::samples::{Dice, Folds};
use crate::mesh::{Lofter, intersection};
use crate::model::{PatchKind, Section};

/// A tube of 41 sections, 12 mm long, with folds that grow and turn.
fn surface() -> Mesh {
    let mut folds = Folds::new(240, 60, 9.0, 40.0);
    let mut dice = Dice(5);
    let section = |folds: &Folds, step: u32| {
        let section = folds.section(f64::from(step));
        Section { z_um: 300.0 * f64::from(step), ..section }
    };
    let mut lofter = Lofter::new(section(&folds, 0)).unwrap();
    for step in 1..=40 {
        folds.grow(6, 2, &mut dice);
        lofter.advance(&[section(&folds, step)]).unwrap();
    }
    lofter.finish().unwrap()
}

/// Stations of the tube.
fn lean_of(strength_um: f64) -> Lean {
    let station = |k: u32| {
        let t = f64::from(k) / 40.0;
        Station { z_um: 12_000.0 * t, r_in_um: 500.0 + 1000.0 * t, squash: 1.0, strength_um }
    };
    Lean {
        seed: 3,
        wavelength_um: 100.0,
        along_um: 30_000.0,
        ends_um: 2000.0,
        stations: (0..=40).map(station).collect(),
    }
}

/// The leaning tube, its lean, and z of its vertices before the lean.
pub(in crate::mesh) fn leaning() -> (Mesh, Lean, Vec<f32>) {
    let mut mesh = surface();
    let z = mesh.positions.iter().map(|p| p[2]).collect();
    let by = lean_of(300.0);
    lean(&mut mesh, &by, &|| false);
    (mesh, by, z)
}

/// The tube with a lean so strong that it intersects itself, its lean, and z of its vertices before
/// the lean.
pub(in crate::mesh) fn pressed() -> (Mesh, Lean, Vec<f32>) {
    let mut mesh = surface();
    let z = mesh.positions.iter().map(|p| p[2]).collect();
    let lean = lean_of(300.0);
    let field = LeanField::new(&lean);
    for p in &mut mesh.positions {
        p[2] += 1e-6 * field.at(p.map(in_um)) as f32;
    }
    (mesh, lean, z)
}

#[test]
fn a_displaced_surface_does_not_meet_itself_and_keeps_its_ends_and_its_outside() {
    let before = surface();
    let mut mesh = before.clone();
    let lean_by = lean_of(300.0);
    let done = lean(&mut mesh, &lean_by, &|| false);
    assert!(done.met > 0 && done.damped > 0, "too weak to test: {done:?}");
    assert!(intersection::all_pairs(&mesh).is_empty());
    let outer = before.patches.iter().find(|patch| patch.kind == PatchKind::OuterWall).unwrap();
    let is_outer: std::collections::HashSet<u32> =
        before.triangles[outer.triangles.clone()].iter().flatten().copied().collect();
    let high = before.positions.iter().map(|p| p[2]).fold(0.0, f32::max);
    let mut farthest = 0.0_f32;
    for (v, (a, b)) in before.positions.iter().zip(&mesh.positions).enumerate() {
        assert_eq!(a[..2], b[..2], "only z changes");
        if is_outer.contains(&(v as u32)) || a[2] == 0.0 || a[2] == high {
            assert_eq!(a, b);
        }
        farthest = farthest.max((a[2] - b[2]).abs());
    }
    assert!(farthest > 300e-6 && farthest <= 601e-6, "{farthest}");
    let again = lean(&mut before.clone(), &lean_by, &|| false);
    assert_eq!(again, done);
}

#[test]
fn a_lean_that_would_fold_the_tube_is_reduced_everywhere() {
    let mut mesh = surface();
    let steep = lean_of(5000.0);
    let done = lean(&mut mesh, &steep, &|| false);
    assert!(done.scale > 0.0 && done.scale < 0.15, "{done:?}");
    assert!(intersection::all_pairs(&mesh).is_empty());
    let gentle = Lean { stations: lean_of(10.0).stations, ..steep };
    assert!(gentle.steepness() < STEEPEST);
}

#[test]
fn waves_shorter_than_triangles_end_without_displacement_or_contact() {
    let mut mesh = surface();
    let wild = Lean { wavelength_um: 20.0, ..lean_of(2000.0) };
    let done = lean(&mut mesh, &wild, &|| false);
    assert!(done.met > 0 && intersection::all_pairs(&mesh).is_empty(), "{done:?}");
}

#[test]
fn nothing_is_displaced_without_strength_and_a_stop_ends_it() {
    let before = surface();
    let mut mesh = before.clone();
    let none = lean_of(0.0);
    assert_eq!(lean(&mut mesh, &none, &|| false), Leaned { scale: 1.0, ..Leaned::default() });
    assert!(mesh == before);
    let stopped = lean(&mut mesh, &lean_of(300.0), &|| true);
    assert!(stopped.met > 0 && stopped.rounds == 0);
}
