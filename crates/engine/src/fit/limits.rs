//! Targets that a search did not meet: out of reach, or not together with others; and the bounds
//! that prevent it.

use super::error::FitError;
use super::evaluate::Candidate;
use super::linear::Linear;
use super::request::{FitSpec, Physics};
use super::search::Archive;
use super::target::Target;
use crate::spec::End;
use serde::{Deserialize, Serialize};

/// Maximum distance of a variable from its bound, as a fraction of the distance of both bounds, at
/// which it counts as at the bound.
const AT_BOUND: f64 = 0.02;
/// Minimum change of a deviation between both bounds of a variable for which the variable counts.
const MIN_SLOPE: f64 = 0.5;
/// Alternative minimum for targets far away, whose range is large compared with the measure: change
/// of the measure as a fraction of it.
const MIN_CHANGE: f64 = 0.05;
/// Maximum number of targets for which corners are tried.
const MAX_CORNER_TARGETS: usize = 10;

/// Reason why a target is not met.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Why {
    /// No candidate met it, also not where all variables were at the bounds that favour it.
    OutOfReach,
    /// No variable changes it noticeably.
    Insensitive,
    /// Candidates met it, but none of them met the others too.
    Conflict,
}

/// A target that is not met.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Unmet {
    /// Region of the target.
    pub region: String,
    /// Quantity of the target.
    pub quantity: String,
    /// Reason why the target is not met.
    pub why: Why,
    /// Closest value to the target among all candidates.
    pub nearest: Option<f64>,
    /// Targets that cannot be met together with this one, as `region/quantity`.
    pub conflicts: Vec<String>,
    /// Bounds beyond which the measure would come closer to the target.
    pub bounds: Vec<Bound>,
}

/// A bound of a variable.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Bound {
    /// JSON pointer of the parameter.
    pub parameter: String,
    /// End of the tube at which the variable acts; null if it acts everywhere.
    pub end: Option<End>,
    /// Name of the bound: `from` or `to`.
    pub bound: String,
    /// Value of the bound.
    pub value: f64,
}

/// Targets that `best` does not meet, with reasons. For each of them, tries the corner of the
/// bounds that favours it.
pub(super) fn unmet(fit: &FitSpec, archive: &Archive<'_>, best: &Candidate) -> Result<Vec<Unmet>, FitError> {
    let targets = &fit.targets;
    let missed: Vec<usize> = (0..targets.len()).filter(|&t| !targets[t].is_met(best.measures[t])).collect();
    if missed.is_empty() {
        return Ok(Vec::new());
    }
    let before = archive.candidates();
    let model = Linear::around(best, &before, targets);
    let corner = |&t: &usize| model.corner(t, least_slope(&targets[t], best.measures[t]));
    let corners: Vec<Vec<f64>> = missed.iter().take(MAX_CORNER_TARGETS).map(corner).collect();
    archive.measure(&corners, Physics::Whole)?;
    let all = archive.candidates();
    Ok(missed.into_iter().map(|t| unmet_target(fit, &model, best, &all, t)).collect())
}

fn unmet_target(fit: &FitSpec, model: &Linear, best: &Candidate, all: &[Candidate], t: usize) -> Unmet {
    let target = &fit.targets[t];
    let meets = |candidate: &Candidate, t: usize| fit.targets[t].is_met(candidate.measures[t]);
    let distance = |candidate: &Candidate| target.deviation(candidate.measures[t]).abs();
    let nearest = all.iter().filter(|c| c.measures[t].is_some()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
    let least = least_slope(target, best.measures[t]);
    // With fewer other candidates than variables, the slopes may be unknown.
    let known = all.iter().filter(|candidate| candidate.places != best.places).count() >= fit.variables.len();
    let sensitive = !known || model.slopes[t].iter().any(|slope| slope.abs() >= least);
    let met: Vec<&Candidate> = all.iter().filter(|candidate| meets(candidate, t)).collect();
    let (why, at) = match (met.is_empty(), sensitive) {
        (false, _) => (Why::Conflict, Some(best)),
        (true, true) => (Why::OutOfReach, nearest),
        (true, false) => (Why::Insensitive, None),
    };
    let mut conflicts = Vec::new();
    if why == Why::Conflict {
        let others = (0..fit.targets.len()).filter(|&s| s != t && all.iter().any(|candidate| meets(candidate, s)));
        let never: Vec<usize> = others.filter(|&s| !met.iter().any(|candidate| meets(candidate, s))).collect();
        // If each other target is met by one of the candidates, the conflicts are the targets that
        // the best of these candidates misses.
        let misfit = |candidate: &&&Candidate| candidate.misfit(&fit.targets);
        let least = met.iter().min_by(|a, b| misfit(a).total_cmp(&misfit(b)));
        let together = || {
            let missed = |s: &usize| *s != t && least.is_some_and(|candidate| !meets(candidate, *s));
            (0..fit.targets.len()).filter(missed).collect()
        };
        let against: Vec<usize> = if never.is_empty() { together() } else { never };
        conflicts = against.into_iter().map(|s| fit.targets[s].name()).collect();
    }
    let bounds = at.map_or_else(Vec::new, |at| bounds(fit, model, at, t));
    let (region, quantity) = (target.region.clone(), target.quantity.clone());
    Unmet { region, quantity, why, nearest: nearest.and_then(|candidate| candidate.measures[t]), conflicts, bounds }
}

/// Minimum slope for which a variable counts.
fn least_slope(target: &Target, measured: Option<f64>) -> f64 {
    let changed = measured.filter(|&x| x != 0.0).map(|x| (1.0 + MIN_CHANGE) * x);
    let change = changed.map(|changed| target.deviation(Some(changed)) - target.deviation(measured));
    change.map_or(MIN_SLOPE, |change| change.abs().min(MIN_SLOPE))
}

/// Bounds at which a candidate lies and beyond which the target would come nearer.
fn bounds(fit: &FitSpec, model: &Linear, at: &Candidate, t: usize) -> Vec<Bound> {
    let towards = -fit.targets[t].deviation(at.measures[t]);
    let least = least_slope(&fit.targets[t], at.measures[t]);
    let variables = fit.variables.iter().zip(&at.places).zip(&model.slopes[t]);
    variables
        .filter(|(_, slope)| slope.abs() >= least)
        .filter_map(|((variable, &place), slope)| {
            let (bound, value) = match slope * towards > 0.0 {
                true if place >= 1.0 - AT_BOUND => ("to", variable.to),
                false if place <= AT_BOUND => ("from", variable.from),
                _ => return None,
            };
            let (parameter, end) = (variable.lever.pointer.clone(), variable.end);
            Some(Bound { parameter, end, bound: bound.into(), value })
        })
        .collect()
}
