//! Variety around the wall: folds grow at different rates and have different force ranges,
//! depending on the angle of their anchors.

use crate::sim::layout::StepRow;
use crate::sim::maths::CUT;
use crate::sim::plan::Plan;
use std::f64::consts::TAU;

/// Weight in growth of an edge that grows at the mean rate.
pub(super) const WEIGHT: f32 = 16.0;
/// Maximum weight.
pub(super) const HEAVIEST: f32 = 255.0;

/// Variety at a step.
pub(super) struct Around<'a> {
    row: &'a StepRow,
    /// For each number of maxima, the cosine and sine coefficients of heights, thickness and shift.
    coefficients: Vec<[[f32; 2]; 3]>,
}

/// Values of the fields at an angle.
struct Fields {
    side: f32,
    height: f32,
    thickness: f32,
    shift: f32,
}

impl<'a> Around<'a> {
    /// Variety at step `time`; `None` without variety.
    pub(super) fn new(plan: &'a Plan, time: i64) -> Option<Self> {
        let row = plan.at(time);
        let strengths = [row.asymmetry, row.height, row.thickness, row.shift[0], row.shift[1]];
        let is_on = strengths.iter().any(|&strength| strength != 0.0);
        is_on.then(|| Self { row, coefficients: coefficients(plan, time) })
    }

    /// Logarithm of the growth rate of an edge whose first particle has this anchor.
    pub(super) fn rate(&self, anchor: [f32; 2]) -> f32 {
        let (row, at) = (self.row, self.fields(anchor));
        row.asymmetry * at.side + row.height * at.height + row.shift[0] * at.shift
    }

    /// Factor of the force ranges of a particle with this anchor.
    pub(super) fn ranges(&self, anchor: [f32; 2]) -> f32 {
        let at = self.fields(anchor);
        libm::expf(self.row.thickness * at.thickness + self.row.shift[1] * at.shift)
    }

    fn fields(&self, [x, y]: [f32; 2]) -> Fields {
        let (mut cos, mut sin) = (1.0f32, 0.0f32);
        let (mut side, mut sums) = (0.0, [0.0f32; 3]);
        for (order, terms) in (1..).zip(&self.coefficients) {
            (cos, sin) = (cos * x - sin * y, sin * x + cos * y);
            let values = terms.map(|[a, b]| a * cos + b * sin);
            if order == 1 {
                side = values[0];
            } else {
                sums[0] += values[0];
            }
            sums[1] += values[1];
            sums[2] += values[2];
        }
        let count = self.coefficients.len() as f32;
        let scaled = |sum: f32, count: f32| (sum * (2.0 / count).sqrt()).clamp(-CUT, CUT);
        Fields {
            side,
            height: scaled(sums[0], count - 1.0),
            thickness: scaled(sums[1], count),
            shift: scaled(sums[2], count),
        }
    }
}

/// Coefficients of all modes at a step.
pub(in crate::sim) fn coefficients(plan: &Plan, time: i64) -> Vec<[[f32; 2]; 3]> {
    let of = |phase: f64, drift: f64| {
        let angle = TAU * (phase + drift * time as f64);
        [libm::cos(angle) as f32, -libm::sin(angle) as f32]
    };
    plan.modes.iter().map(|mode| mode.phases.map(|phase| of(phase, mode.drift))).collect()
}
