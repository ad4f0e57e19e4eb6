//! Result of a fit: the spec, its distance from each target, and models of it that are grown in
//! full.

use super::limits::Unmet;
use super::search::{Ended, Fall};
use super::target::Target;
use crate::spec::End;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The result of a fit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct FitResult {
    /// Preset that the spec was resolved on.
    pub preset: String,
    /// The complete spec, as a request for a model takes it.
    #[cfg_attr(feature = "schema", schema(value_type = crate::spec::ModelSpec))]
    pub spec: Value,
    /// The parameters that were varied, with their values.
    pub parameters: Vec<Fitted>,
    /// The targets, with what the spec gives.
    pub targets: Vec<Reached>,
    /// Targets that the search did not meet, and why.
    pub unmet: Vec<Unmet>,
    /// The search.
    pub search: Searched,
    /// Models of the spec, each grown in full with a seed that the search did not use.
    pub models: Vec<Grown>,
}

/// The value of a parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Fitted {
    /// JSON pointer of the parameter.
    pub parameter: String,
    /// End of the tube whose values are changed; null: the parameter as a whole.
    pub end: Option<End>,
    /// Unit; empty if there is none.
    pub unit: String,
    /// Value that the search started from.
    pub start: f64,
    /// Its value; of a schedule, at that end of the tube, or at the ampulla end.
    pub value: f64,
    /// Lower bound.
    pub from: f64,
    /// Upper bound.
    pub to: f64,
}

/// A target and what the spec gives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Reached {
    /// The target.
    #[serde(flatten)]
    pub target: Target,
    /// Mean over the seeds of the search.
    pub measured: Option<f64>,
    /// Number of these seeds: more than `seeds` for measures that cost little.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    #[serde(default)]
    pub seeds: usize,
    /// Distance from the value, in distances from the value to the end of the range on that side.
    pub deviation: f64,
    /// Whether it is within the range.
    pub met: bool,
    /// Mean over the models; null if none has it.
    pub models_mean: Option<f64>,
    /// Standard deviation between the models: the spread over seeds; null if fewer than two have it.
    pub models_sd: Option<f64>,
    /// Number of models within the range.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub models_met: usize,
}

/// The search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Searched {
    /// Why it ended.
    pub ended: Ended,
    /// Seeds of every candidate; those of measures that cost little begin with them.
    pub seeds: Vec<u64>,
    /// Candidates that were measured.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub evaluations: usize,
    /// Candidates that could not be measured.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub failed: usize,
    /// Misfit of the spec that the search started from.
    pub start_misfit: Option<f64>,
    /// Misfit of the result: the mean over the targets of (d² + d⁴)/2 of their deviations d.
    pub misfit: f64,
    /// Where the least misfit fell: on reduced models, and then with the physics of the spec.
    pub history: Vec<Fall>,
}

/// A model of the result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Grown {
    /// Seed.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub seed: u64,
    /// Whether it passed its certificate.
    pub certified: bool,
    /// Its measures, in the order of the targets.
    pub measures: Vec<Option<f64>>,
    /// Why there is no model.
    pub failure: Option<String>,
}
