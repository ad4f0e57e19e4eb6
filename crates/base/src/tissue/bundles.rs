//! Bundles of the longitudinal muscle, where it does not surround the tube.

use super::{Layers, wander};

/// Number of bundles around the tube; chosen.
const BUNDLES: u32 = 20;
/// Exponent of the outline of a bundle where bundles are narrow.
const BLUNT: f64 = 0.6;
/// Maximum displacement of the border between two bundles, as a fraction of a bundle.
const SHIFT: f64 = 0.36;
/// First index of the random numbers of bundles.
const FIRST: u32 = 1000;

/// Thickness of the longitudinal layer in a direction, as a fraction of its full thickness; 0
/// between two bundles. Every bundle covers the same share of its sector, so that all together
/// cover `longitudinal_cover` of the circumference.
pub(super) fn height(turn: f64, layers: &Layers) -> f64 {
    let cover = layers.longitudinal_cover;
    if cover >= 1.0 || cover <= 0.0 {
        return cover;
    }
    let place = turn.rem_euclid(1.0) * f64::from(BUNDLES);
    let k = (place as u32).min(BUNDLES - 1);
    let border = |k: u32| {
        let seed = FIRST + k % BUNDLES;
        f64::from(k) + SHIFT * wander(layers, seed)
    };
    let (own, next) = (border(k), border(k + 1));
    let [from, to] = if place < own {
        [if k == 0 { border(BUNDLES - 1) - f64::from(BUNDLES) } else { border(k - 1) }, own]
    } else if place < next {
        [own, next]
    } else {
        [next, border((k + 2) % BUNDLES) + if k + 2 >= BUNDLES { f64::from(BUNDLES) } else { 0.0 }]
    };
    let x = (2.0 * (place - from) / (to - from) - 1.0) / cover;
    if x.abs() >= 1.0 { 0.0 } else { libm::pow(1.0 - x * x, BLUNT * (1.0 - cover)) }
}
