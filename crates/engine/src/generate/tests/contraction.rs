//! Contraction of a model in frames.

use super::*;

#[test]
fn a_tube_contracts_in_frames_that_are_certified_and_keep_its_tissue() {
    let grown = |more: serde_json::Value, threads: usize| {
        // Sections are a millimetre apart: at larger distances, their differences alone make walls
        // of a bent tube intersect.
        let mut patch = json!({
            "length_mm": 20, "steps": 240, "lean": { "strength_um": 300 },
            "z": { "keys": [[0, 0], [1, 1]] },
            // Open gaps and few clefts leave the wave room to close.
            "collision": { "gap_um": 42, "tissue_um": 80 }, "primary": { "clefts": 8 },
            "contraction": { "frames": 5, "wavelength_mm": 6, "shortening": 0.01 },
        });
        json_patch::merge(&mut patch, &more);
        let dir = tempfile::tempdir().unwrap();
        let request = Request {
            outputs: Outputs { formats: vec![Output::Vtp], bodies: vec![BodyKind::Tissue], units: None },
            ..request(small(&patch), Backend::Cpu, dir.path())
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let outcome = pool.install(|| generate(&request, &(), &CancelToken::default())).unwrap();
        let data = std::fs::read(dir.path().join("frames.bin")).unwrap();
        (outcome, data)
    };
    let arc = json!({ "course": { "shape": "arc", "turn_deg": 60 } });
    for more in [json!({}), json!({ "mesh": { "smooth_um": 5 } }), arc] {
        let (outcome, data) = grown(more.clone(), 1);
        let report = outcome.findings.contraction.clone().unwrap();
        assert!(report.tissue_deviation < 0.02, "{more}: {report:?}");
        // Along the arc, edges that are split beside whole ones damp the wave.
        let least = if more["course"].is_null() { 0.7 } else { 0.3 };
        assert!(report.contracted.least_factor > least, "{more}: {report:?}");
        assert_eq!(report.frames.len(), 5);
        let summary = &outcome.findings.summary;
        assert_eq!(data.len() as u64, 13 * summary.triangles + 5 * 12 * summary.vertices);
        for frame in &report.frames {
            let certificate = &frame.certificate;
            assert!(certificate.passed && certificate.triangles == summary.triangles, "{more}");
            assert!(frame.lumen_volume_mm3 < report.lumen_volume_mm3 && frame.length_mm < 20.0, "{more}");
            assert!(frame.closed > 0.1 && frame.narrowed > 0.0, "{more}: {frame:?}");
        }
        let names: Vec<&str> = outcome.files.iter().map(|file| file.name.as_str()).collect();
        for name in ["animation.glb", "frames.bin", "frames.xdmf"] {
            assert!(names.contains(&name), "{names:?}");
        }
        let (again, _) = grown(more, 3);
        let hashes = |outcome: &Outcome| outcome.files.iter().map(|file| file.sha256.clone()).collect::<Vec<_>>();
        assert_eq!(hashes(&outcome), hashes(&again), "the same bytes on any number of threads");
    }
}
