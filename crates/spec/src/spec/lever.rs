//! Numeric parameters that a fit changes.

use super::parameters::leaves;
use super::study::number_at;
use super::{Fault, ModelSpec, Preset};
use serde_json::{Map, Value, json};

/// A numeric parameter. A schedule is changed by multiplying its keys.
#[derive(Clone, Debug, PartialEq)]
pub struct Lever {
    /// JSON pointer in the specification.
    pub pointer: String,
    /// Name for display.
    pub title: &'static str,
    /// Unit; empty if there is none.
    pub unit: &'static str,
    /// Minimum and maximum value.
    pub bounds: [f64; 2],
    /// True if only integers are valid.
    pub integer: bool,
    /// True if the value may change along the tube.
    pub schedule: bool,
}

/// End of the tube at which a schedule is changed: `isthmus` up to the junction, or `ampulla` from
/// the junction on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum End {
    /// The isthmus, up to the junction.
    Isthmus,
    /// The ampulla, from the junction on.
    Ampulla,
}

impl Lever {
    /// Finds the parameter at a JSON pointer.
    ///
    /// # Errors
    /// Returns a sentence that says why the pointer is not a numeric parameter.
    pub fn at(pointer: &str) -> Result<Self, String> {
        let (bounds, integer) = number_at(pointer)?;
        let Some((_, field)) = leaves().into_iter().find(|(at, _)| at == pointer) else {
            return Err("is a part of a parameter; name the parameter".to_owned());
        };
        let schedule = matches!(field.kind, super::table::Kind::Schedule(_));
        let (title, unit) = (field.title, field.unit);
        Ok(Self { pointer: pointer.to_owned(), title, unit, bounds, integer, schedule })
    }

    /// Value in a specification. The value of a schedule is that of its first key at the isthmus
    /// end, otherwise that of its last key.
    #[must_use]
    pub fn value(&self, spec: &ModelSpec, end: Option<End>) -> f64 {
        match spec.to_json().pointer(&self.pointer) {
            Some(Value::Object(schedule)) => {
                let keys = keys(schedule);
                let key = if end == Some(End::Isthmus) { keys.first() } else { keys.last() };
                key.map_or(0.0, |key| key[1])
            }
            value => value.and_then(Value::as_f64).unwrap_or(0.0),
        }
    }
}

/// A lever, the end of the tube at which it acts (`None`: both), and its new value.
pub type Setting<'a> = (&'a Lever, Option<End>, f64);

impl ModelSpec {
    /// Sets levers. The keys of a schedule are multiplied, so that the schedule keeps its form and
    /// has the new value at the given end. Between the ends of the junction, the factors of both
    /// ends are interpolated.
    ///
    /// # Errors
    /// Returns all faults of the result.
    pub fn with(&self, preset: &Preset, settings: &[Setting<'_>]) -> Result<Self, Vec<Fault>> {
        let mut whole = self.to_json();
        // Factors at the isthmus and the ampulla end.
        let mut end_factors: Vec<(&Lever, [f64; 2])> = Vec::new();
        for &(lever, end, value) in settings {
            let Some(target) = whole.pointer_mut(&lever.pointer) else { continue };
            if !lever.schedule || end.is_none() && target.is_number() {
                *target = number(lever, value);
                continue;
            }
            let before = lever.value(self, end);
            let factor = if before == 0.0 { 1.0 } else { value / before };
            let at = end_factors.iter().position(|(other, _)| other.pointer == lever.pointer);
            let at = at.unwrap_or_else(|| {
                end_factors.push((lever, [1.0; 2]));
                end_factors.len() - 1
            });
            match end {
                Some(End::Isthmus) => end_factors[at].1[0] = factor,
                Some(End::Ampulla) => end_factors[at].1[1] = factor,
                None => end_factors[at].1 = [factor; 2],
            }
        }
        for (lever, factors) in end_factors {
            if let Some(target) = whole.pointer_mut(&lever.pointer) {
                self.scale_ends(target, factors);
            }
        }
        Self::resolve(preset, &whole)
    }

    fn scale_ends(&self, schedule: &mut Value, [isthmus, ampulla]: [f64; 2]) {
        let [from, to] = [self.regions.junction_from, self.regions.junction_to];
        if let Some(value) = schedule.as_f64() {
            // A key at each end of the junction confines the change to the junction.
            let mut steps: Vec<f64> = [0.0, self.step_fraction(from), self.step_fraction(to), 1.0].to_vec();
            steps.dedup_by(|b, a| *b - *a < 1e-6);
            let keys: Vec<[f64; 2]> = steps.into_iter().map(|u| [u, value]).collect();
            *schedule = json!({ "keys": keys });
        }
        let Some(members) = schedule.as_object_mut() else { return };
        let keys: Vec<[f64; 2]> = keys(members)
            .into_iter()
            .map(|[u, value]| {
                let z = self.z.at(u);
                let part =
                    if to > from { ((z - from) / (to - from)).clamp(0.0, 1.0) } else { f64::from(u8::from(z > to)) };
                [u, value * (isthmus + (ampulla - isthmus) * part)]
            })
            .collect();
        members.insert("keys".into(), json!(keys));
    }

    /// Fraction of the steps at which the tube has reached the fraction `z` of its length.
    fn step_fraction(&self, z: f64) -> f64 {
        let [mut low, mut high] = [0.0, 1.0];
        // The schedule of `z` increases strictly, so bisection applies.
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if self.z.at(middle) < z { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }
}

fn keys(schedule: &Map<String, Value>) -> Vec<[f64; 2]> {
    schedule.get("keys").and_then(|keys| serde_json::from_value(keys.clone()).ok()).unwrap_or_default()
}

fn number(lever: &Lever, value: f64) -> Value {
    if lever.integer { json!(value.round()) } else { json!(value) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::preset;

    fn pig() -> ModelSpec {
        ModelSpec::resolve(preset("pig").unwrap(), &json!({})).unwrap()
    }

    fn with(spec: &ModelSpec, settings: &[Setting<'_>]) -> ModelSpec {
        spec.with(preset("pig").unwrap(), settings).unwrap()
    }

    #[test]
    fn levers_are_parameters_that_take_numbers() {
        let gap = Lever::at("/collision/gap_um").unwrap();
        assert!(gap.schedule && !gap.integer && gap.unit == "µm" && gap.bounds == [5.0, 1000.0], "{gap:?}");
        let steps = Lever::at("/steps").unwrap();
        assert!(steps.integer && !steps.schedule);
        for (pointer, hint) in [
            ("gap_um", "JSON pointer"),
            ("/collision", "vary its members"),
            ("/collision/gap_mm", "did you mean"),
            ("/solver/search", "takes no numbers"),
            ("/friction/keys", "takes no numbers"),
            ("/friction/fluctuation/amplitude", "part of a parameter"),
        ] {
            let detail = Lever::at(pointer).unwrap_err();
            assert!(detail.contains(hint), "{pointer}: {detail}");
        }
    }

    #[test]
    fn the_ends_of_a_schedule_change_alone() {
        let (pig, bending) = (pig(), Lever::at("/bending").unwrap());
        assert_eq!([Some(End::Isthmus), Some(End::Ampulla), None].map(|end| bending.value(&pig, end)), [0.2, 0.1, 0.1]);
        let soft = with(&pig, &[(&bending, Some(End::Isthmus), 0.05)]);
        assert_eq!([0.0, 0.125, 1.0].map(|u| soft.bending.at(u)), [0.05, 0.05, 0.1]);
        let both = with(&pig, &[(&bending, Some(End::Isthmus), 0.1), (&bending, Some(End::Ampulla), 0.05)]);
        assert_eq!(both, with(&pig, &[(&bending, None, 0.05)]));
        assert_eq!(with(&pig, &[(&bending, Some(End::Ampulla), 0.1)]), pig);
    }

    #[test]
    fn a_constant_changes_at_the_junction() {
        let (pig, squash) = (pig(), Lever::at("/containment/squash").unwrap());
        let bent = with(&pig, &[(&squash, Some(End::Ampulla), 0.44)]);
        let at = |z: f64| bent.containment.squash.at(bent.step_fraction(z));
        for (z, value) in [(0.0, 0.88), (0.29, 0.88), (0.41, 0.44), (1.0, 0.44)] {
            assert!((at(z) - value).abs() < 2e-3, "{z}: {}", at(z));
        }
        assert!((0.5..0.8).contains(&at(0.35)), "{}", at(0.35));
        assert_eq!(with(&pig, &[(&squash, None, 0.7)]).containment.squash, crate::spec::Schedule::constant(0.7));
    }

    #[test]
    fn numbers_are_set_and_faults_are_told() {
        let pig = pig();
        let [length, lobes] = ["/length_mm", "/wall/lobes"].map(|at| Lever::at(at).unwrap());
        let other = with(&pig, &[(&length, None, 12.5), (&lobes, None, 2.6)]);
        assert_eq!((other.length_mm, other.wall.lobes), (12.5, 3));
        let faults = pig.with(preset("pig").unwrap(), &[(&length, None, 1e9)]).unwrap_err();
        assert_eq!(faults[0].pointer, "/length_mm");
    }
}
