//! The values of one parameter: a list, a range or a distribution.

use super::distribution::{Distribution, Normal};
use super::target::Target;
use crate::spec::canonical::number;
use crate::spec::fault::child;
use crate::spec::reader::JsonReader;
use serde_json::{Map, Value};

/// Distributions by their names in JSON, with the members of each.
pub(super) const DISTRIBUTIONS: [(&str, &[&str]); 5] = [
    ("uniform", &["from", "to"]),
    ("log-uniform", &["from", "to"]),
    ("triangular", &["from", "mode", "to"]),
    ("normal", &["mean", "sd", "min", "max"]),
    ("log-normal", &["median", "sd_log", "min", "max"]),
];

/// Source of the values of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Source {
    /// Values listed in the request.
    List(Vec<Value>),
    /// Equal steps between two numbers. A Latin hypercube has no `count`.
    Range { from: f64, to: f64, count: Option<usize>, integer: bool },
    /// Quantiles of a distribution.
    Quantiles { distribution: Distribution, count: Option<usize>, integer: bool },
}

/// Requirements of the design on the values of a parameter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Requirements {
    /// Maximum number of values.
    pub(super) max_values: usize,
    /// True if ranges and distributions must have a `count`, false if they must not.
    pub(super) requires_count: bool,
}

impl Source {
    /// Reads the values for `target`. `at` is the pointer of `value`.
    pub(super) fn read(
        reader: &mut JsonReader,
        at: &str,
        value: &Value,
        target: Target,
        requirements: Requirements,
    ) -> Option<Self> {
        match value {
            Value::Array(items) if (1..=requirements.max_values).contains(&items.len()) => {
                Some(Self::List(items.clone()))
            }
            Value::Array(items) => {
                reader.fault(at, format!("must have 1 to {} values, not {}", requirements.max_values, items.len()))
            }
            Value::Object(_) if !target.is_number() => reader.fault(at, "takes no numbers; give a list of its values"),
            Value::Object(members) => {
                let mut source = SourceReader { reader, at, members, target, requirements };
                match members.get("distribution") {
                    None => source.range(),
                    Some(name) => source.quantiles(name),
                }
            }
            other => {
                let forms = "a list of values, or an object with from and to or with a distribution";
                reader.unexpected(at, forms, other)
            }
        }
    }

    /// True if the request lists the values.
    pub(super) fn is_list(&self) -> bool {
        matches!(self, Self::List(_))
    }

    /// Values in order, for a grid or a zip. A distribution contributes the median of each of
    /// `count` intervals of equal probability.
    pub(super) fn levels(&self) -> Vec<Value> {
        match self {
            Self::List(items) => items.clone(),
            Self::Range { from, to, count, integer } => {
                let count = count.unwrap_or_default();
                let step = |i: usize| i as f64 / (count - 1) as f64;
                // Rounding must not exceed an end.
                let value = |i: usize| if i + 1 == count { *to } else { from + (to - from) * step(i) };
                (0..count).map(|i| whole(value(i), *integer)).collect()
            }
            Self::Quantiles { distribution, count, integer } => {
                let count = count.unwrap_or_default();
                let middle = |i: usize| (i as f64 + 0.5) / count as f64;
                (0..count).map(|i| whole(distribution.quantile(middle(i)), *integer)).collect()
            }
        }
    }

    /// Values at these quantiles, and for each quantile the index of its value.
    pub(super) fn values_at(&self, quantiles: &[f64]) -> (Vec<Value>, Vec<usize>) {
        let each = (0..quantiles.len()).collect();
        match self {
            Self::List(items) => {
                let item = |u: &f64| ((u * items.len() as f64) as usize).min(items.len() - 1);
                (items.clone(), quantiles.iter().map(item).collect())
            }
            Self::Range { from, to, integer, .. } => {
                // Half a unit more on each side makes all integers equally likely, including both
                // ends.
                let wide = if *integer { 0.5 } else { 0.0 };
                let uniform = Distribution::Uniform { from: from - wide, to: to + wide };
                let value = |u: &f64| whole(uniform.quantile(*u), *integer).as_f64().unwrap_or(*from).clamp(*from, *to);
                (quantiles.iter().map(|u| number(value(u))).collect(), each)
            }
            Self::Quantiles { distribution, integer, .. } => {
                (quantiles.iter().map(|u| whole(distribution.quantile(*u), *integer)).collect(), each)
            }
        }
    }
}

/// The number as JSON, rounded if it must be an integer. Quantiles of a very wide distribution may
/// overflow; they become the largest number, which is out of bounds.
fn whole(value: f64, integer: bool) -> Value {
    let value = value.clamp(f64::MIN, f64::MAX);
    number(if integer { value.round() } else { value })
}

/// State of reading a range or a distribution.
struct SourceReader<'a> {
    reader: &'a mut JsonReader,
    at: &'a str,
    members: &'a Map<String, Value>,
    target: Target,
    requirements: Requirements,
}

impl SourceReader<'_> {
    fn range(&mut self) -> Option<Source> {
        let known = self.reader.only(self.at, self.members, &["distribution", "from", "to", "count"]);
        // Both ends are values, so there are at least two.
        let (ends, count) = (self.ends(), self.count(2));
        let ((from, to), count) = (ends?, count?);
        known.then_some(Source::Range { from, to, count, integer: self.target.integer })
    }

    fn quantiles(&mut self, name: &Value) -> Option<Source> {
        let Some((name, own)) = DISTRIBUTIONS.iter().find(|(known, _)| name.as_str() == Some(known)) else {
            let names = DISTRIBUTIONS.map(|(name, _)| name);
            return self.reader.not_a_choice(&child(self.at, "distribution"), name, &names);
        };
        let known = self.reader.only(self.at, self.members, &[&["distribution", "count"], *own].concat());
        let (distribution, count) = (self.distribution(name), self.count(1));
        let (distribution, count) = (distribution?, count?);
        known.then_some(Source::Quantiles { distribution, count, integer: self.target.integer })
    }

    fn distribution(&mut self, name: &str) -> Option<Distribution> {
        match name {
            "uniform" => self.ends().map(|(from, to)| Distribution::Uniform { from, to }),
            "log-uniform" => {
                let (from, to) = self.ends()?;
                self.require(from > 0.0, "from", || format!("is {from}; it must be above 0 for a logarithm"))?;
                Some(Distribution::LogUniform { from, to })
            }
            "triangular" => {
                let mode = self.bounded("mode");
                let (from, to) = self.ends()?;
                let mode = mode?;
                self.require((from..=to).contains(&mode), "mode", || {
                    format!("is {mode}; it must be from {from} to {to}")
                })?;
                Some(Distribution::Triangular { from, mode, to })
            }
            "normal" => {
                let (mean, sd) = (self.required("mean"), self.positive("sd"));
                let [min, max] = self.truncation();
                let normal = Normal { mean: mean?, sd: sd?, min: min?, max: max? };
                self.check_mass(normal).map(Distribution::Normal)
            }
            _ => {
                let (median, sd) = (self.positive("median"), self.positive("sd_log"));
                let [min, max] = self.truncation();
                let log = |end: f64| if end > 0.0 { libm::log(end) } else { f64::NEG_INFINITY };
                let normal = Normal { mean: libm::log(median?), sd: sd?, min: log(min?), max: log(max?) };
                self.check_mass(normal).map(Distribution::LogNormal)
            }
        }
    }

    /// Reads the members `from` and `to`.
    fn ends(&mut self) -> Option<(f64, f64)> {
        let (from, to) = (self.bounded("from"), self.bounded("to"));
        let (from, to) = (from?, to?);
        self.require(from < to, "to", || format!("is {to}; it must be above from, which is {from}"))?;
        Some((from, to))
    }

    fn require(&mut self, ok: bool, name: &str, detail: impl FnOnce() -> String) -> Option<()> {
        if ok { Some(()) } else { self.reader.fault(child(self.at, name), detail()) }
    }

    fn required(&mut self, name: &str) -> Option<f64> {
        let at = child(self.at, name);
        match self.members.get(name) {
            Some(value) => self.reader.number(&at, value),
            None => self.reader.fault(at, "is missing"),
        }
    }

    fn positive(&mut self, name: &str) -> Option<f64> {
        let value = self.required(name)?;
        self.require(value > 0.0, name, || format!("is {value}; it must be above 0"))?;
        Some(value)
    }

    /// Reads a number that is valid for the parameter.
    fn bounded(&mut self, name: &str) -> Option<f64> {
        let value = self.required(name)?;
        if let Some(detail) = self.target.refuses(value) {
            return self.reader.fault(child(self.at, name), detail);
        }
        self.require(!self.target.integer || value.fract() == 0.0, name, || {
            format!("is {value}; it must be an integer")
        })?;
        Some(value)
    }

    /// Reads the members `min` and `max`; infinite if absent.
    fn truncation(&mut self) -> [Option<f64>; 2] {
        let (min, max) = (f64::NEG_INFINITY, f64::INFINITY);
        [("min", min), ("max", max)]
            .map(|(name, none)| if self.members.contains_key(name) { self.bounded(name) } else { Some(none) })
    }

    fn check_mass(&mut self, normal: Normal) -> Option<Normal> {
        self.require(normal.min < normal.max, "max", || "must be above min".to_owned())?;
        let end = if self.members.contains_key("min") { "min" } else { "max" };
        self.require(normal.has_mass(), end, || {
            "leaves less than a millionth of the distribution; choose a wider interval".to_owned()
        })?;
        Some(normal)
    }

    /// Reads the member `count`, at least `least`. Returns `Some(None)` if it is absent and not
    /// required.
    fn count(&mut self, least: usize) -> Option<Option<usize>> {
        let at = child(self.at, "count");
        match self.members.get("count") {
            None if self.requirements.requires_count => self.reader.fault(at, "is missing; give the number of values"),
            None => Some(None),
            Some(_) if !self.requirements.requires_count => {
                self.reader.fault(at, "is not valid in the design lhs; use samples")
            }
            Some(value) => self.reader.integer(&at, value, least..=self.requirements.max_values).map(Some),
        }
    }
}
