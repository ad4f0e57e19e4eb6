//! The displacement: a smooth random field within the folds, zero at the wall and at both ends.

use super::stations::{CUT, Lean, Station};
use crate::random::{self, Stream};
use std::f64::consts::{PI, TAU};

/// Number of cosines.
const WAVES: u32 = 24;
/// Elliptic radius, in units of `R_in`, up to which the displacement is full; at `R_in` it is zero.
const FULL: f64 = 0.9;

/// The displacement along z as a function of the place.
pub(in crate::mesh) struct Field<'a> {
    lean: &'a Lean,
    waves: Vec<Wave>,
}

/// `cos(2π(k·p + phase))`, k in turns per µm.
struct Wave {
    k: [f64; 3],
    phase: f64,
}

impl<'a> Field<'a> {
    pub(in crate::mesh) fn new(lean: &'a Lean) -> Self {
        let wave = |i: u32| {
            let w = random::words(lean.seed, Stream::Lean, i, 0);
            let unit = |j: usize| f64::from(random::unit(w[j]));
            // Directions are stratified over the half circle; wave numbers across the tube vary by ±30 %.
            let direction = PI * (f64::from(i) + unit(0)) / f64::from(WAVES);
            let across = (0.7 + 0.6 * unit(1)) / lean.wavelength_um;
            let along = (2.0 * unit(3) - 1.0) / lean.along_um;
            Wave { k: [across * libm::cos(direction), across * libm::sin(direction), along], phase: unit(2) }
        };
        Self { lean, waves: (0..WAVES).map(wave).collect() }
    }

    /// The displacement at a place, micrometres.
    pub(in crate::mesh) fn at(&self, p_um: [f64; 3]) -> f64 {
        let station = self.station(p_um[2]);
        if station.strength_um <= 0.0 {
            return 0.0;
        }
        let flat = p_um[1] / station.squash;
        let radius = (p_um[0] * p_um[0] + flat * flat).sqrt() / station.r_in_um;
        let within = 1.0 - smooth((radius - FULL) / (1.0 - FULL));
        if within == 0.0 {
            return 0.0;
        }
        let phase = |w: &Wave| w.k[0] * p_um[0] + w.k[1] * p_um[1] + w.k[2] * p_um[2] + w.phase;
        let sum: f64 = self.waves.iter().map(|w| libm::cos(TAU * phase(w))).sum();
        let field = (sum * (2.0 / self.waves.len() as f64).sqrt()).clamp(-CUT, CUT);
        station.strength_um * within * self.ends(p_um[2]) * field
    }

    /// Rises from 0 at either end to 1.
    fn ends(&self, z_um: f64) -> f64 {
        let stations = &self.lean.stations;
        let [first, last] = [stations[0].z_um, stations[stations.len() - 1].z_um];
        smooth((z_um - first).min(last - z_um) / self.lean.ends_um)
    }

    /// Between two stations.
    fn station(&self, z_um: f64) -> Station {
        let stations = &self.lean.stations;
        let after = stations.partition_point(|s| s.z_um <= z_um).clamp(1, stations.len() - 1);
        let (a, b) = (&stations[after - 1], &stations[after]);
        let t = ((z_um - a.z_um) / (b.z_um - a.z_um)).clamp(0.0, 1.0);
        let mix = |a: f64, b: f64| a + t * (b - a);
        Station {
            z_um,
            r_in_um: mix(a.r_in_um, b.r_in_um),
            squash: mix(a.squash, b.squash),
            strength_um: mix(a.strength_um, b.strength_um),
        }
    }
}

/// Smoothstep from 0 to 1.
fn smooth(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
