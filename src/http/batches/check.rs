//! Checks of a request for a batch, all before anything is queued.

use super::request::{BatchRequest, BatchSeeds};
use crate::generate::Cost;
use crate::http::AppState;
use crate::http::models::create::{self, check_backend, find_preset, too_much};
use crate::http::models::request::ModelRequest;
use crate::http::wire::blocking::blocking;
use crate::http::wire::faults::body_reader;
use crate::http::wire::problem::Problem;
use crate::http::wire::shares::Turn;
use crate::spec::study::Study;
use crate::spec::{Fault, JsonReader, ModelSpec, Preset};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Maximum size of the specs of all models of a batch as JSON, in bytes.
const MAX_SPEC_BYTES: usize = 32 << 20;

/// A request that passed all checks. Only a full queue can refuse it.
pub(super) struct CheckedBatch {
    /// Members that all models have in common.
    pub(super) request: ModelRequest,
    /// Seeds of each point.
    pub(super) seeds: BatchSeeds,
    /// The study; without one, all models belong to a single point.
    pub(super) study: Option<Arc<Study>>,
    pub(super) points: Vec<CheckedPoint>,
}

/// A point of a study.
pub(super) struct CheckedPoint {
    pub(super) spec: Arc<ModelSpec>,
    pub(super) cost: Cost,
}

/// Reads and checks a body, for a request with this turn.
pub(super) async fn check_body(state: &AppState, body: &Value, turn: &Turn) -> Result<CheckedBatch, Problem> {
    let mut reader = body_reader();
    let BatchRequest { seeds, study, common } = BatchRequest::read(&mut reader, body, state.limits.batch);
    if let Some(study) = study {
        return check_study(state, common, seeds, Arc::new(study), reader, turn).await;
    }
    let create::CheckedModel { request, spec, cost } = create::check(state, common, reader).await?;
    if json_bytes(&spec).saturating_mul(seeds.len()) > MAX_SPEC_BYTES {
        return Err(Problem::invalid([too_large("/spec")]));
    }
    Ok(CheckedBatch {
        points: vec![CheckedPoint { spec, cost: Arc::unwrap_or_clone(cost) }],
        request,
        seeds,
        study: None,
    })
}

/// Size of a spec as JSON, in bytes.
fn json_bytes(spec: &ModelSpec) -> usize {
    spec.to_json().to_string().len()
}

fn too_large(at: &str) -> Fault {
    Fault::new(at, format!("the specs of all models together have more than {MAX_SPEC_BYTES} bytes as JSON"))
}

async fn check_study(
    state: &AppState,
    request: ModelRequest,
    seeds: BatchSeeds,
    study: Arc<Study>,
    mut reader: JsonReader,
    turn: &Turn,
) -> Result<CheckedBatch, Problem> {
    let mut points = Vec::new();
    if let Some(preset) = find_preset(&request, &mut reader) {
        reader.extend("/spec", replaced_faults(preset, &request, &study));
        let (common, varied, seeds) = (request.clone(), Arc::clone(&study), seeds.len());
        // Resolving thousands of points takes seconds.
        let resolve = move || resolve_points(preset, &common, &varied, seeds);
        match blocking("Checking the request", turn.clone(), resolve).await? {
            Ok(resolved) => points = resolved,
            Err(faults) => reader.extend("", faults),
        }
    }
    if reader.count() > 0 {
        return Err(Problem::invalid(reader));
    }
    check_costs(state, &study, &points)?;
    check_backend(state, &request).await?;
    Ok(CheckedBatch { request, seeds, study: Some(study), points })
}

/// Faults of members of `spec` that the study replaces. No point has them.
fn replaced_faults(preset: &Preset, request: &ModelRequest, study: &Study) -> impl Iterator<Item = Fault> {
    let is_replaced = move |pointer: &str| {
        let contains = |varied: &&String| pointer == varied.as_str() || pointer.starts_with(&format!("{varied}/"));
        study.pointers().iter().find(contains).is_some_and(|varied| request.spec.pointer(varied).is_some())
    };
    let faults = ModelSpec::resolve(preset, &request.spec).err().unwrap_or_default();
    faults.into_iter().filter(move |fault| is_replaced(&fault.pointer))
}

/// Resolves all points, each for a number of `seeds`.
///
/// # Errors
/// Returns all faults, each once, with the first point that has it.
fn resolve_points(
    preset: &Preset,
    common: &ModelRequest,
    study: &Study,
    seeds: usize,
) -> Result<Vec<CheckedPoint>, Vec<Fault>> {
    let (mut points, mut faults, mut bytes) = (Vec::new(), PointFaults::default(), 0);
    let mut digests = BTreeMap::new();
    for point in 0..study.points() {
        match ModelSpec::resolve_all(preset, &[&common.spec, &study.patch(point)]) {
            Ok(spec) => {
                bytes += json_bytes(&spec);
                if bytes.saturating_mul(seeds) > MAX_SPEC_BYTES {
                    return Err(vec![too_large("/vary")]);
                }
                if let Some(first) = digests.insert(spec.digest(0), point) {
                    let detail =
                        format!("gives the same model at {} and at {}", study.describe(first), study.describe(point));
                    faults.repeated.push(Fault::new("/vary/values", detail));
                }
                points.push(CheckedPoint { cost: Cost::new(&spec, &common.outputs), spec: Arc::new(spec) });
            }
            Err(of_point) => of_point.into_iter().for_each(|fault| faults.add(study, point, fault)),
        }
    }
    let faults = faults.into_vec(study);
    if faults.is_empty() { Ok(points) } else { Err(faults) }
}

/// Faults of the points of a study.
#[derive(Default)]
struct PointFaults {
    /// First point and number of points with a fault, by pointer and detail.
    points: BTreeMap<(String, String), (usize, usize)>,
    /// Points that equal another point.
    repeated: Vec<Fault>,
}

impl PointFaults {
    fn add(&mut self, study: &Study, point: usize, Fault { pointer, detail }: Fault) {
        let at = study.place(point, &pointer).map_or_else(|| format!("/spec{pointer}"), |at| format!("/vary{at}"));
        self.points.entry((at, detail)).or_insert((point, 0)).1 += 1;
    }

    fn into_vec(self, study: &Study) -> Vec<Fault> {
        let fault = |((at, detail), (first, count)): ((String, String), (usize, usize))| {
            let others = if count > 1 { format!(" and {} more", count - 1) } else { String::new() };
            match count == study.points() {
                true => Fault::new(at, detail),
                false => Fault::new(at, format!("{detail}; so at {}{others}", study.describe(first))),
            }
        };
        self.points.into_iter().map(fault).chain(self.repeated).collect()
    }
}

fn check_costs(state: &AppState, study: &Study, points: &[CheckedPoint]) -> Result<(), Problem> {
    let over = |(i, point): (usize, &CheckedPoint)| state.limits.cost.check(&point.cost).err().map(|over| (i, over));
    let over: Vec<_> = points.iter().enumerate().filter_map(over).collect();
    let Some((first, of_first)) = over.first() else { return Ok(()) };
    let mut faults = Vec::new();
    for (point, over) in &over {
        faults.extend(over.iter().map(|over| Fault::new("/vary", format!("{over}; so at {}", study.describe(*point)))));
    }
    let detail =
        format!("{} of {} points exceed a limit; prediction and limit are of point {first}.", over.len(), points.len());
    Err(too_much(&points[*first].cost, of_first).with_detail(detail).with_errors(faults))
}
