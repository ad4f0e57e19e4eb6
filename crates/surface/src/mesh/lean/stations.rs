//! What to displace by how much, and how steep that is.

/// Standard deviations at which the field is cut off.
pub(super) const CUT: f64 = 2.0;
/// What to displace by how much.
#[derive(Clone, Debug)]
pub struct Lean {
    /// Seed of the field.
    pub seed: u64,
    /// Mean wavelength across the tube, µm.
    pub wavelength_um: f64,
    /// Wavelength along the tube, µm.
    pub along_um: f64,
    /// Distance from either end over which the displacement rises from zero, µm.
    pub ends_um: f64,
    /// Sections along the tube, two or more, by ascending z.
    pub stations: Vec<Station>,
}

/// A place along the tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Place, µm.
    pub z_um: f64,
    /// Radius of the region that holds the folds, µm (x axis).
    pub r_in_um: f64,
    /// Its y radius over its x radius.
    pub squash: f64,
    /// Root mean square displacement, µm.
    pub strength_um: f64,
}

impl Lean {
    /// About the most by which the displacement changes along z: where its strength or its share near an end changes, and where
    /// the field changes four times as fast as its root mean square.
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

    /// Distance of the stations around a place.
    pub(super) fn spacing_um(&self, z_um: f64) -> f64 {
        let after = self.stations.partition_point(|s| s.z_um <= z_um).clamp(1, self.stations.len() - 1);
        self.stations[after].z_um - self.stations[after - 1].z_um
    }
}
