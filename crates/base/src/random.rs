//! Counter-based random numbers: each number is a pure function of seed, stream and index.
//!
//! Results therefore depend neither on the number of threads nor on the order of evaluation. Only
//! 32-bit integers are used, so that WGSL computes the same numbers. The mixer is PCG4D (Jarzynski
//! and Olano, *Hash Functions for GPU Rendering*, JCGT 9(3), 2020).

/// Purpose of random numbers. Streams are independent of each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Stream {
    /// Phase of the fluctuation of a schedule; index: ordinal of the parameter.
    SchedulePhase = 1,
    /// Contortion of a particle: whether, and to which side; index: particle id.
    Contortion = 2,
    /// Candidates of the growth tournaments; index: growth event and candidate.
    Growth = 3,
    /// Directions and phases of the thickness field; index: component.
    Thickness = 4,
    /// Lobes of the outer wall; index: lobe.
    Lobes = 5,
    /// Initial displacement of a particle; index: particle id.
    Start = 6,
    /// Times and calls of `oviduct load`; index: ordinal of the call.
    Load = 8,
    /// Latin hypercubes; index: sample and dimension.
    Study = 7,
    /// Directions, wavelengths, phases and periods of the sway; index: component and quantity.
    Sway = 10,
    /// Directions, wavelengths and phases of the lean; index: component.
    Lean = 11,
    /// Phases of the variety around the wall; index: number of maxima.
    Variety = 12,
    /// Wavelengths and phases of a random course; index: component.
    Course = 13,
    /// Places of transverse folds; index: component or row.
    Folds = 14,
    /// Directions of the clefts between primary folds; index: cleft and candidate.
    Clefts = 15,
    /// Cells and fibres of stained sections; index: section, then cell or lattice point.
    Histology = 9,
}

fn pcg4d(mut v: [u32; 4]) -> [u32; 4] {
    for x in &mut v {
        *x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    }
    let round = |v: &mut [u32; 4]| {
        v[0] = v[0].wrapping_add(v[1].wrapping_mul(v[3]));
        v[1] = v[1].wrapping_add(v[2].wrapping_mul(v[0]));
        v[2] = v[2].wrapping_add(v[0].wrapping_mul(v[1]));
        v[3] = v[3].wrapping_add(v[1].wrapping_mul(v[2]));
    };
    round(&mut v);
    for x in &mut v {
        *x ^= *x >> 16;
    }
    round(&mut v);
    v
}

/// Four random words for the counters `a` and `b`.
#[must_use]
#[inline]
pub fn words(seed: u64, stream: Stream, a: u32, b: u32) -> [u32; 4] {
    // The upper seed bits (at most 21 are used) are spread before the stream number is mixed in.
    let high = ((seed >> 32) as u32).wrapping_mul(0x9E37_79B9) ^ (stream as u32).wrapping_mul(0x85EB_CA6B);
    pcg4d([seed as u32, high, a, b])
}

/// The first of the four random words.
#[must_use]
#[inline]
pub fn word(seed: u64, stream: Stream, a: u32, b: u32) -> u32 {
    words(seed, stream, a, b)[0]
}

/// Maps a word to `[0, 1)` with 24 bits, exact in f32.
#[must_use]
#[inline]
pub fn unit(word: u32) -> f32 {
    (word >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Maps two words to `[0, 1)` with 53 bits, exact in f64.
#[must_use]
#[inline]
pub fn unit_f64(high: u32, low: u32) -> f64 {
    let bits = (u64::from(high) << 32 | u64::from(low)) >> 11;
    let exact = bits as f64;
    exact / 9_007_199_254_740_992.0
}

/// Maps a word to `0..n` by multiplication instead of division. `n` must be at most 65,536.
#[must_use]
#[inline]
pub fn below(word: u32, n: u32) -> u32 {
    debug_assert!(n <= 65_536);
    ((word >> 16) * n) >> 16
}

/// Draws a seed from 0 to 2^53 − 1 for a request without one. This is the only function of the
/// module whose result does not follow from its arguments.
#[must_use]
pub fn draw_seed() -> u64 {
    use std::hash::{BuildHasher, RandomState};
    RandomState::new().hash_one(0u8) >> 11
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_a_pure_function_of_their_counters() {
        assert_eq!(words(7, Stream::Growth, 3, 4), words(7, Stream::Growth, 3, 4));
        assert_ne!(word(7, Stream::Growth, 3, 4), word(8, Stream::Growth, 3, 4));
        assert_ne!(word(7, Stream::Growth, 3, 4), word(7, Stream::Lobes, 3, 4));
        assert_ne!(word(7, Stream::Growth, 3, 4), word(7 + (1 << 40), Stream::Growth, 3, 4));
    }

    #[test]
    fn units_are_uniform() {
        let n = 40_000u32;
        let mut bins = [0u32; 20];
        for i in 0..n {
            let u = unit(word(42, Stream::Growth, i, 0));
            assert!((0.0..1.0).contains(&u));
            bins[(u * 20.0) as usize] += 1;
        }
        let expected = f64::from(n) / 20.0;
        let chi2: f64 = bins.iter().map(|&b| (f64::from(b) - expected).powi(2) / expected).sum();
        assert!(chi2 < 43.8, "chi-square {chi2} is beyond the 0.999 quantile of 19 degrees of freedom");
    }

    #[test]
    fn two_words_give_all_bits_of_a_double() {
        assert_eq!(unit_f64(0, 0), 0.0);
        assert_eq!(unit_f64(1 << 31, 0), 0.5);
        assert_eq!(unit_f64(u32::MAX, u32::MAX), 1.0 - f64::EPSILON / 2.0);
    }

    #[test]
    fn drawn_seeds_differ_and_are_exact_in_json() {
        let seeds: std::collections::BTreeSet<u64> = (0..100).map(|_| draw_seed()).collect();
        assert_eq!(seeds.len(), 100);
        assert!(seeds.iter().all(|&seed| seed < 1 << 53));
    }

    #[test]
    fn below_stays_below() {
        for i in 0..1000 {
            assert!(below(word(1, Stream::Growth, i, 0), 7) < 7);
        }
        assert_eq!(below(u32::MAX, 65_536), 65_535);
    }
}
