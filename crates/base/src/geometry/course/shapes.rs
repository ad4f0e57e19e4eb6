//! Courses by name.

use super::Course;
use crate::random::{self, Stream};
use glam::DVec3;
use std::f64::consts::TAU;

/// Cosines in each direction of a random course.
const WAVES: u32 = 8;
/// Least tortuosity that amplitudes are searched for, and the greatest amplitude, radians.
const GREATEST_SWING: f64 = 3.0;
const SWING_STEP: f64 = 0.05;
const HALVINGS: u32 = 48;

/// A random course.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Random {
    /// Seed of the source of randomness.
    pub seed: u64,
    /// Mean wavelength.
    pub wavelength: f64,
    /// Length over the distance of the ends.
    pub tortuosity: f64,
}

impl Course {
    /// An arc of a circle that turns by an angle, toward x.
    #[must_use]
    pub fn arc(turn: f64, length: f64, nodes: usize, twist: f64) -> Self {
        Self::along(|t| heading(turn * t), length, nodes, twist)
    }

    /// An S: it turns toward x by an angle and back to where it began.
    #[must_use]
    pub fn sigmoid(turn: f64, length: f64, nodes: usize, twist: f64) -> Self {
        Self::along(|t| heading(0.5 * turn * (1.0 - libm::cos(TAU * t))), length, nodes, twist)
    }

    /// A helix of so many windings, which advances by `pitch` in each; none if it is too short for that.
    #[must_use]
    pub fn coil(windings: f64, pitch: f64, length: f64, nodes: usize, twist: f64) -> Option<Self> {
        let rise = pitch * windings / length;
        let across = (1.0 - rise * rise).sqrt();
        let direction = |t: f64| {
            let (sin, cos) = libm::sincos(TAU * windings * t);
            DVec3::new(across * sin, rise, across * cos)
        };
        (rise < 1.0).then(|| Self::along(direction, length, nodes, twist))
    }

    /// A random course: its direction swings about z by sums of cosines, as far as the tortuosity demands. None if no swing gives it.
    #[must_use]
    pub fn random(of: &Random, length: f64, nodes: usize, twist: f64) -> Option<Self> {
        let waves: Vec<[[f64; 2]; 2]> = (0..WAVES)
            .map(|i| {
                let unit = random::words(of.seed, Stream::Course, i, 0).map(|word| f64::from(random::unit(word)));
                // Wave numbers vary by ±30 %.
                [0, 1].map(|axis| [TAU * length * (0.7 + 0.6 * unit[axis]) / of.wavelength, TAU * unit[2 + axis]])
            })
            .collect();
        let swing = |t: f64, axis: usize| -> f64 {
            waves.iter().map(|wave| libm::cos(wave[axis][0] * t + wave[axis][1])).sum::<f64>() / f64::from(WAVES).sqrt()
        };
        // Computed once, as all amplitudes share them.
        let samples: Vec<[f64; 2]> =
            (0..=2 * nodes).map(|k| [0, 1].map(|axis| swing(k as f64 / (2 * nodes) as f64, axis))).collect();
        let tortuosity = |amplitude: f64| {
            let sum: DVec3 = samples.iter().map(|&[x, y]| tilted(amplitude * x, amplitude * y)).sum();
            samples.len() as f64 / sum.length()
        };
        let steps = (GREATEST_SWING / SWING_STEP) as u32;
        let above = (1..=steps).map(|k| f64::from(k) * SWING_STEP).find(|&swing| tortuosity(swing) >= of.tortuosity)?;
        let [mut low, mut high] = [above - SWING_STEP, above];
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if tortuosity(middle) < of.tortuosity { low = middle } else { high = middle }
        }
        let direction = |t: f64| tilted(high * swing(t, 0), high * swing(t, 1));
        Some(Self::along(direction, length, nodes, twist))
    }
}

/// A unit vector turned from z toward x.
fn heading(angle: f64) -> DVec3 {
    let (sin, cos) = libm::sincos(angle);
    DVec3::new(sin, 0.0, cos)
}

/// A unit vector turned from z by the length of (x, y), in its direction.
fn tilted(x: f64, y: f64) -> DVec3 {
    let angle = (x * x + y * y).sqrt();
    let (sin, cos) = libm::sincos(angle);
    let part = if angle > 0.0 { sin / angle } else { 1.0 };
    DVec3::new(part * x, part * y, cos)
}
