//! Values of the specification that the pointers of a study address.

use crate::spec::bounds::{Range, out_of};
use crate::spec::merge::hint;
use crate::spec::parameters::table;
use crate::spec::read::PERIOD;
use crate::spec::table::{Field, Kind};

/// A value of the specification that a study can vary.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    /// Bounds, if the value is a number.
    range: Option<Range>,
    unit: &'static str,
    /// True if only integers are valid.
    pub(super) integer: bool,
}

impl Target {
    fn number(range: Range, unit: &'static str) -> Self {
        Self { range: Some(range), unit, integer: false }
    }

    /// True if the value is a number.
    pub(super) fn is_number(self) -> bool {
        self.range.is_some()
    }

    /// Minimum and maximum, if the value is a number.
    pub(super) fn bounds(self) -> Option<[f64; 2]> {
        self.range.map(|range| [range.min, range.max])
    }

    /// Describes why `value` is out of bounds. `None` if it is valid.
    pub(super) fn refuses(self, value: f64) -> Option<String> {
        self.range.and_then(|range| out_of(value, range, self.unit))
    }
}

/// Finds the value that a JSON pointer addresses: a parameter, or a part of a schedule.
///
/// # Errors
/// Returns a sentence that says why the pointer addresses no such value.
pub(super) fn target(pointer: &str) -> Result<Target, String> {
    let Some(path) = pointer.strip_prefix('/') else {
        return Err("must be a JSON pointer to a parameter, such as /collision/gap_um".to_owned());
    };
    let mut fields = table();
    let mut names = path.split('/');
    let field = loop {
        let name = names.next().unwrap_or_default();
        let Some(field) = fields.iter().find(|field| field.name == name) else {
            return Err(format!("is no parameter{}", hint(fields, name)));
        };
        match &field.kind {
            Kind::Group(members) if names.clone().next().is_none() => {
                let names: Vec<&str> = members.iter().map(|member| member.name).collect();
                return Err(format!("is a group of parameters; vary its members: {}", names.join(", ")));
            }
            Kind::Group(members) => fields = members,
            _ => break field,
        }
    };
    value_within(field, &names.collect::<Vec<_>>())
}

/// Finds the value at `path` within a parameter.
fn value_within(field: &Field, path: &[&str]) -> Result<Target, String> {
    let other = Target { range: None, unit: "", integer: false };
    match (&field.kind, path) {
        (Kind::Schedule(range) | Kind::Number(range), []) => Ok(Target::number(*range, field.unit)),
        (Kind::Integer(count), []) => {
            let range = Range::of(f64::from(count.min), f64::from(count.max));
            Ok(Target { integer: true, ..Target::number(range, field.unit) })
        }
        (_, []) => Ok(other),
        (Kind::Schedule(_), ["keys" | "ease" | "fluctuation"]) => Ok(other),
        (Kind::Schedule(_), ["fluctuation", "amplitude"]) => Ok(Target::number(Range::of(0.0, f64::MAX), field.unit)),
        (Kind::Schedule(_), ["fluctuation", "period"]) => Ok(Target::number(PERIOD, "steps")),
        (Kind::Schedule(_), _) => Err(
            "is no part of a schedule; those are keys, ease, fluctuation, fluctuation/amplitude and fluctuation/period"
                .to_owned(),
        ),
        _ => Err(format!("is no parameter; `{}` has no members", field.name)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_and_parts_of_schedules_can_be_varied() {
        for (pointer, number, integer) in [
            ("/steps", true, true),
            ("/length_mm", true, false),
            ("/collision/gap_um", true, false),
            ("/friction/fluctuation/amplitude", true, false),
            ("/friction/fluctuation/period", true, false),
            ("/friction/keys", false, false),
            ("/friction/ease", false, false),
            ("/solver/integrator", false, false),
            ("/mesh/strips", false, false),
        ] {
            let target = target(pointer).unwrap();
            assert_eq!((target.is_number(), target.integer), (number, integer), "{pointer}");
        }
    }

    #[test]
    fn other_pointers_are_refused_with_a_hint() {
        for (pointer, hint) in [
            ("", "must be a JSON pointer"),
            ("gap_um", "must be a JSON pointer"),
            ("/", "is no parameter"),
            ("/collision", "vary its members: strength"),
            ("/collision/", "is no parameter"),
            ("/collision/gap_mm", "did you mean `gap_um`"),
            ("/gap_um", "did you mean `/collision/gap_um`"),
            ("/steps/0", "has no members"),
            ("/friction/keys/0/1", "is no part of a schedule"),
            ("/friction/value", "is no part of a schedule"),
        ] {
            let detail = target(pointer).unwrap_err();
            assert!(detail.contains(hint), "{pointer}: {detail}");
        }
    }
}
