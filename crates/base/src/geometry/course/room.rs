//! Whether there is room for a tube along a course: its radius against the curvature, and the distance of far parts.
//!
//! A tube with round sections of radius ρ(s) across the centre line contains ours. Two of its sections do not meet
//! - if the curve between them has a curvature of at most K, is no longer than π/K, and all radii there are below 1/K (such a curve has
//!   a reach of 1/K or more; Federer, *Curvature measures*, 1959), or
//! - if their centres are farther apart than the sum of their radii.
//!
//! A place between samples is at most a step from the sample before it; that is subtracted from distances, once for each of the two.

use super::Course;
use std::f64::consts::PI;

/// Most samples of which all pairs are compared.
const SAMPLES: usize = 1024;

/// The place at which the tube is bent most, for its radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bend {
    /// Place along the course.
    pub at: f64,
    /// Radius of curvature; infinite if the course is straight.
    pub curve: f64,
    /// Radius of the tube.
    pub tube: f64,
}

impl Bend {
    /// The radius of the tube over that of the curve: 0 if it is straight; at 1 the tissue at the inner side would have no length.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.tube / self.curve
    }
}

/// Far parts of the tube that come nearest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Their places along the course.
    pub at: [f64; 2],
    /// At least this far apart; negative if the bound cannot exclude that they meet.
    pub distance: f64,
}

/// How much room there is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Room {
    /// Where the tube is bent most.
    pub bend: Bend,
    /// Where far parts come nearest; none if the course does not turn far enough for that.
    pub near: Option<Near>,
}

/// A part of the course around a sample.
struct Sample {
    at: f64,
    point: glam::DVec3,
    /// Greatest curvature and radius up to the next sample.
    curvature: f64,
    radius: f64,
}

impl Course {
    /// The room for a tube whose radius is a function of the place.
    #[must_use]
    pub fn room(&self, radius: &dyn Fn(f64) -> f64) -> Room {
        let places = self.places();
        let nodes: Vec<[f64; 2]> = places.iter().map(|&at| [self.curvature(at), radius(at)]).collect();
        let most =
            (0..nodes.len()).max_by(|&i, &j| (nodes[i][0] * nodes[i][1]).total_cmp(&(nodes[j][0] * nodes[j][1])));
        let most = most.unwrap_or(0);
        let bend = Bend { at: places[most], curve: 1.0 / nodes[most][0], tube: nodes[most][1] };

        let stride = places.len().div_ceil(SAMPLES);
        let samples: Vec<Sample> = (0..nodes.len())
            .step_by(stride)
            .map(|i| {
                let greatest =
                    |k: usize| nodes[i..nodes.len().min(i + stride + 1)].iter().map(|of| of[k]).fold(0.0, f64::max);
                Sample { at: places[i], point: self.line.points()[i], curvature: greatest(0), radius: greatest(1) }
            })
            .collect();
        let step = stride as f64 * (places[1] - places[0]);
        let mut near: Option<Near> = None;
        for (i, from) in samples.iter().enumerate() {
            let (mut curvature, mut widest) = (from.curvature, from.radius);
            for to in &samples[i + 1..] {
                curvature = curvature.max(to.curvature);
                widest = widest.max(to.radius);
                if curvature * (to.at - from.at + step) <= PI && curvature * widest < 1.0 {
                    continue;
                }
                let distance = from.point.distance(to.point) - 2.0 * step - from.radius - to.radius;
                if near.is_none_or(|found| distance < found.distance) {
                    near = Some(Near { at: [from.at, to.at], distance });
                }
            }
        }
        Room { bend, near }
    }
}
