//! The state of all readers, and the reading of numbers, choices and members.

use super::bounds::{Range, out_of};
use super::fault::{Fault, describe, nearest, unknown};
use serde_json::{Map, Value};

/// Collects faults while reading.
#[derive(Debug, Default)]
pub(super) struct Reader {
    /// All faults so far.
    pub(super) faults: Vec<Fault>,
    /// Pointers of the parameters that could not be read.
    pub(super) bad: Vec<String>,
}

/// JSON pointer and unit of a value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Site<'a> {
    pub(super) at: &'a str,
    pub(super) unit: &'a str,
}

impl Reader {
    /// Records a fault. Returns `None`, so that a reader can return the result.
    pub(super) fn fault<T>(&mut self, at: impl Into<String>, detail: impl Into<String>) -> Option<T> {
        self.faults.push(Fault::new(at, detail));
        None
    }

    /// Records that a value is not one of the names of a choice.
    pub(super) fn not_a_choice<T>(&mut self, site: Site<'_>, value: &Value, names: &[(&str, &str)]) -> Option<T> {
        let names: Vec<&str> = names.iter().map(|(name, _)| *name).collect();
        self.not_a_choice_of(site.at, value, &names)
    }

    /// Records that the value at `at` is not one of `names`.
    pub(super) fn not_a_choice_of<T>(&mut self, at: &str, value: &Value, names: &[&str]) -> Option<T> {
        let known = names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ");
        let hint = value
            .as_str()
            .and_then(|wrong| nearest(wrong, names.iter().copied()))
            .map_or_else(String::new, |name| format!("; did you mean \"{name}\"?"));
        self.fault(at, format!("must be one of {known}, not {}{hint}", describe(value)))
    }

    /// Reads an integer from `min` to `max`. A number such as 7.0 is an integer.
    pub(super) fn size(&mut self, at: &str, value: &Value, min: usize, max: usize) -> Option<usize> {
        let whole =
            value.as_u64().or_else(|| value.as_f64().filter(|x| x.fract() == 0.0 && *x >= 0.0).map(|x| x as u64));
        match whole.and_then(|n| usize::try_from(n).ok()).filter(|n| (min..=max).contains(n)) {
            Some(size) => Some(size),
            None => self.fault(at, format!("must be an integer from {min} to {max}, not {}", describe(value))),
        }
    }

    /// Reads a finite number.
    pub(super) fn number(&mut self, at: &str, value: &Value) -> Option<f64> {
        match value.as_f64().filter(|v| v.is_finite()) {
            // −0 equals 0 and must not result in a different specification.
            Some(v) => Some(v + 0.0),
            None => self.fault(at, format!("must be a number, not {}", describe(value))),
        }
    }

    /// Records a fault if `value` is outside `range`.
    pub(super) fn bounded(&mut self, site: Site<'_>, value: f64, range: Range) -> Option<f64> {
        match out_of(value, range, site.unit) {
            Some(detail) => self.fault(site.at, detail),
            None => Some(value),
        }
    }

    /// Records a fault for each member that is not one of `names`. Returns true if there is none.
    pub(super) fn only(&mut self, at: &str, members: &Map<String, Value>, names: &[&str]) -> bool {
        let before = self.faults.len();
        let hint = |name: &str| match nearest(name, names.iter().copied()) {
            Some(near) => format!("; did you mean `{near}`?"),
            None => format!("; known are {}", names.join(", ")),
        };
        let others = members.keys().filter(|name| !names.contains(&name.as_str()));
        unknown(at, others, hint, &mut self.faults);
        self.faults.len() == before
    }
}
