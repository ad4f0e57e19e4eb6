//! The search: CMA-ES over the places between the bounds of the variables. Between the generations
//! of CMA-ES, the search takes steps of a linear model of the deviations, which needs far fewer
//! candidates where the deviations are nearly linear. This part runs on reduced models. Then
//! further steps of the linear model, from the best candidate, are measured with the physics of the
//! spec.
//!
//! The state of the search is the list of its candidates. The optimizer draws from a generator with
//! a fixed seed, so a search that continues from a checkpoint requests the same candidates again
//! and finds them in the list.

use super::error::FitError;
use super::evaluate::{Candidate, Evaluator, misfit};
use super::linear::Linear;
use super::request::{FitSpec, Physics};
use super::watch::Watch;
use crate::lock::Mutex;
use cmaes::{CMAESOptions, DVector};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Initial standard deviation of the candidates, as a fraction of the distance of the bounds.
const SPREAD: f64 = 0.12;
/// Maximum deviation at which the search ends: a fifth of the accepted range.
const CLOSE: f64 = 0.2;
/// Maximum length of a step of the linear model in a variable, as a fraction of the distance of the
/// bounds.
const REACHES: [f64; 2] = [0.3, 0.08];
/// Maximum quotient of the misfits after and before a step of the linear model for which such steps
/// are repeated.
const PAYS: f64 = 0.9;
/// Number of generations without such an improvement after which the search ends.
const PATIENCE: usize = 4;
/// Standard deviation of the candidates, as a fraction of the distance of the bounds, below which
/// the search ends.
const LEAST_SPREAD: f64 = 1e-3;
/// Misfit of a candidate without measures.
const NO_MODEL: f64 = 1e6;

/// Reason why a search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// Every target is met closely.
    Reached,
    /// All evaluations are used.
    Evaluations,
    /// The misfit no longer falls.
    Converged,
}

/// An improvement of the minimum misfit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Fall {
    /// Number of candidates up to this improvement.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub evaluations: usize,
    /// Minimum misfit of these candidates.
    pub misfit: f64,
    /// True if `misfit` is the misfit of reduced models.
    #[serde(default)]
    pub reduced: bool,
}

/// A finished search.
#[derive(Debug)]
pub(super) struct SearchResult {
    /// Best candidate with the physics of the spec.
    pub(super) best: Candidate,
    /// Misfit of the spec from which the search started; `None` if it could not be measured.
    pub(super) start: Option<f64>,
    /// Falls of the minimum misfit: on reduced models, then with the physics of the spec.
    pub(super) history: Vec<Fall>,
    /// Number of candidates that could be measured.
    pub(super) evaluations: usize,
    /// Number of candidates that could not be measured.
    pub(super) failed: usize,
    pub(super) ended: Ended,
}

/// A candidate with its measures, or with the reason why it has none, as in checkpoints.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct ArchiveEntry {
    physics: Physics,
    places: Vec<f64>,
    #[serde(default)]
    measures: Vec<Option<f64>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    failed: Option<String>,
}

#[derive(Serialize, Deserialize)]
struct Checkpoint {
    /// Digest of the request and the engine version.
    digest: String,
    entries: Vec<ArchiveEntry>,
}

type Key = (Physics, Vec<u64>);

fn key(physics: Physics, places: &[f64]) -> Key {
    (physics, places.iter().map(|place| place.to_bits()).collect())
}

/// Candidates by place. Candidates of a checkpoint are found instead of measured.
pub(super) struct Archive<'a> {
    fit: &'a FitSpec,
    evaluator: Evaluator<'a>,
    watch: &'a Watch<'a>,
    known: Mutex<BTreeMap<Key, ArchiveEntry>>,
    /// Keys in the order of their requests: the measured candidates of the search.
    order: Mutex<Vec<Key>>,
}

impl<'a> Archive<'a> {
    pub(super) fn new(fit: &'a FitSpec, checkpoint: Option<&[u8]>, watch: &'a Watch<'a>) -> Self {
        let read = checkpoint.and_then(|bytes| serde_json::from_slice::<Checkpoint>(bytes).ok());
        let entries = read.filter(|checkpoint| checkpoint.digest == fit.digest()).map(|checkpoint| checkpoint.entries);
        let fits = |entry: &ArchiveEntry| {
            entry.places.len() == fit.variables.len()
                && (entry.failed.is_some() || entry.measures.len() == fit.targets.len())
        };
        let known = entries
            .into_iter()
            .flatten()
            .filter(fits)
            .map(|entry| (key(entry.physics, &entry.places), entry))
            .collect();
        let evaluator = Evaluator::new(fit, watch.sink(), watch.cancel());
        Self { fit, evaluator, watch, known: Mutex::new(known), order: Mutex::default() }
    }

    pub(super) fn checkpoint(&self) -> Vec<u8> {
        let checkpoint =
            Checkpoint { digest: self.fit.digest(), entries: self.known.lock().values().cloned().collect() };
        serde_json::to_vec(&checkpoint).unwrap_or_default()
    }

    /// Measures a candidate that the optimizer requests. Returns its misfit.
    fn ask(&self, places: &[f64], physics: Physics, asked: &Mutex<Vec<Key>>) -> f64 {
        let entry = self.entry(places, physics);
        asked.lock().push(key(physics, places));
        entry.ok().and_then(|entry| self.misfit(&entry)).unwrap_or(NO_MODEL)
    }

    /// Lists the candidates of a generation, in an order that does not depend on the threads.
    fn list(&self, mut asked: Vec<Key>) {
        let known = self.known.lock();
        let misfit = |key: &Key| known.get(key).and_then(|entry| self.misfit(entry)).unwrap_or(NO_MODEL);
        asked.sort_by(|a, b| misfit(a).total_cmp(&misfit(b)).then_with(|| a.cmp(b)));
        self.order.lock().extend(asked);
    }

    /// Measured candidates in order. The candidates on reduced models are shifted by the change
    /// that the physics of the spec makes to the measures of the best of them, so that all
    /// candidates are comparable.
    pub(super) fn candidates(&self) -> Vec<Candidate> {
        let (known, order) = (self.known.lock(), self.order.lock());
        let measured = |key: &Key| known.get(key).cloned().and_then(candidate);
        let shift = order.iter().filter(|key| key.0 == Physics::Whole).find_map(|key| {
            let both = [measured(&(Physics::Reduced, key.1.clone()))?, measured(key)?];
            Some(both.map(|candidate| candidate.measures))
        });
        let shifted = |mut candidate: Candidate| {
            if let Some([reduced, whole]) = &shift {
                for ((measure, reduced), whole) in candidate.measures.iter_mut().zip(reduced).zip(whole) {
                    let change = whole.zip(*reduced).map_or(0.0, |(whole, reduced)| whole - reduced);
                    *measure = measure.map(|x| x + change);
                }
            }
            candidate
        };
        let one = |key: &Key| match key.0 {
            Physics::Reduced => measured(key).map(shifted),
            Physics::Whole => measured(key),
        };
        order.iter().filter_map(one).collect()
    }

    /// Misfit of an entry; `None` if the candidate could not be measured.
    fn misfit(&self, entry: &ArchiveEntry) -> Option<f64> {
        entry.failed.is_none().then(|| misfit(&self.fit.targets, &entry.measures))
    }

    /// Misfit of the spec from which the search started, on a reduced model if there was one.
    fn start_misfit(&self, start: &[f64]) -> Option<f64> {
        let known = self.known.lock();
        let of = |physics: Physics| self.misfit(known.get(&key(physics, start))?);
        of(Physics::Reduced).or_else(|| of(Physics::Whole))
    }

    /// Falls of the minimum misfit, separately for each physics.
    fn history(&self) -> Vec<Fall> {
        let (known, order) = (self.known.lock(), self.order.lock());
        let measured = order.iter().filter_map(|key| Some((key.0, self.misfit(known.get(key)?)?)));
        let mut least = None;
        let fall = |(i, (physics, misfit)): (usize, (Physics, f64))| {
            let fell = least.is_none_or(|(before, least)| before != physics || misfit < least);
            if fell {
                least = Some((physics, misfit));
            }
            fell.then_some(Fall { evaluations: i + 1, misfit, reduced: physics == Physics::Reduced })
        };
        measured.enumerate().filter_map(fall).collect()
    }

    /// Candidate with the minimum misfit of this physics.
    fn best(&self, physics: Physics) -> Option<Candidate> {
        let (known, order) = (self.known.lock(), self.order.lock());
        let of = order.iter().filter(|key| key.0 == physics).filter_map(|key| known.get(key));
        let measured = of.filter_map(|entry| Some((self.misfit(entry)?, entry)));
        measured.min_by(|a, b| a.0.total_cmp(&b.0)).and_then(|(_, entry)| candidate(entry.clone()))
    }

    /// Measures candidates in parallel, and lists them in this order.
    pub(super) fn measure(&self, all: &[Vec<f64>], physics: Physics) -> Result<(), FitError> {
        all.par_iter().try_for_each(|places| self.entry(places, physics).map(|_| ()))?;
        self.order.lock().extend(all.iter().map(|places| key(physics, places)));
        Ok(())
    }

    fn entry(&self, places: &[f64], physics: Physics) -> Result<ArchiveEntry, FitError> {
        let key = key(physics, places);
        // The lock is released before that of the watch is taken, because a checkpoint takes both
        // in the opposite order.
        let known = self.known.lock().get(&key).cloned();
        if let Some(known) = known {
            self.watch.remembered(physics, self.misfit(&known));
            return Ok(known);
        }
        let (measures, failed) = match self.evaluator.measure(places, physics) {
            Ok(measures) => (measures, None),
            Err(FitError::Search { detail }) => (Vec::new(), Some(detail)),
            Err(error) => return Err(error),
        };
        let entry = ArchiveEntry { physics, places: places.to_vec(), measures, failed };
        self.known.lock().insert(key, entry.clone());
        self.watch.measured(physics, self.misfit(&entry), || self.checkpoint());
        Ok(entry)
    }

    /// Number of seeds with which a target is measured.
    pub(super) fn seeds(&self, target: usize) -> usize {
        self.evaluator.seeds(target)
    }

    /// Number of candidates so far.
    pub(super) fn len(&self) -> usize {
        self.order.lock().len()
    }

    /// Number of candidates that could not be measured, and the reason of the last of them.
    fn failures(&self) -> (usize, Option<String>) {
        let (known, order) = (self.known.lock(), self.order.lock());
        let failed: Vec<&String> = order.iter().filter_map(|key| known.get(key)?.failed.as_ref()).collect();
        (failed.len(), failed.last().copied().cloned())
    }
}

fn candidate(entry: ArchiveEntry) -> Option<Candidate> {
    entry.failed.is_none().then_some(Candidate { places: entry.places, measures: entry.measures })
}

/// Converts a coordinate of the optimizer to a place from 0 to 1. Reflection at the bounds replaces
/// bounds in the optimizer.
fn reflected(x: f64) -> f64 {
    let turn = x.rem_euclid(2.0);
    if turn > 1.0 { 2.0 - turn } else { turn }
}

/// Number of candidates of a generation: as CMA-ES recommends, rounded up to an even number, so
/// that two cores have equal work.
pub(super) fn population(variables: usize) -> usize {
    let usual = 4 + (3.0 * (variables as f64).ln()).floor() as usize;
    usual.next_multiple_of(2)
}

/// Measures the candidates to which a linear model of the deviations near the best candidate leads,
/// with a long and a short step.
fn steps(fit: &FitSpec, archive: &Archive<'_>, physics: Physics) -> Result<(), FitError> {
    let Some(best) = archive.best(physics) else { return Ok(()) };
    let model = Linear::around(&best, &archive.candidates(), &fit.targets);
    archive.measure(&REACHES.map(|reach| model.step(reach)), physics)?;
    Ok(())
}

/// Searches on reduced models, then near the best of them with the physics of the spec.
pub(super) fn search(fit: &FitSpec, archive: &Archive<'_>) -> Result<SearchResult, FitError> {
    let start: Vec<f64> = fit.variables.iter().map(super::variable::Variable::start).collect();
    let physics = if fit.refined() > 0 { Physics::Reduced } else { Physics::Whole };
    let explored = explore(fit, archive, &start, physics)?;
    let ended = if physics == Physics::Reduced { refine(fit, archive, &start, explored)? } else { explored };
    let start_misfit = archive.start_misfit(&start);
    let (failed, failure) = archive.failures();
    let Some(best) = archive.best(Physics::Whole) else {
        let detail = failure.unwrap_or_default();
        return Err(FitError::Search { detail: format!("no candidate could be measured: {detail}") });
    };
    let (history, evaluations) = (archive.history(), archive.len() - failed);
    Ok(SearchResult { best, start: start_misfit, history, evaluations, failed, ended })
}

/// Searches until all targets are closely met, the evaluations are used, or the candidates differ
/// too little.
fn explore(fit: &FitSpec, archive: &Archive<'_>, start: &[f64], physics: Physics) -> Result<Ended, FitError> {
    let targets = &fit.targets;
    let population = population(start.len());
    let budget = fit.explored() as usize;
    if budget > 0 {
        archive.measure(&[start.to_vec()], physics)?;
    }
    let asked = Mutex::default();
    let objective =
        |x: &DVector<f64>| archive.ask(&x.iter().map(|&x| reflected(x)).collect::<Vec<_>>(), physics, &asked);
    let options =
        CMAESOptions::new(start.to_vec(), SPREAD).seed(fit.seed).population_size(population).tol_x(LEAST_SPREAD);
    let mut optimizer =
        options.build(objective).map_err(|error| FitError::Search { detail: format!("the optimizer: {error:?}") })?;
    let mut steps_pay = false;
    let (mut best_known, mut since) = (f64::INFINITY, 0);
    loop {
        if archive.watch.cancel().is_cancelled() {
            return Err(FitError::Cancelled);
        }
        let best = archive.best(physics);
        if best.as_ref().is_some_and(|best| best.worst(targets) <= CLOSE) {
            return Ok(Ended::Reached);
        }
        if archive.len() + population > budget {
            return Ok(Ended::Evaluations);
        }
        let before = best.map_or(f64::INFINITY, |best| best.misfit(targets));
        // Takes steps of the linear model while they pay, otherwise a generation of the optimizer.
        if steps_pay {
            steps(fit, archive, physics)?;
        } else {
            let stopped = optimizer.next_parallel();
            archive.list(std::mem::take(&mut *asked.lock()));
            if stopped.is_some() {
                return Ok(Ended::Converged);
            }
        }
        let after = archive.best(physics).map_or(f64::INFINITY, |best| best.misfit(targets));
        steps_pay = !steps_pay || after < PAYS * before;
        // The number of candidates since the last clear fall of the misfit decides the end.
        if after < PAYS * best_known {
            (best_known, since) = (after, archive.len());
        } else if archive.len() - since > PATIENCE * population {
            return Ok(Ended::Converged);
        }
    }
}

/// Measures the best candidate with the physics of the spec, and follows the linear model from
/// there.
fn refine(fit: &FitSpec, archive: &Archive<'_>, start: &[f64], explored: Ended) -> Result<Ended, FitError> {
    let from = archive.best(Physics::Reduced).map_or_else(|| start.to_vec(), |best| best.places);
    let most = archive.len() + fit.refined() as usize;
    archive.measure(&[from], Physics::Whole)?;
    loop {
        if archive.best(Physics::Whole).is_none_or(|best| best.worst(&fit.targets) <= CLOSE) {
            return Ok(Ended::Reached);
        }
        if archive.len() + REACHES.len() > most {
            return Ok(if explored == Ended::Converged { Ended::Converged } else { Ended::Evaluations });
        }
        steps(fit, archive, Physics::Whole)?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_reflected_at_the_bounds() {
        for (x, place) in [(0.3, 0.3), (1.0, 1.0), (1.2, 0.8), (-0.2, 0.2), (2.3, 0.3), (-1.1, 0.9)] {
            assert!((reflected(x) - place).abs() < 1e-12, "{x}");
        }
    }

    #[test]
    fn generations_are_even() {
        assert_eq!([1, 2, 3, 6, 10, 20].map(population), [4, 6, 8, 10, 10, 12]);
    }
}
