//! The surface that `oviduct check` reads from an exported file is the one that was certified.

use oviduct::export::Metadata;
use oviduct::export::glb::{GlbOptions, write_glb};
use oviduct::export::obj::write_obj;
use oviduct::export::read::{Format, parse};
use oviduct::measure::{Certificate, CheckOptions, certify, check_surface};
use oviduct::model::{BodyKind, Mesh, Patch, PatchKind};

#[path = "../benches/common/tube.rs"]
mod tube;

fn model() -> Mesh {
    let tube = tube::tube(5, 300, 40, 7);
    let (inner, outer, all) = (2 * 4 * 300, 2 * 4 * 40, tube.triangles.len());
    let ends = (all - inner - outer) / 2;
    let bounds = [0, inner, inner + outer, inner + outer + ends, all];
    let kinds = [PatchKind::InnerWall, PatchKind::OuterWall, PatchKind::CapIsthmus, PatchKind::CapAmpulla];
    let patches = kinds.into_iter().zip(bounds.windows(2)).map(|(kind, w)| Patch { kind, triangles: w[0]..w[1] });
    Mesh { body: BodyKind::Tissue, positions: tube.positions, triangles: tube.triangles, patches: patches.collect() }
}

fn metadata() -> Metadata {
    Metadata {
        preset: "pig".to_owned(),
        seed: 7,
        digest: "0".repeat(64),
        engine: "test".to_owned(),
        length_mm: 1.2,
        sections: 5,
    }
}

fn same(mut read: Certificate, mut made: Certificate) {
    assert!(read.passed && made.passed, "{:?} {:?}", read.failures, made.failures);
    // Sums depend on the order of triangles in their last digits.
    for (a, b) in [(&mut read.area_mm2, &mut made.area_mm2), (&mut read.volume_mm3, &mut made.volume_mm3)] {
        assert!((*a - *b).abs() < 1e-9 * b.abs());
        (*a, *b) = (0.0, 0.0);
    }
    for c in [&mut read, &mut made] {
        c.bodies.iter_mut().for_each(|body| body.volume_mm3 = 0.0);
        c.min_angle_deg = (c.min_angle_deg * 1e9).round();
    }
    assert_eq!(read, made);
}

#[test]
fn glb_and_obj_hold_the_certified_surface() {
    let mesh = model();
    let made = certify(&mesh, &[]);
    let options = CheckOptions { euler: Some(0), ..CheckOptions::default() };
    for strips in [false, true] {
        let mut bytes = Vec::new();
        write_glb(&mesh, &metadata(), &GlbOptions { strips }, &mut bytes).unwrap();
        let surface = parse(&bytes, Format::Gltf, None).unwrap();
        let names: Vec<_> = surface.groups.iter().map(|g| g.name.as_str()).collect();
        assert_eq!(names, ["inner_wall", "outer_wall", "cap_isthmus", "cap_ampulla"]);
        same(check_surface(&surface.positions, &surface.triangles, &options), made.clone());
    }
    let mut bytes = Vec::new();
    write_obj(&mesh, &metadata(), &mut bytes).unwrap();
    let surface = parse(&bytes, Format::Obj, None).unwrap();
    assert_eq!(surface.triangles, mesh.triangles);
    assert!(surface.positions.iter().zip(&mesh.positions).all(|(a, b)| *a == b.map(f64::from)));
    same(check_surface(&surface.positions, &surface.triangles, &options), made);
}
