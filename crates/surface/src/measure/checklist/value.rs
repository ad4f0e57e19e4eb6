//! Value of an expression for a model, or the reason why it has none.

use super::expression::{Expression, Operator, Place};
use crate::measure::morphometry::{Morphometry, Quantity};
use std::collections::BTreeMap;

/// Model that is judged: its measures, and facts that measures of sections lack.
#[derive(Clone, Copy)]
pub struct Judged<'a> {
    /// Measures of the model.
    pub morphometry: &'a Morphometry,
    /// Organ.
    pub organ: &'a str,
    /// Species.
    pub species: &'a str,
    /// Name of the preset that the model is based on.
    pub preset: &'a str,
    /// Length of the whole tube, of which the model may be a piece, mm.
    pub length_mm: f64,
    /// Reason why the preset is shorter than the organ; `None` if it is not.
    pub shortened: Option<&'a str>,
    /// Further measures of the whole tube, by name.
    pub tube: &'a BTreeMap<&'static str, f64>,
    /// Number at a JSON pointer of the specification of the model (`None`) or of a preset: that of
    /// the model if it is based on this preset. The number of a schedule is its mean.
    pub parameter: &'a dyn Fn(Option<&str>, &str) -> Option<f64>,
}

/// Minimum part of a range of the tube that sections with a value must span.
const LEAST_SPAN: f64 = 0.5;
/// Beginning of the names of quantities that are 0 in a section without folds.
const HEIGHTS: &str = "fold_height_";
/// Variation of heights, which does not exist without folds.
const VARIATION: &str = "fold_height_cv";

impl Judged<'_> {
    /// Value of the expression; the error says what is missing.
    pub(super) fn value(&self, expression: &Expression) -> Result<f64, String> {
        match expression {
            Expression::Number(number) => Ok(*number),
            Expression::At(quantity, Place::Region(region)) => self.in_region(quantity, region),
            Expression::At(quantity, Place::Parts(parts)) => self.between(quantity, *parts),
            Expression::Tube(name) => {
                let further = || self.tube.get(name.as_str()).copied();
                let measured = self.morphometry.mean(name, "tube").or_else(further);
                measured.ok_or_else(|| format!("`{name}` of the tube is not measured"))
            }
            Expression::Parameter(preset, pointer) => (self.parameter)(preset.as_deref(), pointer).ok_or_else(|| {
                let of = preset.as_deref().map_or_else(String::new, |name| format!(" of the preset `{name}`"));
                format!("the specification{of} has no number at `{pointer}`")
            }),
            Expression::Binary(a, operator, b) => {
                let (a, b) = (self.value(a)?, self.value(b)?);
                let value = match operator {
                    Operator::Add => a + b,
                    Operator::Subtract => a - b,
                    Operator::Multiply => a * b,
                    Operator::Divide => a / b,
                };
                if value.is_finite() { Ok(value) } else { Err(format!("{a} cannot be divided by {b}")) }
            }
            Expression::Falling(all) => {
                let all = all.iter().map(|one| self.value(one)).collect::<Result<Vec<_>, _>>()?;
                Ok(all.windows(2).map(|pair| relative_fall(pair[0], pair[1])).fold(f64::INFINITY, f64::min))
            }
            Expression::LeastAt(quantity, parts) => {
                let count = f64::from(*parts);
                let range = |k: u32| [f64::from(k) / count, f64::from(k + 1) / count];
                let means = (0..*parts).map(|k| self.between(quantity, range(k))).collect::<Result<Vec<_>, _>>()?;
                let least = (0..).zip(&means).min_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(k, _)| k);
                Ok((f64::from(least) + 0.5) / count)
            }
        }
    }

    fn in_region(&self, quantity: &str, region: &str) -> Result<f64, String> {
        let mean = self.morphometry.mean(quantity, region);
        mean.ok_or_else(|| self.missing(quantity, &format!("in the region `{region}`")))
    }

    /// Mean between two places, as parts of the length, of the quantity interpolated linearly
    /// between the sections that have it.
    fn between(&self, quantity: &str, [from, to]: [f64; 2]) -> Result<f64, String> {
        let known = self.known(quantity);
        let missing = || self.missing(quantity, &format!("from {from} to {to} of the length"));
        let (Some(first), Some(last)) = (known.first(), known.last()) else { return Err(missing()) };
        let [low, high] = [from.max(first.0), to.min(last.0)];
        if high - low < LEAST_SPAN * (to - from) {
            return Err(missing());
        }
        let integral: f64 = known.windows(2).map(|pair| integral([pair[0], pair[1]], [low, high])).sum();
        Ok(integral / (high - low))
    }

    /// Places as parts of the length, in ascending order, and the values there.
    fn known(&self, quantity: &str) -> Vec<(f64, f64)> {
        let along = &self.morphometry.along;
        let (Some(z), Some(values)) = (along.get("z_mm"), along.get(quantity)) else { return Vec::new() };
        let folds = along.get("primary_folds").filter(|_| quantity.starts_with(HEIGHTS) && quantity != VARIATION);
        let height = |i: usize| folds?.get(i).copied().flatten().filter(|&folds| folds == 0.0);
        let value = |i: usize| values.get(i).copied().flatten().or_else(|| height(i));
        z.iter().enumerate().filter_map(|(i, z)| Some(((*z)? / self.length_mm, value(i)?))).collect()
    }

    fn missing(&self, quantity: &str, place: &str) -> String {
        let Morphometry { along, regions, .. } = self.morphometry;
        let is_known = Quantity::named(quantity).is_some()
            || along.contains_key(quantity)
            || regions.values().any(|region| region.quantities.contains_key(quantity));
        if is_known { format!("`{quantity}` has no value {place}") } else { format!("`{quantity}` is not measured") }
    }
}

/// Fall from `a` to `b` relative to the larger of both; negative if `b` is larger, 0 if both are 0.
fn relative_fall(a: f64, b: f64) -> f64 {
    let larger = a.abs().max(b.abs());
    if larger > 0.0 { (a - b) / larger } else { 0.0 }
}

/// Integral of the straight line through two points over the part of a range between them.
fn integral([(x0, y0), (x1, y1)]: [(f64, f64); 2], [low, high]: [f64; 2]) -> f64 {
    let [from, to] = [x0.max(low), x1.min(high)];
    if from >= to {
        return 0.0;
    }
    let at = |x: f64| y0 + (y1 - y0) * (x - x0) / (x1 - x0);
    (to - from) * (at(from) + at(to)) / 2.0
}
