//! Distributions of times.

use hdrhistogram::Histogram;
use serde::Serialize;
use std::time::Duration;

/// Creates a histogram of times in microseconds with this many significant digits (at most 5).
pub(super) fn histogram(digits: u8) -> Histogram<u64> {
    Histogram::new(digits).expect("at most 5 digits")
}

/// Adds a time.
pub(super) fn add(histogram: &mut Histogram<u64>, time: Duration) {
    // Only times above 584,000 years do not fit.
    let micros = u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
    histogram.record(micros).expect("the histogram grows with its values");
}

/// Percentiles of a distribution in seconds; all 0 if the distribution is empty.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Times {
    pub(super) mean: f64,
    pub(super) p50: f64,
    pub(super) p90: f64,
    pub(super) p99: f64,
    pub(super) p999: f64,
    pub(super) max: f64,
}

impl Times {
    pub(super) fn of(histogram: &Histogram<u64>) -> Self {
        if histogram.is_empty() {
            return Self::default();
        }
        let at = |share| 1e-6 * histogram.value_at_quantile(share) as f64;
        let max = 1e-6 * histogram.max() as f64;
        Self { mean: 1e-6 * histogram.mean(), p50: at(0.5), p90: at(0.9), p99: at(0.99), p999: at(0.999), max }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_exact_to_three_digits() {
        let mut all = histogram(3);
        for ms in (1..=1000).rev() {
            add(&mut all, Duration::from_millis(ms));
        }
        let times = Times::of(&all);
        let found = [times.mean, times.p50, times.p90, times.p99, times.p999, times.max];
        for (found, expected) in found.into_iter().zip([0.5005, 0.5, 0.9, 0.99, 0.999, 1.0]) {
            assert!((found / expected - 1.0f64).abs() < 2e-3, "{found} for {expected}");
        }
        assert_eq!(Times::of(&histogram(3)).max, 0.0);
    }

    #[test]
    fn a_time_of_any_length_fits() {
        let mut all = histogram(3);
        for time in [Duration::ZERO, Duration::from_secs(7 * 86_400), Duration::MAX] {
            add(&mut all, time);
        }
        assert_eq!(all.len(), 3);
    }
}
