//! Tests of the readers with intact and damaged files from oviduct, and with patches of other
//! programs.

use super::*;
use crate::export::tests::{Sample, bits};
use crate::export::{ply, stl, vtp};
use proptest::prelude::*;
use std::ops::Range;

type Kind = (Format, fn(&Sample) -> Vec<u8>);

/// Formats with the functions that write them.
const KINDS: [Kind; 4] = [
    (Format::Stl, |sample| file(|out| stl::write_stl(&sample.shape(), out))),
    (Format::Stl, |sample| file(|out| stl::write_ascii_stl(&sample.shape(), out))),
    (Format::Ply, |sample| file(|out| ply::write_ply(&sample.shape(), out))),
    (Format::Vtp, |sample| file(|out| vtp::write_vtp(&sample.shape(), out))),
];

fn file(write: impl Fn(&mut Vec<u8>) -> std::io::Result<()>) -> Vec<u8> {
    let mut file = Vec::new();
    write(&mut file).unwrap();
    file
}

fn groups(surface: &Surface) -> Vec<(&str, Range<usize>)> {
    surface.groups.iter().map(|group| (&*group.name, group.triangles.clone())).collect()
}

#[test]
fn all_forms_hold_the_same_surface() {
    let sample = Sample::new(40);
    let of = |surface: &Surface| {
        let corner = |v: u32| bits(&[surface.positions[v as usize]])[0];
        surface.triangles.iter().map(|t| t.map(corner)).collect::<Vec<_>>()
    };
    for (format, write) in KINDS {
        let bytes = write(&sample);
        assert_eq!(bytes, write(&sample), "the same bytes");
        let read = parse(&bytes, format, None).unwrap();
        assert_eq!(of(&read), of(&sample.surface()), "{format:?}");
        let runs = |surface: &Surface| surface.groups.iter().map(|group| group.triangles.clone()).collect::<Vec<_>>();
        assert_eq!(runs(&read), runs(&sample.surface()));
    }
}

#[test]
fn attributes_number_patches_in_our_files_only() {
    let mut bytes = KINDS[0].1(&Sample::new(6));
    let read = parse(&bytes, Format::Stl, None).unwrap();
    assert_eq!(groups(&read), [("patch 0", 0..2), ("patch 1", 2..3), ("patch 3", 3..6)]);
    // A triangle without a patch, and a patch in two parts.
    bytes[84 + 4 * 50 + 48] = 0;
    let read = parse(&bytes, Format::Stl, None).unwrap();
    assert_eq!(groups(&read), [("patch 0", 0..2), ("patch 1", 2..3), ("patch 3", 3..4), ("patch 3", 5..6)]);
    bytes[0] = b'O';
    assert!(parse(&bytes, Format::Stl, None).unwrap().groups.is_empty());
}

#[test]
fn each_solid_of_a_text_is_a_group() {
    let facet = "facet normal 0 0 0 outer loop vertex 0 0 0 vertex 0.1 0 0 vertex 0 1 0 endloop endfacet\n";
    let text = format!(
        "solid  inner wall \r\n{facet}{facet}endsolid inner wall\nsolid none\nendsolid\nsolid\n{facet}endsolid\nsolid b\n{facet}endsolid"
    );
    let read = parse(text.as_bytes(), Format::Stl, None).unwrap();
    assert_eq!(groups(&read), [("inner wall", 0..2), ("", 2..3), ("b", 3..4)]);
    assert_eq!(read.positions[1], [0.1, 0.0, 0.0]);
}

#[test]
fn runs_of_ply_files_are_taken_only_if_they_are_sound() {
    let read = |comments: &str, last: &str| {
        let text = format!(
            "ply\nformat ascii 1.0\n{comments}element vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
             element face 3\nproperty list uchar int vertex_index\nend_header\n\
             0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 1 2\n{last}\n"
        );
        parse(text.as_bytes(), Format::Ply, None).unwrap()
    };
    let triangle = "3 0 1 2";
    let surface = read("comment patch 0 2 inner  wall \ncomment patch 2 0 none\ncomment patch 2 1 b\n", triangle);
    assert_eq!(groups(&surface), [("inner  wall", 0..2), ("b", 2..3)]);
    assert_eq!(read("comment patch of units: mm\n", triangle).unit, Unit::Stated(1e-3));
    for (comments, last) in [
        ("comment patch 0 2 a\ncomment patch 1 1 b\n", triangle),
        ("comment patch 0 4 a\n", triangle),
        ("comment patch 4294967295 4294967295 a\n", triangle),
        // The face with four corners becomes two triangles.
        ("comment patch 0 3 a\n", "4 0 1 2 3"),
    ] {
        assert!(read(comments, last).groups.is_empty(), "{comments}");
    }
}

#[test]
fn vtp_is_known_by_its_name() {
    assert_eq!(format_of(Path::new("model.VTP"), b"<?xml"), Some(Format::Vtp));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn damaged_files_never_panic(
        kind in 0..KINDS.len(),
        count in 0_usize..8,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let (format, write) = KINDS[kind];
        let mut bytes = write(&Sample::new(count));
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(surface) = parse(&bytes, format, None) {
            assert_sound(&surface);
        }
    }
}
