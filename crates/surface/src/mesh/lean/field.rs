//! The displacement field of a lean: smooth and random within the folds, zero at the wall and at
//! both ends.

use super::cosine::cosines;
use crate::random::{self, Stream};
use crate::vectorize::Vectors;
use std::f64::consts::{PI, TAU};

/// Number of cosines.
const WAVES: usize = 24;
/// Elliptic radius, in units of `R_in`, up to which the displacement is full. At `R_in` it is zero.
const FULL: f64 = 0.9;
/// Limit of the field, in standard deviations.
const CUT: f64 = 2.0;

/// Parameters of a lean.
#[derive(Clone, Debug)]
pub struct Lean {
    /// Seed of the field.
    pub seed: u64,
    /// Mean wavelength across the tube, µm.
    pub wavelength_um: f64,
    /// Wavelength along the tube, µm.
    pub along_um: f64,
    /// Distance from both ends over which the displacement rises from zero, µm.
    pub ends_um: f64,
    /// Sections along the tube, two or more, by ascending z.
    pub stations: Vec<Station>,
}

/// Parameters at a place along the tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Place, µm.
    pub z_um: f64,
    /// Radius of the region that contains the folds along the x axis, µm.
    pub r_in_um: f64,
    /// Ratio of the y radius of that region to its x radius.
    pub squash: f64,
    /// Root mean square displacement, µm.
    pub strength_um: f64,
}

impl Lean {
    /// Estimate of the maximum derivative of the displacement along z. It adds the changes of
    /// strength, of the rise near an end, and of the field, which may change four times as fast as
    /// its root mean square.
    pub(super) fn steepness(&self) -> f64 {
        let [first, .., last] = &self.stations[..] else { return 0.0 };
        let of = |pair: &[Station]| {
            let [a, b] = pair else { return 0.0 };
            let strength = a.strength_um.max(b.strength_um);
            let near_end = (a.z_um - first.z_um).min(last.z_um - b.z_um) < self.ends_um;
            let ends = if near_end { 1.5 * CUT / self.ends_um } else { 0.0 };
            let along = 4.0 * std::f64::consts::TAU / (3.0_f64.sqrt() * self.along_um);
            CUT * (b.strength_um - a.strength_um).abs() / (b.z_um - a.z_um) + strength * (ends + along)
        };
        self.stations.windows(2).map(of).fold(0.0, f64::max)
    }

    /// Distance between the stations around a place.
    pub(super) fn spacing_um(&self, z_um: f64) -> f64 {
        let [a, b] = self.around(z_um);
        b.z_um - a.z_um
    }

    /// The two stations around a place.
    fn around(&self, z_um: f64) -> [&Station; 2] {
        let after = self.stations.partition_point(|s| s.z_um <= z_um).clamp(1, self.stations.len() - 1);
        [&self.stations[after - 1], &self.stations[after]]
    }
}

/// Displacement along z as a function of the place.
pub(in crate::mesh) struct LeanField<'a> {
    lean: &'a Lean,
    waves: Waves,
}

/// Waves `cos(2π(k·p + phase))`, k in turns per µm.
struct Waves {
    k: [[f64; WAVES]; 3],
    phase: [f64; WAVES],
}

impl Waves {
    /// Sum of the waves at a place.
    fn sum(&self, p_um: [f64; 3]) -> f64 {
        let cosines = Vectors::best().run(
            #[inline(always)]
            || {
                let mut angles = [0.0; WAVES];
                for (i, angle) in angles.iter_mut().enumerate() {
                    let turns = self.k[0][i] * p_um[0] + self.k[1][i] * p_um[1] + self.k[2][i] * p_um[2];
                    *angle = TAU * (turns + self.phase[i]);
                }
                cosines(&mut angles);
                angles
            },
        );
        cosines.iter().sum()
    }
}

impl<'a> LeanField<'a> {
    pub(in crate::mesh) fn new(lean: &'a Lean) -> Self {
        let mut waves = Waves { k: [[0.0; WAVES]; 3], phase: [0.0; WAVES] };
        for i in 0..WAVES {
            let w = random::words(lean.seed, Stream::Lean, i as u32, 0);
            let unit = |j: usize| f64::from(random::unit(w[j]));
            // Directions are stratified over the half circle. Wave numbers across the tube vary by
            // ±30 %.
            let direction = PI * (i as f64 + unit(0)) / WAVES as f64;
            let across = (0.7 + 0.6 * unit(1)) / lean.wavelength_um;
            waves.k[0][i] = across * libm::cos(direction);
            waves.k[1][i] = across * libm::sin(direction);
            waves.k[2][i] = (2.0 * unit(3) - 1.0) / lean.along_um;
            waves.phase[i] = unit(2);
        }
        Self { lean, waves }
    }

    /// Displacement at a place, µm.
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
        let field = (self.waves.sum(p_um) * (2.0 / WAVES as f64).sqrt()).clamp(-CUT, CUT);
        station.strength_um * within * self.ends(p_um[2]) * field
    }

    /// Rises from 0 at both ends to 1.
    fn ends(&self, z_um: f64) -> f64 {
        let stations = &self.lean.stations;
        let [first, last] = [stations[0].z_um, stations[stations.len() - 1].z_um];
        smooth((z_um - first).min(last - z_um) / self.lean.ends_um)
    }

    /// Interpolates between the two stations around a place.
    fn station(&self, z_um: f64) -> Station {
        let [a, b] = self.lean.around(z_um);
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
