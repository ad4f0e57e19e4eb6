//! The checks of a request for a batch, all before anything is queued.

use super::request::{BatchRequest, Seeds};
use crate::generate::Cost;
use crate::http::AppState;
use crate::http::models::create::{self, check_backend, cost, find_preset, too_much};
use crate::http::models::request::ModelRequest;
use crate::http::wire::blocking::blocking;
use crate::http::wire::faults::{Fault, Faults};
use crate::http::wire::problem::Problem;
use crate::spec::study::Study;
use crate::spec::{self, ModelSpec, Preset};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Most bytes of the specs of all models of a batch, as JSON.
const SPECS_MAX: usize = 32 << 20;

/// A request that passed all checks; only a full queue can refuse it.
pub(super) struct AcceptedBatch {
    /// What all models have in common.
    pub(super) request: ModelRequest,
    /// The seeds of each point.
    pub(super) seeds: Seeds,
    /// The study; without one, all models are of one point.
    pub(super) study: Option<Arc<Study>>,
    /// The points.
    pub(super) points: Vec<Point>,
}

/// A point of a study.
pub(super) struct Point {
    pub(super) spec: ModelSpec,
    pub(super) cost: Cost,
}

impl Point {
    fn new(request: &ModelRequest, spec: ModelSpec) -> Self {
        Self { cost: cost(request, &spec), spec }
    }
}

/// Reads and checks a body.
pub(super) async fn check_body(state: &AppState, body: &Value) -> Result<AcceptedBatch, Problem> {
    let mut faults = Faults::default();
    let BatchRequest { seeds, study, each } = BatchRequest::read(body, state.limits.batch, &mut faults);
    let accepted = match study {
        Some(study) => check_study(state, each, seeds, Arc::new(study), faults).await?,
        None => {
            let create::Accepted { request, spec, .. } = create::check(state, each, faults).await?;
            AcceptedBatch { points: vec![Point::new(&request, spec)], request, seeds, study: None }
        }
    };
    if accepted.study.is_none() {
        let bytes: usize = accepted.points.iter().map(|point| written(&point.spec)).sum();
        if bytes.saturating_mul(accepted.seeds.len()) > SPECS_MAX {
            return Err(Problem::invalid(too_large("/spec")));
        }
    }
    Ok(accepted)
}

/// Bytes of a spec as JSON.
fn written(spec: &ModelSpec) -> usize {
    spec.to_json().to_string().len()
}

fn too_large(place: &str) -> Fault {
    Fault::at(place, format!("the specs of all models together have more than {SPECS_MAX} bytes as JSON"))
}

async fn check_study(
    state: &AppState,
    request: ModelRequest,
    seeds: Seeds,
    study: Arc<Study>,
    mut faults: Faults,
) -> Result<AcceptedBatch, Problem> {
    let preset = find_preset(&request, &mut faults);
    let mut points = Vec::new();
    if let Some(preset) = preset {
        faults.extend(replaced(preset, &request, &study));
        // Thousands of points take seconds.
        let (common, of, seeds) = (request.clone(), Arc::clone(&study), seeds.len());
        match blocking("Checking the request", move || resolve(preset, &common, &of, seeds)).await? {
            Ok(resolved) => points = resolved,
            Err(found) => faults.extend(found),
        }
    }
    if !faults.is_empty() {
        return Err(Problem::invalid(faults));
    }
    check_costs(state, &study, &points)?;
    check_backend(state, &request).await?;
    Ok(AcceptedBatch { request, seeds, study: Some(study), points })
}

/// Faults of members of `spec` that the study replaces, so that no point shows them.
fn replaced(preset: &Preset, request: &ModelRequest, study: &Study) -> Vec<Fault> {
    let is_replaced = |pointer: &str| {
        let varied = |of: &&String| pointer == of.as_str() || pointer.starts_with(&format!("{of}/"));
        study.pointers().iter().find(varied).is_some_and(|of| request.spec.pointer(of).is_some())
    };
    let faults = ModelSpec::resolve(preset, &request.spec).err().unwrap_or_default();
    let replaced = faults.iter().filter(|fault| is_replaced(&fault.pointer));
    replaced.map(|fault| Fault::at(format!("/spec{}", fault.pointer), &fault.detail)).collect()
}

/// All points, or all faults: each once, with the first point that has it. Each point has so many `seeds`.
fn resolve(preset: &Preset, common: &ModelRequest, study: &Study, seeds: usize) -> Result<Vec<Point>, Vec<Fault>> {
    let (mut points, mut found, mut bytes) = (Vec::new(), Found::default(), 0);
    let mut digests = BTreeMap::new();
    for point in 0..study.points() {
        match ModelSpec::resolve_all(preset, &[&common.spec, &study.patch(point)]) {
            Ok(spec) => {
                bytes += written(&spec);
                if bytes.saturating_mul(seeds) > SPECS_MAX {
                    return Err(vec![too_large("/vary")]);
                }
                if let Some(first) = digests.insert(spec.digest(0), point) {
                    let detail =
                        format!("gives the same model at {} and at {}", study.describe(first), study.describe(point));
                    found.repeated.push(Fault::at("/vary/values", detail));
                }
                points.push(Point::new(common, spec));
            }
            Err(faults) => faults.into_iter().for_each(|fault| found.add(study, point, fault)),
        }
    }
    let faults = found.into_faults(study);
    if faults.is_empty() { Ok(points) } else { Err(faults) }
}

/// The faults of points so far.
#[derive(Default)]
struct Found {
    /// Place and detail, with the first point and the number of points.
    faults: BTreeMap<(String, String), (usize, usize)>,
    repeated: Vec<Fault>,
}

impl Found {
    fn add(&mut self, study: &Study, point: usize, spec::Fault { pointer, detail }: spec::Fault) {
        let place = study.place(point, &pointer).map_or_else(|| format!("/spec{pointer}"), |at| format!("/vary{at}"));
        self.faults.entry((place, detail)).or_insert((point, 0)).1 += 1;
    }

    fn into_faults(self, study: &Study) -> Vec<Fault> {
        let fault = |((place, detail), (first, count)): ((String, String), (usize, usize))| {
            let others = match count - 1 {
                0 => String::new(),
                n => format!(" and {n} more"),
            };
            match count == study.points() {
                true => Fault::at(place, detail),
                false => Fault::at(place, format!("{detail}; so at {}{others}", study.describe(first))),
            }
        };
        self.faults.into_iter().map(fault).chain(self.repeated).collect()
    }
}

fn check_costs(state: &AppState, study: &Study, points: &[Point]) -> Result<(), Problem> {
    let over = |(i, point): (usize, &Point)| state.limits.cost.check(&point.cost).err().map(|over| (i, over));
    let over: Vec<_> = points.iter().enumerate().filter_map(over).collect();
    let Some((first, of_first)) = over.first() else { return Ok(()) };
    let mut faults = Faults::default();
    for (point, over) in &over {
        faults.extend(over.iter().map(|over| Fault::at("/vary", format!("{over}; so at {}", study.describe(*point)))));
    }
    let detail =
        format!("{} of {} points exceed a limit; prediction and limit are of point {first}.", over.len(), points.len());
    Err(too_much(&points[*first].cost, of_first).with_detail(detail).with_errors(faults.into_parts().0))
}
