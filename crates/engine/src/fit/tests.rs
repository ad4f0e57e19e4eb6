//! Tests of whole fits of small models: hidden parameters, contradictions, checkpoints,
//! cancellation, threads.

use super::*;
use crate::lock::Mutex;
use serde_json::{Value, json};
use std::sync::atomic::{AtomicU32, Ordering};

/// A tube of a few hundred particles.
fn small(patch: &Value) -> Value {
    let mut whole = json!({
        "steps": 120, "burn_in": 40,
        "particles": { "total": { "keys": [[0, 260], [1, 620]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
    });
    json_patch::merge(&mut whole, patch);
    whole
}

/// Measures of models of a spec with these seeds.
fn measures(spec: &Value, names: &[(&str, &str)], seed: u64) -> Vec<f64> {
    let targets: Vec<Value> =
        names.iter().map(|(region, quantity)| json!({ "region": region, "quantity": quantity, "value": 1 })).collect();
    let body =
        json!({ "spec": spec, "targets": targets, "seeds": 4, "seed": seed, "vary": [{ "parameter": "/bending" }] });
    let fit = FitSpec::read(&body, Vec::new(), &[]).unwrap();
    let cancel = CancelToken::default();
    let start: Vec<f64> = fit.variables.iter().map(Variable::start).collect();
    let found = evaluate::Evaluator::new(&fit, &(), &cancel).measure(&start, request::Physics::Whole).unwrap();
    found.into_iter().map(Option::unwrap).collect()
}

fn run(body: &Value, sink: &dyn FitSink, checkpoint: Option<&[u8]>) -> FitResult {
    let dir = tempfile::tempdir().unwrap();
    let fit = FitSpec::read(body, Vec::new(), &[]).unwrap();
    let result = super::fit(&fit, checkpoint, dir.path(), None, sink, &CancelToken::default()).unwrap();
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "models are removed");
    result
}

const NAMES: [(&str, &str); 4] = [
    ("ampulla", "lumen_gap_p50_um"),
    ("ampulla", "tissue_thickness_p50_um"),
    ("ampulla", "lumen_perimeter_mm"),
    ("whole", "tissue_area_mm2"),
];

/// A fit to the measures of a model with other parameters.
fn hidden() -> Value {
    let truth = small(&json!({
        "particles": { "total": { "keys": [[0, 290], [1, 720]] } },
        "collision": { "gap_um": 45, "tissue_um": 100 },
        "containment": { "wall_um": 520 },
    }));
    let start = small(&json!({ "collision": { "gap_um": 36, "tissue_um": 80 }, "containment": { "wall_um": 680 } }));
    let values = measures(&truth, &NAMES, 900);
    let targets: Vec<Value> = NAMES
        .iter()
        .zip(values)
        .map(|((region, quantity), value)| json!({ "region": region, "quantity": quantity, "value": value }))
        .collect();
    json!({
        "spec": start, "targets": targets, "evaluations": 80, "seeds": 4, "models": 3,
        "vary": [
            { "parameter": "/collision/gap_um" }, { "parameter": "/collision/tissue_um" },
            { "parameter": "/containment/wall_um" }, { "parameter": "/particles/total", "from": 400, "to": 900 },
        ],
    })
}

#[test]
fn hidden_parameters_are_fitted_within_5_percent() {
    let result = run(&hidden(), &(), None);
    for target in &result.targets {
        let measured = target.measured.unwrap();
        assert!((measured / target.target.value - 1.0).abs() < 0.05 && target.met, "{target:?}");
        // Other seeds, and a whole model: small models differ strongly between seeds.
        let models = target.models_mean.unwrap();
        assert!((models / target.target.value - 1.0).abs() < 0.12, "{target:?}");
    }
    assert!(result.unmet.is_empty() && result.search.misfit < 1.0, "{:?}", result.search);
    assert!(result.search.start_misfit > Some(2.0), "{:?}", result.search);
    assert!(result.models.len() == 3 && result.models.iter().all(|model| model.certified), "{:?}", result.models);
    let wall = result.parameters.iter().find(|fitted| fitted.parameter == "/containment/wall_um").unwrap();
    assert!((wall.value / 520.0 - 1.0).abs() < 0.1, "{wall:?}");
    // The measures are measures of the physics of the spec, not of reduced models.
    assert_eq!(
        result.targets.iter().map(|t| t.measured.unwrap()).collect::<Vec<_>>(),
        measures(&result.spec, &NAMES, 0)
    );
    // The spec is complete, so a request for a model accepts it.
    let preset = crate::spec::preset(&result.preset).unwrap();
    assert!(crate::spec::ModelSpec::resolve(preset, &result.spec).is_ok());
    let falls = &result.search.history;
    assert!(falls.windows(2).all(|pair| pair[1].misfit < pair[0].misfit || pair[0].reduced && !pair[1].reduced));
    assert_eq!(falls.last().map(|last| (last.misfit, last.reduced)), Some((result.search.misfit, false)));
}

#[test]
fn the_last_evaluations_have_the_physics_of_the_spec() {
    let mut body = hidden();
    body["models"] = json!(1);
    let mut searched = |evaluations: u32, integrator: &str| {
        body["evaluations"] = json!(evaluations);
        body["spec"]["solver"] = json!({ "integrator": integrator });
        let result = run(&body, &(), None);
        if evaluations == 1 {
            // A single candidate does not show which parameters have no influence.
            assert!(!result.unmet.is_empty() && result.unmet.iter().all(|unmet| unmet.why != Why::Insensitive));
        }
        result.search
    };
    let one = searched(1, "rk4");
    assert_eq!((one.evaluations, one.start_misfit, one.history.len()), (1, Some(one.misfit), 1));
    assert!(!one.history[0].reduced);
    let some = searched(9, "rk4");
    assert!(some.evaluations <= 9 && some.history[0].reduced && !some.history.last().unwrap().reduced, "{some:?}");
    // A spec with Euler steps is its own reduced model.
    let euler = searched(9, "euler");
    assert!(euler.evaluations >= 7 && euler.history.iter().all(|fall| !fall.reduced), "{euler:?}");
}

/// Sink that keeps the checkpoints, and counts the candidates that were measured before each.
#[derive(Default)]
struct Keeps {
    checkpoints: Mutex<Vec<Vec<u8>>>,
    candidates: AtomicU32,
}

impl FitSink for Keeps {
    fn progress(&self, progress: &FitProgress) {
        self.candidates.store(progress.evaluations, Ordering::Relaxed);
    }
    fn wants_checkpoint(&self) -> bool {
        true
    }
    fn checkpoint(&self, bytes: Vec<u8>) {
        self.checkpoints.lock().push(bytes);
    }
}

#[test]
fn a_search_continues_from_a_checkpoint_and_does_not_depend_on_threads() {
    let mut body = hidden();
    body["evaluations"] = json!(20);
    body["models"] = json!(1);
    let pool = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let kept = Keeps::default();
    let whole = pool(1).install(|| run(&body, &kept, None));
    assert_eq!(pool(3).install(|| run(&body, &(), None)), whole);
    let checkpoints = std::mem::take(&mut *kept.checkpoints.lock());
    assert!(checkpoints.len() >= 10, "{}", checkpoints.len());
    // From the middle: only the rest is measured.
    let after = Keeps::default();
    let half = checkpoints.len() / 2;
    assert_eq!(pool(2).install(|| run(&body, &after, Some(&checkpoints[half]))), whole);
    let measured = after.checkpoints.lock().len();
    assert_eq!(measured, checkpoints.len() - half - 1);
    // A checkpoint of another request, or an invalid one, is ignored.
    let mut other = body.clone();
    other["seed"] = json!(5);
    other["evaluations"] = json!(6);
    let fresh = run(&other, &(), None);
    assert_eq!(run(&other, &(), checkpoints.last().map(Vec::as_slice)), fresh);
    assert_eq!(run(&other, &(), Some(b"{\"digest\": 3")), fresh);
}

#[test]
fn what_cannot_be_met_is_told_with_its_bounds() {
    // The perimeter grows with the number of particles, which is fixed.
    let names = [("ampulla", "lumen_perimeter_mm"), ("ampulla", "tissue_thickness_p50_um")];
    let values = measures(&small(&json!({})), &names, 0);
    let body = json!({
        "spec": small(&json!({})), "evaluations": 40, "models": 1,
        "targets": [
            { "region": "ampulla", "quantity": "lumen_perimeter_mm", "value": 1.8 * values[0] },
            { "region": "ampulla", "quantity": "tissue_thickness_p50_um", "value": values[1] },
        ],
        "vary": [{ "parameter": "/particles/total", "from": 500, "to": 700 }, { "parameter": "/friction", "from": 0.2, "to": 0.4 }],
    });
    let result = run(&body, &(), None);
    let unmet = result.unmet.iter().find(|unmet| unmet.quantity == "lumen_perimeter_mm").expect("it cannot be met");
    assert_eq!(unmet.why, Why::OutOfReach, "{unmet:?}");
    assert!(unmet.nearest.is_some_and(|nearest| nearest < 1.6 * values[0]), "{unmet:?}");
    let bound = unmet.bounds.iter().find(|bound| bound.parameter == "/particles/total").expect("the bound is named");
    assert_eq!((bound.bound.as_str(), bound.value), ("to", 700.0));
}

#[test]
fn a_target_far_away_is_out_of_reach() {
    let body = json!({
        "spec": small(&json!({})), "evaluations": 20, "models": 1,
        "targets": [{ "region": "ampulla", "quantity": "lumen_perimeter_mm", "value": 100 }],
        "vary": [{ "parameter": "/particles/total", "from": 500, "to": 700 }],
    });
    let result = run(&body, &(), None);
    assert_eq!((result.unmet[0].why, result.unmet[0].bounds[0].bound.as_str()), (Why::OutOfReach, "to"));
}

#[test]
fn contradictions_are_told() {
    // One quantity at two values.
    let value = measures(&small(&json!({})), &[("whole", "tissue_area_mm2")], 0)[0];
    let target = |factor: f64| json!({ "region": "whole", "quantity": "tissue_area_mm2", "value": factor * value });
    let body = json!({
        "spec": small(&json!({})), "evaluations": 40, "models": 1,
        "targets": [target(1.0), target(1.3)], "vary": [{ "parameter": "/containment/wall_um" }],
    });
    let result = run(&body, &(), None);
    assert!(!result.unmet.is_empty());
    for unmet in &result.unmet {
        assert_eq!((unmet.why, unmet.conflicts.as_slice()), (Why::Conflict, &["whole/tissue_area_mm2".to_owned()][..]));
        assert!(unmet.bounds.is_empty(), "{unmet:?}");
    }
}

#[test]
fn what_no_variable_changes_is_told() {
    let body = json!({
        "spec": small(&json!({})), "evaluations": 20, "models": 1, "seeds": 1,
        "targets": [{ "region": "tube", "quantity": "length_mm", "value": 90 }],
        "vary": [{ "parameter": "/friction", "from": 0.2, "to": 0.4 }],
    });
    let result = run(&body, &(), None);
    assert_eq!(
        result.unmet.iter().map(|unmet| (unmet.why, unmet.nearest)).collect::<Vec<_>>(),
        [(Why::Insensitive, Some(60.0))]
    );
}

#[test]
fn a_cancelled_fit_stops_soon() {
    struct Stops(CancelToken);
    impl FitSink for Stops {
        fn progress(&self, progress: &FitProgress) {
            if progress.evaluations == 3 {
                self.0.cancel();
            }
        }
    }
    let (dir, cancel) = (tempfile::tempdir().unwrap(), CancelToken::default());
    let fit = FitSpec::read(&hidden(), Vec::new(), &[]).unwrap();
    let ended = super::fit(&fit, None, dir.path(), None, &Stops(cancel.clone()), &cancel);
    assert!(matches!(ended, Err(FitError::Cancelled)));
}

#[test]
fn a_search_without_any_candidate_says_why() {
    // More particles in the outer loop than in both.
    let body = json!({
        "spec": small(&json!({})), "targets": [{ "region": "whole", "quantity": "fill", "value": 0.7 }], "evaluations": 12,
        "vary": [{ "parameter": "/particles/outer", "from": 2000, "to": 4000 }],
    });
    let fit = FitSpec::read(&body, Vec::new(), &[]).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let ended = super::fit(&fit, None, dir.path(), None, &(), &CancelToken::default()).unwrap_err();
    assert!(ended.to_string().contains("/particles/"), "{ended}");
}

#[test]
fn a_fit_that_needs_more_memory_than_allowed_is_refused() {
    let body = json!({
        "spec": small(&json!({})), "targets": [{ "region": "whole", "quantity": "fill", "value": 0.7 }], "evaluations": 12,
        "seeds": 1, "models": 3, "vary": [{ "parameter": "/particles/total", "from": 400, "to": 5000 }],
    });
    let fit = FitSpec::read(&body, Vec::new(), &[]).unwrap();
    let run = |limit: u64| {
        let dir = tempfile::tempdir().unwrap();
        super::fit(&fit, None, dir.path(), Some(limit), &(), &CancelToken::default())
    };
    let needs: Vec<u64> = fit.extremes().map(|spec| Cost::new(&spec, &Outputs::none()).memory_bytes).collect();
    let costliest = needs[1];
    assert!(needs[0] < costliest, "{needs:?}");
    let refused = run(costliest - 1).unwrap_err();
    assert!(matches!(refused, FitError::Memory { needed, limit } if needed == costliest && limit == costliest - 1));
    // One model at a time leads to the same result as all at the same time.
    let dir = tempfile::tempdir().unwrap();
    let free = super::fit(&fit, None, dir.path(), None, &(), &CancelToken::default()).unwrap();
    assert_eq!(run(costliest).unwrap(), free);
    assert_eq!(free.models.len(), 3);
}
