//! Courses of named shapes.

use super::Course;
use super::integrate::{Heading, integrate};
use crate::random::{self, Stream};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

const WAVES_PER_AXIS: u32 = 8;
/// Amplitudes of a random course, radians: the maximum, and the step of the first search for one.
const MAX_AMPLITUDE: f64 = 3.0;
const AMPLITUDE_STEP: f64 = 0.05;
const BISECTIONS: u32 = 48;
/// Fraction of a turn over which its curvature rises, and over which it falls again.
const RAMP: f64 = 0.2;
/// Steps of the integration of turns per node.
const STEPS_PER_NODE: usize = 4;

/// Parameters of a random course.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomCourse {
    /// Seed of the random numbers.
    pub seed: u64,
    /// Mean wavelength.
    pub wavelength: f64,
    /// Length divided by the distance between the ends.
    pub tortuosity: f64,
}

/// A turn of a course between two straight parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn {
    /// The turning point, which is the middle of the turn, as a fraction of the length.
    pub at: f64,
    /// Angle by which the course turns, radians.
    pub angle: f64,
    /// Direction toward which the course turns, in the rotation-minimising frame: the angle from
    /// its first vector to its second, radians.
    pub toward: f64,
    /// Fraction of the length that the turn takes.
    pub share: f64,
}

impl Turn {
    /// Ends of the turn as fractions of the length.
    #[must_use]
    pub fn ends(&self) -> [f64; 2] {
        [self.at - 0.5 * self.share, self.at + 0.5 * self.share]
    }

    /// Curvature at a fraction of the length, per length: constant except for smooth ramps, so that
    /// a spline can follow it.
    fn curvature(&self, at: f64) -> DVec2 {
        let inside = 0.5 - ((at - self.at) / self.share).abs();
        let x = (inside / RAMP).clamp(0.0, 1.0);
        let (sin, cos) = libm::sincos(self.toward);
        DVec2::new(cos, sin) * (x * x * (3.0 - 2.0 * x) * self.angle / (self.share * (1.0 - RAMP)))
    }
}

impl Course {
    /// Arc of a circle that turns by the angle `turn` towards x.
    #[must_use]
    pub fn arc(turn: f64, length: f64, nodes: usize, twist: f64) -> Self {
        Self::along(|t| heading(turn * t), length, nodes, twist)
    }

    /// S-shaped course: turns by the angle `turn` towards x, then back to its initial direction.
    #[must_use]
    pub fn sigmoid(turn: f64, length: f64, nodes: usize, twist: f64) -> Self {
        Self::along(|t| heading(0.5 * turn * (1.0 - libm::cos(TAU * t))), length, nodes, twist)
    }

    /// Helix with this many windings that advances by `pitch` per winding. `None` if `length` is
    /// too short.
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

    /// Straight parts between turns, which must not overlap.
    #[must_use]
    pub fn turns(turns: &[Turn], length: f64, nodes: usize, twist: f64) -> Self {
        let steps = nodes * STEPS_PER_NODE;
        let bends = (0..steps).map(|i| {
            let at = (i as f64 + 0.5) / steps as f64;
            turns.iter().map(|turn| turn.curvature(at)).sum::<DVec2>() / length
        });
        let begin = Heading { at: DVec3::ZERO, tangent: DVec3::Z, u: DVec3::X };
        let points = integrate(begin, bends, length / steps as f64);
        Self::through_nodes(points.into_iter().step_by(STEPS_PER_NODE).collect(), length, twist)
    }

    /// Random course whose direction oscillates about z as a sum of cosines. The amplitude follows
    /// from the tortuosity; `None` if no amplitude up to the maximum reaches it.
    #[must_use]
    pub fn random(options: &RandomCourse, length: f64, nodes: usize, twist: f64) -> Option<Self> {
        let waves: Vec<[[f64; 2]; 2]> = (0..WAVES_PER_AXIS)
            .map(|i| {
                let unit = random::words(options.seed, Stream::Course, i, 0).map(|word| f64::from(random::unit(word)));
                // Wave numbers vary by ±30 %.
                [0, 1].map(|axis| [TAU * length * (0.7 + 0.6 * unit[axis]) / options.wavelength, TAU * unit[2 + axis]])
            })
            .collect();
        let swing = |t: f64, axis: usize| -> f64 {
            waves.iter().map(|wave| libm::cos(wave[axis][0] * t + wave[axis][1])).sum::<f64>()
                / f64::from(WAVES_PER_AXIS).sqrt()
        };
        // All amplitudes share these samples.
        let samples: Vec<[f64; 2]> =
            (0..=2 * nodes).map(|k| [0, 1].map(|axis| swing(k as f64 / (2 * nodes) as f64, axis))).collect();
        let tortuosity = |amplitude: f64| {
            let sum: DVec3 = samples.iter().map(|&[x, y]| tilted(amplitude * x, amplitude * y)).sum();
            samples.len() as f64 / sum.length()
        };
        let steps = (MAX_AMPLITUDE / AMPLITUDE_STEP) as u32;
        let above = (1..=steps)
            .map(|k| f64::from(k) * AMPLITUDE_STEP)
            .find(|&amplitude| tortuosity(amplitude) >= options.tortuosity)?;
        let [mut low, mut high] = [above - AMPLITUDE_STEP, above];
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if tortuosity(middle) < options.tortuosity { low = middle } else { high = middle }
        }
        let direction = |t: f64| tilted(high * swing(t, 0), high * swing(t, 1));
        Some(Self::along(direction, length, nodes, twist))
    }
}

/// Unit vector at an angle from z towards x.
fn heading(angle: f64) -> DVec3 {
    let (sin, cos) = libm::sincos(angle);
    DVec3::new(sin, 0.0, cos)
}

/// Unit vector at an angle from z: the length of (x, y), towards (x, y).
fn tilted(x: f64, y: f64) -> DVec3 {
    let angle = (x * x + y * y).sqrt();
    let (sin, cos) = libm::sincos(angle);
    let part = if angle > 0.0 { sin / angle } else { 1.0 };
    DVec3::new(part * x, part * y, cos)
}
