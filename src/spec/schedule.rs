//! A parameter along the tube: piecewise keys over [0, 1] plus an optional fluctuation (paper, section 3:
//! "the initial value and the manner in which each parameter changes").

use std::f64::consts::TAU;

/// How a value moves between two keys.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ease {
    /// Straight line.
    #[default]
    Linear,
    /// Smoothstep, 3x² − 2x³.
    Smooth,
}

/// A sinusoidal fluctuation around the keys; its phase comes from the seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fluctuation {
    /// Amplitude in the unit of the parameter.
    pub amplitude: f64,
    /// Period in steps.
    pub period: f64,
}

/// A value, or a value that changes along the tube.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    pub(super) keys: Vec<[f64; 2]>,
    pub(super) ease: Ease,
    pub(super) fluctuation: Option<Fluctuation>,
}

impl Schedule {
    /// A constant.
    #[must_use]
    pub fn constant(value: f64) -> Self {
        Self { keys: vec![[0.0, value]], ease: Ease::Linear, fluctuation: None }
    }

    /// Keys `[u, value]`, ascending in u.
    #[must_use]
    pub fn keyed(keys: Vec<[f64; 2]>, ease: Ease) -> Self {
        Self { keys, ease, fluctuation: None }
    }

    /// The keyed value at `u`, the fraction of steps (clamped to [0, 1]), without the fluctuation.
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

    /// The value at `step` of `steps`, with the fluctuation; `phase` in turns, from the seed.
    #[must_use]
    pub fn sample(&self, step: f64, steps: f64, phase: f64) -> f64 {
        let wave = self.fluctuation.map_or(0.0, |f| f.amplitude * libm::sin(TAU * (step / f.period + phase)));
        self.at(step / steps) + wave
    }

    /// The least and greatest value that it can take.
    #[must_use]
    pub fn range(&self) -> (f64, f64) {
        let swing = self.fluctuation.map_or(0.0, |f| f.amplitude.abs());
        let low = self.keys.iter().map(|k| k[1]).fold(f64::INFINITY, f64::min);
        let high = self.keys.iter().map(|k| k[1]).fold(f64::NEG_INFINITY, f64::max);
        (low - swing, high + swing)
    }
}
