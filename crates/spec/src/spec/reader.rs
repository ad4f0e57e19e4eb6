//! Reading JSON: the faults so far, and readers of numbers, texts, choices and members.

use super::bounds::{Range, out_of};
use super::fault::{Fault, child, describe, nearest, shorten};
use serde_json::{Map, Value};
use std::fmt::Display;
use std::ops::RangeInclusive;

/// Maximum seed: 2^53 − 1, the largest integer that all JSON readers represent exactly.
pub const SEED_MAX: u64 = (1 << 53) - 1;
/// Maximum number of unknown members of an object that are named. The limit keeps the response to a
/// small request small.
const MAX_NAMED_UNKNOWN: usize = 64;

/// Reads JSON values and records a fault for each invalid one. Specifications, studies and all
/// requests are read with it.
///
/// A method that returns an `Option` returns `None` exactly if it recorded a fault.
#[derive(Debug)]
pub struct JsonReader {
    faults: Vec<Fault>,
    /// Number of faults beyond `max_faults`.
    left_out: usize,
    max_faults: usize,
    describe: fn(&Value) -> String,
    /// Pointers of the parameters that could not be read.
    pub(super) bad: Vec<String>,
}

/// JSON pointer and unit of a value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Site<'a> {
    pub(super) at: &'a str,
    pub(super) unit: &'a str,
}

impl Default for JsonReader {
    /// A reader that keeps all faults.
    fn default() -> Self {
        Self::new(usize::MAX, describe)
    }
}

impl JsonReader {
    /// A reader that keeps the first `max_faults` faults and counts the others. `describe`
    /// describes an invalid value in a fault.
    #[must_use]
    pub fn new(max_faults: usize, describe: fn(&Value) -> String) -> Self {
        Self { faults: Vec::new(), left_out: 0, max_faults, describe, bad: Vec::new() }
    }

    /// Faults that were kept.
    #[must_use]
    pub fn faults(&self) -> &[Fault] {
        &self.faults
    }

    /// Number of all faults, including those that were not kept.
    #[must_use]
    pub fn count(&self) -> usize {
        self.faults.len() + self.left_out
    }

    /// Faults that were kept, and the number of the others.
    #[must_use]
    pub fn into_parts(self) -> (Vec<Fault>, usize) {
        (self.faults, self.left_out)
    }

    /// Returns `value` if there is no fault.
    ///
    /// # Errors
    /// Returns the faults. There are none only if `value` is `None` without a fault.
    pub fn finish<T>(self, value: Option<T>) -> Result<T, Vec<Fault>> {
        value.filter(|_| self.faults.is_empty()).ok_or(self.faults)
    }

    /// Records a fault. Returns `None`, so that a reader can return the result.
    pub fn fault<T>(&mut self, at: impl Into<String>, detail: impl Into<String>) -> Option<T> {
        self.push(Fault::new(at, detail));
        None
    }

    /// Records that the value at `at` is not what was `expected`, such as `an object`.
    pub fn unexpected<T>(&mut self, at: impl Into<String>, expected: impl Display, value: &Value) -> Option<T> {
        let found = (self.describe)(value);
        self.fault(at, format!("must be {expected}, not {found}"))
    }

    /// Records the faults of a part of the document. Their pointers are relative to `at`.
    pub fn extend(&mut self, at: &str, faults: impl IntoIterator<Item = Fault>) {
        faults.into_iter().for_each(|fault| self.push(fault.within(at)));
    }

    fn push(&mut self, fault: Fault) {
        if self.faults.len() < self.max_faults {
            self.faults.push(fault);
        } else {
            self.left_out += 1;
        }
    }

    /// Reads an object.
    pub fn object<'a>(&mut self, at: &str, value: &'a Value) -> Option<&'a Map<String, Value>> {
        value.as_object().or_else(|| self.unexpected(at, "an object", value))
    }

    /// Reads an array.
    pub fn array<'a>(&mut self, at: &str, value: &'a Value) -> Option<&'a Vec<Value>> {
        value.as_array().or_else(|| self.unexpected(at, "an array", value))
    }

    /// Reads a string.
    pub fn text<'a>(&mut self, at: &str, value: &'a Value) -> Option<&'a str> {
        value.as_str().or_else(|| self.unexpected(at, "a string", value))
    }

    /// Reads a Boolean.
    pub fn flag(&mut self, at: &str, value: &Value) -> Option<bool> {
        value.as_bool().or_else(|| self.unexpected(at, "true or false", value))
    }

    /// Reads an integer within `range`, as [`integer_in`] does.
    pub fn integer<T>(&mut self, at: &str, value: &Value, range: RangeInclusive<T>) -> Option<T>
    where
        T: TryFrom<i64> + PartialOrd + Display,
    {
        integer_in(value, &range).or_else(|| {
            self.unexpected(at, format_args!("an integer from {} to {}", range.start(), range.end()), value)
        })
    }

    /// Reads a finite number.
    pub(super) fn number(&mut self, at: &str, value: &Value) -> Option<f64> {
        // −0 equals 0 and must not result in a different specification.
        let number = value.as_f64().filter(|v| v.is_finite()).map(|v| v + 0.0);
        number.or_else(|| self.unexpected(at, "a number", value))
    }

    /// Records a fault if `value` is outside `range`.
    pub(super) fn bounded(&mut self, site: Site<'_>, value: f64, range: Range) -> Option<f64> {
        match out_of(value, range, site.unit) {
            Some(detail) => self.fault(site.at, detail),
            None => Some(value),
        }
    }

    /// Records that the value at `at` is not one of `names`.
    pub(super) fn not_a_choice<T>(&mut self, at: &str, value: &Value, names: &[&str]) -> Option<T> {
        let known = names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ");
        let hint = value
            .as_str()
            .and_then(|wrong| nearest(wrong, names.iter().copied()))
            .map_or_else(String::new, |name| format!("; did you mean \"{name}\"?"));
        self.fault(at, format!("must be one of {known}, not {}{hint}", (self.describe)(value)))
    }

    /// Reads an object whose members are among `names`. Unknown members are faults, but do not
    /// prevent the others from being read.
    pub fn members<'a>(&mut self, at: &str, value: &'a Value, names: &[&str]) -> Option<&'a Map<String, Value>> {
        let members = self.object(at, value)?;
        self.only_members(at, members, names, "the fields are");
        Some(members)
    }

    /// Records a fault for each member that is not one of `names`. Returns true if there is none.
    pub(super) fn only(&mut self, at: &str, members: &Map<String, Value>, names: &[&str]) -> bool {
        self.only_members(at, members, names, "known are")
    }

    fn only_members(&mut self, at: &str, members: &Map<String, Value>, names: &[&str], introduction: &str) -> bool {
        let before = self.count();
        let hint = |name: &str| match nearest(name, names.iter().copied()) {
            Some(near) => format!("; did you mean `{near}`?"),
            None => format!("; {introduction} {}", names.join(", ")),
        };
        self.unknown(at, members.keys().filter(|name| !names.contains(&name.as_str())), hint);
        self.count() == before
    }

    /// Records the unknown members of the object at `at`: the first ones with a hint each, the
    /// others as a count.
    pub(super) fn unknown<'a>(
        &mut self,
        at: &str,
        mut names: impl Iterator<Item = &'a String>,
        hint: impl Fn(&str) -> String,
    ) {
        for name in names.by_ref().take(MAX_NAMED_UNKNOWN) {
            self.push(Fault::new(child(at, name), format!("unknown field `{}`{}", shorten(name), hint(name))));
        }
        let more = names.count();
        if more > 0 {
            self.push(Fault::new(at, format!("has {more} more unknown fields")));
        }
    }
}

/// The integer if it is within `range`. A number such as 7.0 is an integer in JSON.
pub fn integer_in<T: TryFrom<i64> + PartialOrd>(value: &Value, range: &RangeInclusive<T>) -> Option<T> {
    let is_exact = |x: &f64| x.fract() == 0.0 && x.abs() <= SEED_MAX as f64;
    let integer = value.as_i64().or_else(|| value.as_f64().filter(is_exact).map(|x| x as i64));
    integer.and_then(|n| T::try_from(n).ok()).filter(|n| range.contains(n))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn whole_numbers_are_integers() {
        for (value, integer) in [(json!(0), 0), (json!(-0.0), 0), (json!(62.0), 62), (json!(SEED_MAX), SEED_MAX)] {
            assert_eq!(integer_in(&value, &(0..=SEED_MAX)), Some(integer), "{value}");
        }
        for value in [json!(-1), json!(0.5), json!("7"), json!(null), json!(1e300), json!(u64::MAX)] {
            assert_eq!(integer_in(&value, &(0..=SEED_MAX)), None, "{value}");
        }
    }

    #[test]
    fn faults_beyond_the_limit_are_counted() {
        let mut reader = JsonReader::new(1, |_| "that".to_owned());
        assert_eq!(reader.object("/a", &json!(3)), None);
        reader.extend("/spec", [Fault::new("/steps", "is missing")]);
        assert_eq!(reader.count(), 2);
        assert_eq!(reader.into_parts(), (vec![Fault::new("/a", "must be an object, not that")], 1));
    }

    #[test]
    fn a_value_with_faults_is_not_returned() {
        assert_eq!(JsonReader::default().finish(Some(1)), Ok(1));
        let mut reader = JsonReader::default();
        assert_eq!(reader.flag("/reuse", &json!("no")), None);
        assert_eq!(
            reader.finish(Some(1)).map_err(|faults| faults[0].to_string()),
            Err("/reuse: must be true or false, not the string \"no\"".to_owned())
        );
    }
}
