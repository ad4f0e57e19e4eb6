//! A parameter along the tube: keys over [0, 1] and an optional fluctuation (paper, section 3: "the
//! initial value and the manner in which each parameter changes").
//!
//! Invariant: a constant has one key, at 0. Any other schedule has at least two keys at strictly
//! increasing fractions, the first at 0, the last at 1. Equal schedules therefore compare equal.

use super::table::choice;
use std::f64::consts::TAU;

choice! {
    /// How a value changes between two keys.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum Ease {
        /// Straight line.
        #[default]
        Linear = "linear",
        /// Smoothstep, 3x² − 2x³.
        Smooth = "smooth",
    }
}

/// A sinusoidal fluctuation about the keyed value. Its phase follows from the seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fluctuation {
    /// Amplitude in the unit of the parameter.
    pub amplitude: f64,
    /// Period in steps.
    pub period: f64,
}

/// A value that may change along the tube.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    pub(super) keys: Vec<[f64; 2]>,
    pub(super) ease: Ease,
    pub(super) fluctuation: Option<Fluctuation>,
}

impl Schedule {
    /// Creates a constant.
    #[must_use]
    pub fn constant(value: f64) -> Self {
        Self { keys: vec![[0.0, value]], ease: Ease::Linear, fluctuation: None }
    }

    /// Creates a schedule from keys that the reader has checked. Keys with equal values become a
    /// constant.
    pub(super) fn new(keys: Vec<[f64; 2]>, ease: Ease, fluctuation: Option<Fluctuation>) -> Self {
        match keys.first() {
            Some(&[_, first]) if keys.iter().all(|[_, v]| *v == first) => Self { fluctuation, ..Self::constant(first) },
            _ => Self { keys, ease, fluctuation },
        }
    }

    /// Fractions of the steps at which there are keys.
    pub(super) fn fractions(&self) -> impl Iterator<Item = f64> + '_ {
        self.keys.iter().map(|k| k[0])
    }

    /// Keyed value at the fraction `u` of the steps (clamped to [0, 1]), without the fluctuation.
    #[must_use]
    pub fn at(&self, u: f64) -> f64 {
        let u = u.clamp(0.0, 1.0);
        let next = self.keys.partition_point(|k| k[0] <= u);
        match (next.checked_sub(1).map(|i| self.keys[i]), self.keys.get(next)) {
            (Some([u0, v0]), Some(&[u1, v1])) => {
                let x = (u - u0) / (u1 - u0);
                let x = match self.ease {
                    Ease::Linear => x,
                    Ease::Smooth => x * x * (3.0 - 2.0 * x),
                };
                v0 + (v1 - v0) * x
            }
            (Some([_, v]), None) | (None, Some(&[_, v])) => v,
            (None, None) => 0.0,
        }
    }

    /// Value at `step` of `steps`, including the fluctuation. `phase` is in turns.
    #[must_use]
    pub fn sample(&self, step: f64, steps: f64, phase: f64) -> f64 {
        let wave = self.fluctuation.map_or(0.0, |f| f.amplitude * libm::sin(TAU * (step / f.period + phase)));
        self.at(step / steps) + wave
    }

    /// Minimum and maximum value, including the fluctuation.
    #[must_use]
    pub fn range(&self) -> (f64, f64) {
        let swing = self.fluctuation.map_or(0.0, |f| f.amplitude.abs());
        let low = self.keys.iter().map(|k| k[1]).fold(f64::INFINITY, f64::min);
        let high = self.keys.iter().map(|k| k[1]).fold(f64::NEG_INFINITY, f64::max);
        (low - swing, high + swing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn schedule() -> impl Strategy<Value = Schedule> {
        let keys = prop::collection::vec((0.01..1.0, -1e3..1e3), 1..8);
        let wave = prop::option::of((0.0..10.0, 2.0..500.0));
        (keys, any::<bool>(), wave).prop_map(|(steps, smooth, wave)| {
            let total: f64 = steps.iter().skip(1).map(|s| s.0).sum();
            let mut u = 0.0;
            let last = steps.len() - 1;
            let keys = steps.iter().enumerate().map(|(i, (du, v))| {
                u += if i == 0 { 0.0 } else { du / total };
                [if i == last && i > 0 { 1.0 } else { u }, *v]
            });
            let ease = if smooth { Ease::Smooth } else { Ease::Linear };
            let fluctuation = wave.map(|(amplitude, period)| Fluctuation { amplitude, period });
            Schedule::new(keys.collect(), ease, fluctuation)
        })
    }

    proptest! {
        #[test]
        fn samples_stay_in_range(s in schedule(), step in -10.0..2100.0, phase in 0.0..1.0) {
            let (low, high) = s.range();
            let v = s.sample(step, 2000.0, phase);
            prop_assert!(v >= low - 1e-9 && v <= high + 1e-9, "{v} outside {low}..{high}");
        }

        #[test]
        fn it_passes_through_its_keys(s in schedule()) {
            for &[u, v] in &s.keys {
                prop_assert!((s.at(u) - v).abs() <= 1e-9 * v.abs().max(1.0));
            }
        }
    }

    #[test]
    fn eases_differ_between_keys_only() {
        let keys = vec![[0.0, 0.0], [1.0, 8.0]];
        let linear = Schedule::new(keys.clone(), Ease::Linear, None);
        let smooth = Schedule::new(keys, Ease::Smooth, None);
        assert_eq!((linear.at(0.25), smooth.at(0.25)), (2.0, 1.25));
        assert_eq!((linear.at(0.5), smooth.at(0.5)), (4.0, 4.0));
        assert_eq!((smooth.at(-1.0), smooth.at(2.0)), (0.0, 8.0));
    }

    #[test]
    fn a_fluctuation_turns_with_its_period_and_phase() {
        let wave = Some(Fluctuation { amplitude: 2.0, period: 100.0 });
        let s = Schedule::new(vec![[0.0, 5.0], [1.0, 5.0]], Ease::Smooth, wave);
        assert_eq!(s.sample(0.0, 2000.0, 0.0), 5.0);
        assert!((s.sample(25.0, 2000.0, 0.0) - 7.0).abs() < 1e-12);
        assert!((s.sample(0.0, 2000.0, 0.75) - 3.0).abs() < 1e-12);
        assert_eq!(s.range(), (3.0, 7.0));
    }
}
