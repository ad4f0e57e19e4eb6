//! Percentiles and variation of a sample.

use serde::{Deserialize, Serialize};

/// A distribution in four numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Spread {
    /// 5th percentile.
    pub p5: f64,
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Coefficient of variation: standard deviation over mean.
    pub cv: f64,
}

impl Spread {
    /// Distribution of a sample; `None` for an empty sample. Percentiles use the nearest rank.
    pub(super) fn of(mut values: Vec<f32>) -> Option<Self> {
        let last = values.len().checked_sub(1)?;
        let n = values.len() as f64;
        let mean = values.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
        let variance = values.iter().map(|&x| (f64::from(x) - mean).powi(2)).sum::<f64>() / n;
        let mut from = 0;
        let [p5, p50, p95] = [0.05, 0.5, 0.95].map(|share: f64| {
            let rank = ((n * share).ceil() as usize).saturating_sub(1).min(last);
            // No value before the last rank is larger.
            let value = *values[from..].select_nth_unstable_by(rank - from, f32::total_cmp).1;
            from = rank;
            f64::from(value)
        });
        Some(Self { p5, p50, p95, cv: if mean > 0.0 { variance.sqrt() / mean } else { 0.0 } })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_the_nearest_rank() {
        let spread = Spread::of((1..=100).rev().map(|i| i as f32).collect()).unwrap();
        assert_eq!((spread.p5, spread.p50, spread.p95), (5.0, 50.0, 95.0));
        assert!((spread.cv - 28.866_070 / 50.5).abs() < 1e-6);
        assert_eq!(Spread::of(Vec::new()), None);
        for n in 1..6 {
            let spread = Spread::of(vec![3.0; n]).unwrap();
            assert_eq!((spread.p5, spread.p50, spread.p95, spread.cv), (3.0, 3.0, 3.0, 0.0));
        }
    }
}
