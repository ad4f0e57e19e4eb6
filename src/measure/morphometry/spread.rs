//! Percentiles and variation of a sample.

use serde::Serialize;
use utoipa::ToSchema;

/// A distribution in four numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
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
    /// Of values that count alike.
    pub(super) fn even(values: impl IntoIterator<Item = f32>) -> Option<Self> {
        Self::of(&mut values.into_iter().map(|value| (value, 1.0)).collect::<Vec<_>>())
    }

    /// Of values with weights, whose order is changed; none if there are none. A percentile is the least value up to which lies that
    /// part of the weight.
    pub(super) fn of(values: &mut [(f32, f32)]) -> Option<Self> {
        let total: f64 = values.iter().map(|value| f64::from(value.1)).sum();
        if values.is_empty() || total <= 0.0 {
            return None;
        }
        let sum = |of: &dyn Fn(f64) -> f64| -> f64 {
            values.iter().map(|&(value, weight)| f64::from(weight) * of(f64::from(value))).sum()
        };
        let mean = sum(&|x| x) / total;
        let variance = sum(&|x| (x - mean).powi(2)) / total;
        let (mut from, mut passed) = (0, 0.0);
        let [p5, p50, p95] = [0.05, 0.5, 0.95].map(|share| {
            // Rounding of the sums decides between equals at most.
            let (at, before) = percentile(&mut values[from..], total * (share - 1e-9) - passed);
            (from, passed) = (from + at, passed + before);
            f64::from(values[from].0)
        });
        Some(Self { p5, p50, p95, cv: if mean > 0.0 { variance.sqrt() / mean } else { 0.0 } })
    }
}

/// The place of the least value up to which lies `share` of the weight, and the weight of those before it. Nothing before that place
/// is greater, nothing after it less.
fn percentile(values: &mut [(f32, f32)], share: f64) -> (usize, f64) {
    let weight = |part: &[(f32, f32)]| -> f64 { part.iter().map(|value| f64::from(value.1)).sum() };
    let (mut low, mut high, mut before) = (0, values.len(), 0.0);
    while high - low > 1 {
        let middle = (high - low) / 2;
        values[low..high].select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0));
        let left = weight(&values[low..low + middle]);
        if before + left >= share {
            high = low + middle;
        } else {
            before += left;
            low += middle;
        }
    }
    (low, before)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_the_nearest_rank() {
        let spread = Spread::even((1..=100).rev().map(|i| i as f32)).unwrap();
        assert_eq!((spread.p5, spread.p50, spread.p95), (5.0, 50.0, 95.0));
        assert!((spread.cv - 28.866_070 / 50.5).abs() < 1e-6);
        assert_eq!(Spread::of(&mut []), None);
        for n in 1..6 {
            let spread = Spread::even(vec![3.0; n]).unwrap();
            assert_eq!((spread.p5, spread.p50, spread.p95, spread.cv), (3.0, 3.0, 3.0, 0.0));
        }
    }

    #[test]
    fn a_weight_counts_like_so_many_values() {
        let mut weighted: Vec<(f32, f32)> = (1..=40).map(|i| ((i * 7 % 41) as f32, (i % 5) as f32)).collect();
        let repeated = weighted.iter().flat_map(|&(value, weight)| vec![value; weight as usize]);
        let repeated = Spread::even(repeated).unwrap();
        let spread = Spread::of(&mut weighted).unwrap();
        assert_eq!((spread.p5, spread.p50, spread.p95), (repeated.p5, repeated.p50, repeated.p95));
        assert!((spread.cv - repeated.cv).abs() < 1e-9);
        assert_eq!(Spread::of(&mut [(1.0, 0.0)]), None);
    }
}
