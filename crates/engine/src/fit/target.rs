//! Target of a fit: a quantity in a region, with the accepted range.

use crate::measure::morphometry::{ISLANDS, Morphometry, Quantity, Tube};
use crate::spec::{nearest, shorten};
use serde::{Deserialize, Serialize};

/// Half width of the accepted range if the request has none, as a fraction of the value.
pub const TOLERANCE: f64 = 0.05;
/// Minimum half width of a range in the computation of deviations, as a fraction of the value.
const LEAST_HALF: f64 = 0.005;
/// Deviation of a measure that a model lacks, such as the height of folds without folds.
const NOT_MEASURED: f64 = 10.0;
/// Deviation from which on the loss grows linearly, so that one target out of reach does not
/// outweigh all others.
const LINEAR_FROM: f64 = 3.0;

/// Regions of sections, by their names in the report.
const REGIONS: [&str; 4] = ["isthmus", "junction", "ampulla", "whole"];
/// Quantities that compare a section with the next one in the list of sections of the report.
const STEPS: [&str; 2] = ["fold_continuity", "twist_deg_per_mm"];

/// A quantity in a region, with the accepted range.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Target {
    /// `isthmus`, `junction`, `ampulla`, `whole`, or `tube` for a measure of the whole tube.
    pub region: String,
    /// Name of the quantity, as in the report.
    pub quantity: String,
    /// Value to reach: the mean over the region.
    pub value: f64,
    /// Lower end of the accepted range.
    pub low: f64,
    /// Upper end of the accepted range.
    pub high: f64,
    /// Source of the value, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
}

impl Target {
    /// Distance of `measured` from the value, in units of the distance from the value to the end of
    /// the range on that side: from −1 to 1 within the range.
    #[must_use]
    pub fn deviation(&self, measured: Option<f64>) -> f64 {
        let Some(measured) = measured else { return NOT_MEASURED };
        let off = measured - self.value;
        let side = if off < 0.0 { self.value - self.low } else { self.high - self.value };
        off / side.max(LEAST_HALF * self.value.abs()).max(f64::MIN_POSITIVE.sqrt())
    }

    /// True if `measured` is within the range.
    #[must_use]
    pub fn is_met(&self, measured: Option<f64>) -> bool {
        measured.is_some_and(|x| (self.low..=self.high).contains(&x))
    }

    /// Measure of a model; `None` if the model lacks it.
    #[must_use]
    pub fn measured(&self, morphometry: &Morphometry) -> Option<f64> {
        morphometry.mean(&self.quantity, &self.region).filter(|value| value.is_finite())
    }

    /// True if the target needs every recorded section.
    pub(super) fn needs_all_sections(&self) -> bool {
        STEPS.contains(&self.quantity.as_str())
            || self.region == "tube" && ["fold_continuity", "twist_deg"].contains(&self.quantity.as_str())
    }

    /// Name for messages and tables.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{}/{}", self.region, self.quantity)
    }
}

/// Loss of a deviation: (d² + d⁴)/2, and a straight line from [`LINEAR_FROM`] on. The loss is 1 at
/// the ends of the range and rises steeply beyond. Bringing all targets into their ranges therefore
/// pays more than bringing some to their values.
#[must_use]
pub(super) fn loss(deviation: f64) -> f64 {
    let size = deviation.abs();
    let quartic = |d: f64| (d.powi(2) + d.powi(4)) / 2.0;
    if size <= LINEAR_FROM { quartic(size) } else { quartic(LINEAR_FROM) + slope(LINEAR_FROM) * (size - LINEAR_FROM) }
}

/// Slope of the loss at a deviation from 0 to [`LINEAR_FROM`].
fn slope(size: f64) -> f64 {
    size + 2.0 * size.powi(3)
}

/// Weight with which the square of a deviation has the slope of its loss.
#[must_use]
pub(super) fn weight(deviation: f64) -> f64 {
    let size = deviation.abs();
    if size < 1e-9 { 0.5 } else { slope(size.min(LINEAR_FROM)) / (2.0 * size) }
}

/// Reason why a quantity in a region cannot be a target, with the member at fault; `None` if it
/// can.
pub(super) fn refused(region: &str, quantity: &str) -> Option<(&'static str, String)> {
    if region != "tube" && !REGIONS.contains(&region) {
        let names = REGIONS.into_iter().chain(["tube"]);
        let detail = format!("`{}` is unknown; the regions are {} and tube", shorten(region), REGIONS.join(", "));
        return Some(("region", detail + &hint(region, names)));
    }
    let name = shorten(quantity);
    let detail = match quantity {
        ISLANDS => format!(
            "`{name}` is always 0 in simulated sections, so no parameter changes it; planar cuts of a finished model \
             have islands (`cuts` in report.json)"
        ),
        _ if region == "tube" => {
            let known = measures_of_tube();
            if known.iter().any(|name| name == quantity) {
                return None;
            }
            let hint = hint(quantity, known.iter().map(String::as_str));
            format!("`{name}` is no measure of the tube; those are {}{hint}", known.join(", "))
        }
        "least_gap_um" => format!("`{name}` comes from the certificate of a surface, which a fit does not make"),
        _ if Quantity::named(quantity).is_some_and(|of| of.of_layers) => {
            format!("`{name}` is a measure of the layers of a finished model, which a fit does not make")
        }
        _ if STEPS.contains(&quantity) || Quantity::named(quantity).is_some() => return None,
        _ => {
            let names = Quantity::of_simulated().map(|quantity| quantity.name).chain(STEPS);
            format!("`{name}` is unknown; docs/morphometry.md lists the quantities{}", hint(quantity, names))
        }
    };
    Some(("quantity", detail))
}

/// Question whether the most similar name was meant, if one is similar.
fn hint<'a>(wrong: &str, names: impl Iterator<Item = &'a str>) -> String {
    nearest(wrong, names).map_or_else(String::new, |name| format!("; did you mean `{name}`?"))
}

fn measures_of_tube() -> Vec<String> {
    let tube = serde_json::json!(Tube::default());
    tube.as_object().into_iter().flatten().map(|(name, _)| name.clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(value: f64, low: f64, high: f64) -> Target {
        Target { region: "ampulla".into(), quantity: "fill".into(), value, low, high, source: None }
    }

    #[test]
    fn deviations_are_in_parts_of_the_range() {
        let folds = target(8.0, 7.0, 10.0);
        for (measured, deviation) in [(8.0, 0.0), (7.0, -1.0), (10.0, 1.0), (6.0, -2.0), (9.0, 0.5), (14.0, 3.0)] {
            assert!((folds.deviation(Some(measured)) - deviation).abs() < 1e-12, "{measured}");
            assert_eq!(folds.is_met(Some(measured)), deviation.abs() <= 1.0, "{measured}");
        }
        assert!(folds.deviation(None) > 3.0 && !folds.is_met(None));
        // A value at the end of its range, or without a range, has a minimum distance.
        assert_eq!(target(8.0, 8.0, 10.0).deviation(Some(7.0)), -25.0);
        assert!(target(0.0, 0.0, 0.0).deviation(Some(1.0)).is_finite());
    }

    #[test]
    fn the_loss_is_smooth_where_it_becomes_linear() {
        assert_eq!((loss(0.0), loss(-1.0), loss(2.0), loss(3.0), loss(5.0)), (0.0, 1.0, 10.0, 45.0, 159.0));
        let slope = |x: f64| (loss(x + 1e-6) - loss(x - 1e-6)) / 2e-6;
        assert!((slope(2.999) - slope(3.001)).abs() < 0.2);
        for size in [0.5, 1.5, 4.0] {
            assert!((2.0 * size * weight(-size) - slope(size)).abs() < 1e-4, "{size}");
        }
    }

    #[test]
    fn names_are_those_of_the_report() {
        for (region, quantity) in [
            ("isthmus", "folds_on_ring"),
            ("whole", "tissue_area_mm2"),
            ("junction", "fold_continuity"),
            ("tube", "length_mm"),
            ("tube", "fold_ratio"),
            ("tube", "twist_deg"),
        ] {
            assert_eq!(refused(region, quantity), None, "{region}/{quantity}");
        }
        for (region, quantity, member) in [
            ("ampula", "fill", "region"),
            ("ampulla", "folds", "quantity"),
            ("ampulla", "length_mm", "quantity"),
            ("tube", "fill", "quantity"),
            ("whole", "least_gap_um", "quantity"),
            ("ampulla", "islands", "quantity"),
            ("tube", "islands", "quantity"),
            ("isthmus", "muscle_thickness_um", "quantity"),
            ("ampulla", "fold_splits_per_mm", "quantity"),
        ] {
            assert_eq!(refused(region, quantity).map(|(member, _)| member), Some(member), "{region}/{quantity}");
        }
    }
    #[test]
    fn refusals_name_what_was_probably_meant() {
        let told = |region: &str, quantity: &str| refused(region, quantity).unwrap().1;
        for (region, quantity, start, end) in [
            ("ampula", "fill", "`ampula` is unknown; the regions are isthmus, ", "did you mean `ampulla`?"),
            ("ampulla", "fold_on_ring", "`fold_on_ring` is unknown", "did you mean `folds_on_ring`?"),
            ("tube", "lenght_mm", "`lenght_mm` is no measure of the tube", "did you mean `length_mm`?"),
            ("whole", "island", "`island` is unknown", "lists the quantities"),
            ("whole", "islands", "`islands` is always 0 in simulated sections", "(`cuts` in report.json)"),
        ] {
            let told = told(region, quantity);
            assert!(told.starts_with(start) && told.ends_with(end), "{told}");
        }
        assert!(told("whole", &"x".repeat(10_000)).len() < 200);
    }
}
