//! Tests of halves: they are closed, and their volumes are those of the whole.

use super::*;
use crate::model::sample::tube;
use std::collections::HashSet;

type Surface = (Vec<[f32; 3]>, Vec<[u32; 3]>);

fn volume(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> f64 {
    let corner = |v: u32| positions[v as usize].map(f64::from);
    triangles.iter().map(|t| t.map(corner)).map(|[a, b, c]| dot(a, cross(b, c)) / 6.0).sum()
}

/// Volume of a half, which must be closed and oriented, with distinct vertices that are all in use.
fn sound(half: &Half) -> f64 {
    let edges: Vec<[u32; 2]> = half.triangles.iter().flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]).collect();
    let once: HashSet<[u32; 2]> = edges.iter().copied().collect();
    assert_eq!(once.len(), edges.len(), "an edge twice");
    assert!(once.iter().all(|&[a, b]| once.contains(&[b, a])), "an open edge");
    let places: HashSet<[u32; 3]> = half.positions.iter().map(|p| p.map(|x| (x + 0.0).to_bits())).collect();
    assert_eq!(places.len(), half.positions.len(), "two vertices at one place");
    let used: HashSet<u32> = half.triangles.iter().flatten().copied().collect();
    assert_eq!(used.len(), half.positions.len(), "an unused vertex");
    volume(&half.positions, &half.triangles)
}

fn both(surface: &Surface, normal: [f64; 3], offset: f64) -> [Result<Half, HalfError>; 2] {
    let length = dot(normal, normal).sqrt();
    let front = HalfSpace { normal: normal.map(|x| x / length), offset: offset / length };
    let back = HalfSpace { normal: front.normal.map(|x| -x), offset: -front.offset };
    let all = 0..surface.1.len();
    [front, back].map(|space| half(&surface.0, &surface.1, std::slice::from_ref(&all), &space))
}

fn cube() -> Surface {
    let positions = (0..8).map(|k| [0, 1, 2].map(|axis| (k >> axis & 1) as f32)).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    (positions, quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect())
}

#[test]
fn two_halves_have_the_volume_of_the_whole() {
    let mesh = tube(24, 4, 0.3);
    let surface = (mesh.positions, mesh.triangles);
    let whole = volume(&surface.0, &surface.1);
    for (normal, offset) in [
        ([0.0, 0.0, 1.0], 1.7e-3),
        // Through vertices of a section.
        ([0.0, 0.0, 1.0], f64::from(1e-3_f32)),
        ([0.0, 0.0, -1.0], f64::from(-2e-3_f32)),
        // Along the axis and beside it, so that the cut has one or several parts.
        ([0.0, 1.0, 0.0], 0.0),
        ([1.0, 0.0, 0.0], 4.2e-4),
        ([1.0, 0.0, 0.0], 7.3e-4),
        ([0.0, 1.0, 1.0], 2e-3),
        ([0.3, -0.2, 0.7], 1.1e-3),
        ([1.0, 1.0, 0.1], 0.0),
    ] {
        let halves = both(&surface, normal, offset).map(|half| half.unwrap_or_else(|e| panic!("{normal:?}: {e}")));
        let [front, back] = halves.each_ref().map(sound);
        assert!(front > 0.0 && back > 0.0);
        assert!(((front + back) / whole - 1.0).abs() < 1e-6, "{normal:?} {offset}: {front} + {back}, not {whole}");
        for (half, side) in halves.iter().zip([1.0, -1.0]) {
            let length = dot(normal, normal).sqrt();
            for &v in half.triangles[half.cap.clone()].as_flattened() {
                let height = dot(half.positions[v as usize].map(f64::from), normal) / length;
                assert!((height - offset / length).abs() < 1e-9, "the cap lies on the plane");
            }
            let highest = half.positions.iter().map(|p| dot(p.map(f64::from), normal) * side).fold(f64::MIN, f64::max);
            assert!(highest > offset * side);
        }
    }
}

#[test]
fn a_cube_is_cut_through_its_corners_and_along_its_faces() {
    let cube = cube();
    for (normal, offset, expected) in [
        ([1.0, 1.0, 0.0], 1.0, 0.5),
        ([1.0, 1.0, 1.0], 1.0, 5.0 / 6.0),
        ([1.0, 0.0, 0.0], 0.25, 0.75),
        ([0.0, -1.0, 0.0], -0.25, 0.25),
    ] {
        let [front, back] = both(&cube, normal, offset).map(|half| sound(&half.unwrap()));
        assert!((front - expected).abs() < 1e-6 && (front + back - 1.0).abs() < 1e-6, "{normal:?}: {front} {back}");
    }
    // A face in the plane is replaced by the cap; behind it is nothing.
    let [front, back] = both(&cube, [0.0, 0.0, 1.0], 0.0);
    let front = front.unwrap();
    assert!((sound(&front) - 1.0).abs() < 1e-12);
    assert_eq!((front.cap.len(), front.patches[0].len()), (2, 10));
    assert_eq!(back, Err(HalfError::Nothing));
    // In front of a plane that misses the cube is all of it, without a cap.
    let [front, back] = both(&cube, [0.0, 0.0, 1.0], -0.5);
    assert_eq!((front.unwrap().cap.len(), back), (0, Err(HalfError::Nothing)));
}

#[test]
fn patches_keep_their_triangles() {
    let mesh = tube(12, 3, 0.0);
    let patches: Vec<_> = mesh.patches.iter().map(|patch| patch.triangles.clone()).collect();
    let space = HalfSpace { normal: [0.0, 0.0, 1.0], offset: 2e-3 };
    let half = half(&mesh.positions, &mesh.triangles, &patches, &space).unwrap();
    let lengths: Vec<usize> = half.patches.iter().map(std::iter::ExactSizeIterator::len).collect();
    // Half of the three slabs: a whole one, and one and a half times as many triangles in the
    // other.
    assert_eq!(lengths, [24 + 36, 24 + 36, 0, 24]);
    assert_eq!((half.patches[1].start, half.cap.end), (60, half.triangles.len()));
}

#[test]
fn an_open_surface_is_refused() {
    let (positions, mut triangles) = cube();
    triangles.remove(4);
    let half = both(&(positions, triangles), [0.0, 0.0, 1.0], 0.5);
    assert_eq!(half, [Err(HalfError::Open), Err(HalfError::Open)]);
}
