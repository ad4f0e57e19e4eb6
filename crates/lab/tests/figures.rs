//! `oviduct-lab figures`: the paper's figures from a small model.

use oviduct::generate::{Backend, CancelToken, Output, Request, generate};
use oviduct::spec::{ModelSpec, preset};
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Output as Ran};
use tiny_skia::Pixmap;

/// A model that even an unoptimised build grows in a second or two.
const TINY: [&str; 4] = ["--set", "steps=60", "--set", "particles.total={\"keys\":[[0,300],[1,420]]}"];

fn run(folder: &Path, arguments: &[&str]) -> Ran {
    let mut command = Command::new(env!("CARGO_BIN_EXE_oviduct-lab"));
    command.current_dir(folder).env_clear().args(arguments).output().expect("the command runs")
}

fn said(output: &Ran) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn code(output: &Ran) -> i32 {
    output.status.code().expect("it was not killed")
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a directory")
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("the directory exists");
    let mut names: Vec<_> = entries.map(|e| e.expect("read").file_name().into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

/// Returns the report of the model that the figures show, grown by the library.
fn report() -> Value {
    let patch = json!({ "steps": 60, "particles": { "total": { "keys": [[0, 300], [1, 420]] } } });
    let dir = folder();
    let request = Request {
        preset: "paper".to_owned(),
        spec: ModelSpec::resolve(preset("paper").expect("a preset"), &patch).expect("valid"),
        seed: 1,
        backend: Backend::Cpu,
        outputs: vec![Output::Glb].into(),
        dir: dir.path().to_owned(),
        memory_limit_bytes: None,
    };
    generate(&request, &(), &CancelToken::default()).expect("grown");
    serde_json::from_slice(&std::fs::read(dir.path().join("report.json")).expect("there")).expect("JSON")
}

const ALL: [&str; 10] = [
    "figure-10a.svg",
    "figure-10b.svg",
    "figure-10c.svg",
    "figure-11.svg",
    "figure-4.png",
    "figure-7.png",
    "figure-8.png",
    "figure-9.png",
    "figures.html",
    "figures.json",
];

fn figures(at: &Path, options: &[&str]) -> Ran {
    run(at, &[&["figures", "--size", "400", "--quick", "--gpu", "off"], &TINY[..], options].concat())
}

fn numbers(dir: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(dir.join("figures.json")).expect("there")).expect("JSON")
}

/// Returns the fraction of pixels that are not white.
fn inked(picture: &Pixmap) -> f64 {
    let inked = picture.pixels().iter().filter(|p| p.red().min(p.green()).min(p.blue()) < 240).count();
    inked as f64 / picture.pixels().len() as f64
}

/// Returns the number of white regions with at least `least` pixels, connected by their sides.
fn white_regions(picture: &Pixmap, [left, right]: [u32; 2], least: usize) -> usize {
    let (width, height) = ((right - left) as usize, picture.height() as usize);
    let white = |i: usize| picture.pixel(left + (i % width) as u32, (i / width) as u32).expect("inside").red() > 200;
    let mut seen: Vec<bool> = (0..width * height).map(|i| !white(i)).collect();
    let mut regions = 0;
    for start in 0..seen.len() {
        let (mut stack, mut size) = (vec![start], 0);
        while let Some(i) = stack.pop() {
            if std::mem::replace(&mut seen[i], true) {
                continue;
            }
            size += 1;
            let (x, y) = (i % width, i / width);
            let near = [(x > 0, i.wrapping_sub(1)), (x + 1 < width, i + 1), (y > 0, i.wrapping_sub(width))];
            stack.extend(near.into_iter().chain([(y + 1 < height, i + width)]).filter(|n| n.0).map(|n| n.1));
        }
        regions += usize::from(size >= least);
    }
    regions
}

#[test]
fn all_figures_are_made_and_their_numbers_are_those_of_the_model() {
    let at = folder();
    let output = figures(at.path(), &["--out", "f"]);
    assert_eq!(code(&output), 0, "{}", said(&output));
    let dir = at.path().join("f");
    assert_eq!(names(&dir), ALL);
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(printed.lines().count(), ALL.len());
    for (line, name) in printed.lines().zip(["figure-4.png", "figure-7.png", "figure-8.png", "figure-9.png"]) {
        assert!(line.starts_with(&format!("f/{name}  ")), "{line}");
    }

    let picture = |name: &str| Pixmap::load_png(dir.join(name)).expect("a picture");
    for (name, share) in [("4", 0.01..0.3), ("7", 0.1..0.8), ("8", 0.1..0.9), ("9", 0.1..0.9)] {
        let picture = picture(&format!("figure-{name}.png"));
        assert_eq!(picture.width(), 400);
        assert!(picture.height() > 100 && share.contains(&inked(&picture)), "figure {name}: {}", inked(&picture));
    }
    // Two loops divide a picture into three regions: outside, tissue and lumen.
    let loops = picture("figure-4.png");
    assert_eq!([[0, 200], [200, 400]].map(|half| white_regions(&loops, half, 100)), [3, 3]);

    let all = numbers(&dir);
    let report = report();
    assert_eq!((&all["digest"], &all["model"]["summary"]), (&report["digest"], &report["summary"]));
    let mesh = &all["figures"]["8"]["numbers"]["mesh"];
    for count in ["vertices", "triangles", "sections"] {
        assert_eq!(mesh[count], report["summary"][count], "{count}");
    }
    // A ring of n triangles has 2n edges, n of them on its two borders.
    let cap = &all["figures"]["8"]["numbers"]["caps"]["isthmus"];
    let triangles = cap["triangles"].as_u64().expect("a count");
    assert!(triangles >= report["summary"]["particles"]["start"].as_u64().expect("a count"));
    assert_eq!(cap["edges"], json!(2 * triangles));
    let strip = all["figures"]["7"]["numbers"]["sections"].as_array().expect("sections");
    assert_eq!((strip[0]["z_mm"].as_f64(), strip[strip.len() - 1]["z_mm"].as_f64()), (Some(0.0), Some(60.0)));

    let times = &all["figures"]["11"]["numbers"];
    for (of, single, multi) in [("lists", "lists", "lists-multi"), ("all_pairs", "paper-single", "paper-multi")] {
        let versions = all["figures"]["10"]["numbers"]["versions"].as_array().expect("versions");
        let seconds = |id: &str| versions.iter().find(|v| v["id"] == id).expect("measured")["seconds"].clone();
        assert_eq!([&times[of]["single_seconds"], &times[of]["multi_seconds"]], [&seconds(single), &seconds(multi)]);
        assert!(times[of]["single_seconds"].as_f64() > Some(0.0) && times[of]["gpu_seconds"].is_null());
    }
    assert!((times["paper"]["gpu_over_single"].as_f64().expect("known") - 463.04).abs() < 0.01);

    for (name, text) in [("10a", "GPU: not used"), ("10b", "all pairs"), ("10c", "time step"), ("11", "08:03:27.491")] {
        let svg = std::fs::read_to_string(dir.join(format!("figure-{name}.svg"))).expect("there");
        assert!(svg.starts_with("<svg") && svg.contains(text) && !svg.contains("NaN"), "{name}");
    }
    let page = std::fs::read_to_string(dir.join("figures.html")).expect("there");
    assert_eq!((page.matches("<figure>").count(), page.matches("data:image/png").count()), (6, 4));
    assert_eq!(page.matches("<svg").count(), 4);
    assert!(page.contains("790,211") && page.contains("no micrographs"));
    for outside in ["<script", "http:", "https:", "url(", "@import"] {
        assert!(!page.replace("http://www.w3.org/2000/svg", "").contains(outside), "{outside}");
    }
}

#[test]
fn chosen_figures_are_made_alone_and_replace_older_ones() {
    let at = folder();
    let dir = at.path().join("f");
    std::fs::create_dir(&dir).expect("made");
    for name in ["figure-4.png", "figure-7.png", "other"] {
        std::fs::write(dir.join(name), "old").expect("written");
    }
    let output = figures(at.path(), &["--out", "f", "--only", "4,11", "--seed", "5"]);
    assert_eq!(code(&output), 0, "{}", said(&output));
    assert_eq!(names(&dir), ["figure-11.svg", "figure-4.png", "figure-7.png", "figures.html", "figures.json", "other"]);
    assert!(Pixmap::load_png(dir.join("figure-4.png")).is_ok());
    assert_eq!(std::fs::read(dir.join("figure-7.png")).expect("there"), b"old");
    let all = numbers(&dir);
    let made: Vec<&str> = all["figures"].as_object().expect("figures").keys().map(String::as_str).collect();
    assert_eq!((made, &all["seed"]), (vec!["11", "4"], &json!(5)));
    // Times need no model.
    let output = figures(at.path(), &["--out", "g", "--only", "11"]);
    assert_eq!(code(&output), 0, "{}", said(&output));
    assert!(numbers(&at.path().join("g"))["model"].is_null());
}

#[test]
fn wrong_options_are_named_and_leave_no_file() {
    let at = folder();
    for (wrong, named) in [
        (&["figures"][..], "--out"),
        (&["figures", "--out", "f", "--only", "5"], "--only"),
        (&["figures", "--out", "f", "--only", ""], "--only"),
        (&["figures", "--out", "f", "--size", "399"], "--size"),
        (&["figures", "--out", "f", "--seed=-1"], "--seed"),
        (&["figures", "--out", "f", "--preset", "whale"], "/preset"),
        (&["figures", "--out", "f", "--backend", "abacus"], "--backend"),
        (&["figures", "--out", "f", "--outputs", "glb"], "--outputs"),
        (&["figures", "--out", "f", "--set", "steps=0"], "/spec/steps"),
    ] {
        let output = run(at.path(), wrong);
        assert_eq!((code(&output), output.stdout.len()), (2, 0), "{wrong:?}: {}", said(&output));
        assert!(said(&output).contains(named), "{wrong:?}: {}", said(&output));
    }
    assert!(names(at.path()).is_empty());
    // A file is where the directory should be.
    std::fs::write(at.path().join("f"), "").expect("written");
    let output = figures(at.path(), &["--out", "f"]);
    assert_eq!(code(&output), 1);
    assert!(said(&output).contains("--out f"), "{}", said(&output));
    // The backend is not there.
    let output = figures(at.path(), &["--out", "g", "--backend", "gpu"]);
    assert_eq!(code(&output), 1, "{}", said(&output));
    assert!(names(&at.path().join("g")).is_empty());
}
