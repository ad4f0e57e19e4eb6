//! The wave: how much of the lumen it closes and how much it shortens the tube, by place and time.

use std::f64::consts::TAU;

/// Wave that travels along the tube.
#[derive(Clone, Debug)]
pub struct Contraction {
    /// Sections along the tube, two or more, by ascending z.
    pub stations: Vec<Station>,
    /// Place of the first crest, in wavelengths.
    pub phase: f64,
    /// True if the wave travels towards the uterus, to lower z.
    pub to_uterus: bool,
    /// Distance from both ends of the model over which the contraction rises from zero, µm.
    pub ends_um: f64,
}

/// Values of the wave at a place along the tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Place, µm.
    pub z_um: f64,
    /// Area of the ellipse that contains the folds, µm²; the muscle lies around it.
    pub base_um2: f64,
    /// Fraction of the lumen that a crest closes.
    pub closure: f64,
    /// Fraction of the length that a crest takes away.
    pub shortening: f64,
    /// Wavelength, µm.
    pub wavelength_um: f64,
}

/// The wave at the places of the sections.
pub(super) struct Wave {
    /// Values of the station of each section, and its distance from the first section in
    /// wavelengths.
    pub(super) at: Vec<(Station, f64)>,
    phase: f64,
    sign: f64,
}

impl Wave {
    /// Evaluates the wave at places in ascending order, µm.
    pub(super) fn new(by: &Contraction, places: &[f64]) -> Self {
        let mut turns = 0.0;
        let mut before: Option<Station> = None;
        let at = places.iter().map(|&z| {
            let here = by.station(z);
            if let Some(before) = before {
                turns += 0.5 * (z - before.z_um) * (1.0 / before.wavelength_um + 1.0 / here.wavelength_um);
            }
            before = Some(here);
            (here, turns)
        });
        Self { at: at.collect(), phase: by.phase, sign: if by.to_uterus { 1.0 } else { -1.0 } }
    }

    /// Height of the wave, from 0 to 1 at a crest, by section and time in periods.
    pub(super) fn rise(&self, section: usize, time: f64) -> f64 {
        let turns = self.at[section].1 - self.phase + self.sign * time;
        0.5 + 0.5 * libm::cos(TAU * turns)
    }
}

impl Contraction {
    /// Interpolates between the two stations around a place.
    fn station(&self, z_um: f64) -> Station {
        let after = self.stations.partition_point(|s| s.z_um <= z_um).clamp(1, self.stations.len() - 1);
        let (a, b) = (&self.stations[after - 1], &self.stations[after]);
        let t = ((z_um - a.z_um) / (b.z_um - a.z_um)).clamp(0.0, 1.0);
        let mix = |a: f64, b: f64| a + t * (b - a);
        Station {
            z_um,
            base_um2: mix(a.base_um2, b.base_um2),
            closure: mix(a.closure, b.closure),
            shortening: mix(a.shortening, b.shortening),
            wavelength_um: mix(a.wavelength_um, b.wavelength_um),
        }
    }
}
