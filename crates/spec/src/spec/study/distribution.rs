//! Quantiles (inverse cumulative distribution functions) of distributions.
//!
//! Only libm is used, so a study has the same points on every platform.

use std::f64::consts::SQRT_2;

/// Minimum probability of the interval to which a distribution is truncated.
const MIN_MASS: f64 = 1e-6;

/// A distribution of real numbers with valid parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Distribution {
    /// Uniform between two numbers.
    Uniform { from: f64, to: f64 },
    /// The logarithm is uniform.
    LogUniform { from: f64, to: f64 },
    /// The density rises linearly from 0 at `from` to its maximum at `mode` and falls linearly to 0
    /// at `to`.
    Triangular { from: f64, mode: f64, to: f64 },
    /// Normal, truncated to an interval.
    Normal(Normal),
    /// The natural logarithm is normal.
    LogNormal(Normal),
}

/// A normal distribution, truncated to an interval that may be infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Normal {
    /// Mean before truncation.
    pub(super) mean: f64,
    /// Standard deviation before truncation.
    pub(super) sd: f64,
    /// Lower end of the interval.
    pub(super) min: f64,
    /// Upper end of the interval.
    pub(super) max: f64,
}

impl Normal {
    /// Probabilities below `min` and below `max`, before truncation.
    fn end_probabilities(self) -> [f64; 2] {
        [self.min, self.max].map(|end| standard_cumulative((end - self.mean) / self.sd))
    }

    /// True if the probability of the interval is large enough for accurate quantiles.
    pub(super) fn has_mass(self) -> bool {
        let [low, high] = self.end_probabilities();
        high - low >= MIN_MASS
    }

    fn quantile(self, u: f64) -> f64 {
        let [low, high] = self.end_probabilities();
        (self.mean + self.sd * standard_quantile(low + u * (high - low))).clamp(self.min, self.max)
    }
}

impl Distribution {
    /// Number below which the fraction `u` of the distribution lies; 0 < `u` < 1.
    pub(super) fn quantile(self, u: f64) -> f64 {
        match self {
            Self::Uniform { from, to } => (from + u * (to - from)).clamp(from, to),
            Self::LogUniform { from, to } => {
                let (low, high) = (libm::log(from), libm::log(to));
                libm::exp(low + u * (high - low)).clamp(from, to)
            }
            Self::Triangular { from, mode, to } => {
                let width = to - from;
                let rising = (mode - from) / width;
                let value = if u < rising {
                    from + libm::sqrt(u * width * (mode - from))
                } else {
                    to - libm::sqrt((1.0 - u) * width * (to - mode))
                };
                value.clamp(from, to)
            }
            Self::Normal(normal) => normal.quantile(u),
            Self::LogNormal(normal) => libm::exp(normal.quantile(u)),
        }
    }
}

/// Probability that a standard normal variable is below `z`.
fn standard_cumulative(z: f64) -> f64 {
    0.5 * libm::erfc(-z / SQRT_2)
}

/// Inverse of [`standard_cumulative`], by bisection.
fn standard_quantile(p: f64) -> f64 {
    // Beyond 9 standard deviations, probabilities round to 0 or 1.
    let (mut low, mut high) = (-9.0, 9.0);
    for _ in 0..64 {
        let middle = 0.5 * (low + high);
        if standard_cumulative(middle) < p {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    const INFINITE: f64 = f64::INFINITY;

    /// Mean and standard deviation of 20,000 quantiles.
    fn moments(distribution: Distribution) -> (f64, f64) {
        let n = 20_000;
        let values: Vec<f64> = (0..n).map(|i| distribution.quantile((f64::from(i) + 0.5) / f64::from(n))).collect();
        assert!(values.is_sorted());
        let mean = values.iter().sum::<f64>() / f64::from(n);
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / f64::from(n);
        (mean, variance.sqrt())
    }

    #[test]
    fn moments_are_those_of_the_formulas() {
        let free = |mean, sd| Normal { mean, sd, min: -INFINITE, max: INFINITE };
        // Truncated by one standard deviation on each side, then a half-normal distribution.
        let cut = Normal { min: 5.0, max: 15.0, ..free(10.0, 5.0) };
        let half = Normal { min: 10.0, ..free(10.0, 5.0) };
        let e = std::f64::consts::E;
        for (distribution, mean, sd) in [
            (Distribution::Uniform { from: 2.0, to: 8.0 }, 5.0, 6.0 / 12_f64.sqrt()),
            (
                Distribution::LogUniform { from: 1.0, to: e },
                e - 1.0,
                ((e * e - 1.0) / 2.0 - (e - 1.0) * (e - 1.0)).sqrt(),
            ),
            (Distribution::Triangular { from: 0.0, mode: 3.0, to: 12.0 }, 5.0, (117_f64 / 18.0).sqrt()),
            (Distribution::Triangular { from: 0.0, mode: 0.0, to: 3.0 }, 1.0, 0.5_f64.sqrt()),
            (Distribution::Normal(free(10.0, 5.0)), 10.0, 5.0),
            (Distribution::Normal(cut), 10.0, 5.0 * 0.539_560_09),
            (Distribution::Normal(half), 10.0 + 5.0 * 0.797_884_56, 5.0 * 0.602_810_27),
            (Distribution::LogNormal(free(0.0, 0.5)), 1.133_148_45, 0.603_900_53),
        ] {
            let found = moments(distribution);
            assert!((found.0 - mean).abs() < 2e-3 * sd, "{distribution:?}: mean {} and not {mean}", found.0);
            assert!((found.1 - sd).abs() < 5e-3 * sd, "{distribution:?}: sd {} and not {sd}", found.1);
        }
    }

    #[test]
    fn quantiles_of_the_normal_distribution_are_those_of_tables() {
        for (p, z) in [(0.5, 0.0), (0.975, 1.959_963_984_540), (0.01, -2.326_347_874_041), (1e-6, -4.753_424_308_823)] {
            assert!((standard_quantile(p) - z).abs() < 1e-9, "{p}");
        }
    }

    #[test]
    fn values_stay_within_their_ends() {
        let cut = Normal { mean: 30.0, sd: 100.0, min: 25.0, max: 50.0 };
        for distribution in [
            Distribution::Uniform { from: 25.0, to: 50.0 },
            Distribution::LogUniform { from: 25.0, to: 50.0 },
            Distribution::Triangular { from: 25.0, mode: 50.0, to: 50.0 },
            Distribution::Normal(cut),
        ] {
            for u in [f64::EPSILON, 1e-9, 0.3, 1.0 - f64::EPSILON] {
                assert!((25.0..=50.0).contains(&distribution.quantile(u)), "{distribution:?} at {u}");
            }
        }
        assert!(cut.has_mass());
        assert!(!Normal { mean: 0.0, sd: 1.0, min: 7.0, max: 9.0 }.has_mass());
    }
}
