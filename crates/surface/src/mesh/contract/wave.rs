//! The wave: how much of the lumen it closes, and by how much it shortens the tube, at a place and a time.

use std::f64::consts::TAU;

/// A wave that travels along the tube.
#[derive(Clone, Debug)]
pub struct Contraction {
    /// Sections along the tube, two or more, by ascending z.
    pub stations: Vec<Station>,
    /// Place of the first crest, in wavelengths.
    pub phase: f64,
    /// Whether it travels toward the uterus, to lower z.
    pub to_uterus: bool,
    /// Distance from either end of the model over which the contraction rises from zero, µm.
    pub ends_um: f64,
}

/// A place along the tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Place, µm.
    pub z_um: f64,
    /// Area of the ellipse that holds the folds, µm²; the muscle lies around it.
    pub base_um2: f64,
    /// Share of the lumen that the crest closes.
    pub closure: f64,
    /// Share of the length that the crest takes away.
    pub shortening: f64,
    /// Wavelength, µm.
    pub wavelength_um: f64,
}

/// The wave at the places of sections.
pub(super) struct Wave {
    /// By section: values of the station there, and wavelengths from the first one.
    pub(super) at: Vec<(Station, f64)>,
    phase: f64,
    sign: f64,
}

impl Wave {
    /// The wave at places in ascending order, µm.
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

    /// Between 0 and 1 at a crest, by section and time in periods.
    pub(super) fn rise(&self, section: usize, time: f64) -> f64 {
        let turns = self.at[section].1 - self.phase + self.sign * time;
        0.5 + 0.5 * libm::cos(TAU * turns)
    }
}

impl Contraction {
    /// Between two stations.
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
