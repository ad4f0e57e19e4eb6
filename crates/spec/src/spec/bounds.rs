//! Bounds of parameters.

use super::canonical::number;

/// Closed bounds of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Range {
    pub(super) min: f64,
    pub(super) max: f64,
    /// Reason for the upper bound, if it is not obvious.
    pub(super) because: Option<&'static str>,
    /// True if a schedule must not fluctuate.
    pub(super) steady: bool,
}

impl Range {
    /// Range from `min` to `max`, both included.
    pub(super) const fn of(min: f64, max: f64) -> Self {
        Self { min, max, because: None, steady: false }
    }

    /// Forbids fluctuations of a schedule.
    pub(super) const fn steady(mut self) -> Self {
        self.steady = true;
        self
    }

    /// Sets the reason for the upper bound.
    pub(super) const fn because(mut self, reason: &'static str) -> Self {
        self.because = Some(reason);
        self
    }
}

/// Closed bounds of an integer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Count {
    pub(super) min: u32,
    pub(super) max: u32,
}

impl Count {
    /// Range from `min` to `max`, both included.
    pub(super) const fn of(min: u32, max: u32) -> Self {
        Self { min, max }
    }
}

/// Describes how a value leaves its range, with the bound. `None` if the value is in the range.
pub(super) fn out_of(value: f64, range: Range, unit: &str) -> Option<String> {
    let with_unit = |v: f64| if unit.is_empty() { number(v).to_string() } else { format!("{} {unit}", number(v)) };
    if value < range.min {
        return Some(format!("is {}, below the least allowed {}", number(value), with_unit(range.min)));
    }
    let because = range.because.map_or_else(String::new, |reason| format!(": {reason}"));
    (value > range.max)
        .then(|| format!("is {}, above the greatest allowed {}{because}", number(value), with_unit(range.max)))
}
