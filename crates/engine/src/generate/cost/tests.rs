//! Tests of predicted costs.

use super::super::limits::CostLimits;
use super::*;
use crate::spec::preset;
use Output::{Glb, Labels, Lod, Obj, Vtp};
use serde_json::{Value, json};

/// The cost of a model with these formats of the tissue.
fn predict(spec: &ModelSpec, formats: &[Output]) -> Cost {
    Cost::new(spec, &formats.to_vec().into())
}

fn spec(patch: &Value) -> ModelSpec {
    ModelSpec::resolve(preset("paper").unwrap(), patch).unwrap()
}

#[test]
fn the_papers_model_has_the_papers_size() {
    let cost = predict(&spec(&json!({})), &[Glb, Lod, Obj]);
    assert_eq!((cost.particles_end, cost.sections), (8300, 201));
    assert!(cost.vertices.abs_diff(790_211) < 790_211 / 50, "{}", cost.vertices);
    assert_eq!(cost.triangles, 2 * cost.vertices);
    assert_eq!(cost.bytes.keys().collect::<Vec<_>>(), ["glb", "lod", "obj", "report", "sections"]);
    assert!(cost.seconds["cpu"].seconds < cost.seconds["cpu-single"].seconds);
    let without = predict(&spec(&json!({})), &[Glb, Obj]);
    assert!(without.seconds["cpu"].seconds + 0.5 < cost.seconds["cpu"].seconds);
    assert!(without.memory_bytes < cost.memory_bytes);
}

#[test]
fn the_papers_simulation_takes_what_was_measured() {
    let seconds = simulation_seconds(&spec(&json!({})));
    assert!((3.5..5.5).contains(&seconds), "lists: {seconds} s");
    let seconds = simulation_seconds(&spec(&json!({ "solver": { "search": "all_pairs" } })));
    assert!((240.0..340.0).contains(&seconds), "all pairs: {seconds} s");
}

#[test]
fn a_last_step_beside_the_raster_is_recorded_too() {
    let s = spec(&json!({ "steps": 25, "particles": { "total": 900 } }));
    assert_eq!(s.stations().collect::<Vec<_>>(), [0, 10, 20, 25]);
    assert_eq!(predict(&s, &[]).sections, 4);
    let s = spec(&json!({ "steps": 20, "particles": { "total": 900 } }));
    assert_eq!(s.stations().collect::<Vec<_>>(), [0, 10, 20]);
    let s = spec(&json!({ "steps": 1, "particles": { "total": 900, "outer": 100 } }));
    assert_eq!(s.stations().collect::<Vec<_>>(), [0, 1]);
}

#[test]
fn the_steps_between_two_sections_take_memory() {
    let memory = |every: u32| predict(&spec(&json!({ "solver": { "record_every": every } })), &[]).memory_bytes;
    assert!(memory(1000) > 500 << 20, "{}", memory(1000));
    assert!(memory(10) < 400 << 20, "{}", memory(10));
    let sparse = json!({
        "solver": { "record_every": 1000 }, "particles": { "total": 200_000, "outer": 1000 }, "wall": { "lobing": 0 },
    });
    let over = CostLimits::default().check(&predict(&spec(&sparse), &[])).unwrap_err();
    assert!(over.iter().any(|o| o.quantity == "memory"), "{over:?}");
}

/// Peaks of the engine in MB, on two threads.
#[test]
fn memory_is_what_was_measured_and_some_to_spare() {
    let tenfold = json!({ "solver": { "record_every": 1 } });
    for (patch, outputs, measured) in
        [(&json!({}), &[Glb][..], 84.0), (&json!({}), &[Glb, Lod], 102.0), (&tenfold, &[Glb], 723.0)]
    {
        let predicted = predict(&spec(patch), outputs).memory_bytes as f64 / 1e6;
        assert!((1.0..1.6).contains(&(predicted / measured)), "{outputs:?}: {predicted} MB");
    }
}

#[test]
fn a_finer_label_volume_costs_more_up_to_the_limits() {
    let cost = |patch: &Value| predict(&spec(patch), &[Labels]);
    let (coarse, fine) = (cost(&json!({})), cost(&json!({ "labels": { "voxel_um": 5, "slice_um": 25 } })));
    assert!(fine.bytes["labels"] > 5 * coarse.bytes["labels"], "{coarse:?} {fine:?}");
    assert!(fine.memory_bytes > coarse.memory_bytes && fine.seconds["cpu"].seconds > coarse.seconds["cpu"].seconds);
    assert!(!predict(&spec(&json!({})), &[Glb]).bytes.contains_key("labels"));
    let piece = cost(&json!({ "labels": { "from": 0.9 } }));
    assert!(piece.bytes["labels"] < coarse.bytes["labels"] / 4, "{piece:?}");
    let over =
        CostLimits::default().check(&cost(&json!({ "labels": { "voxel_um": 0.5, "slice_um": 3 } }))).unwrap_err();
    let quantities: Vec<&str> = over.iter().map(|o| o.quantity).collect();
    assert!(quantities.contains(&"seconds") && quantities.contains(&"output"), "{over:?}");
    assert!(over.iter().all(|o| o.to_string().contains("/labels")), "{over:?}");
}

#[test]
fn textures_make_larger_files_and_need_memory() {
    let [plain, textured] = [false, true].map(|on| predict(&spec(&json!({ "mesh": { "textured": on } })), &[Glb]));
    let added = textured.bytes["glb"] - plain.bytes["glb"];
    assert!(added > 8 * plain.vertices && added < 8 * plain.vertices + 4_000_000, "{added}");
    assert!(textured.memory_bytes > plain.memory_bytes);
    assert_eq!(textured.bytes["sections"], plain.bytes["sections"]);
}

#[test]
fn strips_make_smaller_files_and_euler_less_work() {
    let full = spec(&json!({}));
    let strips = spec(&json!({ "mesh": { "strips": true } }));
    assert!(predict(&strips, &[Glb]).bytes["glb"] < predict(&full, &[Glb]).bytes["glb"]);
    let euler = spec(&json!({ "solver": { "integrator": "euler" } }));
    assert!(simulation_seconds(&euler) < simulation_seconds(&full) / 3.0);
}

fn pig(patch: &Value) -> ModelSpec {
    ModelSpec::resolve(preset("pig").unwrap(), patch).unwrap()
}

#[test]
fn finer_surfaces_and_longer_pieces_cost_more() {
    let cost = |patch: &Value| predict(&pig(patch), &[Glb]);
    let (whole, piece) = (cost(&json!({})), cost(&json!({ "piece": { "from": 0.6, "to": 0.7 } })));
    assert!(piece.triangles < whole.triangles / 5 && piece.memory_bytes < whole.memory_bytes);
    assert!(piece.seconds["cpu"].seconds < whole.seconds["cpu"].seconds);
    let even = |um: f64| cost(&json!({ "mesh": { "resolution_um": um } }));
    assert_eq!(even(40.0).sections, whole.sections);
    assert!(even(10.0).triangles.abs_diff(4 * even(20.0).triangles) < 8);
    assert!(even(20.0).triangles > 2 * even(40.0).triangles && even(40.0).triangles > even(80.0).triangles);
    assert!(even(40.0).seconds["cpu"].seconds > 5.0 * whole.seconds["cpu"].seconds);
    let smooth = cost(&json!({ "mesh": { "smooth_um": 5 } }));
    assert_eq!(smooth.triangles, 2 * whole.triangles);
    let both = cost(&json!({ "mesh": { "smooth_um": 5, "resolution_um": 40 } }));
    assert!(both.seconds["cpu"].seconds > 3.0 * even(40.0).seconds["cpu"].seconds);
    assert!(smooth.bytes["sections"] > whole.bytes["sections"] && smooth.particles_end == whole.particles_end);
}

#[test]
fn more_frames_cost_more() {
    let cost = |frames: u32| predict(&pig(&json!({ "contraction": { "frames": frames } })), &[Vtp]);
    let (none, twenty, forty) = (cost(0), cost(20), cost(40));
    assert!(!none.bytes.contains_key("contraction"));
    assert!(twenty.bytes["contraction"] > 10 * none.bytes["vtp"] / 4);
    assert!(forty.seconds["cpu"].seconds > twenty.seconds["cpu"].seconds + 10.0);
    assert!(twenty.memory_bytes > none.memory_bytes);
}
