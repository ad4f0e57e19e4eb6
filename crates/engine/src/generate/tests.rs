//! Tests of whole generations of small models: bytes, progress, cancellation, limits, warnings.

mod contraction;
mod random;
mod textured;

use super::*;
use crate::measure::morphometry::Basis;
use crate::model::{BodyKind, LengthUnit};
use crate::spec::{ModelSpec, preset};
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

/// A tube of a few hundred particles, with all forces and the thickness field.
pub(super) fn small(patch: &serde_json::Value) -> ModelSpec {
    let mut whole = json!({
        "steps": 120, "burn_in": 40,
        "particles": { "total": { "keys": [[0, 260], [1, 620]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
        "labels": { "slice_um": 1000, "voxel_um": 20 },
    });
    json_patch::merge(&mut whole, patch);
    ModelSpec::resolve(preset("pig").unwrap(), &whole).unwrap()
}

pub(super) fn request(spec: ModelSpec, backend: Backend, dir: &std::path::Path) -> Request {
    Request {
        preset: "pig".into(),
        spec,
        seed: 7,
        backend,
        outputs: Outputs { formats: Output::ALL.to_vec(), bodies: BodyKind::ALL.to_vec(), units: None },
        dir: dir.into(),
        memory_limit_bytes: None,
    }
}

fn hashes(spec: ModelSpec, backend: Backend, threads: usize) -> BTreeMap<String, String> {
    let dir = tempfile::tempdir().unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let outcome = pool.install(|| generate(&request(spec, backend, dir.path()), &(), &CancelToken::default())).unwrap();
    outcome.files.into_iter().map(|f| (f.name, f.sha256)).collect()
}

#[test]
fn bytes_do_not_depend_on_threads_or_backend() {
    let one = hashes(small(&json!({})), Backend::CpuSingle, 1);
    let kinds = "three bodies in nine files, centre line, levels, labels, sections.bin, report.json";
    assert_eq!(one.len(), 3 * 9 + 2 + 3 + 2 + 2, "{kinds}: {one:?}");
    assert_eq!(one, hashes(small(&json!({})), Backend::Cpu, 1));
    assert_eq!(one, hashes(small(&json!({})), Backend::Auto, 2));
    assert_eq!(one, hashes(small(&json!({})), Backend::Cpu, 5));
}

fn has_passed(surface: &SurfaceFinding) -> bool {
    match &surface.certificate {
        SurfaceCertificate::Body(certificate) => certificate.passed,
        SurfaceCertificate::Regions(certificate) => certificate.passed,
    }
}

#[test]
fn a_bent_model_has_certified_bodies_and_the_sections_and_labels_of_the_straight_one() {
    let grown = |course: serde_json::Value| {
        let dir = tempfile::tempdir().unwrap();
        let patch = json!({ "length_mm": 20, "lean": { "strength_um": 250 }, "course": course });
        let outcome =
            generate(&request(small(&patch), Backend::Cpu, dir.path()), &(), &CancelToken::default()).unwrap();
        let hashes: BTreeMap<_, _> = outcome.files.iter().map(|f| (f.name.clone(), f.sha256.clone())).collect();
        let csv = std::fs::read_to_string(dir.path().join("centreline.csv")).unwrap();
        let ends: Vec<Vec<f64>> = [csv.lines().nth(1), csv.lines().last()]
            .map(|line| line.unwrap().split(',').take(3).map(|x| x.parse().unwrap()).collect())
            .to_vec();
        (outcome.findings, hashes, ends)
    };
    let (straight, plain, _) = grown(json!({}));
    assert_eq!(straight.course, None);
    let half_turn = json!({ "shape": "arc", "turn_deg": 180 });
    let (bent, files, ends) = grown(half_turn.clone());
    let course = bent.course.clone().unwrap();
    assert!((course.tortuosity - std::f64::consts::FRAC_PI_2).abs() < 1e-3 && !course.relaxed, "{course:?}");
    assert!(bent.certificate.passed);
    assert!(bent.surfaces.iter().all(has_passed));
    assert!(bent.surfaces.iter().any(|surface| surface.body == BodyKind::Regions));
    assert!((bent.certificate.volume_mm3 / straight.certificate.volume_mm3 - 1.0).abs() < 0.02);
    let distance = (0..3).map(|axis| (ends[1][axis] - ends[0][axis]).powi(2)).sum::<f64>().sqrt();
    assert!((distance - 40.0 / std::f64::consts::PI).abs() < 0.1, "{distance}");
    assert_eq!(bent.simulated, straight.simulated);
    // Planes across the centre line show the same as planes across the straight tube, with more
    // vertices.
    for (region, name) in [("whole", "muscle_thickness_um"), ("ampulla", "free_lumen"), ("whole", "tissue_area_mm2")] {
        let [bent, straight] = [&bent, &straight].map(|of| of.morphometry.mean(name, region).unwrap());
        assert!((bent / straight - 1.0).abs() < 1e-3, "{name}: {bent} and {straight}");
    }
    let [straight, bent] = [straight.cuts, bent.cuts].map(Option::unwrap);
    assert_eq!((bent.count, bent.with_islands), (straight.count, straight.with_islands));
    for (bent, straight) in [(bent.thickness_um, straight.thickness_um), (bent.gap_um, straight.gap_um)] {
        let (bent, straight) = (bent.unwrap(), straight.unwrap());
        for (a, b) in [(bent.least_p5, straight.least_p5), (bent.p5, straight.p5), (bent.p50, straight.p50)] {
            assert!((a - b).abs() < 0.02 + 1e-3 * b, "{a} and {b}");
        }
    }
    for name in ["labels.nii.gz", "labels.ome.tif"] {
        assert!(files.contains_key(name) && plain.contains_key(name));
    }
    assert_eq!(grown(half_turn).1, files, "the same bytes");
}

#[test]
fn the_report_lists_turning_points_that_the_surface_follows_without_facets() {
    let dir = tempfile::tempdir().unwrap();
    let turns = json!([[0.25, 150, 0, 0.45], [0.8, 120, 90, 0.35]]);
    let patch = json!({ "length_mm": 20, "course": { "shape": "turns", "turns": turns } });
    let mut request = request(small(&patch), Backend::Cpu, dir.path());
    request.outputs.formats = vec![Output::Glb];
    let outcome = generate(&request, &(), &CancelToken::default()).unwrap();
    assert!(outcome.findings.certificate.passed);
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(dir.path().join("report.json")).unwrap()).unwrap();
    let turns = report["course"]["turns"].as_array().unwrap();
    let stated: Vec<_> = turns.iter().map(|turn| (&turn["number"], &turn["z_mm"], &turn["region"])).collect();
    assert_eq!(stated, [(&json!(2), &json!(5.0), &json!("isthmus")), (&json!(1), &json!(16.0), &json!("ampulla"))]);
    // Sections are 1.7 mm apart, so edges in the turns are far from their images until split.
    assert!(report["course"]["split"].as_u64().unwrap() > 0);
}

#[test]
fn an_even_surface_can_be_bent_with_its_lids() {
    let dir = tempfile::tempdir().unwrap();
    let patch = json!({
        "length_mm": 10, "mesh": { "resolution_um": 60 }, "course": { "shape": "sigmoid", "turn_deg": 60, "twist_deg": 90 },
        "lean": { "strength_um": 0 },
    });
    let mut request = request(small(&patch), Backend::Cpu, dir.path());
    request.outputs.formats = vec![Output::Vtp];
    let outcome = generate(&request, &(), &CancelToken::default()).unwrap();
    assert!(outcome.findings.certificate.passed);
    assert!(outcome.findings.course.is_some() && outcome.findings.surfaces.len() >= 3);
}

#[test]
fn bytes_do_not_depend_on_the_search() {
    let of = |search: &str| {
        let mut files = hashes(small(&json!({ "solver": { "search": search } })), Backend::Cpu, 2);
        // The report contains the specification, including the search.
        files.remove("report.json");
        files
    };
    let lists = of("lists");
    assert_eq!(lists, of("grid"));
    assert_eq!(lists, of("all_pairs"));
}

#[test]
fn another_seed_is_another_model() {
    let dir = tempfile::tempdir().unwrap();
    let mut other = request(small(&json!({})), Backend::Cpu, dir.path());
    other.seed = 8;
    let outcome = generate(&other, &(), &CancelToken::default()).unwrap();
    let seven = hashes(small(&json!({})), Backend::Cpu, 1);
    assert!(outcome.files.iter().all(|f| seven[&f.name] != f.sha256));
}

#[test]
fn euler_and_strips_end_certified_too() {
    // A larger clearance puts off splits beside a wall.
    let near = json!({ "clearance_um": 0.05 });
    for patch in [
        json!({ "solver": { "integrator": "euler" }, "collision": near }),
        json!({ "mesh": { "strips": true }, "collision": near }),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let outcome =
            generate(&request(small(&patch), Backend::Cpu, dir.path()), &(), &CancelToken::default()).unwrap();
        assert!(outcome.findings.certificate.passed);
        assert_eq!(outcome.findings.certificate.euler, 0);
        assert_eq!(outcome.findings.summary.particles, ParticleCounts { start: 260, end: 620 });
    }
}

#[derive(Default)]
struct Recorder {
    fractions: Mutex<Vec<(Stage, f64)>>,
    sections: AtomicU32,
    /// Number of sections in the last reported progress.
    reported: AtomicU32,
    stop_at: Option<(u32, CancelToken)>,
}

impl Sink for Recorder {
    fn progress(&self, progress: &Progress) {
        self.fractions.lock().unwrap().push((progress.stage, progress.fraction));
        self.reported.store(progress.sections, Ordering::Relaxed);
        if let Some((step, cancel)) = &self.stop_at
            && progress.step >= *step
        {
            cancel.cancel();
        }
    }

    fn section(&self, _: &crate::model::Section) {
        self.sections.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn the_report_states_the_levels_if_they_were_asked_for() {
    let report = |outputs: &[Output]| -> (serde_json::Value, u64, u64) {
        let dir = tempfile::tempdir().unwrap();
        let mut request = request(small(&json!({})), Backend::Cpu, dir.path());
        request.outputs = outputs.to_vec().into();
        let outcome = generate(&request, &(), &CancelToken::default()).unwrap();
        let written: u64 =
            outcome.files.iter().filter(|f| Output::Lod.files().contains(&&*f.name)).map(|f| f.bytes).sum();
        let predicted = Cost::new(&request.spec, &vec![Output::Lod].into()).bytes["lod"];
        (serde_json::from_slice(&std::fs::read(dir.path().join("report.json")).unwrap()).unwrap(), written, predicted)
    };
    let (with, written, predicted) = report(&[Output::Lod]);
    let levels = with["levels"].as_array().unwrap();
    assert_eq!(levels.iter().map(|level| level["file"].as_str().unwrap()).collect::<Vec<_>>(), Output::Lod.files());
    // The model has fewer triangles than the limit of each level.
    assert!(levels.iter().all(|level| level["triangles"] == with["certificate"]["triangles"]), "{levels:?}");
    assert!(written.abs_diff(predicted) < written / 3, "{written} bytes, predicted {predicted}");
    let (without, written, _) = report(&[Output::Glb]);
    assert_eq!((without.get("levels"), written), (None, 0));
}

#[test]
fn a_label_volume_has_the_piece_that_was_asked_for_and_about_the_predicted_size() {
    let dir = tempfile::tempdir().unwrap();
    let labels = json!({ "labels": { "from": 0.25, "to": 0.75, "slice_um": 500, "voxel_um": 8 } });
    let mut request = request(small(&labels), Backend::Cpu, dir.path());
    request.outputs = vec![Output::Labels].into();
    let outcome = generate(&request, &(), &CancelToken::default()).unwrap();
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(dir.path().join("report.json")).unwrap()).unwrap();
    assert_eq!(report["labels"]["voxel_um"], json!([8.0, 8.0, 500.0]));
    let length_um = request.spec.length_mm * 1000.0;
    assert_eq!(report["labels"]["size"][2], json!((length_um / 1000.0) as u32), "half of the tube");
    assert_eq!(report["labels"]["first_um"][2], json!(0.25 * length_um + 250.0));
    let written: u64 = outcome.files.iter().filter(|f| f.name.starts_with("labels.")).map(|f| f.bytes).sum();
    let predicted = Cost::new(&request.spec, &vec![Output::Labels].into()).bytes["labels"];
    assert!(written < 2 * predicted && predicted < 3 * written, "{written} bytes, predicted {predicted}");
}

#[test]
fn progress_only_grows_and_names_every_stage() {
    let dir = tempfile::tempdir().unwrap();
    let sink = Recorder::default();
    generate(&request(small(&json!({})), Backend::Cpu, dir.path()), &sink, &CancelToken::default()).unwrap();
    let seen = sink.fractions.into_inner().unwrap();
    assert!(seen.windows(2).all(|w| w[0].1 <= w[1].1 && w[1].1 <= 1.0));
    for stage in [Stage::Simulate, Stage::Mesh, Stage::Certify, Stage::Measure, Stage::Export] {
        assert!(seen.iter().any(|(s, _)| *s == stage), "{stage:?}");
    }
    assert_eq!((sink.sections.into_inner(), sink.reported.into_inner()), (13, 13));
}

#[test]
fn a_leaning_surface_is_certified_in_every_form_and_reported() {
    let dir = tempfile::tempdir().unwrap();
    // Steep enough for triangles to intersect, so that the displacement is damped.
    let shape = json!({ "steps": 240, "length_mm": 20, "sway": { "strength": 4 } });
    let mut lean = json!({ "lean": { "strength_um": 1000, "wavelength_um": 100, "ends_mm": 4 } });
    json_patch::merge(&mut lean, &shape);
    let request = request(small(&lean), Backend::Cpu, dir.path());
    let leaning = generate(&request, &(), &CancelToken::default()).unwrap().findings;
    let done = leaning.lean.unwrap();
    assert!(done.met > 0 && done.damped > 0 && done.rounds > 0 && done.scale > 0.0, "{done:?}");
    assert!(leaning.certificate.passed);
    let cuts = leaning.cuts.unwrap();
    assert_eq!((cuts.count, cuts.to_mm), (8, 20.0));
    assert!(cuts.gap_um.unwrap().p5 > 0.0 && cuts.thickness_um.unwrap().p5 > 0.0);

    // The cuts lean, the simulated sections do not.
    let simulated = leaning.simulated.unwrap();
    assert_eq!([&leaning.morphometry, &simulated].map(|of| of.settings.basis), [Basis::Cuts, Basis::Sections]);
    let folds = |of: &Morphometry| of.mean("fold_height_p50_um", "ampulla").unwrap();
    assert_ne!(folds(&leaning.morphometry), folds(&simulated));
    let figures = Findings { morphometry: leaning.morphometry.clone(), ..Findings::default() }.figures();
    assert_eq!(figures["morphometry"]["ampulla"]["fold_height_p50_um"], folds(&leaning.morphometry));
    let mut straight = json!({ "lean": { "strength_um": 0 } });
    json_patch::merge(&mut straight, &shape);
    let other = tempfile::tempdir().unwrap();
    let straight = generate(&self::request(small(&straight), Backend::Cpu, other.path()), &(), &CancelToken::default());
    let straight = straight.unwrap().findings;
    assert!(straight.simulated.is_none() && straight.cuts.is_none() && straight.lean.is_none());
    for (name, values) in &simulated.along {
        assert_eq!(straight.morphometry.along[name], *values, "{name}");
    }
    assert_ne!(straight.summary.volume_mm3, leaning.summary.volume_mm3);
    assert_eq!((straight.surfaces.len(), leaning.surfaces.len()), (5, 5), "all bodies in both units");
    // An even surface does not lean, and warns about it.
    let spec = small(&even(&json!({})));
    assert!(spec.asks_to_lean() && !spec.leans());
}

#[test]
fn files_and_findings_do_not_depend_on_what_else_is_asked_for() {
    for lean in [json!({}), json!({ "lean": { "strength_um": 0 } })] {
        let dir = tempfile::tempdir().unwrap();
        let all = request(small(&lean), Backend::Cpu, dir.path());
        let mut one = all.clone();
        one.outputs = vec![Output::Vtp].into();
        let [all, one] = [all, one].map(|request| generate(&request, &(), &CancelToken::default()).unwrap());
        let names: Vec<&str> = one.files.iter().map(|file| file.name.as_str()).collect();
        assert_eq!(names, ["model.vtp", "sections.bin", "report.json"]);
        assert!(one.files[..2].iter().all(|file| all.files.contains(file)));
        assert_eq!(one.findings.certificate, all.findings.certificate);
        assert_eq!(one.findings.summary, all.findings.summary);
        assert_eq!(one.findings.surfaces.len(), 1, "the tissue in millimetres");
        assert!(all.findings.surfaces.contains(&one.findings.surfaces[0]));
        assert!(one.findings.morphometry == all.findings.morphometry);
    }
}

/// A short tube with a surface of even triangles, whose edges are as long as small tests allow.
pub(super) fn even(patch: &serde_json::Value) -> serde_json::Value {
    let mut whole = json!({ "length_mm": 4, "mesh": { "resolution_um": 60, "tolerance_um": 8 } });
    json_patch::merge(&mut whole, patch);
    whole
}

#[test]
fn an_even_surface_has_good_triangles_and_the_sections_of_the_lofted_one() {
    let dir = tempfile::tempdir().unwrap();
    let sink = Recorder::default();
    let request = request(small(&even(&json!({}))), Backend::Cpu, dir.path());
    let outcome = generate(&request, &sink, &CancelToken::default()).unwrap();
    assert_eq!((sink.sections.into_inner(), sink.reported.into_inner()), (13, 13));
    let seen = sink.fractions.into_inner().unwrap();
    assert!(seen.windows(2).all(|w| w[0].1 <= w[1].1 && w[1].1 <= 1.0));
    assert!(seen.iter().filter(|(stage, _)| *stage == Stage::Mesh).count() > 3, "the surface takes most of the time");
    let certificate = &outcome.findings.certificate;
    let quality = &certificate.quality;
    assert!(quality.least_angles_from_20 > 0.99 && quality.edge_ratios_to_4 > 0.99, "{quality:?}");
    assert_eq!(outcome.findings.surfaces.len(), 2 + 3, "lumen and regions in metres, all three in millimetres");
    let triangles = certificate.triangles;
    let predicted = Cost::new(&request.spec, &request.outputs).triangles;
    assert!(predicted < 2 * triangles && triangles < 2 * predicted, "{triangles} triangles, predicted {predicted}");

    let one = hashes(small(&even(&json!({}))), Backend::CpuSingle, 1);
    assert_eq!(one, outcome.files.into_iter().map(|f| (f.name, f.sha256)).collect());
}

/// Sections of a model, and its findings.
fn grown(patch: &serde_json::Value) -> (Vec<crate::model::Section>, Findings) {
    let dir = tempfile::tempdir().unwrap();
    let mut request = request(small(patch), Backend::Cpu, dir.path());
    request.outputs = vec![Output::Glb].into();
    let outcome = generate(&request, &(), &CancelToken::default()).unwrap();
    let file = std::fs::File::open(dir.path().join("sections.bin")).unwrap();
    let mut reader = crate::export::sections_bin::SectionsReader::open(file).unwrap();
    ((0..reader.len()).map(|k| reader.section(k).unwrap()).collect(), outcome.findings)
}

/// Maximum angle by which a contour turns, degrees.
fn greatest_turn(points: &[[f32; 2]]) -> f64 {
    let n = points.len();
    let turn = |i: usize| {
        let [a, b, c] = [i, (i + 1) % n, (i + 2) % n].map(|i| points[i].map(f64::from));
        let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - b[0], c[1] - b[1]]);
        (u[0] * v[1] - u[1] * v[0]).atan2(u[0] * v[0] + u[1] * v[1]).abs().to_degrees()
    };
    (0..n).map(turn).fold(0.0, f64::max)
}

#[test]
fn smooth_contours_have_two_points_a_particle_and_no_sharp_angles() {
    let sharp = json!({ "contortion": { "magnitude": 6, "fraction": 0.4 } });
    let mut smooth = sharp.clone();
    json_patch::merge(&mut smooth, &json!({ "mesh": { "smooth_um": 5 } }));
    let ((before, sharp), (after, smooth)) = (grown(&sharp), grown(&smooth));
    assert_eq!(sharp.summary.particles, smooth.summary.particles);
    let turn = |sections: &[crate::model::Section]| {
        sections.iter().map(|s| greatest_turn(&s.inner.points).max(greatest_turn(&s.outer.points))).fold(0.0, f64::max)
    };
    assert!(turn(&before) > 65.0 && turn(&after) <= 60.0, "{} {}", turn(&before), turn(&after));
    for (before, after) in before.iter().filter(|s| !s.added).zip(after.iter().filter(|s| !s.added)) {
        assert_eq!(after.inner.len(), 2 * before.inner.len());
        assert!(
            before.inner.ids.iter().eq(after.inner.ids.iter().step_by(2).map(|id| id / 2).collect::<Vec<_>>().iter())
        );
    }
    // An even surface follows the smooth contours, and a checkpoint contains them.
    let both = even(&json!({ "mesh": { "smooth_um": 5 } }));
    let (sections, _) = grown(&both);
    assert!(turn(&sections) <= 60.0);
}

#[test]
fn a_run_is_cancelled_while_its_surface_is_remeshed() {
    struct Stops(CancelToken);
    impl Sink for Stops {
        fn progress(&self, progress: &Progress) {
            if progress.stage == Stage::Mesh && progress.fraction > 0.2 {
                self.0.cancel();
            }
        }
        fn section(&self, _: &crate::model::Section) {}
    }
    let dir = tempfile::tempdir().unwrap();
    let sink = Stops(CancelToken::default());
    let result = generate(&request(small(&even(&json!({}))), Backend::Cpu, dir.path()), &sink, &sink.0);
    assert!(matches!(result, Err(GenerateError::Cancelled)));
}

#[test]
fn a_piece_has_the_sections_that_the_whole_tube_has_there() {
    let (all, _) = grown(&json!({}));
    let ((part, findings), (even, _)) = (
        grown(&json!({ "piece": { "from": 0.3, "to": 0.7 } })),
        grown(&even(
            &json!({ "length_mm": 60, "mesh": { "resolution_um": 400 }, "piece": { "from": 0.3, "to": 0.7 } }),
        )),
    );
    let is_shown = |s: &&crate::model::Section| !s.added;
    let [begin, end] = [&part[0], &part[part.len() - 1]].map(|s| s.z_um / 60e3);
    assert!(begin <= 0.3 && end >= 0.7, "{begin} {end}");
    let within: Vec<_> = all.iter().filter(is_shown).filter(|s| (begin..=end).contains(&(s.z_um / 60e3))).collect();
    assert!(within.len() >= 3 && within.len() < all.len());
    assert!(part.iter().filter(is_shown).eq(within.iter().copied()), "the piece has other sections");
    assert!(even.iter().eq(within), "the even surface has other sections");
    let bounds = findings.certificate.bounds_um;
    assert!((bounds[0][2] - part[0].z_um).abs() < 0.01, "{bounds:?}");
    assert!((findings.morphometry.tube.length_mm - (end - begin) * 60.0).abs() < 1e-9);
    assert!(findings.summary.warnings.is_empty());
}

#[test]
fn a_cancelled_run_stops_at_the_next_step() {
    let dir = tempfile::tempdir().unwrap();
    let cancel = CancelToken::default();
    let sink = Recorder { stop_at: Some((30, cancel.clone())), ..Recorder::default() };
    let result = generate(&request(small(&json!({})), Backend::Cpu, dir.path()), &sink, &cancel);
    assert!(matches!(result, Err(GenerateError::Cancelled)));
    assert!(sink.sections.into_inner() <= 4);
}

#[test]
fn the_memory_limit_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let mut tight = request(small(&json!({})), Backend::Cpu, dir.path());
    tight.memory_limit_bytes = Some(1 << 20);
    let error = generate(&tight, &(), &CancelToken::default()).unwrap_err();
    assert!(matches!(error, GenerateError::Memory { limit: 1_048_576, .. }), "{error}");
}

#[test]
fn a_glb_beyond_its_format_is_refused_before_it_is_grown() {
    let dir = tempfile::tempdir().unwrap();
    let large = json!({ "steps": 20_000, "solver": { "record_every": 1 }, "particles": {
        "total": { "keys": [[0, 710], [1, 20_000]] }, "outer": { "keys": [[0, 110], [1, 300]] } } });
    let mut request = request(small(&large), Backend::Cpu, dir.path());
    request.outputs = vec![Output::Glb].into();
    let error = generate(&request, &(), &CancelToken::default()).unwrap_err();
    assert!(matches!(&error, GenerateError::Format { name, .. } if name == "model.glb"), "{error}");
    assert!(error.to_string().contains("4294967295") && error.to_string().contains("gltf"), "{error}");
}

#[test]
fn a_folder_that_is_missing_is_an_error_with_the_file_named() {
    let dir = tempfile::tempdir().unwrap();
    let error =
        generate(&request(small(&json!({})), Backend::Cpu, &dir.path().join("none")), &(), &CancelToken::default())
            .unwrap_err();
    assert!(matches!(error, GenerateError::Io { .. }), "{error}");
}

#[test]
fn poor_growth_is_reported_in_the_summary_and_the_report() {
    let crowded = json!({
        "steps": 100, "burn_in": 20, "variation": { "amplitude": 0 }, "containment": { "spacing_um": 12 },
        "particles": { "total": { "keys": [[0, 300], [1, 700]] }, "outer": 60 },
        "collision": { "strength": 0.02, "barrier": 0 }, "contortion": { "magnitude": 10, "fraction": 0.5 },
    });
    let codes = |patch: &serde_json::Value| {
        let dir = tempfile::tempdir().unwrap();
        let request = request(small(patch), Backend::Cpu, dir.path());
        let outcome = generate(&request, &(), &CancelToken::default()).unwrap();
        let report = std::fs::read_to_string(dir.path().join("report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        let warnings = outcome.findings.summary.warnings;
        assert_eq!(report["summary"]["warnings"], json!(warnings));
        warnings.iter().map(|warning| warning.code.clone()).collect::<Vec<_>>()
    };
    assert_eq!(codes(&crowded), ["splits-missing", "small-gap", "particles-short"]);
    assert_eq!(codes(&json!({})), [""; 0]);
}

#[test]
fn a_model_of_one_step_has_two_sections() {
    let dir = tempfile::tempdir().unwrap();
    let spec = small(&json!({ "steps": 1, "particles": { "total": 300, "outer": 60 } }));
    let outcome = generate(&request(spec, Backend::Cpu, dir.path()), &(), &CancelToken::default()).unwrap();
    assert_eq!(outcome.findings.summary.sections, 2);
    let figures = outcome.findings.figures();
    assert_eq!((&figures["sections"], &figures["certificate"]["passed"]), (&json!(2), &json!(true)));
    assert_eq!(figures["certificate"]["min_angle_deg"], outcome.findings.certificate.min_angle_deg);
    assert_eq!(figures["certificate"].get("bodies"), None);
}

#[test]
fn bodies_are_certified_alone_and_together_in_each_unit() {
    let dir = tempfile::tempdir().unwrap();
    let mut request = request(small(&json!({})), Backend::Cpu, dir.path());
    let surfaces = |request: &Request| generate(request, &(), &CancelToken::default()).unwrap().findings.surfaces;
    let named = |found: &[SurfaceFinding]| -> Vec<String> {
        assert!(found.iter().all(has_passed), "{found:?}");
        let name = |value: serde_json::Value| value.as_str().unwrap().to_owned();
        found.iter().map(|s| format!("{} {}", name(json!(s.body)), name(json!(s.unit)))).collect()
    };
    request.outputs = vec![Output::Glb, Output::Obj].into();
    assert_eq!(named(&surfaces(&request)), [""; 0], "the tissue in metres has the certificate of the model");
    request.outputs.formats = vec![Output::Stl];
    assert_eq!(named(&surfaces(&request)), ["tissue mm"]);
    request.outputs = Outputs { formats: vec![Output::Ply], bodies: vec![BodyKind::Lumen], units: None };
    assert_eq!(named(&surfaces(&request)), ["lumen m", "regions m", "lumen mm"]);
    request.outputs.units = Some(LengthUnit::Micrometre);
    request.outputs.bodies = vec![BodyKind::Regions];
    let found = surfaces(&request);
    assert_eq!(named(&found), ["lumen m", "regions m", "tissue um", "lumen um", "regions um"]);
    let volume = |i: usize| match &found[i].certificate {
        SurfaceCertificate::Body(certificate) => certificate.volume_mm3,
        SurfaceCertificate::Regions(certificate) => certificate.volume_mm3,
    };
    assert!((volume(0) / volume(3) - 1.0).abs() < 1e-6 && (volume(1) / volume(4) - 1.0).abs() < 1e-6);
    assert!((volume(2) + volume(3)) / volume(4) - 1.0 < 1e-12);
    let SurfaceCertificate::Regions(together) = &found[1].certificate else { panic!("{found:?}") };
    assert_eq!(together.triangle_intersections, 0);
}

#[test]
fn files_have_about_the_predicted_size() {
    let dir = tempfile::tempdir().unwrap();
    let request = request(small(&json!({})), Backend::Cpu, dir.path());
    let outcome = generate(&request, &(), &CancelToken::default()).unwrap();
    let predicted = Cost::new(&request.spec, &request.outputs).bytes;
    for output in [
        Output::Glb,
        Output::Gltf,
        Output::Obj,
        Output::Stl,
        Output::StlAscii,
        Output::Ply,
        Output::Vtp,
        Output::ThreeMf,
        Output::Centreline,
    ] {
        let one = Outputs { formats: vec![output], ..request.outputs.clone() };
        let written: u64 = outcome.files.iter().filter(|f| one.files().contains(&f.name)).map(|f| f.bytes).sum();
        let expected = predicted[output.name()];
        assert!(
            written < expected + expected / 4 && expected < written + written / 4,
            "{output:?}: {written}, predicted {expected}"
        );
    }
}
