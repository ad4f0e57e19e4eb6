//! Fits parameters to measures: from targets, such as the measures of a micrograph, to a
//! specification whose models meet them.
//!
//! The search measures candidates on reduced models, with the same seeds for all candidates. It
//! verifies the result on models that are grown in full with other seeds. `docs/fitting.md`
//! describes the method.
//!
//! | file | subject |
//! |---|---|
//! | `request` | the request as JSON or CSV, valid by construction |
//! | `target` | a quantity in a region and its accepted range; loss |
//! | `variable` | a parameter between two bounds; parameters that targets depend on |
//! | `error` | errors of a fit |
//! | `evaluate` | measures of a candidate on a reduced model |
//! | `search` | the optimizer, its candidates, checkpoints |
//! | `image` | targets from images of sections |
//! | `linear` | a linear model of the deviations near a candidate |
//! | `limits` | targets that cannot be met, and the bounds that prevent it |
//! | `result` | the result of a fit |
//! | `watch` | progress |

mod error;
mod evaluate;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod image;
mod limits;
mod linear;
mod request;
mod result;
mod search;
mod target;
mod variable;
mod watch;

pub use error::FitError;
pub use image::{IMAGE_QUANTITIES, IMAGE_TOLERANCE, ImageFault, MOST_IMAGES, SectionImage, image_targets, read_images};
pub use limits::{Bound, Unmet, Why};
pub use request::{EVALUATIONS, FitSpec, MEMBERS, MODELS, MOST_TARGETS, MOST_VARIABLES, SEEDS};
pub use result::{FitResult, Fitted, Grown, Reached, Searched};
pub use search::{Ended, Fall};
pub use target::{TOLERANCE, Target};
pub use variable::{Variable, Varied};
pub use watch::{FitProgress, FitSink, FitStage};

use crate::generate::{Backend, CancelToken, Cost, GenerateError, Outputs, Request, generate};
use crate::spec::ModelSpec;
use evaluate::Candidate;
use rayon::prelude::*;
use search::{Archive, search};
use std::path::Path;
use watch::Watch;

/// Searches for a spec that meets the targets, and verifies it.
///
/// Uses all threads of the rayon pool in which it is called; the result does not depend on their
/// number. `dir` receives the files of models, which are deleted again. The limit of predicted
/// memory bounds the number of models that are grown at the same time. A search continues from a
/// `checkpoint` that an earlier search passed to its sink.
///
/// # Errors
/// [`FitError`].
pub fn fit(
    fit: &FitSpec,
    checkpoint: Option<&[u8]>,
    dir: &Path,
    memory_limit_bytes: Option<u64>,
    sink: &dyn FitSink,
    cancel: &CancelToken,
) -> Result<FitResult, FitError> {
    check_memory(fit, memory_limit_bytes)?;
    let watch = Watch::new(sink, cancel, fit.evaluations, fit.models);
    let archive = Archive::new(fit, checkpoint, &watch);
    let found = search(fit, &archive)?;
    let unmet = limits::unmet(fit, &archive, &found.best)?;
    watch.verify();
    let invalid = |_| FitError::Search { detail: "the best candidate is invalid".to_owned() };
    let spec = fit.at(&found.best.places).map_err(invalid)?;
    let models = models(fit, &spec, dir, memory_limit_bytes, &watch)?;
    Ok(FitResult {
        preset: fit.preset.name.clone(),
        spec: spec.to_json(),
        parameters: parameters(fit, &found.best),
        targets: reached(fit, &archive, &found.best, &models),
        unmet,
        search: Searched {
            ended: found.ended,
            seeds: fit.search_seeds().collect(),
            evaluations: found.evaluations,
            failed: found.failed,
            start_misfit: found.start,
            misfit: found.best.misfit(&fit.targets),
            history: found.history,
        },
        models,
    })
}

/// Refuses a fit whose start, or whose variables at their upper bounds, need more memory than
/// allowed.
fn check_memory(fit: &FitSpec, limit: Option<u64>) -> Result<(), FitError> {
    let Some(limit) = limit else { return Ok(()) };
    let needed = fit.extremes().map(|spec| Cost::new(&spec, &Outputs::none()).memory_bytes).max().unwrap_or_default();
    if needed > limit { Err(FitError::Memory { needed, limit }) } else { Ok(()) }
}

/// Grows models of the result in full.
fn models(
    fit: &FitSpec,
    spec: &ModelSpec,
    dir: &Path,
    memory_limit_bytes: Option<u64>,
    watch: &Watch<'_>,
) -> Result<Vec<Grown>, FitError> {
    let request = |seed: u64| Request {
        preset: fit.preset.name.clone(),
        spec: spec.clone(),
        seed,
        backend: Backend::Cpu,
        outputs: Outputs::none(),
        dir: dir.join(format!("model-{seed}")),
        memory_limit_bytes,
    };
    let requests: Vec<Request> = fit.model_seeds().map(request).collect();
    let needed = Cost::new(spec, &Outputs::none()).memory_bytes.max(1);
    let at_once = memory_limit_bytes.map_or(usize::MAX, |limit| usize::try_from(limit / needed).unwrap_or(usize::MAX));
    let mut models = Vec::with_capacity(requests.len());
    for some in requests.chunks(at_once.max(1)) {
        let grown: Result<Vec<Grown>, FitError> = some.par_iter().map(|request| model(fit, request, watch)).collect();
        models.extend(grown?);
    }
    Ok(models)
}

fn model(fit: &FitSpec, request: &Request, watch: &Watch<'_>) -> Result<Grown, FitError> {
    let (seed, dir) = (request.seed, &request.dir);
    watch.sink().pause(watch.cancel());
    std::fs::create_dir_all(dir)?;
    let grown = generate(request, &(), watch.cancel());
    std::fs::remove_dir_all(dir)?;
    watch.grown();
    let unmeasured = vec![None; fit.targets.len()];
    Ok(match grown {
        Ok(outcome) => {
            let measures = fit.targets.iter().map(|t| t.measured(&outcome.findings.morphometry)).collect();
            Grown { seed, certified: true, measures, failure: None }
        }
        Err(GenerateError::Cancelled) => return Err(FitError::Cancelled),
        Err(error) => Grown { seed, certified: false, measures: unmeasured, failure: Some(error.to_string()) },
    })
}

fn parameters(fit: &FitSpec, best: &Candidate) -> Vec<Fitted> {
    let fitted = |(variable, &place): (&Variable, &f64)| Fitted {
        parameter: variable.lever.pointer.clone(),
        end: variable.end,
        unit: variable.lever.unit.to_owned(),
        start: variable.start,
        value: variable.at(place),
        from: variable.from,
        to: variable.to,
    };
    fit.variables.iter().zip(&best.places).map(fitted).collect()
}

fn reached(fit: &FitSpec, archive: &Archive<'_>, best: &Candidate, models: &[Grown]) -> Vec<Reached> {
    let one = |(t, target): (usize, &Target)| {
        let measured = best.measures[t];
        let values: Vec<f64> = models.iter().filter_map(|model| model.measures[t]).collect();
        let n = values.len() as f64;
        let mean = (!values.is_empty()).then(|| values.iter().sum::<f64>() / n);
        let squares = mean.map(|mean| values.iter().map(|x| (x - mean).powi(2)).sum::<f64>());
        Reached {
            target: target.clone(),
            measured,
            seeds: archive.seeds(t),
            deviation: target.deviation(measured),
            met: target.is_met(measured),
            models_mean: mean,
            models_sd: squares.filter(|_| values.len() > 1).map(|squares| (squares / (n - 1.0)).sqrt()),
            models_met: values.iter().filter(|&&x| target.is_met(Some(x))).count(),
        }
    };
    fit.targets.iter().enumerate().map(one).collect()
}

#[cfg(test)]
mod tests;
