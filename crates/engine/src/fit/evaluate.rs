//! Measures of a candidate: only the simulation runs, up to the last region with a target, and as
//! many of its sections are measured as the means over the regions need. No surface is lofted. The
//! search uses Euler steps; its last candidates use the integrator of the spec.

use super::error::FitError;
use super::request::{EARLY_SEEDS, FitSpec, Physics};
use super::target::{Target, loss};
use super::watch::FitSink;
use crate::generate::CancelToken;
use crate::measure::morphometry::{Morphometry, Regions, morphometry};
use crate::model::Section;
use crate::sim::Plan;
use crate::sim::cpu::CpuSimulation;
use crate::spec::ModelSpec;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Number of sections that are measured in a region.
const SECTIONS: usize = 12;

/// Maximum cost of early measures, as a fraction of the cost of a whole simulation in particles
/// times steps. Early measures are the mean over [`EARLY_SEEDS`] times the seeds: the isthmus is
/// simulated first, with few particles, and differs most between seeds.
const EARLY: f64 = 0.125;

/// A candidate: its place between the bounds of each variable, and the measures of its models.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Candidate {
    pub(super) places: Vec<f64>,
    /// Mean over the seeds, by target; `None` if it could not be measured.
    pub(super) measures: Vec<Option<f64>>,
}

impl Candidate {
    /// Mean loss over the targets.
    pub(super) fn misfit(&self, targets: &[Target]) -> f64 {
        misfit(targets, &self.measures)
    }

    /// Maximum deviation.
    pub(super) fn worst(&self, targets: &[Target]) -> f64 {
        let deviations = targets.iter().zip(&self.measures).map(|(target, measured)| target.deviation(*measured).abs());
        deviations.fold(0.0, f64::max)
    }
}

/// Mean loss of measures over the targets.
pub(super) fn misfit(targets: &[Target], measures: &[Option<f64>]) -> f64 {
    let losses = targets.iter().zip(measures).map(|(target, measured)| loss(target.deviation(*measured)));
    losses.sum::<f64>() / targets.len() as f64
}

/// Measures candidates.
pub(super) struct Evaluator<'a> {
    fit: &'a FitSpec,
    sink: &'a dyn FitSink,
    cancel: &'a CancelToken,
    /// Seeds, with the targets that are measured with each. They are the same for every candidate,
    /// so differences come from the parameters (common random numbers).
    seeds: Vec<(u64, Vec<usize>)>,
}

impl<'a> Evaluator<'a> {
    pub(super) fn new(fit: &'a FitSpec, sink: &'a dyn FitSink, cancel: &'a CancelToken) -> Self {
        let early: Vec<bool> = fit.targets.iter().map(|target| is_early(&fit.start, target)).collect();
        let of = |k: u32| (0..early.len()).filter(|&t| k < fit.seeds || early[t]).collect();
        let seeds = (0..EARLY_SEEDS * fit.seeds).map(|k| (fit.seed + u64::from(k), of(k)));
        Self {
            fit,
            sink,
            cancel,
            seeds: seeds.filter(|(_, targets): &(u64, Vec<usize>)| !targets.is_empty()).collect(),
        }
    }

    /// Number of seeds with which a target is measured.
    pub(super) fn seeds(&self, target: usize) -> usize {
        self.seeds.iter().filter(|(_, targets)| targets.contains(&target)).count()
    }

    /// Measures a candidate, its seeds in parallel.
    pub(super) fn measure(&self, places: &[f64], physics: Physics) -> Result<Vec<Option<f64>>, FitError> {
        let spec = self.fit.at(places).map_err(|faults| {
            let detail = faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
            FitError::Search { detail }
        })?;
        let spec = if physics == Physics::Reduced { self.fit.reduced(spec) } else { spec };
        let one = |(seed, targets): &(u64, Vec<usize>)| self.one(&spec, *seed, targets);
        let of_seeds: Vec<Vec<Option<f64>>> = self.seeds.par_iter().map(one).collect::<Result<_, _>>()?;
        let mean = |k: usize| {
            let known: Vec<f64> = of_seeds.iter().filter_map(|measures| measures[k]).collect();
            (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
        };
        Ok((0..self.fit.targets.len()).map(mean).collect())
    }

    /// Measures some of the targets with one seed.
    fn one(&self, spec: &ModelSpec, seed: u64, targets: &[usize]) -> Result<Vec<Option<f64>>, FitError> {
        let stations = targets.iter().flat_map(|&t| stations(spec, &self.fit.targets[t])).collect();
        let morphometry = self.measured(spec, seed, &stations)?;
        let all = self.fit.targets.iter().enumerate();
        Ok(all.map(|(t, target)| target.measured(&morphometry).filter(|_| targets.contains(&t))).collect())
    }

    /// Grows the sections at these steps and measures them.
    fn measured(&self, spec: &ModelSpec, seed: u64, stations: &BTreeSet<u32>) -> Result<Morphometry, FitError> {
        // Candidates are measured in parallel, each on one thread.
        let mut simulation = CpuSimulation::new(Plan::new(spec, seed), 1);
        let mut sections: Vec<Section> = Vec::with_capacity(stations.len());
        let last = stations.last().map_or(0, |&step| i64::from(step));
        loop {
            let time = simulation.time();
            if u32::try_from(time).is_ok_and(|step| stations.contains(&step)) {
                sections.push(simulation.section());
            }
            if time >= last {
                break;
            }
            self.sink.pause(self.cancel);
            if self.cancel.is_cancelled() {
                return Err(FitError::Cancelled);
            }
            simulation.step().map_err(|error| FitError::Search { detail: error.to_string() })?;
        }
        let junction = [spec.regions.junction_from, spec.regions.junction_to];
        let regions = Regions { length_mm: spec.length_mm, junction, piece: [0.0, 1.0] };
        Ok(morphometry(&sections, &[], &regions, None))
    }
}

/// True if the sections of a target are simulated in a small part of the time of a whole model.
fn is_early(spec: &ModelSpec, target: &Target) -> bool {
    let last = stations(spec, target).last().copied().unwrap_or(spec.steps);
    let particles = |step: u32| spec.particles.total.at(f64::from(step) / f64::from(spec.steps));
    let until = |last: u32| f64::from(spec.burn_in) * particles(0) + (0..last).map(particles).sum::<f64>();
    until(last) <= EARLY * until(spec.steps)
}

/// Steps whose sections are measured for a target.
fn stations(spec: &ModelSpec, target: &Target) -> Vec<u32> {
    let all = spec.stations().map(|step| (step, spec.z.at(f64::from(step) / f64::from(spec.steps))));
    let [from, to] = [spec.regions.junction_from, spec.regions.junction_to];
    let [low, high] = match target.region.as_str() {
        "isthmus" => [0.0, from],
        "junction" => [from, to],
        "ampulla" => [to, 1.0],
        _ => [0.0, 1.0],
    };
    let last = high >= 1.0;
    let within: Vec<u32> = all.filter(|(_, z)| *z >= low && (*z < high || last)).map(|(step, _)| step).collect();
    let most = match target.region.as_str() {
        _ if target.needs_all_sections() => within.len(),
        "whole" | "tube" => 3 * SECTIONS,
        _ => SECTIONS,
    };
    spread(&within, most).collect()
}

/// At most `most` of the steps, evenly spread, including the first and the last.
fn spread(steps: &[u32], most: usize) -> impl Iterator<Item = u32> + '_ {
    let count = steps.len().min(most);
    (0..count).map(move |i| if count == 1 { steps[0] } else { steps[i * (steps.len() - 1) / (count - 1)] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::preset;
    use serde_json::json;

    fn target(region: &str, quantity: &str) -> Target {
        Target { region: region.into(), quantity: quantity.into(), value: 1.0, low: 0.9, high: 1.1, source: None }
    }

    #[test]
    fn sections_are_those_that_the_targets_need() {
        let spec = ModelSpec::resolve(preset("pig").unwrap(), &json!({})).unwrap();
        let of = |region, quantity| stations(&spec, &target(region, quantity));
        let isthmus = of("isthmus", "fill");
        assert_eq!((isthmus.len(), isthmus.first()), (SECTIONS, Some(&0)));
        assert!(isthmus.last().is_some_and(|&step| step < 425), "{isthmus:?}");
        let ampulla = of("ampulla", "fill");
        assert!(ampulla.first().is_some_and(|&step| step > 425) && ampulla.last() == Some(&2000), "{ampulla:?}");
        assert_eq!(of("tube", "lumen_volume_mm3").len(), 3 * SECTIONS);
        assert_eq!(of("whole", "fold_continuity").len(), 201);
    }

    #[test]
    fn the_isthmus_is_measured_with_more_seeds() {
        let target = |region: &str| json!({ "region": region, "quantity": "fill", "value": 0.7 });
        let seeds = |region: &str| {
            let body = json!({ "targets": [target(region), target("ampulla")], "seeds": 3, "seed": 20 });
            let fit = FitSpec::read(&body, Vec::new(), &[]).unwrap();
            let cancel = CancelToken::default();
            let evaluator = Evaluator::new(&fit, &(), &cancel);
            assert_eq!(evaluator.seeds(1), 3);
            let seeds: Vec<u64> = evaluator.seeds.iter().map(|(seed, _)| *seed).collect();
            assert!(seeds.is_sorted() && seeds[0] == 20 && fit.model_seeds().all(|seed| !seeds.contains(&seed)));
            (evaluator.seeds(0), seeds.len())
        };
        assert_eq!(["isthmus", "junction", "whole"].map(seeds), [(12, 12), (3, 3), (3, 3)]);
    }

    #[test]
    fn a_few_of_many_are_spread() {
        let steps: Vec<u32> = (0..=100).collect();
        assert_eq!(spread(&steps, 5).collect::<Vec<_>>(), [0, 25, 50, 75, 100]);
        assert_eq!(spread(&steps[..3], 5).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(spread(&steps[..1], 5).count() + spread(&[], 5).count(), 1);
    }
}
