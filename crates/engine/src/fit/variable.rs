//! Variables of a fit: parameters, each between two bounds.

use super::target::Target;
use crate::spec::{End, Lever, ModelSpec};
use serde::Serialize;

/// A varied parameter, the end at which it acts, and its bounds.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    pub(super) lever: Lever,
    /// End of the tube where the variable acts; `None` for the whole tube.
    pub(super) end: Option<End>,
    /// Value in the spec from which the search starts.
    pub(super) start: f64,
    pub(super) from: f64,
    pub(super) to: f64,
}

/// A variable in answers.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Varied {
    /// JSON pointer of the parameter.
    pub parameter: String,
    /// End of the tube at which the parameter is varied; null if it is varied as a whole.
    pub end: Option<End>,
    /// Lower bound.
    pub from: f64,
    /// Upper bound.
    pub to: f64,
}

/// Parameters to vary for each target: pairs of (prefixes of the names of quantities, JSON
/// pointers). The first matching entry applies.
const LEVERS: [(&[&str], &[&str]); 12] = [
    (&["length_mm", "isthmus_length", "ampulla_length"], &["/length_mm"]),
    (&["lumen_volume", "tissue_volume", "lumen_surface"], &["/length_mm", "/containment/wall_um", "/particles/total"]),
    (
        &["tissue_area", "tissue_diameter", "outer_diameter", "wall_share"],
        &["/containment/wall_um", "/containment/spacing_um", "/particles/total"],
    ),
    (&["tissue_thickness_p50"], &["/collision/tissue_um"]),
    (&["tissue_thickness"], &["/collision/tissue_um", "/variation/amplitude"]),
    (
        &["lumen_gap_p50", "fill", "lumen_area", "hydraulic", "surface_over_volume"],
        &["/collision/gap_um", "/containment/spacing_um", "/particles/total"],
    ),
    (&["lumen_gap"], &["/collision/gap_um", "/variation/amplitude"]),
    (&["secondary", "tertiary", "branching"], &["/particles/tip_weight", "/particles/total", "/collision/tissue_um"]),
    (
        &["folds_on_ring", "primary_folds", "fold_ratio", "fold_height"],
        &["/collision/tissue_um", "/particles/total", "/containment/spacing_um"],
    ),
    (&["fold_continuity"], &["/contortion/magnitude", "/regulatory/strength"]),
    (&["twist"], &["/contortion/magnitude"]),
    (&[""], &["/particles/total", "/containment/spacing_um", "/collision/gap_um"]),
];

/// Factor of the default bounds: the start divided and multiplied by this factor.
const FACTOR: f64 = 2.0;

impl Variable {
    /// A variable with these bounds. Missing bounds get defaults.
    ///
    /// # Errors
    /// The member at fault, and a sentence that says what is wrong.
    pub(super) fn new(
        lever: Lever,
        end: Option<End>,
        spec: &ModelSpec,
        bounds: [Option<f64>; 2],
    ) -> Result<Self, (&'static str, String)> {
        if end.is_some() && !lever.schedule {
            return Err(("end", "is for parameters that may change along the tube".into()));
        }
        let start = lever.value(spec, end);
        let [least, most] = lever.bounds;
        let around = if start > 0.0 { [start / FACTOR, start * FACTOR] } else { [least, most.min(1.0)] };
        let [from, to] = [bounds[0].unwrap_or(around[0].max(least)), bounds[1].unwrap_or(around[1].min(most))];
        for (member, bound) in [("from", from), ("to", to)] {
            if !(least..=most).contains(&bound) {
                let unit = if lever.unit.is_empty() { String::new() } else { format!(" {}", lever.unit) };
                return Err((member, format!("is {bound}, but the parameter takes {least} to {most}{unit}")));
            }
        }
        if from >= to {
            return Err(("to", format!("must be greater than `from`, which is {from}")));
        }
        Ok(Self { lever, end, start, from, to })
    }

    /// Variables for targets whose request names none.
    pub(super) fn chosen(targets: &[Target], spec: &ModelSpec) -> Vec<Self> {
        let mut chosen: Vec<(&str, Option<End>)> = Vec::new();
        for target in targets {
            let of = |names: &[&str]| names.iter().any(|name| target.quantity.starts_with(name));
            let levers = LEVERS.iter().find(|(names, _)| of(names)).map_or(&[][..], |(_, levers)| levers);
            let ends: &[End] = match target.region.as_str() {
                "isthmus" => &[End::Isthmus],
                "ampulla" => &[End::Ampulla],
                _ => &[End::Isthmus, End::Ampulla],
            };
            for lever in levers {
                let schedule = Lever::at(lever).is_ok_and(|lever| lever.schedule);
                let places: Vec<Option<End>> =
                    if schedule { ends.iter().copied().map(Some).collect() } else { vec![None] };
                chosen.extend(places.into_iter().map(|end| (*lever, end)));
            }
        }
        chosen.sort_unstable();
        chosen.dedup();
        let make = |(at, end)| Self::new(Lever::at(at).ok()?, end, spec, [None, None]).ok();
        chosen.into_iter().filter_map(make).collect()
    }

    /// True if the logarithm of the value is varied.
    fn is_logarithmic(&self) -> bool {
        self.from > 0.0 && self.to >= 1.5 * self.from
    }

    /// Value at a place between the bounds, from 0 to 1.
    pub(super) fn at(&self, place: f64) -> f64 {
        let value = if self.is_logarithmic() {
            self.from * (self.to / self.from).powf(place)
        } else {
            self.from + (self.to - self.from) * place
        };
        let value = value.clamp(self.from, self.to);
        if self.lever.integer { value.round() } else { value }
    }

    /// Place of the start, kept off the bounds.
    pub(super) fn start(&self) -> f64 {
        let place = if self.is_logarithmic() {
            (self.start / self.from).ln() / (self.to / self.from).ln()
        } else {
            (self.start - self.from) / (self.to - self.from)
        };
        if place.is_finite() { place.clamp(0.02, 0.98) } else { 0.02 }
    }

    /// In answers.
    #[must_use]
    pub fn shown(&self) -> Varied {
        Varied { parameter: self.lever.pointer.clone(), end: self.end, from: self.from, to: self.to }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::preset;
    use serde_json::json;

    fn pig() -> ModelSpec {
        ModelSpec::resolve(preset("pig").unwrap(), &json!({})).unwrap()
    }

    fn variable(pointer: &str, end: Option<End>, bounds: [Option<f64>; 2]) -> Result<Variable, (&'static str, String)> {
        Variable::new(Lever::at(pointer).unwrap(), end, &pig(), bounds)
    }

    #[test]
    fn places_lie_between_the_bounds() {
        let gap = variable("/collision/gap_um", Some(End::Ampulla), [None, None]).unwrap();
        assert_eq!((gap.from, gap.to, gap.start), (5.0, 20.0, 10.0));
        assert!((gap.start() - 0.5).abs() < 1e-12 && (gap.at(0.5) - 10.0).abs() < 1e-9);
        assert_eq!((gap.at(0.0), gap.at(1.0)), (5.0, 20.0));
        let lobes = variable("/wall/lobes", None, [Some(1.0), Some(9.0)]).unwrap();
        assert_eq!(lobes.at(0.5), 3.0);
        // The bounds of the parameter win over the factor, and a start outside is moved inside.
        let friction = variable("/friction", None, [Some(1.0), None]).unwrap_err();
        assert_eq!(friction.0, "to");
        assert_eq!(variable("/friction", None, [Some(1.0), Some(2.0)]).unwrap().start(), 0.02);
    }

    #[test]
    fn impossible_variables_are_refused() {
        for (pointer, end, bounds, member) in [
            ("/length_mm", Some(End::Ampulla), [None, None], "end"),
            ("/collision/gap_um", None, [Some(1.0), None], "from"),
            ("/collision/gap_um", None, [None, Some(1e5)], "to"),
            ("/collision/gap_um", None, [Some(40.0), Some(40.0)], "to"),
            ("/collision/gap_um", None, [Some(f64::NAN), None], "from"),
        ] {
            assert_eq!(variable(pointer, end, bounds).unwrap_err().0, member, "{pointer} {bounds:?}");
        }
    }

    #[test]
    fn variables_follow_from_the_targets() {
        let target = |region: &str, quantity: &str| Target {
            region: region.into(),
            quantity: quantity.into(),
            value: 1.0,
            low: 0.9,
            high: 1.1,
            source: None,
        };
        let of = |targets: &[Target]| -> Vec<String> {
            let name = |v: &Variable| {
                format!("{}{}", v.lever.pointer, v.end.map_or("", |end| if end == End::Isthmus { "<" } else { ">" }))
            };
            Variable::chosen(targets, &pig()).iter().map(name).collect()
        };
        assert_eq!(of(&[target("tube", "length_mm")]), ["/length_mm"]);
        assert_eq!(of(&[target("isthmus", "tissue_thickness_p50_um")]), ["/collision/tissue_um<"]);
        assert_eq!(
            of(&[target("ampulla", "folds_on_ring"), target("ampulla", "tissue_thickness_cv")]),
            ["/collision/tissue_um>", "/containment/spacing_um>", "/particles/total>", "/variation/amplitude>"]
        );
        for quantity in crate::measure::morphometry::QUANTITIES {
            assert!(!of(&[target("whole", quantity.name)]).is_empty(), "{}", quantity.name);
        }
    }
}
