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
    /// The complete spec, in the form that a request for a model has.
    #[cfg_attr(feature = "schema", schema(value_type = crate::spec::ModelSpec))]
    pub spec: Value,
    /// Varied parameters with their values.
    pub parameters: Vec<Fitted>,
    /// Targets, each with the values that the spec reaches.
    pub targets: Vec<Reached>,
    /// Targets that the search did not meet, with the reasons.
    pub unmet: Vec<Unmet>,
    /// Statistics of the search.
    pub search: Searched,
    /// Models of the spec, each grown in full with a seed that the search did not use.
    pub models: Vec<Grown>,
}

/// Result for one parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Fitted {
    /// JSON pointer of the parameter.
    pub parameter: String,
    /// End of the tube at which the parameter is varied; null if it is varied as a whole.
    pub end: Option<End>,
    /// Unit; empty if there is none.
    pub unit: String,
    /// Value that the search started from.
    pub start: f64,
    /// Value in the result. For a schedule, the value at `end`, or at the ampulla end if `end` is
    /// null.
    pub value: f64,
    /// Lower bound.
    pub from: f64,
    /// Upper bound.
    pub to: f64,
}

/// A target, with the values that the spec reaches.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Reached {
    /// The target.
    #[serde(flatten)]
    pub target: Target,
    /// Mean over the seeds of the search.
    pub measured: Option<f64>,
    /// Number of these seeds. For inexpensive measures, it is larger than `seeds`.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    #[serde(default)]
    pub seeds: usize,
    /// Deviation of the measure from the value, in units of the distance from the value to the end
    /// of the range on the same side.
    pub deviation: f64,
    /// True if the measure is within the range.
    pub met: bool,
    /// Mean over the models; null if no model has the measure.
    pub models_mean: Option<f64>,
    /// Standard deviation between the models, which is the spread over seeds; null if fewer than
    /// two models have the measure.
    pub models_sd: Option<f64>,
    /// Number of models within the range.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub models_met: usize,
}

/// Statistics of the search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Searched {
    /// Reason why the search ended.
    pub ended: Ended,
    /// Seeds of every candidate. Inexpensive measures use further seeds in addition.
    pub seeds: Vec<u64>,
    /// Number of candidates that were measured.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub evaluations: usize,
    /// Number of candidates that could not be measured.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub failed: usize,
    /// Misfit of the spec that the search started from.
    pub start_misfit: Option<f64>,
    /// Misfit of the result: the mean over the targets of (d² + d⁴)/2, where d is the deviation of
    /// a target. This term grows linearly above a deviation of 3.
    pub misfit: f64,
    /// Improvements of the minimum misfit: first on reduced models, then with the physics of the
    /// spec.
    pub history: Vec<Fall>,
}

/// A model that was grown from the result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Grown {
    /// Seed.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub seed: u64,
    /// True if the model passed its certificate.
    pub certified: bool,
    /// Measures of the model, in the order of the targets.
    pub measures: Vec<Option<f64>>,
    /// Reason why there is no model; null if there is one.
    pub failure: Option<String>,
}
