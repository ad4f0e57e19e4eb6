//! Planar cuts across a surface: frequency of islands, tissue thickness and gaps.

use super::rays::{Distances, distances};
use super::shape::Shape;
use super::spread::Spread;
use super::tube::Regions;
use crate::geometry::cut::Body;
use crate::model::{Cut, CutRing, RingKind};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Number of cuts, evenly spread over the ampulla.
const COUNT: usize = 40;
/// Minimum area of an island, µm². Smaller ones are tips that a plane barely touches.
const LEAST_ISLAND_UM2: f64 = 500.0;

/// Measures of planar cuts across the ampulla.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Cuts {
    /// Number of cuts, evenly spread from `from_mm` to `to_mm`.
    pub count: usize,
    /// Start of the part of the ampulla in the model, mm.
    pub from_mm: f64,
    /// End of the part of the ampulla in the model, mm.
    pub to_mm: f64,
    /// Minimum area of an island that counts, µm².
    pub least_island_um2: f64,
    /// Fraction of the cuts that have an island.
    pub with_islands: f64,
    /// Mean number of islands per cut.
    pub islands_per_cut: f64,
    /// Areas of the islands, µm².
    pub island_area_um2: Option<Spread>,
    /// Mean number of pockets per cut: parts of the lumen that are not connected to the rest in the
    /// plane.
    pub pockets_per_cut: f64,
    /// Tissue thickness in the cuts, measured as in sections.
    pub thickness_um: Option<AmongCuts>,
    /// Gaps in the cuts, measured as in sections.
    pub gap_um: Option<AmongCuts>,
}

/// Distributions of a measure in many cuts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct AmongCuts {
    /// Minimum of the 5th percentiles of the cuts.
    pub least_p5: f64,
    /// Mean of the 5th percentiles of the cuts.
    pub p5: f64,
    /// Mean of the medians of the cuts.
    pub p50: f64,
}

/// Measures cuts across the ampulla of a tissue; `None` if the model has no part of the ampulla.
#[must_use]
pub fn cuts(tissue: &Body<'_>, regions: &Regions) -> Option<Cuts> {
    let [from_mm, to_mm] = regions.ampulla_mm()?;
    let z_um: Vec<f64> =
        (0..COUNT).map(|k| 1e3 * (from_mm + (to_mm - from_mm) * (k as f64 + 0.5) / COUNT as f64)).collect();
    let cuts = tissue.cuts_across(&z_um);
    let of = |kind| cuts.iter().flat_map(move |cut: &Cut| cut.of(kind));
    let is_counted = |ring: &&CutRing| ring.area_um2 >= LEAST_ISLAND_UM2;
    let areas: Vec<f32> = of(RingKind::Island).filter(is_counted).map(|ring| ring.area_um2 as f32).collect();
    let with_islands = cuts.iter().filter(|cut| cut.of(RingKind::Island).any(|ring| is_counted(&ring))).count();
    let found: Vec<Distances> = cuts.par_iter().filter_map(measured).collect();
    let spreads = |of: fn(&Distances) -> Option<Spread>| found.iter().filter_map(of).collect::<Vec<_>>();
    Some(Cuts {
        count: COUNT,
        from_mm,
        to_mm,
        least_island_um2: LEAST_ISLAND_UM2,
        with_islands: with_islands as f64 / COUNT as f64,
        islands_per_cut: areas.len() as f64 / COUNT as f64,
        island_area_um2: Spread::of(areas),
        pockets_per_cut: of(RingKind::Pocket).count() as f64 / COUNT as f64,
        thickness_um: AmongCuts::of(&spreads(|of| of.thickness)),
        gap_um: AmongCuts::of(&spreads(|of| of.gap)),
    })
}

impl AmongCuts {
    fn of(spreads: &[Spread]) -> Option<Self> {
        let mean = |of: fn(&Spread) -> f64| spreads.iter().map(of).sum::<f64>() / spreads.len() as f64;
        let least_p5 = spreads.iter().map(|of| of.p5).reduce(f64::min)?;
        Some(Self { least_p5, p5: mean(|of| of.p5), p50: mean(|of| of.p50) })
    }
}

/// Distances in a cut; `None` if the cut is empty.
fn measured(cut: &Cut) -> Option<Distances> {
    // The lumen lies to the left of its rings, opposite to the rings of tissue.
    let rings: Vec<Vec<[f32; 2]>> =
        cut.rings.iter().map(|ring| ring.points.iter().rev().map(|p| p.map(|x| x as f32)).collect()).collect();
    let (outer, lumen) = rings.split_first()?;
    let outer: Vec<[f32; 2]> = outer.iter().rev().copied().collect();
    let shape = Shape { outer: &outer, lumen: lumen.iter().map(Vec::as_slice).collect() };
    Some(distances(&shape))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample::tube;

    #[test]
    fn a_straight_tube_has_no_islands_and_the_thickness_of_its_wall() {
        let mesh = tube(720, 4, 0.0);
        let regions = Regions { length_mm: 4.0, junction: [0.3, 0.4], piece: [0.0, 1.0] };
        let cuts = cuts(&Body::from(&mesh), &regions).unwrap();
        assert_eq!((cuts.count, cuts.with_islands, cuts.islands_per_cut, cuts.pockets_per_cut), (40, 0.0, 0.0, 0.0));
        assert_eq!((cuts.from_mm, cuts.to_mm, cuts.island_area_um2), (1.6, 4.0, None));
        for (found, expected) in [(cuts.thickness_um.unwrap(), 500.0), (cuts.gap_um.unwrap(), 1000.0)] {
            for value in [found.least_p5, found.p5, found.p50] {
                assert!((value / expected - 1.0).abs() < 3e-3, "{value} µm, not {expected}");
            }
        }
        assert_eq!(super::cuts(&Body::from(&mesh), &Regions { piece: [0.0, 0.35], ..regions }), None);
    }
}
