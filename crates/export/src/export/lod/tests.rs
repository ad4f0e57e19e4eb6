//! Tests of the levels of a folded tube: structure, topology, distances, bytes.

use super::grid::Grid;
use super::*;
use crate::export::read::{Format, ReadError, parse};
use crate::export::tests::{meta, turned};
use crate::geometry::distance::squared_distance;
use crate::model::{BodyKind, PatchKind, sample};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::atomic::{AtomicUsize, Ordering};

/// A tube with 4·n·(slabs + 1) triangles that is wider in its middle, so that simplification has an
/// effect.
fn bulge(n: u32, slabs: u32) -> Mesh {
    let mut mesh = sample::tube(n, slabs, 0.3);
    for [x, y, z] in &mut mesh.positions {
        let t = *z / 4e-3;
        let factor = 1.0 + 1.6 * t * (1.0 - t);
        (*x, *y) = (*x * factor, *y * factor);
    }
    mesh
}

/// A mesh of 23,424 triangles.
fn mesh() -> Mesh {
    bulge(96, 60)
}

fn made() -> Vec<Level> {
    levels_of(&mesh(), None, [8000, 2500], &|| false).unwrap()
}

pub(super) fn file(level: &Level) -> Vec<u8> {
    let mut bytes = Vec::new();
    level.write(&meta(), &mut bytes).unwrap();
    bytes
}

fn document(bytes: &[u8]) -> Value {
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&bytes[20..20 + length]).unwrap()
}

/// Reads a level as any other glTF file, moves its vertices to the nearest place of the grid in
/// f32, and merges those of equal position.
pub(super) fn read_level(bytes: &[u8]) -> Result<Mesh, ReadError> {
    let surface = parse(bytes, Format::Gltf, None)?;
    let document = document(bytes);
    let body = document["nodes"].as_array().unwrap().iter().find(|node| node["scale"].is_array()).unwrap();
    let vector = |name: &str| std::array::from_fn(|axis| body[name][axis].as_f64().unwrap() as f32);
    let grid = Grid { origin: vector("translation"), step: vector("scale") };
    let mut mesh = Mesh { body: BodyKind::Tissue, positions: Vec::new(), triangles: Vec::new(), patches: Vec::new() };
    let mut known = HashMap::new();
    let merged: Vec<u32> = (surface.positions.iter())
        .map(|p| {
            let place = grid.position(grid.nearest(p.map(|x| x as f32)));
            assert!((0..3).all(|axis| (f64::from(place[axis]) - p[axis]).abs() < 1e-9 + p[axis].abs() * 1e-6), "{p:?}");
            *known.entry(place.map(f32::to_bits)).or_insert_with(|| {
                mesh.positions.push(place);
                mesh.positions.len() as u32 - 1
            })
        })
        .collect();
    mesh.triangles = surface.triangles.iter().map(|t| t.map(|v| merged[v as usize])).collect();
    for group in surface.groups {
        let kind = PatchKind::named(&group.name).unwrap_or(PatchKind::Inlet);
        mesh.patches.push(Patch { kind, triangles: group.triangles });
    }
    Ok(mesh)
}

/// Sorted triangles of each patch as bits of positions, each from its smallest corner.
pub(super) fn shapes(mesh: &Mesh, place: impl Fn(u32) -> [f32; 3]) -> BTreeMap<&'static str, Vec<[[u32; 3]; 3]>> {
    let of_patch = |patch: &crate::model::Patch| {
        let triangles = &mesh.triangles[patch.triangles.clone()];
        let mut all: Vec<_> = triangles.iter().map(|t| turned(t.map(|v| place(v).map(f32::to_bits)))).collect();
        all.sort_unstable();
        (patch.kind.name(), all)
    };
    mesh.patches.iter().map(of_patch).collect()
}

/// Checks that a mesh is closed and oriented, with the Euler number of its body.
pub(super) fn check_closed(mesh: &Mesh) {
    let edges: HashSet<_> = mesh.triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
    assert_eq!(edges.len(), 3 * mesh.triangles.len());
    assert!(edges.iter().all(|&(a, b)| a != b && edges.contains(&(b, a))));
    let euler = mesh.positions.len() as i64 - edges.len() as i64 / 2 + mesh.triangles.len() as i64;
    assert_eq!(euler, mesh.body.euler());
}

#[test]
fn the_finest_level_is_the_full_surface_on_the_grid() {
    let (mesh, levels) = (mesh(), made());
    let read = read_level(&file(&levels[0])).unwrap();
    let full = FullSurface::new(&mesh);
    assert_eq!(read.body, mesh.body);
    assert_eq!(shapes(&read, |v| read.positions[v as usize]), shapes(&mesh, |v| full.placed(v)));
    let half: f64 = levels[0].report.precision_um.iter().map(|step| (step / 2.0).powi(2)).sum::<f64>().sqrt();
    let distance = levels[0].report.distance_um;
    assert!(distance > half / 4.0 && distance < half * 1.02, "{distance} of {half}");
    assert_eq!(levels[0].report.vertices, mesh.positions.len());
}

#[test]
fn every_level_is_closed_and_keeps_ends_and_borders() {
    let mut borders = Vec::new();
    for level in made() {
        let read = read_level(&file(&level)).unwrap();
        check_closed(&read);
        assert_eq!((read.positions.len(), read.triangles.len()), (level.report.vertices, level.report.triangles));
        let mut shapes = shapes(&read, |v| read.positions[v as usize]);
        let ends = [PatchKind::CapIsthmus, PatchKind::CapAmpulla].map(|cap| shapes.remove(cap.name()).unwrap());
        assert_eq!(shapes.into_keys().collect::<Vec<_>>(), ["inner_wall", "outer_wall"]);
        borders.push(ends);
    }
    assert!(borders.iter().all(|ends| *ends == borders[0]), "the ends differ between levels");
}

#[test]
fn levels_keep_to_their_budgets() {
    let triangles = |levels: &[Level]| levels.iter().map(|level| level.report.triangles).collect::<Vec<_>>();
    let found = triangles(&made());
    assert_eq!(found[0], mesh().triangles.len());
    assert!((7600..=8000).contains(&found[1]) && (2300..=2500).contains(&found[2]), "{found:?}");
    let count = mesh().triangles.len();
    assert_eq!(triangles(&levels_of(&mesh(), None, [count, 10_000_000], &|| false).unwrap()), [count; 3]);
    // Only the borders remain.
    let least = triangles(&levels_of(&mesh(), None, [1000, 1], &|| false).unwrap());
    assert!(least[2] >= 4 * 96 && least[2] < 1200, "{least:?}");
    assert_eq!(
        levels(&Mesh { triangles: vec![], ..mesh() }, None, &|| false).err().map(|e| e.kind()),
        Some(io::ErrorKind::InvalidInput)
    );
}

#[test]
fn a_level_simplified_in_pieces_is_as_close_as_one_simplified_whole() {
    let (mesh, pieces) = (mesh(), made());
    let full = FullSurface::new(&mesh);
    let wall = &mesh.triangles[mesh.patches[0].triangles.clone()];
    assert!(wall.len() > simplify::AT_ONCE, "{}", wall.len());
    let mut whole = full.triangles();
    for (triangles, _) in whole.iter_mut().zip(&mesh.patches).filter(|(_, patch)| patch.kind.is_wall()) {
        *triangles = simplify::collapse_piece(&mesh.positions, triangles, 8000.0 / mesh.triangles.len() as f64).into();
    }
    let sources = full.patches.iter().map(|patch| distance::source(&full, patch));
    let whole = micrometres(sources.zip(&whole).map(|(source, level)| source.distance(level, 1)).fold(0.0, f64::max));
    assert!(pieces[1].report.distance_um < 2.0 * whole, "{} and {whole}", pieces[1].report.distance_um);
}

#[test]
fn ends_of_many_triangles_leave_the_walls_some() {
    let mesh = mesh();
    let ends =
        mesh.patches.iter().filter(|patch| !patch.kind.is_wall()).map(|patch| patch.triangles.len()).sum::<usize>();
    let level = &levels_of(&mesh, None, [8000, ends + 2], &|| false).unwrap()[2];
    assert!(level.report.triangles > ends * 3 / 2, "{:?}", level.report);
}

#[test]
fn a_patch_is_read_once() {
    let mut bytes = file(&made()[2]);
    let list = b"\"children\":[";
    let at = bytes.windows(list.len()).position(|window| window == list).unwrap() + list.len();
    // Repeats the first child as the second.
    assert_eq!(bytes[at + 1], b',');
    bytes[at + 2] = bytes[at];
    assert!(read_level(&bytes).unwrap_err().to_string().contains("more than one parent"));
}

#[test]
fn levels_are_stopped() {
    let asked = AtomicUsize::new(0);
    let kind = |stop: &(dyn Fn() -> bool + Sync)| levels(&mesh(), None, stop).err().map(|e| e.kind());
    assert_eq!(kind(&|| asked.fetch_add(1, Ordering::Relaxed) > 1000), None);
    for after in 0..asked.into_inner() {
        let count = AtomicUsize::new(0);
        assert_eq!(kind(&|| count.fetch_add(1, Ordering::Relaxed) >= after), Some(io::ErrorKind::Interrupted));
    }
}

#[test]
fn the_distance_is_that_of_brute_force() {
    let mesh = bulge(48, 10);
    for level in &levels_of(&mesh, None, [1400, 700], &|| false).unwrap()[1..] {
        let read = read_level(&file(level)).unwrap();
        let corners = |mesh: &Mesh, kind: PatchKind| -> Vec<[[f64; 3]; 3]> {
            let patch = mesh.patches.iter().find(|patch| patch.kind == kind).unwrap();
            let triangles = &mesh.triangles[patch.triangles.clone()];
            triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize].map(f64::from))).collect()
        };
        let farthest = |samples: Vec<[f64; 3]>, triangles: &[[[f64; 3]; 3]]| {
            let nearest =
                |p: &[f64; 3]| triangles.iter().map(|t| squared_distance(*p, *t)).fold(f64::INFINITY, f64::min);
            samples.iter().map(nearest).fold(0.0, f64::max).sqrt()
        };
        let mut expected: f64 = 0.0;
        for patch in &mesh.patches {
            let (full, coarse) = (corners(&mesh, patch.kind), corners(&read, patch.kind));
            let mean = |points: &[[f64; 3]]| -> [f64; 3] {
                std::array::from_fn(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / points.len() as f64)
            };
            let there = farthest(full.as_flattened().to_vec(), &coarse);
            let samples = |t: &[[f64; 3]; 3]| {
                let [a, b, c] = *t;
                [a, b, c, mean(&[a, b]), mean(&[b, c]), mean(&[c, a]), mean(t)]
            };
            let back = farthest(coarse.iter().flat_map(samples).collect(), &full);
            // For patches with all triangles, the distance is a bound above the sampled distances.
            if full.len() > coarse.len() {
                expected = expected.max(there).max(back);
            }
        }
        assert_eq!(level.report.distance_um, micrometres(expected));
        assert!(level.report.distance_um > 1.0, "nothing was simplified: {:?}", level.report);
    }
}

#[test]
fn bytes_do_not_depend_on_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| made().iter().map(file).collect::<Vec<_>>())
    };
    assert!(on(1) == on(4));
}

#[test]
fn bytes_do_not_depend_on_the_machine() {
    // Recorded on x86-64. A different digest on another machine means that the C++ compiler
    // contracts multiplications and additions.
    let digests = made().iter().map(|level| hex::encode(Sha256::digest(file(level)))).collect::<Vec<_>>();
    assert_eq!(
        digests,
        [
            "e6d22c0a7ca4c42fc72aaa3446b49db7d75f2dc40bd3d6ab9fd022098ff5f547",
            "0f189f831c1a3da07b0e5269389031ea9ef66958cf5dc59d88af1a81588ab0b6",
            "da15a8c365abddaea6db1f1a53907ef704205171885d9f315350118708f4046a",
        ]
    );
}

#[test]
fn the_document_declares_what_a_viewer_needs() {
    let level = &made()[0];
    let bytes = file(level);
    let document = document(&bytes);
    let both = serde_json::json!(["EXT_meshopt_compression", "KHR_mesh_quantization"]);
    assert_eq!((&document["extensionsUsed"], &document["extensionsRequired"]), (&both, &both));
    assert_eq!(document["asset"]["extras"]["level"], serde_json::to_value(&level.report).unwrap());
    let (data, plain) = (&document["buffers"][0], &document["buffers"][1]);
    assert_eq!((data.get("uri"), data.get("extensions")), (None, None));
    assert_eq!(plain["extensions"]["EXT_meshopt_compression"], serde_json::json!({ "fallback": true }));
    let views = document["bufferViews"].as_array().unwrap();
    let begin = bytes.len() - data["byteLength"].as_u64().unwrap() as usize;
    let (mut end, mut plain_end) = (0, 0);
    for view in views {
        let packed = &view["extensions"]["EXT_meshopt_compression"];
        let number = |value: &Value| value.as_u64().unwrap();
        assert_eq!((number(&view["buffer"]), number(&packed["buffer"])), (1, 0));
        assert_eq!(number(&view["byteLength"]), number(&packed["count"]) * number(&packed["byteStride"]));
        assert_eq!((number(&view["byteOffset"]), number(&packed["byteOffset"])), (plain_end, end));
        // First byte: 0xa0 is version 0 of the vertex codec, 0xe1 version 1 of the index codec.
        let (header, stride) =
            if packed["mode"] == "TRIANGLES" { (0xe1, None) } else { (0xa0, Some(&packed["byteStride"])) };
        assert_eq!((bytes[begin + end as usize], view.get("byteStride")), (header, stride));
        end = (end + number(&packed["byteLength"])).next_multiple_of(4);
        plain_end = (plain_end + number(&view["byteLength"])).next_multiple_of(4);
    }
    assert_eq!((number_of(data), number_of(plain)), (end, plain_end));
    let body = document["nodes"].as_array().unwrap().iter().find(|node| node["name"] == "tissue").unwrap();
    assert_eq!((body["scale"].as_array().unwrap().len(), body["children"].as_array().unwrap().len()), (3, 4));
    let outer = document["meshes"].as_array().unwrap().iter().find(|mesh| mesh["name"] == "outer_wall").unwrap();
    let positions = &document["accessors"][outer["primitives"][0]["attributes"]["POSITION"].as_u64().unwrap() as usize];
    // The outer wall spans the whole grid.
    assert_eq!(
        (&positions["min"], &positions["max"]),
        (&serde_json::json!([0, 0, 0]), &serde_json::json!([65535, 65535, 65535]))
    );
}

fn number_of(buffer: &Value) -> u64 {
    buffer["byteLength"].as_u64().unwrap()
}

#[test]
fn a_doubled_edge_is_turned() {
    // A ring of three corners is a cycle of edges without a face. Merging two of its corners
    // duplicates an edge.
    let mesh = sample::tube(3, 4, 0.0);
    let full = FullSurface::new(&mesh);
    let wall = full.patches.iter().position(|patch| patch.kind == PatchKind::OuterWall).unwrap();
    let (from, to) = (5 * 3 + 2 * 3 + 1, 5 * 3 + 2 * 3);
    let mut level = full.triangles();
    let collapsed = level[wall].iter().map(|t| t.map(|v| if v == from { to } else { v }));
    level[wall] = Cow::Owned(collapsed.filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]).collect());
    let before = level.clone();
    assert!(mend::mend(&mut level, &mesh));
    assert!(level != before, "the edge was not doubled");
    let mut bytes = Vec::new();
    Encoded::new(&full, &level, false).write(&meta(), Map::new(), &mut bytes).unwrap();
    let read = read_level(&bytes).unwrap();
    check_closed(&read);
    assert_eq!(read.positions.len(), mesh.positions.len() - 1);
    // A hole cannot be mended.
    level[wall].to_mut().pop();
    assert!(!mend::mend(&mut level, &mesh));
}

#[test]
fn damaged_and_foreign_files_are_refused() {
    let bytes = file(&made()[2]);
    for length in (0..bytes.len()).step_by(97) {
        assert!(read_level(&bytes[..length]).is_err(), "{length} bytes");
    }
    // A change may remain undetected, but must leave all indices in range.
    for at in (0..bytes.len()).step_by(131) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x55;
        if let Ok(read) = parse(&damaged, Format::Gltf, None) {
            assert!(read.triangles.as_flattened().iter().all(|&v| (v as usize) < read.positions.len()));
        }
    }
    // A count of 4 billion is refused.
    let text = String::from_utf8_lossy(&bytes[20..]).into_owned();
    let count = document(&bytes)["accessors"][0]["count"].as_u64().unwrap();
    let stated = format!("\"count\":{count}");
    assert!(text.contains(&stated));
    let digits = stated.len() - 8;
    let mut huge = bytes.clone();
    for at in text.match_indices(&stated).map(|(at, _)| 20 + at + 8) {
        huge[at..at + digits].fill(b'9');
    }
    assert!(read_level(&huge).is_err());
}

#[test]
fn a_level_is_read_as_any_other_surface() {
    let level = &made()[2];
    let surface = parse(&file(level), Format::Gltf, None).unwrap();
    let mut vertices: Vec<_> = surface.positions.iter().map(|p| p.map(f64::to_bits)).collect();
    vertices.sort_unstable();
    vertices.dedup();
    assert_eq!((vertices.len(), surface.triangles.len()), (level.report.vertices, level.report.triangles));
    assert_eq!((surface.groups.len(), surface.notes.len()), (4, 0), "{:?}", surface.notes);
}
