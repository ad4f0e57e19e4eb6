//! Room for a tube along a course: tube radius against curvature, and the distance between distant
//! parts.
//!
//! The tube is contained in one with round sections of radius ρ(s). Two of these sections are
//! disjoint if one of two conditions holds:
//! - The curvature between them is at most K, the arc is at most π/K long, and all radii are below
//!   1/K. Such an arc has a reach of at least 1/K (Federer, *Curvature measures*, 1959).
//! - Their centres are farther apart than the sum of their radii.
//!
//! Places are sampled. Any place is at most one step from the sample before it, so two steps are
//! subtracted from the distance of two samples.

use super::Course;
use std::f64::consts::PI;

/// Maximum number of samples. All pairs of them are compared.
const MAX_SAMPLES: usize = 1024;

/// The place with the largest ratio of tube radius to curve radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bend {
    /// Place along the course.
    pub at: f64,
    /// Radius of curvature; infinite on a straight course.
    pub curve: f64,
    /// Radius of the tube.
    pub tube: f64,
}

impl Bend {
    /// Radius of the tube divided by the radius of curvature: 0 if straight. At 1, tissue on the
    /// inner side would be compressed to length 0.
    #[must_use]
    pub fn radius_ratio(&self) -> f64 {
        self.tube / self.curve
    }
}

/// The pair of distant places at which the tube comes closest to itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Places along the course.
    pub at: [f64; 2],
    /// Lower bound of the distance between the walls. If negative, the walls may intersect.
    pub distance: f64,
}

/// Room for a tube along a course.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Room {
    /// The tightest bend.
    pub bend: Bend,
    /// The closest distant parts. `None` if the course turns too little for parts to approach each
    /// other.
    pub near: Option<Near>,
}

/// A sampled place, standing for the course up to the next sample.
struct Sample {
    at: f64,
    point: glam::DVec3,
    /// Maximum curvature and radius up to the next sample.
    curvature: f64,
    radius: f64,
}

impl Course {
    /// Computes the room for a tube. `radius` returns the radius of the tube at a place.
    #[must_use]
    pub fn room(&self, radius: &dyn Fn(f64) -> f64) -> Room {
        let places = self.places();
        let nodes: Vec<[f64; 2]> = places.iter().map(|&at| [self.curvature(at), radius(at)]).collect();
        let tightest =
            (0..nodes.len()).max_by(|&i, &j| (nodes[i][0] * nodes[i][1]).total_cmp(&(nodes[j][0] * nodes[j][1])));
        let tightest = tightest.unwrap_or(0);
        let bend = Bend { at: places[tightest], curve: 1.0 / nodes[tightest][0], tube: nodes[tightest][1] };

        let stride = places.len().div_ceil(MAX_SAMPLES);
        let samples: Vec<Sample> = (0..nodes.len())
            .step_by(stride)
            .map(|i| {
                let maximum =
                    |k: usize| nodes[i..nodes.len().min(i + stride + 1)].iter().map(|node| node[k]).fold(0.0, f64::max);
                Sample { at: places[i], point: self.line.points()[i], curvature: maximum(0), radius: maximum(1) }
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
