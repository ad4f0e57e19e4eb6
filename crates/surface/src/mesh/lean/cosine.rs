//! Cosines of many angles at once, bit for bit those of [`libm::cos`].
//!
//! The operations of `libm` (FreeBSD's `s_cos.c`, `e_rem_pio2.c`, `k_cos.c` and `k_sin.c`) in the
//! same order, without branches, so that the compiler can use vectors. An angle that takes another
//! path in `libm` is left to it.

/// 1.5 · 2⁵², which rounds a small number to an integer when it is added.
const TO_INTEGER: f64 = 1.5 / f64::EPSILON;
/// The first 33 bits of π/2, and the rest.
const HALF_PI: [f64; 2] = [f64::from_bits(0x3ff9_21fb_5440_0000), f64::from_bits(0x3dd0_b461_1a62_6331)];
/// Maximum remainder. Within 4e-6 of the bounds of a quarter turn, `libm` may round to another
/// quarter turn.
const REMAINDER: f64 = std::f64::consts::FRAC_PI_4 - 8e-6;
/// Minimum remainder, as a fraction of the angle. `libm` computes a smaller one more precisely.
const CANCELLATION: f64 = 1.0 / (1 << 16) as f64;
/// Maximum angle. `libm` reduces larger ones in another way.
const ANGLE: f64 = 1e6;

/// Replaces angles by their cosines.
#[inline(always)]
pub(super) fn cosines<const N: usize>(angles: &mut [f64; N]) {
    let mut found = [0.0; N];
    let mut is_usual = true;
    for (cosine, &angle) in found.iter_mut().zip(angles.iter()) {
        let shifted = angle * std::f64::consts::FRAC_2_PI + TO_INTEGER;
        let quarters = shifted - TO_INTEGER;
        let rest = angle - quarters * HALF_PI[0];
        let tail = quarters * HALF_PI[1];
        let y = rest - tail;
        is_usual &= (y.abs() <= REMAINDER)
            & (angle.abs() < ANGLE)
            & ((y.abs() >= CANCELLATION * angle.abs()) | (quarters == 0.0));
        let of_y = cosine_and_sine(y, (rest - y) - tail);
        // The last bits of the sum are the number of quarter turns.
        let quarter = shifted.to_bits();
        let size = if quarter & 1 == 0 { of_y[0] } else { of_y[1] };
        *cosine = f64::from_bits(size.to_bits() ^ ((quarter + 1) & 2) << 62);
    }
    *angles = if is_usual { found } else { angles.map(libm::cos) };
}

/// Cosine and sine of `x + y` for `|x| <= π/4` and a small `y`.
#[inline(always)]
fn cosine_and_sine(x: f64, y: f64) -> [f64; 2] {
    const C: [f64; 6] = [
        4.166_666_666_666_66e-2,
        -1.388_888_888_887_411e-3,
        2.480_158_728_947_673e-5,
        -2.755_731_435_139_066_3e-7,
        2.087_572_321_298_175e-9,
        -1.135_964_755_778_819_5e-11,
    ];
    const S: [f64; 6] = [
        -1.666_666_666_666_663_2e-1,
        8.333_333_333_322_49e-3,
        -1.984_126_982_985_795e-4,
        2.755_731_370_707_006_8e-6,
        -2.505_076_025_340_686_3e-8,
        1.589_690_995_211_55e-10,
    ];
    let z = x * x;
    let w = z * z;
    let r = z * (C[0] + z * (C[1] + z * C[2])) + w * w * (C[3] + z * (C[4] + z * C[5]));
    let half = 0.5 * z;
    let one = 1.0 - half;
    let cosine = one + (((1.0 - one) - half) + (z * r - x * y));
    let r = S[1] + z * (S[2] + z * S[3]) + z * w * (S[4] + z * S[5]);
    let v = z * x;
    let sine = x - ((z * (0.5 * y - v * r) - y) - v * S[0]);
    [cosine, sine]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::samples::Dice;
    use crate::vectorize::Vectors;
    use std::f64::consts::{FRAC_PI_4, PI};

    /// Compares with `libm`, with each set of vectors.
    fn check(angles: [f64; 8]) {
        let expected = angles.map(|x| libm::cos(x).to_bits());
        for set in [Vectors::Baseline, Vectors::Avx2, Vectors::Avx512] {
            let mut found = angles;
            set.run(
                #[inline(always)]
                || cosines(&mut found),
            );
            assert_eq!(found.map(f64::to_bits), expected, "{angles:?} with {set:?}");
        }
    }

    #[test]
    fn cosines_are_those_of_libm() {
        let mut dice = Dice(7);
        for round in 0..400_000 {
            let reach = [1.0, 8.0, 100.0, 3000.0][round % 4];
            check(std::array::from_fn(|_| reach * (2.0 * dice.unit() - 1.0)));
        }
    }

    #[test]
    fn cosines_are_those_of_libm_where_it_takes_other_paths() {
        let mut dice = Dice(8);
        // Multiples of π/4 are bounds of quarter turns, or remainders that cancel.
        for eighth in -80..=80_i32 {
            for exponent in 1..=52 {
                let near = f64::from(eighth) * FRAC_PI_4;
                check(std::array::from_fn(|_| near + (2.0 * dice.unit() - 1.0) * f64::powi(0.5, exponent)));
            }
        }
        let rare = [0.0, -0.0, 5e-324, -1e-300, 1e-9, 1e6 * PI, -1e22, f64::MAX];
        check(rare);
        rare.into_iter().for_each(|angle| check([angle; 8]));
        let mut none = [f64::NAN, f64::INFINITY];
        cosines(&mut none);
        assert!(none.iter().all(|cosine| cosine.is_nan()));
    }
}
