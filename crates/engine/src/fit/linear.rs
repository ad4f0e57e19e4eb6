//! Linear model of the deviations near the best candidate: the change of each target with each
//! variable.

use super::evaluate::Candidate;
use super::target::{Target, weight};

/// Damping of slopes, because candidates are few at first.
const RIDGE: f64 = 1e-3;
/// Damping of steps.
const DAMPING: f64 = 3e-3;
/// Number of sweeps of the descent; far more than problems of this size need.
const SWEEPS: usize = 400;

/// Deviations of all targets as linear functions of the places, from candidates weighted by their
/// distance to the centre.
#[derive(Clone, Debug)]
pub(super) struct Linear {
    pub(super) centre: Vec<f64>,
    /// Deviations at the centre.
    pub(super) deviations: Vec<f64>,
    /// By target and variable: change of the deviation from the lower to the upper bound.
    pub(super) slopes: Vec<Vec<f64>>,
}

impl Linear {
    pub(super) fn around(centre: &Candidate, candidates: &[Candidate], targets: &[Target]) -> Self {
        let n = centre.places.len();
        let deviations = deviations(centre, targets);
        let steps: Vec<Vec<f64>> =
            candidates.iter().map(|c| c.places.iter().zip(&centre.places).map(|(x, x0)| x - x0).collect()).collect();
        let mut distances: Vec<f64> = steps.iter().map(|step| square(step)).filter(|&d| d > 0.0).collect();
        distances.sort_unstable_by(f64::total_cmp);
        // Width of the weights: the distance of the candidate whose rank is twice the number of
        // variables.
        let width = distances.get((2 * n).min(distances.len().saturating_sub(1))).copied().unwrap_or(1.0);
        let weights: Vec<f64> = steps.iter().map(|step| (-square(step) / width.max(1e-12)).exp()).collect();
        let total: f64 = weights.iter().sum();
        let mut products = vec![vec![0.0; n]; n];
        for (step, weight) in steps.iter().zip(&weights) {
            for i in 0..n {
                for j in 0..n {
                    products[i][j] += weight * step[i] * step[j];
                }
            }
        }
        for (i, row) in products.iter_mut().enumerate() {
            row[i] += RIDGE * width * total;
        }
        let unbounded = vec![[f64::NEG_INFINITY, f64::INFINITY]; n];
        let all: Vec<Vec<f64>> = candidates.iter().map(|c| self::deviations(c, targets)).collect();
        let slopes = (0..targets.len())
            .map(|t| {
                let mut right = vec![0.0; n];
                for ((step, weight), known) in steps.iter().zip(&weights).zip(&all) {
                    // Distant candidates contain little information about the slopes here, and
                    // their deviations may be very large.
                    let change = (known[t] - deviations[t]).clamp(-50.0, 50.0);
                    right.iter_mut().zip(step).for_each(|(r, s)| *r += weight * s * change);
                }
                minimize(&products, &right, &unbounded)
            })
            .collect();
        Self { centre: centre.places.clone(), deviations, slopes }
    }

    /// Places where the model has the minimum sum of squared deviations, at most `reach` away in
    /// each variable.
    pub(super) fn step(&self, reach: f64) -> Vec<f64> {
        let n = self.centre.len();
        let mut products = vec![vec![0.0; n]; n];
        let mut right = vec![0.0; n];
        for (slopes, deviation) in self.slopes.iter().zip(&self.deviations) {
            let weight = weight(*deviation);
            for i in 0..n {
                right[i] -= weight * slopes[i] * deviation;
                for j in 0..n {
                    products[i][j] += weight * slopes[i] * slopes[j];
                }
            }
        }
        let largest = (0..n).map(|i| products[i][i]).fold(0.0, f64::max);
        for (i, row) in products.iter_mut().enumerate() {
            row[i] += DAMPING * largest.max(1e-9);
        }
        let bounds: Vec<[f64; 2]> = self.centre.iter().map(|x| [(-x).max(-reach), (1.0 - x).min(reach)]).collect();
        let step = minimize(&products, &right, &bounds);
        self.centre.iter().zip(step).map(|(x, d)| (x + d).clamp(0.0, 1.0)).collect()
    }

    /// Corner of the bounds where the model brings a target nearest to its value. Variables that do
    /// not change the target keep their places.
    pub(super) fn corner(&self, target: usize, least: f64) -> Vec<f64> {
        let towards = -self.deviations[target];
        let place = |(x, slope): (&f64, &f64)| match slope * towards {
            _ if slope.abs() < least => *x,
            gain if gain > 0.0 => 1.0,
            _ => 0.0,
        };
        self.centre.iter().zip(&self.slopes[target]).map(place).collect()
    }
}

fn deviations(candidate: &Candidate, targets: &[Target]) -> Vec<f64> {
    targets.iter().zip(&candidate.measures).map(|(target, measured)| target.deviation(*measured)).collect()
}

fn square(step: &[f64]) -> f64 {
    step.iter().map(|x| x * x).sum()
}

/// Minimizes x·Ax/2 − b·x between bounds, for a symmetric positive definite A, by coordinate
/// descent.
fn minimize(a: &[Vec<f64>], b: &[f64], bounds: &[[f64; 2]]) -> Vec<f64> {
    let mut x = vec![0.0; b.len()];
    for _ in 0..SWEEPS {
        for i in 0..x.len() {
            let others: f64 = (0..x.len()).filter(|&j| j != i).map(|j| a[i][j] * x[j]).sum();
            let free = if a[i][i] > 0.0 { (b[i] - others) / a[i][i] } else { 0.0 };
            x[i] = free.clamp(bounds[i][0], bounds[i][1]);
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(value: f64) -> Target {
        Target {
            region: "ampulla".into(),
            quantity: "fill".into(),
            value,
            low: value - 1.0,
            high: value + 1.0,
            source: None,
        }
    }

    /// Measures 10 + 8x − 4y and 5 + 2y.
    fn candidate(x: f64, y: f64) -> Candidate {
        Candidate { places: vec![x, y], measures: vec![Some(10.0 + 8.0 * x - 4.0 * y), Some(5.0 + 2.0 * y)] }
    }

    fn model() -> Linear {
        let places = [(0.5, 0.5), (0.3, 0.6), (0.7, 0.2), (0.1, 0.9), (0.45, 0.4), (0.6, 0.6), (0.2, 0.3)];
        let all: Vec<Candidate> = places.iter().map(|&(x, y)| candidate(x, y)).collect();
        Linear::around(&all[0], &all, &[target(15.0), target(5.5)])
    }

    #[test]
    fn slopes_of_a_linear_model_are_found() {
        let model = model();
        assert_eq!(model.deviations, [-3.0, 0.5]);
        for (slope, truth) in model.slopes.iter().flatten().zip([8.0, -4.0, 0.0, 2.0]) {
            assert!((slope - truth).abs() < 0.15, "{:?}", model.slopes);
        }
    }

    #[test]
    fn a_step_leads_to_the_targets_or_to_the_bounds() {
        // 10 + 8x − 4y = 15 and 5 + 2y = 5.5.
        let [x, y]: [f64; 2] = model().step(1.0).try_into().unwrap();
        assert!((x - 0.75).abs() < 0.06 && (y - 0.25).abs() < 0.06, "{x} {y}");
        let short = model().step(0.1);
        assert!(short.iter().all(|x| (x - 0.5).abs() < 0.1 + 1e-12), "{short:?}");
        assert_eq!(model().corner(0, 0.5), [1.0, 0.0]);
        assert_eq!(model().corner(1, 0.5), [0.5, 0.0]);
    }

    #[test]
    fn minima_respect_bounds() {
        let a = vec![vec![2.0, 1.0], vec![1.0, 3.0]];
        let free = minimize(&a, &[1.0, 2.0], &[[f64::NEG_INFINITY, f64::INFINITY]; 2]);
        assert!((free[0] - 0.2).abs() < 1e-9 && (free[1] - 0.6).abs() < 1e-9, "{free:?}");
        let bound = minimize(&a, &[1.0, 2.0], &[[-1.0, 1.0], [-1.0, 0.3]]);
        assert!((bound[0] - 0.35).abs() < 1e-9 && bound[1] == 0.3, "{bound:?}");
    }
}
