//! The values that one parameter takes: a list, a range or a distribution.

use super::distribution::{Distribution, Normal};
use super::target::Target;
use crate::spec::canonical::number;
use crate::spec::fault::{child, describe};
use crate::spec::reader::Reader;
use serde_json::{Map, Value};

/// The distributions by their names in JSON, and the members of each.
pub(super) const DISTRIBUTIONS: [(&str, &[&str]); 5] = [
    ("uniform", &["from", "to"]),
    ("log-uniform", &["from", "to"]),
    ("triangular", &["from", "mode", "to"]),
    ("normal", &["mean", "sd", "min", "max"]),
    ("log-normal", &["median", "sd_log", "min", "max"]),
];

/// Where the values of a parameter come from.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Source {
    /// These values.
    List(Vec<Value>),
    /// Equal steps from one number to another; `count` is absent in a Latin hypercube.
    Range { from: f64, to: f64, count: Option<usize>, integer: bool },
    /// Quantiles of a distribution.
    Drawn { distribution: Distribution, count: Option<usize>, integer: bool },
}

/// What the values are needed for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Need {
    /// Greatest number of values.
    pub(super) most: usize,
    /// Whether ranges and distributions must tell how many values they give. If not, they must not tell.
    pub(super) counted: bool,
}

impl Source {
    /// Reads the values for `target`; `at` is the pointer of `value`.
    pub(super) fn read(reader: &mut Reader, at: &str, value: &Value, target: Target, need: Need) -> Option<Self> {
        match value {
            Value::Array(items) if (1..=need.most).contains(&items.len()) => Some(Self::List(items.clone())),
            Value::Array(items) => {
                reader.fault(at, format!("must have 1 to {} values, not {}", need.most, items.len()))
            }
            Value::Object(_) if !target.is_number() => reader.fault(at, "takes no numbers; give a list of its values"),
            Value::Object(members) => {
                let mut form = Form { reader, at, members, target, need };
                match members.get("distribution") {
                    None => form.range(),
                    Some(name) => form.drawn(name),
                }
            }
            other => {
                let forms = "must be a list of values, or an object with from and to or with a distribution";
                reader.fault(at, format!("{forms}, not {}", describe(other)))
            }
        }
    }

    /// Whether its values stand in the request.
    pub(super) fn is_list(&self) -> bool {
        matches!(self, Self::List(_))
    }

    /// Its values in order, for a grid or a zip. Those of a distribution are its quantiles in the middle of parts of equal
    /// probability.
    #[expect(clippy::cast_precision_loss, reason = "a batch has fewer than 2^53 models")]
    pub(super) fn levels(&self) -> Vec<Value> {
        match self {
            Self::List(items) => items.clone(),
            Self::Range { from, to, count, integer } => {
                let count = count.unwrap_or_default();
                let step = |i: usize| i as f64 / (count - 1) as f64;
                // Rounding must not lead beyond an end.
                let value = |i: usize| if i + 1 == count { *to } else { from + (to - from) * step(i) };
                (0..count).map(|i| whole(value(i), *integer)).collect()
            }
            Self::Drawn { distribution, count, integer } => {
                let count = count.unwrap_or_default();
                let middle = |i: usize| (i as f64 + 0.5) / count as f64;
                (0..count).map(|i| whole(distribution.quantile(middle(i)), *integer)).collect()
            }
        }
    }

    /// Its values at these quantiles, and which of them each quantile has.
    pub(super) fn at(&self, quantiles: &[f64]) -> (Vec<Value>, Vec<usize>) {
        let each = (0..quantiles.len()).collect();
        match self {
            Self::List(items) => {
                #[expect(
                    clippy::cast_precision_loss,
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "an index of a list"
                )]
                let item = |u: &f64| ((u * items.len() as f64) as usize).min(items.len() - 1);
                (items.clone(), quantiles.iter().map(item).collect())
            }
            Self::Range { from, to, integer, .. } => {
                // Each integer is equally likely, the two ends too.
                let wide = if *integer { 0.5 } else { 0.0 };
                let uniform = Distribution::Uniform { from: from - wide, to: to + wide };
                let value = |u: &f64| whole(uniform.quantile(*u), *integer).as_f64().unwrap_or(*from).clamp(*from, *to);
                (quantiles.iter().map(|u| number(value(u))).collect(), each)
            }
            Self::Drawn { distribution, integer, .. } => {
                (quantiles.iter().map(|u| whole(distribution.quantile(*u), *integer)).collect(), each)
            }
        }
    }
}

/// The number as JSON, rounded if it must be an integer. A distribution may be so wide that its quantiles overflow; the
/// greatest number is then refused by the parameter.
fn whole(value: f64, integer: bool) -> Value {
    let value = value.clamp(f64::MIN, f64::MAX);
    number(if integer { value.round() } else { value })
}

/// A range or a distribution that is being read.
struct Form<'a> {
    reader: &'a mut Reader,
    at: &'a str,
    members: &'a Map<String, Value>,
    target: Target,
    need: Need,
}

impl Form<'_> {
    fn range(&mut self) -> Option<Source> {
        let known = self.reader.only(self.at, self.members, &["distribution", "from", "to", "count"]);
        // Both ends are values, so there are at least two.
        let (ends, count) = (self.ends(), self.count(2));
        let ((from, to), count) = (ends?, count?);
        known.then_some(Source::Range { from, to, count, integer: self.target.integer })
    }

    fn drawn(&mut self, name: &Value) -> Option<Source> {
        let Some((name, own)) = DISTRIBUTIONS.iter().find(|(known, _)| name.as_str() == Some(known)) else {
            let names = DISTRIBUTIONS.map(|(name, _)| name);
            return self.reader.not_a_choice_of(&child(self.at, "distribution"), name, &names);
        };
        let known = self.reader.only(self.at, self.members, &[&["distribution", "count"], *own].concat());
        let (distribution, count) = (self.distribution(name), self.count(1));
        let (distribution, count) = (distribution?, count?);
        known.then_some(Source::Drawn { distribution, count, integer: self.target.integer })
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
                self.enough(normal).map(Distribution::Normal)
            }
            _ => {
                let (median, sd) = (self.positive("median"), self.positive("sd_log"));
                let [min, max] = self.truncation();
                let log = |end: f64| if end > 0.0 { libm::log(end) } else { f64::NEG_INFINITY };
                let normal = Normal { mean: libm::log(median?), sd: sd?, min: log(min?), max: log(max?) };
                self.enough(normal).map(Distribution::LogNormal)
            }
        }
    }

    /// The members `from` and `to`.
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

    /// A value that the parameter takes.
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

    /// The members `min` and `max`; infinite if they are absent.
    fn truncation(&mut self) -> [Option<f64>; 2] {
        let (min, max) = (f64::NEG_INFINITY, f64::INFINITY);
        [("min", min), ("max", max)]
            .map(|(name, none)| if self.members.contains_key(name) { self.bounded(name) } else { Some(none) })
    }

    fn enough(&mut self, normal: Normal) -> Option<Normal> {
        self.require(normal.min < normal.max, "max", || "must be above min".to_owned())?;
        let end = if self.members.contains_key("min") { "min" } else { "max" };
        self.require(normal.has_mass(), end, || "leaves almost nothing of the distribution".to_owned())?;
        Some(normal)
    }

    /// The member `count`, at least `least`; `Some(None)` if it is absent and not needed.
    fn count(&mut self, least: usize) -> Option<Option<usize>> {
        let at = child(self.at, "count");
        match self.members.get("count") {
            None if self.need.counted => self.reader.fault(at, "is missing; it says how many values there are"),
            None => Some(None),
            Some(_) if !self.need.counted => {
                self.reader.fault(at, "does not belong to a Latin hypercube, which has samples")
            }
            Some(value) => self.reader.size(&at, value, least, self.need.most).map(Some),
        }
    }
}
