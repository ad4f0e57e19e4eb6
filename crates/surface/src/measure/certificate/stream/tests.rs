//! The streamed certificate against that of the whole mesh.

mod faulty;

use super::super::samples::{Soup, flipped, folded_tube, tetrahedron};
use super::super::types::{Failure, FailureKind};
use super::super::{Certificate, certify_body};
use super::*;
use crate::model::Mesh;
use std::ops::Range;

/// The mesh with its vertices and triangles in the order along the tube.
fn along_the_tube(mesh: &Mesh) -> Mesh {
    let z = |v: u32| mesh.positions[v as usize][2];
    let mut order: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    order.sort_by(|&a, &b| z(a).total_cmp(&z(b)));
    let mut number = vec![0; order.len()];
    for (new, &old) in (0..).zip(&order) {
        number[old as usize] = new;
    }
    let mut triangles = mesh.triangles.clone();
    let extent = |t: &[u32; 3]| t.map(z).into_iter().fold([f32::MIN, f32::MAX], |[h, l], z| [h.max(z), l.min(z)]);
    triangles.sort_by(|a, b| extent(a).partial_cmp(&extent(b)).expect("finite"));
    triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
    let positions = order.iter().map(|&v| mesh.positions[v as usize]).collect();
    Mesh { positions, triangles, ..mesh.clone() }
}

/// The mesh in chunks that end at these triangles, with the greatest promises that hold.
fn chunks<'a>(mesh: &'a Mesh, ends: &[usize]) -> Vec<Chunk<'a>> {
    let triangles = mesh.triangles.len();
    let mut ends: Vec<usize> = ends.iter().map(|&end| end.min(triangles)).chain([triangles]).collect();
    ends.sort_unstable();
    let (mut chunks, mut begin, mut come) = (Vec::new(), 0, 0);
    for end in ends {
        let (now, later) = (&mesh.triangles[begin..end], &mesh.triangles[end..]);
        let named = now.iter().flatten().fold(come, |most, &v| most.max(v as usize + 1)).min(mesh.positions.len());
        let last = if end == triangles { mesh.positions.len() } else { named };
        let z = later.iter().flatten().filter_map(|&v| mesh.positions.get(v as usize)).map(|p| p[2]);
        chunks.push(Chunk {
            positions: &mesh.positions[come..last],
            first_vertex: come as u32,
            triangles: <[_; 2]>::from(now.split_at(now.len() / 3)).into(),
            retired_vertices: later.iter().flatten().copied().min().unwrap_or(u32::MAX),
            retired_z: z.fold(f32::INFINITY, f32::min),
        });
        (begin, come) = (end, last);
    }
    chunks
}

fn stream(body: BodyKind, chunks: &[Chunk<'_>]) -> Certificate {
    let mut certifier = StreamCertifier::new(body, LengthUnit::Metre);
    chunks.iter().for_each(|chunk| certifier.push(chunk));
    certifier.finish()
}

/// Streams the mesh in these chunks and compares everything with the certificate of the whole.
#[track_caller]
fn assert_same(mesh: &Mesh, ends: &[usize]) -> Certificate {
    let found = stream(mesh.body, &chunks(mesh, ends));
    let mut expected = certify_body(mesh, LengthUnit::Metre);
    let close = |a: f64, b: f64, scale: f64| (a - b).abs() <= 1e-9 * scale || a.is_nan() && b.is_nan();
    let scale = expected.area_mm2 + expected.area_mm2.powf(1.5);
    assert!(close(found.volume_mm3, expected.volume_mm3, scale), "{} {}", found.volume_mm3, expected.volume_mm3);
    assert!(close(found.area_mm2, expected.area_mm2, scale));
    (expected.volume_mm3, expected.area_mm2) = (found.volume_mm3, found.area_mm2);
    assert_eq!(found.bodies.len(), expected.bodies.len());
    for (body, found) in expected.bodies.iter_mut().zip(&found.bodies) {
        assert!(close(body.volume_mm3, found.volume_mm3, scale));
        body.volume_mm3 = found.volume_mm3;
    }
    if expected.components > 1 {
        expected.failures.retain(|f| !matches!(f.kind, FailureKind::Volume | FailureKind::Overlap));
    }
    assert_eq!(found, expected);
    found
}

fn tube() -> Mesh {
    along_the_tube(&folded_tube(6, 60, 12, 5).0)
}

/// Where the triangles of the slabs of [`tube`] end: after the cap, slabs of equal size.
fn slabs(per_chunk: usize) -> Vec<usize> {
    let cap = 60 * 3 + 12;
    (1..6).step_by(per_chunk).map(|slab| cap + 72 * 2 * slab).collect()
}

#[test]
fn sound_tubes_pass_in_chunks_of_any_size() {
    let mesh = tube();
    for ends in [slabs(1), slabs(2), slabs(3), vec![], (0..mesh.triangles.len()).step_by(7).collect()] {
        let found = assert_same(&mesh, &ends);
        assert!(found.passed, "{:?}", found.failures);
    }
    let singles: Vec<usize> = (0..mesh.triangles.len()).collect();
    assert!(assert_same(&mesh, &singles).passed);
    let large = along_the_tube(&folded_tube(4, 3_000, 200, 30).0);
    assert!(assert_same(&large, &[10_000, 16_000]).passed);
    let inside_out = Mesh { triangles: mesh.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(), ..mesh };
    let found = assert_same(&inside_out, &slabs(1));
    assert_eq!(found.failures.iter().map(|f| f.kind).collect::<Vec<_>>(), [FailureKind::Volume]);
}

#[test]
fn the_window_holds_no_more_than_the_last_slabs() {
    let mesh = tube();
    let mut certifier = StreamCertifier::new(mesh.body, LengthUnit::Metre);
    for chunk in chunks(&mesh, &slabs(1)) {
        certifier.push(&chunk);
        assert!(certifier.window.numbers().len() <= 3 * 60 + 12 + 72 * 2);
        assert!(certifier.parts.labels().len() <= 2 * 72 + 60);
    }
    assert_eq!(certifier.window.numbers().len(), 0);
    assert!(certifier.finish().passed);
}

#[test]
fn no_triangles_and_isolated_vertices_are_no_surface() {
    let kinds = |c: &Certificate| c.failures.iter().map(|f| f.kind).collect::<Vec<_>>();
    assert_eq!(kinds(&stream(BodyKind::Lumen, &[])), [FailureKind::Empty]);
    let positions = [[0.0; 3]; 4];
    let chunk =
        Chunk { positions: &positions, first_vertex: 0, triangles: vec![], retired_vertices: 3, retired_z: 1.0 };
    assert_eq!(kinds(&stream(BodyKind::Lumen, &[chunk])), [FailureKind::Empty]);
    let mut mesh = tube();
    mesh.positions.splice(0..0, [[0.0; 3]; 5]);
    mesh.triangles.iter_mut().flatten().for_each(|v| *v += 5);
    assert!(assert_same(&mesh, &slabs(1)).passed);
}

#[test]
fn many_components_are_counted_and_the_first_listed() {
    let mut mesh = Mesh { body: BodyKind::Lumen, positions: Vec::new(), triangles: Vec::new(), patches: Vec::new() };
    for i in 0..2_000u32 {
        let soup = tetrahedron(1e-3, [0.0, 0.0, f64::from(i) * 8e-4 + f64::from(i % 2) * 1e-5]);
        let at = mesh.positions.len();
        add(&mut mesh, if i == 7 { flipped(soup) } else { soup }, at);
    }
    let found = assert_same(&mesh, &(0..mesh.triangles.len()).step_by(101).collect::<Vec<_>>());
    assert_eq!((found.components, found.bodies.len()), (2_000, 256));
}

/// Adds a body, with its vertices after the others, before a triangle.
fn add(mesh: &mut Mesh, (positions, triangles): Soup, before: usize) {
    let base = mesh.positions.len() as u32;
    mesh.positions.extend(positions.iter().map(|p| p.map(|x| x as f32)));
    let before = before.min(mesh.triangles.len());
    mesh.triangles.splice(before..before, triangles.into_iter().map(|t| t.map(|v| v + base)));
}

#[test]
fn copies_that_meet_those_of_another_chunk_count_for_each_copy() {
    let mut mesh = Mesh { body: BodyKind::Lumen, positions: Vec::new(), triangles: Vec::new(), patches: Vec::new() };
    for (copies, at) in [(2, [0.0; 3]), (3, [0.3, 0.2, 0.1])] {
        let (positions, triangles) = tetrahedron(2.0, at);
        let end = mesh.triangles.len();
        add(&mut mesh, (positions, triangles.repeat(copies)), end);
    }
    let found = assert_same(&mesh, &[8]);
    assert_eq!((found.duplicate_triangles, found.triangle_intersections % 6), (4 + 4 * 3, 0));
    assert!(found.triangle_intersections > 0);
}

#[test]
fn triangles_in_no_order_within_their_slab_are_searched() {
    let mut mesh = along_the_tube(&folded_tube(4, 3_000, 200, 30).0);
    // In low slabs triangles in no order are far apart.
    mesh.positions.iter_mut().for_each(|p| p[2] *= 0.1);
    let ends = [9_200 + 6_400, 9_200 + 2 * 6_400];
    for (begin, end) in [(0, ends[0]), (ends[0], ends[1]), (ends[1], mesh.triangles.len())] {
        let count = end - begin;
        (0..count).for_each(|i| mesh.triangles.swap(begin + i, begin + (i * 7_919 + 13) % count));
    }
    assert!(assert_same(&mesh, &ends).passed);
    // Folds of both sections between the slabs, pushed through others.
    for vertex in (6_200..12_600).step_by(137) {
        mesh.positions[vertex][1] += 3e-4;
    }
    assert!(assert_same(&mesh, &ends).triangle_intersections > 0);
}

#[test]
fn the_search_stops_when_it_found_enough_with_any_number_of_threads() {
    // Triangles that all cross each other.
    let n = 1_200u32;
    let corner = |i: u32, k: u32| {
        let angle = std::f32::consts::TAU * (i as f32 / n as f32 + k as f32) / 3.0;
        [angle.cos(), angle.sin(), ((i * 7 + k * 1_009) % 97) as f32 / 97.0 - 0.5]
    };
    let positions = (0..n).flat_map(|i| [0, 1, 2].map(|k| corner(i, k))).collect();
    let triangles = (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let mesh = Mesh { body: BodyKind::Lumen, positions, triangles, patches: Vec::new() };
    let run = |threads| in_pool(threads, || stream(mesh.body, &chunks(&mesh, &[300, 600, 900])));
    let found = run(1);
    assert!(found.triangle_intersections > 100_000 && found.triangle_intersections < 700_000);
    let failure = found.failures.iter().find(|f| f.kind == FailureKind::TriangleIntersections).expect("they meet");
    assert!(failure.detail.starts_with("at least ") && failure.detail.ends_with("(the search stopped after 100000)"));
    assert_eq!(failure.places.len(), 16);
    assert_eq!(found, run(3));
}

fn in_pool<T: Send>(threads: usize, run: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads").install(run)
}

/// The failure of a tube of which a chunk is changed.
fn broken(change: impl Fn(&mut [Chunk<'_>])) -> Vec<Failure> {
    let mesh = tube();
    let mut chunks = chunks(&mesh, &slabs(1));
    change(&mut chunks);
    let found = stream(mesh.body, &chunks);
    assert!(!found.passed && found.triangles == 0);
    found.failures
}

#[test]
fn broken_promises_are_failures() {
    let order = |change: &dyn Fn(&mut [Chunk<'_>])| {
        let failures = broken(change);
        assert_eq!(failures.iter().map(|f| f.kind).collect::<Vec<_>>(), [FailureKind::Order]);
        failures[0].detail.clone()
    };
    let detail = order(&|chunks| chunks[1].retired_vertices += 1);
    assert!(detail.contains("names a vertex below"), "{detail}");
    let detail = order(&|chunks| chunks[1].retired_z = chunks[1].retired_z.next_up());
    assert!(detail.contains("has a corner below z"), "{detail}");
    for by in [1, u32::MAX] {
        let detail = order(&|chunks| chunks[2].first_vertex = chunks[2].first_vertex.wrapping_add(by));
        assert!(detail.contains("is numbered"), "{detail}");
    }
    order(&|chunks| chunks.swap(1, 2));
    let indices = broken(|chunks| chunks[2].positions = &chunks[2].positions[1..]);
    assert!(matches!(indices[0].kind, FailureKind::Indices | FailureKind::Order), "{indices:?}");
}

#[test]
fn weaker_promises_change_nothing() {
    let mesh = tube();
    let chunks = chunks(&mesh, &slabs(1));
    let expected = stream(mesh.body, &chunks);
    let with = |weaken: &dyn Fn(usize, &mut Chunk<'_>)| {
        let mut chunks = chunks.clone();
        chunks.iter_mut().enumerate().for_each(|(i, chunk)| weaken(i, chunk));
        assert_eq!(stream(mesh.body, &chunks), expected);
    };
    with(&|_, chunk| chunk.retired_vertices = 0);
    // The vertices of the first section retire, but not those in its cap.
    with(&|i, chunk| chunk.retired_vertices -= if i == 0 { 60 } else { 0 });
    with(&|_, chunk| chunk.retired_z = f32::NAN);
    with(&|i, chunk| chunk.retired_vertices = if i % 2 == 0 { chunk.retired_vertices / 2 } else { 3 });
    with(&|i, chunk| chunk.retired_z *= if i % 2 == 0 { 0.7 } else { 1.0 });
}

#[test]
fn what_is_no_surface_is_named() {
    let ends: Range<usize> = 0..1_000;
    let ends: Vec<usize> = ends.step_by(150).collect();
    for bad in [f32::NAN, f32::INFINITY] {
        let mut mesh = tube();
        mesh.positions[200][1] = bad;
        mesh.positions[300][2] = bad;
        let found = assert_same(&mesh, &ends);
        assert_eq!(found.failures[0].count, 2);
    }
    let mut mesh = tube();
    let beyond = mesh.positions.len() as u32;
    mesh.triangles[400][1] = beyond;
    mesh.triangles[500][2] = beyond + 7;
    let found = stream(mesh.body, &chunks(&mesh, &ends));
    assert_eq!((found.failures[0].kind, found.failures[0].count), (FailureKind::Indices, 2));
}
