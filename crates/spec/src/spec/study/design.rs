//! Designs: the level of each parameter at every point of a study.

use crate::random::{Stream, unit_f64, words};

/// Method of combining the values of several parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Design {
    /// All combinations.
    Grid,
    /// The first values of all parameters, the second values of all, and so on.
    Zip,
    /// A Latin hypercube: with n samples, each parameter takes one value from each of n intervals
    /// of equal probability.
    LatinHypercube,
}

impl Design {
    /// Designs by their names in JSON.
    pub(super) const NAMES: [(&'static str, Self); 3] =
        [("grid", Self::Grid), ("zip", Self::Zip), ("lhs", Self::LatinHypercube)];
}

/// All combinations of `lengths` levels; the last parameter varies fastest.
pub(super) fn grid(lengths: &[usize]) -> Vec<Vec<usize>> {
    lengths.iter().fold(vec![Vec::new()], |points, &length| {
        let longer = |point: &Vec<usize>, level| point.iter().copied().chain([level]).collect();
        points.iter().flat_map(|point| (0..length).map(move |level| longer(point, level))).collect()
    })
}

/// Quantiles of one dimension of a Latin hypercube, strictly between 0 and 1: a random one in each
/// of `samples` equal intervals, in random order.
pub(super) fn latin_hypercube(samples: usize, seed: u64, dimension: u32) -> Vec<f64> {
    let random = |sample: usize| words(seed, Stream::Study, sample as u32, dimension);
    // Sorting by random keys is a random permutation.
    let mut parts: Vec<usize> = (0..samples).collect();
    parts.sort_by_cached_key(|&part| {
        let [high, low, ..] = random(part);
        (high, low, part)
    });
    let place = |(sample, part): (usize, usize)| {
        let [.., high, low] = random(sample);
        let u = (part as f64 + unit_f64(high, low)) / samples as f64;
        u.clamp(f64::EPSILON, 1.0 - f64::EPSILON)
    };
    parts.into_iter().enumerate().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_last_parameter_of_a_grid_varies_fastest() {
        let points = grid(&[2, 1, 3]);
        assert_eq!(points, [[0, 0, 0], [0, 0, 1], [0, 0, 2], [1, 0, 0], [1, 0, 1], [1, 0, 2]]);
        assert_eq!(grid(&[3, 0]), Vec::<Vec<usize>>::new());
    }

    proptest! {
        #[test]
        fn each_part_of_each_dimension_has_one_sample(samples in 1_usize..300, seed in 0_u64..1 << 53, dimension in 0_u32..8) {
            let units = latin_hypercube(samples, seed, dimension);
            let mut parts: Vec<usize> = units.iter().map(|u| (u * samples as f64) as usize).collect();
            parts.sort_unstable();
            prop_assert_eq!(parts, (0..samples).collect::<Vec<_>>());
            prop_assert!(units.iter().all(|u| *u > 0.0 && *u < 1.0));
        }
    }

    #[test]
    fn dimensions_and_seeds_are_independent() {
        let n = 1000;
        let columns: Vec<Vec<f64>> = [(4, 0), (4, 1), (4, 2), (5, 0)]
            .iter()
            .map(|&(seed, dimension)| latin_hypercube(n, seed, dimension))
            .collect();
        for (i, a) in columns.iter().enumerate() {
            for b in &columns[i + 1..] {
                // The correlation of 1000 independent pairs has a standard deviation of 0.032.
                let r: f64 = a.iter().zip(b).map(|(x, y)| (x - 0.5) * (y - 0.5)).sum::<f64>() * 12.0 / n as f64;
                assert!(r.abs() < 0.12, "correlation {r}");
            }
        }
    }

    /// Stored studies are repeated from their seed, so these numbers must never change.
    #[test]
    fn the_same_seed_gives_the_same_points() {
        let units = latin_hypercube(4, 4, 0);
        let rounded: Vec<f64> = units.iter().map(|u| (u * 1e6).round() / 1e6).collect();
        assert_eq!(rounded, [0.849506, 0.187503, 0.381091, 0.739511]);
    }
}
