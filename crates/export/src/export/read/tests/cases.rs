//! The files of other programs in `tests/cases`, with what they hold.

use super::*;
use std::collections::HashMap;
use std::path::PathBuf;

/// What a file holds.
struct Case {
    file: &'static str,
    triangles: usize,
    /// Volume in units of the file.
    volume: f64,
    /// Largest relative error of the volume, which is rounding of the coordinates of the file.
    within: f64,
    groups: &'static [(&'static str, usize)],
    /// Beginnings of the notes.
    notes: &'static [&'static str],
}

const CUBE: Case = Case { file: "", triangles: 12, volume: 8.0, within: 1e-9, groups: &[], notes: &[] };

const CASES: [Case; 18] = [
    Case { file: "closed-self-intersecting/cube.obj", volume: 1.0, ..CUBE },
    Case { file: "obj-backslash-comment/cube.obj", ..CUBE },
    Case { file: "obj-bom/cube.obj", ..CUBE },
    Case { file: "obj-continuation-space/cube.obj", ..CUBE },
    Case { file: "obj-cr-only/cube.obj", ..CUBE },
    Case { file: "obj-mixed/cube.obj", groups: &[("wall left", 12)], ..CUBE },
    Case { file: "obj-ngon-concave/ell.obj", triangles: 20, volume: 3.0, ..CUBE },
    // Twelve corners at radii 3 and 1: the coordinates are decimals of six digits.
    Case { file: "obj-ngon-concave/lumen.obj", triangles: 44, volume: 90.000_044_64, ..CUBE },
    Case { file: "ply-big-endian-extras/cube.ply", ..CUBE },
    Case {
        file: "ply-nan-unused/cube.ply",
        notes: &["1 vertex has a coordinate that is not finite, belongs to no triangle"],
        ..CUBE
    },
    Case { file: "ply-tristrips/cube.ply", ..CUBE },
    Case { file: "stl-end-solid/cube.stl", groups: &[("cube", 12)], ..CUBE },
    Case { file: "stl-nan-normal/ind.stl", groups: &[("cube", 12)], ..CUBE },
    Case { file: "stl-no-unit-mm/tube-lumen-mm.stl", triangles: 48, volume: 90.0, within: 1e-7, ..CUBE },
    Case { file: "stl-trailing-bytes/cube.stl", notes: &["92 bytes after the last of 12 triangles"], ..CUBE },
    Case { file: "stl-uppercase/cube.stl", groups: &[("CUBE", 12)], ..CUBE },
    Case {
        file: "vtp-foreign-names/float-patch.vtp",
        notes: &["the cell data \"patch\" do not number patches"],
        ..CUBE
    },
    Case { file: "vtp-modelfaceid/cube.vtp", groups: &[("face 1", 2), ("face 2", 2), ("face 3", 8)], ..CUBE },
];

fn path(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases").join(file)
}

/// Enclosed volume of a surface.
pub(in crate::export::read) fn volume(surface: &Surface) -> f64 {
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| surface.positions[v as usize]);
        a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    surface.triangles.iter().map(of).sum::<f64>() / 6.0
}

/// Asserts that every edge between positions has two triangles, in opposite directions.
pub(super) fn assert_closed(surface: &Surface) {
    let mut edges: HashMap<[[u64; 3]; 2], i32> = HashMap::new();
    for t in &surface.triangles {
        let key = t.map(|v| surface.positions[v as usize].map(|x| (x + 0.0).to_bits()));
        for k in 0..3 {
            *edges.entry([key[k], key[(k + 1) % 3]]).or_default() += 1;
        }
    }
    assert!(edges.iter().all(|(&[a, b], &count)| count == 1 && edges.get(&[b, a]) == Some(&1)));
}

#[test]
fn every_case_holds_what_it_should() {
    for case in CASES {
        let file = case.file;
        let surface = read_surface(&path(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        assert_eq!(surface.triangles.len(), case.triangles, "{file}");
        let found = volume(&surface);
        assert!((found / case.volume - 1.0).abs() <= case.within, "{file}: {found}");
        let groups: Vec<_> = surface.groups.iter().map(|g| (&*g.name, g.triangles.len())).collect();
        assert_eq!(groups, case.groups, "{file}");
        assert_eq!(surface.notes.len(), case.notes.len(), "{file}: {:?}", surface.notes);
        for (note, start) in surface.notes.iter().zip(case.notes) {
            assert!(note.starts_with(start), "{file}: {note}");
        }
        assert_closed(&surface);
        assert_sound(&surface);
    }
}

#[test]
fn cases_without_a_surface_are_refused() {
    for (file, message) in [
        ("stl-empty/empty.stl", "the file has no triangles"),
        ("stl-no-endsolid/cube.stl", "line 85: the end is missing: the file stops after facet 12, before `endsolid`"),
    ] {
        assert_eq!(read_surface(&path(file)).unwrap_err().to_string(), message);
    }
}
