//! A spool gives the same files as the same surface in memory, however it was pushed.

use super::*;
use crate::export::glb::{GlbOptions, write_glb, write_gltf, write_gltf_data};
use crate::export::obj::write_obj;
use crate::export::ply::write_ply;
use crate::export::stl::{write_ascii_stl, write_stl};
use crate::export::tests::meta;
use crate::export::vtp::write_vtp;
use crate::export::{Shape, Source};
use crate::model::{LengthUnit, Mesh, Patch, Ring, Section, sample};
use oviduct_surface::mesh::Lofter;
use proptest::prelude::*;
use std::f64::consts::TAU;

/// Where each push ends: as shares of the triangles of each patch, of the vertices for those that are known early, and of the
/// vertices that are no longer used for those that are retired.
type Cuts = Vec<[f64; 8]>;

fn cuts() -> impl Strategy<Value = Cuts> {
    let share = prop_oneof![Just(0.0), Just(1.0), 0.0..1.0];
    prop::collection::vec(prop::array::uniform8(share), 0..7)
}

/// Pushes a mesh piece by piece. Each vertex comes with the first triangle that uses it or before, and retires after the last.
fn spool(mesh: &Mesh, cuts: &Cuts, folder: &Path) -> Spool {
    let share = |share: f64, of: usize| (share * of as f64) as usize;
    let mut writer = SpoolWriter::new(folder, mesh.body).unwrap();
    let mut starts = vec![0; mesh.patches.len()];
    let (mut known, mut retired) = (0, 0);
    for cut in cuts.iter().chain([&[1.0; 8]]) {
        let mut pieces = Vec::new();
        for (patch, start) in starts.iter_mut().enumerate() {
            let triangles = mesh.patch(mesh.patches[patch].kind);
            let end = share(cut[patch], triangles.len()).max(*start);
            pieces.push((mesh.patches[patch].kind, &triangles[*start..end]));
            *start = end;
        }
        let used = pieces.iter().flat_map(|(_, t)| t.as_flattened()).max().map_or(0, |&v| v as usize + 1);
        let later = mesh.patches.iter().zip(&starts).flat_map(|(p, &start)| &mesh.patch(p.kind)[start..]).flatten();
        let next = later.min().map_or(mesh.positions.len(), |&v| v as usize);
        let end = used.max(known).max(share(cut[6], mesh.positions.len()));
        retired = share(cut[7], next).min(end).max(retired);
        writer.push(&mesh.positions[known..end], &pieces, retired as u32).unwrap();
        known = end;
    }
    writer.finish().unwrap()
}

type File = (&'static str, Result<Vec<u8>, String>);

/// The files of all formats.
fn files(surface: &dyn Source) -> [File; 8] {
    let options = GlbOptions::default();
    let file = |write: &dyn Fn(&mut Vec<u8>) -> io::Result<()>| {
        let mut file = Vec::new();
        write(&mut file).map(|()| file).map_err(|error| error.to_string())
    };
    [
        ("glb", file(&|out| write_glb(surface, &options, out))),
        ("gltf", file(&|out| write_gltf(surface, &options, "x.bin", out))),
        ("bin", file(&|out| write_gltf_data(surface, &options, out))),
        ("obj", file(&|out| write_obj(surface, out))),
        ("stl", file(&|out| write_stl(surface, out))),
        ("text stl", file(&|out| write_ascii_stl(surface, out))),
        ("ply", file(&|out| write_ply(surface, out))),
        ("vtp", file(&|out| write_vtp(surface, out))),
    ]
}

/// The first format whose file differs in some unit.
fn difference(mesh: &Mesh, cuts: &Cuts) -> Option<(&'static str, LengthUnit)> {
    let (folder, meta) = (tempfile::tempdir().unwrap(), meta());
    let spool = spool(mesh, cuts, folder.path());
    LengthUnit::ALL.into_iter().find_map(|unit| {
        let positions = unit.of_metres(&mesh.positions);
        let shape = Shape { positions: &positions, unit, ..Shape::of(mesh, &meta) };
        let both = files(&shape).into_iter().zip(files(&spool.shape(unit, &meta)));
        both.into_iter().find_map(|(expected, found)| (expected != found).then_some((expected.0, unit)))
    })
}

/// A tube whose rings get new points in every section, as the lofter makes it: these are in the rim below too, numbered after
/// the rest of it.
fn lofted(sections: u32) -> Mesh {
    let mut rings = [0, 1].map(|_| (0..8_u32).map(|i| (i, TAU * f64::from(i) / 8.0)).collect::<Vec<_>>());
    let section = |rings: &[Vec<(u32, f64)>; 2], step: u32| {
        let ring = |points: &[(u32, f64)], radius: f64| Ring {
            ids: points.iter().map(|point| point.0).collect(),
            points: points.iter().map(|p| [(radius * p.1.cos()) as f32, (radius * p.1.sin()) as f32]).collect(),
        };
        let (step, z_um) = (f64::from(step), 75.0 * f64::from(step));
        let (inner, outer) = (ring(&rings[0], 400.0 + step), ring(&rings[1], 900.0 - step));
        Section { step, z_um, added: false, inner, outer }
    };
    let mut lofter = Lofter::new(section(&rings, 0)).unwrap();
    for step in 1..sections {
        for (ring, every) in rings.iter_mut().zip([3, 2]) {
            for at in (0..ring.len() - 1).rev().step_by(every + step as usize % 2) {
                let middle = 0.5 * (ring[at].1 + ring[at + 1].1);
                ring.insert(at + 1, (ring.len() as u32, middle));
            }
        }
        lofter.advance(&[section(&rings, step)]).unwrap();
    }
    lofter.finish().unwrap()
}

#[test]
fn a_lofted_tube_is_the_same() {
    let mesh = lofted(5);
    let inner = mesh.patch(PatchKind::InnerWall);
    assert!(inner.iter().any(|t| t.iter().max().unwrap() - t.iter().min().unwrap() > 60), "some are inserted");
    let even = |pushes: u32| (1..=pushes).map(|k| [f64::from(k) / f64::from(pushes); 8]).collect();
    for pushes in [0, 1, 2, 7, 100] {
        assert_eq!(difference(&mesh, &even(pushes)), None, "{pushes}");
    }
}

#[test]
fn a_patch_in_two_places_is_the_same() {
    let corner = |i: u16| [f32::from(i), f32::from(i % 2), f32::from(i % 3)].map(|x| 1e-3 * x);
    let patch = |kind, triangles| Patch { kind, triangles };
    let patches = [(PatchKind::InnerWall, 0..2), (PatchKind::OuterWall, 2..4), (PatchKind::CapIsthmus, 4..5)];
    let mesh = Mesh {
        body: BodyKind::Tissue,
        positions: (0..12).map(corner).collect(),
        triangles: vec![[0, 1, 2], [9, 10, 11], [3, 4, 5], [6, 7, 8], [1, 0, 4]],
        patches: patches.into_iter().chain([(PatchKind::CapAmpulla, 5..5)]).map(|(k, t)| patch(k, t)).collect(),
    };
    // The cap comes before the wall that shades its corners, and the ends of the inner wall share no vertices in use.
    let push = |inner, outer| [inner, outer, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let cuts = vec![push(0.0, 0.0), push(0.5, 0.0), push(0.5, 0.5), push(0.5, 1.0)];
    assert_eq!(difference(&mesh, &cuts), None);
}

#[test]
fn wide_indices_are_the_same() {
    let mesh = sample::tube(700, 100, 0.3);
    assert_eq!(difference(&mesh, &vec![[0.4, 0.2, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), None);
}

#[test]
fn other_bodies_are_the_same() {
    let regions = oviduct_surface::mesh::regions(&lofted(4)).unwrap();
    let cuts = vec![[0.5, 0.4, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0]];
    for mesh in [oviduct_surface::mesh::lumen(&regions), regions] {
        assert_eq!(difference(&mesh, &cuts), None);
    }
}

/// A surface of tissue with triangles anywhere, as far as no vertex is in two walls, or in two caps but no wall.
fn scattered() -> impl Strategy<Value = Mesh> {
    let coordinate = prop_oneof![-1e-3f32..1e-3, Just(0.0), Just(-0.0)];
    let positions = prop::collection::vec(prop::array::uniform3(coordinate), 12..60);
    let corners = prop::collection::vec((0..4_usize, prop::array::uniform3(0..1000_u32)), 0..60);
    (positions, corners).prop_map(|(positions, corners)| {
        let count = positions.len() as u32;
        let class = |class: u32| (0..count).filter(move |v| v % 4 == class);
        let walls = class(0).chain(class(1)).collect::<Vec<_>>();
        let usable: [Vec<u32>; 4] = [
            class(0).collect(),
            class(1).collect(),
            walls.iter().copied().chain(class(2)).collect(),
            walls.iter().copied().chain(class(3)).collect(),
        ];
        let (mut triangles, mut patches) = (Vec::new(), Vec::new());
        for (patch, &kind) in BodyKind::Tissue.patches().iter().enumerate() {
            let start = triangles.len();
            let of_patch = corners.iter().filter(|(p, _)| *p == patch);
            triangles.extend(of_patch.map(|(_, t)| t.map(|i| usable[patch][i as usize % usable[patch].len()])));
            if kind.is_wall() {
                triangles.extend(usable[patch].windows(3).map(|t| [t[0], t[1], t[2]]));
            }
            patches.push(Patch { kind, triangles: start..triangles.len() });
        }
        Mesh { body: BodyKind::Tissue, positions, triangles, patches }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_cuts_give_the_same_files(cuts in cuts(), sections in 2..6_u32) {
        prop_assert_eq!(difference(&lofted(sections), &cuts), None);
    }

    #[test]
    fn any_surface_gives_the_same_files(cuts in cuts(), mesh in scattered()) {
        prop_assert_eq!(difference(&mesh, &cuts), None);
    }
}

#[test]
fn an_empty_spool_is_the_same() {
    let patches = BodyKind::Tissue.patches().iter().map(|&kind| Patch { kind, triangles: 0..0 }).collect();
    let mesh = Mesh { body: BodyKind::Tissue, positions: vec![], triangles: vec![], patches };
    assert_eq!(difference(&mesh, &vec![]), None);
    let points = Mesh { positions: vec![[1.0; 3], [2.0; 3]], ..mesh };
    assert_eq!(difference(&points, &vec![[0.5; 8]]), None);
}

#[test]
fn broken_promises_are_errors() {
    use PatchKind::{InnerWall, OuterWall, Wall};
    let refused = |triangles: &[(PatchKind, &[[u32; 3]])], retired| {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = SpoolWriter::new(folder.path(), BodyKind::Tissue).unwrap();
        writer.push(&[[0.0; 3]; 4], &[(InnerWall, &[[0, 1, 2]]), (OuterWall, &[[1, 2, 3]])], 1).unwrap();
        let error = writer.push(&[[0.0; 3]; 2], triangles, retired).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
        error.to_string()
    };
    let in_use = "those in use are 1..6";
    assert_eq!(refused(&[(InnerWall, &[[5, 2, 0]])], 1), format!("a triangle of inner_wall names vertex 0; {in_use}"));
    assert_eq!(refused(&[(OuterWall, &[[6, 2, 3]])], 1), format!("a triangle of outer_wall names vertex 6; {in_use}"));
    assert_eq!(refused(&[(Wall, &[[1, 2, 3]])], 1), "the tissue has no patch wall");
    assert_eq!(refused(&[], 0), format!("vertices before 0 cannot retire: {in_use}"));
    assert_eq!(refused(&[], 7), format!("vertices before 7 cannot retire: {in_use}"));
}

#[test]
fn files_are_removed() {
    let folder = tempfile::tempdir().unwrap();
    let files = || std::fs::read_dir(folder.path()).unwrap().count();
    let writer = SpoolWriter::new(folder.path(), BodyKind::Tissue).unwrap();
    assert_eq!(files(), 5);
    drop(SpoolWriter::new(folder.path(), BodyKind::Tissue).unwrap());
    assert_eq!(files(), 5, "a second one removes only its own");
    let spool = writer.finish().unwrap();
    assert_eq!(files(), 5);
    drop(spool);
    assert_eq!(files(), 0);
    assert!(SpoolWriter::new(&folder.path().join("none"), BodyKind::Tissue).is_err());
}

#[test]
fn several_read_at_a_time() {
    let (folder, meta) = (tempfile::tempdir().unwrap(), meta());
    let spool = spool(&sample::tube(60, 40, 0.3), &vec![[0.5; 8]], folder.path());
    let shape = spool.shape(LengthUnit::Metre, &meta);
    let expected = files(&shape);
    std::thread::scope(|scope| {
        let readers = [(); 3].map(|()| scope.spawn(|| files(&shape)));
        readers.into_iter().for_each(|reader| assert!(reader.join().unwrap() == expected));
    });
}

#[test]
fn what_is_lost_from_the_disk_is_an_error() {
    let (folder, meta) = (tempfile::tempdir().unwrap(), meta());
    let spool = spool(&sample::tube(30, 6, 0.3), &vec![[0.5; 8]], folder.path());
    let file = std::fs::File::options().write(true).open(&spool.positions).unwrap();
    file.set_len(100).unwrap();
    let shape = spool.shape(LengthUnit::Metre, &meta);
    assert_eq!(write_ply(&shape, &mut Vec::new()).unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
}

#[test]
fn strips_need_a_surface_in_memory() {
    let (folder, meta) = (tempfile::tempdir().unwrap(), meta());
    let spool = spool(&sample::tube(30, 6, 0.3), &vec![], folder.path());
    let (mut out, options) = (Vec::new(), GlbOptions { strips: true });
    let error = write_glb(&spool.shape(LengthUnit::Metre, &meta), &options, &mut out).unwrap_err();
    assert_eq!((error.kind(), out.len()), (io::ErrorKind::InvalidInput, 0));
    assert!(error.to_string().contains("strips"), "{error}");
}
