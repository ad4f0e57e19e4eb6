//! Binary seeds of the corpora, which the program's own writers produce. After a change of a
//! format, regenerate them: `OVIDUCT_BLESS=1 cargo test --test whole corpus::`.

use oviduct::export::glb::{GlbOptions, write_glb};
use oviduct::export::lod::levels;
use oviduct::export::obj::write_obj;
use oviduct::export::ply::write_ply;
use oviduct::export::sections_bin::write_sections;
use oviduct::export::stl::{write_ascii_stl, write_stl};
use oviduct::export::vtp::write_vtp;
use oviduct::export::{Metadata, Shape};
use oviduct::generate::{Backend, CancelToken, Output, Progress, Request, Sink, generate};
use oviduct::model::{BodyKind, Mesh, Patch, PatchKind, Section};
use oviduct::sim::Plan;
use oviduct::sim::cpu::CpuSimulation;
use oviduct::spec::{ModelSpec, preset};
use serde_json::json;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use tempfile::TempPath;

/// Requests a checkpoint at one step and stops there.
struct StopAt {
    step: u32,
    now: AtomicU32,
    taken: Mutex<Vec<u8>>,
    cancel: CancelToken,
}

impl Sink for StopAt {
    fn progress(&self, progress: &Progress) {
        self.now.store(progress.step, Ordering::Relaxed);
    }

    fn section(&self, _: &Section) {}

    fn wants_checkpoint(&self) -> bool {
        self.now.load(Ordering::Relaxed) >= self.step
    }

    fn checkpoint(&self, file: TempPath) {
        *self.taken.lock().expect("no thread panics") = fs::read(file).expect("the checkpoint can be read");
        self.cancel.cancel();
    }
}

fn spec(search: &str) -> Result<ModelSpec, Box<dyn Error>> {
    let patch = json!({
        "steps": 60, "burn_in": 20, "solver": { "search": search, "record_every": 5 }, "particles": {
            "total": { "keys": [[0, 40], [1, 80]] }, "outer": { "keys": [[0, 12], [1, 16]] } },
    });
    let pig = preset("pig").ok_or("there is no preset pig")?;
    ModelSpec::resolve(pig, &patch).map_err(|faults| format!("{faults:?}").into())
}

fn metadata(sections: usize) -> Metadata {
    let digest = "0".repeat(64);
    Metadata { preset: "pig".into(), seed: 7, digest, engine: "test".into(), length_mm: 60.0, sections }
}

/// Compares an input with the corpus; with `OVIDUCT_BLESS`, writes it.
fn check(target: &str, name: &str, bytes: impl AsRef<[u8]>) -> Result<(), Box<dyn Error>> {
    let path = Path::new("fuzz/corpus").join(target).join(name);
    if std::env::var_os("OVIDUCT_BLESS").is_some() {
        return Ok(fs::write(path, bytes)?);
    }
    let kept = fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    if kept == bytes.as_ref() { Ok(()) } else { Err(format!("{} is out of date", path.display()).into()) }
}

fn simulations() -> Result<(), Box<dyn Error>> {
    let mut simulation = CpuSimulation::new(Plan::new(&*spec("lists")?, 7), 1);
    let mut sections = Vec::new();
    check("state", "start", simulation.save())?;
    while simulation.time() < 30 {
        simulation.step()?;
        if simulation.time() % 10 == 0 {
            check("state", &format!("step{}", simulation.time()), simulation.save())?;
            sections.push(simulation.section());
        }
    }
    for count in [0, 1, 3] {
        let mut bytes = Vec::new();
        write_sections(&sections[..count], &metadata(count), &mut bytes)?;
        check("sections", &format!("sections{count}"), bytes)?;
    }
    Ok(())
}

fn checkpoints() -> Result<(), Box<dyn Error>> {
    let dir = tempfile::tempdir()?;
    for step in [1, 23] {
        let sink = StopAt { step, now: 0.into(), taken: Mutex::default(), cancel: CancelToken::default() };
        let request = Request {
            preset: "pig".into(),
            spec: spec("lists")?,
            seed: 7,
            backend: Backend::CpuSingle,
            outputs: vec![Output::Lod].into(),
            dir: dir.path().into(),
            memory_limit_bytes: None,
        };
        let _ = generate(&request, &sink, &sink.cancel);
        check("checkpoint", &format!("step{step}"), sink.taken.into_inner()?)?;
    }
    Ok(())
}

fn surfaces() -> Result<(), Box<dyn Error>> {
    let mesh = Mesh {
        body: BodyKind::Tissue,
        positions: vec![[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], [0.0, 1.5e-3, 0.0], [1e-4, 2e-4, 3e-3]],
        triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        patches: vec![
            Patch { kind: PatchKind::InnerWall, triangles: 0..2 },
            Patch { kind: PatchKind::OuterWall, triangles: 2..4 },
        ],
    };
    for strips in [false, true] {
        let mut bytes = Vec::new();
        write_glb(&Shape::of(&mesh, &metadata(2)), &GlbOptions { strips, skin: None }, &mut bytes)?;
        check("gltf", if strips { "own-strips" } else { "own" }, bytes)?;
    }
    let mut bytes = Vec::new();
    levels(&mesh, None, &|| false)?[0].write(&metadata(2), &mut bytes)?;
    check("gltf", "level", bytes)?;
    let mut bytes = Vec::new();
    write_obj(&Shape::of(&mesh, &metadata(2)), &mut bytes)?;
    check("obj", "own", bytes)?;
    let mut bytes = Vec::new();
    write_stl(&Shape::of(&mesh, &metadata(2)), &mut bytes)?;
    check("stl", "own", bytes)?;
    let mut bytes = Vec::new();
    write_ascii_stl(&Shape::of(&mesh, &metadata(2)), &mut bytes)?;
    check("stl", "own-text", bytes)?;
    let mut bytes = Vec::new();
    write_ply(&Shape::of(&mesh, &metadata(2)), &mut bytes)?;
    check("ply", "own", bytes)?;
    let mut bytes = Vec::new();
    write_vtp(&Shape::of(&mesh, &metadata(2)), &mut bytes)?;
    check("vtp", "own", bytes)?;
    Ok(())
}

/// Images of small sections: a mask, and tissue labels with an island and a pocket.
fn images() -> Result<(), Box<dyn Error>> {
    let side = 48;
    let within = |i: usize, x: f64, y: f64, radius: f64| ((i % side) as f64 - x).hypot((i / side) as f64 - y) < radius;
    let label = |i: usize| match i {
        _ if !within(i, 23.5, 23.5, 21.0) => 0,
        _ if within(i, 18.0, 24.0, 3.0) => 2,
        _ if within(i, 20.0, 22.0, 11.0) || within(i, 36.0, 33.0, 3.0) => 1,
        _ => 4,
    };
    let labels: Vec<u8> = (0..side * side).map(label).collect();
    let mask: Vec<u8> =
        labels.chunks(8).map(|bits| bits.iter().fold(0, |byte, bit| byte << 1 | bit >> 1 & 1 | bit >> 2)).collect();
    for (name, pixels, color, depth) in [
        ("labels", &labels, png::ColorType::Grayscale, png::BitDepth::Eight),
        ("palette", &labels, png::ColorType::Indexed, png::BitDepth::Eight),
        ("mask", &mask, png::ColorType::Grayscale, png::BitDepth::One),
    ] {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, side as u32, side as u32);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == png::ColorType::Indexed {
            encoder.set_palette((0..30).collect::<Vec<u8>>());
        }
        let mut writer = encoder.write_header()?;
        writer.write_image_data(pixels)?;
        writer.finish()?;
        check("micrograph", name, file)?;
    }
    Ok(())
}

#[test]
fn seeds_equal_the_output_of_the_program() -> Result<(), Box<dyn Error>> {
    simulations()?;
    checkpoints()?;
    surfaces()?;
    images()
}
