//! Measures of planar cuts across a surface: what a histologist sees of a leaning tube.

use super::quantity::QUANTITIES;
use super::section::{MODEL_RAYS_UM, Measures, Scope, measure_with};
use super::sections::LayersAt;
use super::shape::Shape;
use super::spread::Spread;
use super::track::{Changes, Following, Frame, Traced, per_mm};
use super::tube::{Basis, Found, Intervals, Morphometry, Regions, Tube, detailed_places};
use crate::geometry::cut::Body;
use crate::model::{Cut, CutRing, Mesh, Plane, RingKind};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Number of cuts per measured cut. Those in between only follow folds and clefts, which move too
/// far from one measured cut to the next.
const PER_MEASURED: usize = 5;
/// Distance of the first and the last cut from the ends, µm.
const END_UM: f64 = 1.0;
/// Minimum area of an island, µm². Smaller ones are tips that a plane barely touches.
const LEAST_ISLAND_UM2: f64 = 500.0;

/// Islands, thickness and gaps in the measured cuts across the ampulla.
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

/// A cut across the tube.
struct Slice {
    z_mm: f64,
    measured: Option<Measured>,
}

struct Measured {
    measures: Measures,
    /// Areas of the islands that count, µm².
    islands: Vec<f32>,
    pockets: usize,
}

/// Measures planar cuts across the surface of a straight tissue. `simulated` are the measures of the
/// sections from which it was made: they follow points, which cuts do not have.
///
/// The second result is `None` if the model has no part of the ampulla.
#[must_use]
#[inline(never)] // counted by scripts/counts
pub fn morphometry_of_cuts(
    tissue: &Mesh,
    regions: &Regions,
    layers: &LayersAt<'_>,
    simulated: &Morphometry,
) -> (Morphometry, Option<Cuts>) {
    let sections = simulated.along.get("z_mm").map_or(0, Vec::len);
    let measured = detailed_places(sections);
    let intervals = Intervals::of_cuts(measured, sections);
    let (slices, changes) = slices(tissue, &places(tissue, intervals, measured), layers);
    let at: Vec<usize> = (0..slices.len()).filter(|&k| slices[k].measured.is_some()).collect();
    let z_mm: Vec<f64> = at.iter().map(|&k| slices[k].z_mm).collect();
    let summed: Vec<Changes> = at.windows(2).map(|pair| changes[pair[0]..pair[1]].iter().sum()).collect();
    let cuts = Cuts::among(&slices, regions);
    let Tube { fold_continuity, twist_deg, .. } = simulated.tube;
    let found = Found {
        basis: Basis::Cuts,
        intervals,
        steps: per_mm(&summed, &z_mm),
        z_mm,
        measures: slices.into_iter().filter_map(|slice| Some(slice.measured?.measures)).collect(),
        fold_continuity,
        twist_deg,
    };
    (found.summarized(QUANTITIES.iter(), regions), cuts)
}

/// Place of a cut, and what is measured of it.
#[derive(Clone, Copy, Debug)]
struct Place {
    z_um: f64,
    is_measured: bool,
    has_tree: bool,
    has_layers: bool,
}

/// Places of the cuts, evenly spread between the ends of a tissue.
fn places(tissue: &Mesh, intervals: Intervals, measured: usize) -> Vec<Place> {
    let [_, _, [low, high]] = extent_um(tissue);
    let [low, high] = [low + END_UM, high - END_UM];
    let last = PER_MEASURED * (measured - 1);
    let place = |k: usize| {
        let is_measured = k.is_multiple_of(PER_MEASURED);
        Place {
            z_um: low + (high - low) * k as f64 / last as f64,
            is_measured,
            has_tree: is_measured && intervals.has_tree(k / PER_MEASURED),
            has_layers: is_measured && intervals.has_layers(k / PER_MEASURED),
        }
    };
    (0..=last).map(place).collect()
}

/// Minimum and maximum of x, y and z over a mesh, µm.
fn extent_um(mesh: &Mesh) -> [[f64; 2]; 3] {
    let mut extent = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    for position in &mesh.positions {
        for (range, x) in extent.iter_mut().zip(position) {
            let um = f64::from(*x) * 1e6;
            *range = [range[0].min(um), range[1].max(um)];
        }
    }
    extent
}

fn frame(tissue: &Mesh) -> Frame {
    let [[left, right], [bottom, top], _] = extent_um(tissue);
    Frame::of([[left, bottom], [right, top]])
}

/// Cuts at ascending places, and the changes from each to the next one. A place at which the plane
/// misses the surface has no cut.
fn slices(tissue: &Mesh, places: &[Place], layers: &LayersAt<'_>) -> (Vec<Slice>, Vec<Changes>) {
    let (body, frame) = (Body::from(tissue), frame(tissue));
    let (mut slices, mut following) = (Vec::with_capacity(places.len()), Following::default());
    for some in places.chunks(Following::PORTION) {
        let found = some.par_iter().map(|place| slice(&body.cut(&Plane::across(place.z_um)), place, layers, &frame));
        let (found, traced): (Vec<Slice>, Vec<Traced>) = found.collect::<Vec<_>>().into_iter().flatten().unzip();
        slices.extend(found);
        following.add(traced);
    }
    (slices, following.into_changes())
}

fn slice(cut: &Cut, place: &Place, layers: &LayersAt<'_>, frame: &Frame) -> Option<(Slice, Traced)> {
    // The lumen lies to the left of its rings, opposite to the rings of tissue.
    let points = |ring: &CutRing| ring.points.iter().rev().map(|p| p.map(|x| x as f32)).collect::<Vec<_>>();
    let (outer, inner) = cut.rings.split_first()?;
    let mut outer = points(outer);
    outer.reverse();
    let lumen: Vec<Vec<[f32; 2]>> = inner.iter().filter(|ring| ring.parent.is_some()).map(points).collect();
    let shape = Shape { outer: &outer, lumen: lumen.iter().map(Vec::as_slice).collect() };
    let base = shape.base_ellipse();
    let measured = place.is_measured.then(|| {
        let layers = place.has_layers.then(|| layers(place.z_um));
        let islands = cut.of(RingKind::Island).filter(|ring| ring.area_um2 >= LEAST_ISLAND_UM2);
        Measured {
            measures: measure_with(
                &shape,
                &base,
                Scope { rays_um: Some(MODEL_RAYS_UM), tree: place.has_tree, layers: layers.as_ref() },
            ),
            islands: islands.map(|ring| ring.area_um2 as f32).collect(),
            pockets: cut.of(RingKind::Pocket).count(),
        }
    });
    Some((Slice { z_mm: place.z_um / 1e3, measured }, Traced::new(&shape, &base, frame)))
}

impl Cuts {
    /// Summarizes the measured cuts across the ampulla; `None` if there are none.
    fn among(slices: &[Slice], regions: &Regions) -> Option<Self> {
        let [from_mm, to_mm] = regions.ampulla_mm()?;
        let within = slices.iter().filter(|slice| (from_mm..=to_mm).contains(&slice.z_mm));
        let cuts: Vec<&Measured> = within.filter_map(|slice| slice.measured.as_ref()).collect();
        if cuts.is_empty() {
            return None;
        }
        let count = cuts.len() as f64;
        let areas: Vec<f32> = cuts.iter().flat_map(|cut| cut.islands.iter().copied()).collect();
        let spreads = |of: fn(&Measures) -> Option<Spread>| {
            AmongCuts::of(&cuts.iter().filter_map(|cut| of(&cut.measures)).collect::<Vec<_>>())
        };
        Some(Self {
            count: cuts.len(),
            from_mm,
            to_mm,
            least_island_um2: LEAST_ISLAND_UM2,
            with_islands: cuts.iter().filter(|cut| !cut.islands.is_empty()).count() as f64 / count,
            islands_per_cut: areas.len() as f64 / count,
            island_area_um2: Spread::of(areas),
            pockets_per_cut: cuts.iter().map(|cut| cut.pockets).sum::<usize>() as f64 / count,
            thickness_um: spreads(|of| of.thickness_um),
            gap_um: spreads(|of| of.gap_um),
        })
    }
}

impl AmongCuts {
    fn of(spreads: &[Spread]) -> Option<Self> {
        let mean = |of: fn(&Spread) -> f64| spreads.iter().map(of).sum::<f64>() / spreads.len() as f64;
        let least_p5 = spreads.iter().map(|of| of.p5).reduce(f64::min)?;
        Some(Self { least_p5, p5: mean(|of| of.p5), p50: mean(|of| of.p50) })
    }
}

#[cfg(test)]
mod tests {
    use super::super::sections::morphometry;
    use super::*;
    use crate::model::sample::{section, tube};
    use crate::tissue::Layers;

    #[test]
    fn a_straight_tube_has_the_measures_of_its_wall_and_no_islands() {
        let mesh = tube(720, 4, 0.0);
        let regions = Regions { length_mm: 4.0, junction: [0.3, 0.4], piece: [0.0, 1.0] };
        let sections: Vec<_> = (0..5).map(|k| section(720, f64::from(k), 1000.0 * f64::from(k))).collect();
        let simulated = morphometry(&sections, &[], &regions, None);
        let layers = |z_um: f64| {
            let um = 20.0 + z_um / 400.0;
            Layers { epithelium_um: um, lamina_um: 40.0, opening_um: 30.0, serosa_um: 20.0, ..Layers::NONE }
        };
        let (found, cuts) = morphometry_of_cuts(&mesh, &regions, &layers, &simulated);
        let cuts = cuts.unwrap();
        assert_eq!((cuts.count, cuts.with_islands, cuts.islands_per_cut, cuts.pockets_per_cut), (8, 0.0, 0.0, 0.0));
        assert_eq!((cuts.from_mm, cuts.to_mm, cuts.island_area_um2), (1.6, 4.0, None));
        for (found, expected) in [(cuts.thickness_um.unwrap(), 500.0), (cuts.gap_um.unwrap(), 1000.0)] {
            for value in [found.least_p5, found.p5, found.p50] {
                assert!((value / expected - 1.0).abs() < 3e-3, "{value} µm, not {expected}");
            }
        }
        assert_eq!(found.settings.basis, Basis::Cuts);
        assert!(found.along.values().all(|values| values.len() == 13));
        let [first, last] = [found.along["z_mm"][0], found.along["z_mm"][12]].map(Option::unwrap);
        assert!((first - 0.001).abs() < 1e-9 && (last - 3.999).abs() < 1e-6, "{first} {last}");
        for name in ["islands", "fold_splits_per_mm", "fold_joins_per_mm", "blind_pockets_per_mm"] {
            assert_eq!(found.mean(name, "whole"), Some(0.0), "{name}");
        }
        // The epithelium grows from 20 to 30 µm, the muscle reaches from there to 980 µm.
        let near = |name: &str, region: &str, expected: f64| {
            let value = found.mean(name, region).unwrap();
            assert!((value / expected - 1.0).abs() < 0.02, "{name} {region}: {value}, not {expected}");
        };
        near("muscle_thickness_um", "whole", 480.0 - 65.0);
        near("muscle_thickness_um", "ampulla", 480.0 - 67.2);
        near("lumen_disc_share", "whole", 1.0);
        assert_eq!(found.mean("touching_share", "whole"), Some(0.0));
    }

    #[test]
    fn a_model_without_ampulla_has_no_cuts_across_it() {
        let mesh = tube(90, 4, 0.0);
        let regions = Regions { length_mm: 20.0, junction: [0.3, 0.4], piece: [0.0, 0.2] };
        let (found, cuts) = morphometry_of_cuts(&mesh, &regions, &|_| Layers::NONE, &Morphometry::default());
        assert!(cuts.is_none() && found.regions.contains_key("isthmus") && !found.regions.contains_key("ampulla"));
    }
}
