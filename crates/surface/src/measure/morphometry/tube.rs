//! Measures of a tube: of every section or cut, by region, and of the whole tube.

use super::quantity::Quantity;
use super::section::{Measures, PIXEL_UM};
use super::{fractal, ring, tree};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Number of sections per section that is measured in detail, and the minimum and maximum number of
/// such sections; the same holds for cuts. Neighbouring sections differ little.
const SECTIONS_PER_DETAILED: usize = 5;
const DETAILED: [usize; 2] = [13, 41];
/// Maximum number of sections whose shape tree is built; they are evenly spread.
const TREES: usize = 31;
/// Number of recorded sections per section whose layers are measured, and the minimum number of
/// such sections. Layers take longer than all other measures and change slowly along the tube.
const SECTIONS_PER_LAYERED: usize = 12;
const LEAST_LAYERED: usize = 5;
/// Maximum number of sections whose layers are measured.
const LAYERED: usize = 16;

/// Measures of a model. `docs/morphometry.md` defines them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Morphometry {
    /// Measures of the whole tube.
    pub tube: Tube,
    /// Measures by region: `isthmus`, `junction`, `ampulla` and `whole`. A region without sections
    /// is absent.
    pub regions: BTreeMap<String, Region>,
    /// One value per section or cut, by quantity; null if it lacks the quantity. Sections that were
    /// added to mend a slab are left out.
    pub along: BTreeMap<String, Vec<Option<f64>>>,
    /// Settings of the measurement.
    pub settings: Settings,
}

/// Measures of the whole tube.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Tube {
    /// Length of the model along the tube.
    pub length_mm: f64,
    /// Length of the part of the isthmus in the model.
    pub isthmus_length_mm: f64,
    /// Length of the part of the ampulla in the model.
    pub ampulla_length_mm: f64,
    /// Number of primary folds in the ampulla divided by the number in the isthmus; both are means
    /// over the region.
    pub fold_ratio: Option<f64>,
    /// Volume of the lumen: the areas of the sections, integrated by the trapezoidal rule.
    pub lumen_volume_mm3: f64,
    /// Volume of the tissue, integrated in the same way. The certificate has the volume of the
    /// surface.
    pub tissue_volume_mm3: f64,
    /// Surface of the mucosa: the perimeters of the sections, integrated by the trapezoidal rule.
    pub lumen_surface_mm2: f64,
    /// Surface of the mucosa divided by the volume of the lumen.
    pub surface_over_volume_per_mm: f64,
    /// Four times the volume of the lumen, divided by the surface of the mucosa.
    pub hydraulic_diameter_um: f64,
    /// Mean fraction of the folds on the counting ring that continue as one fold each in the next
    /// section.
    pub fold_continuity: Option<f64>,
    /// Angle by which the mucosa turns around the axis from end to end, degrees; positive if
    /// counter-clockwise as seen from the ampulla.
    pub twist_deg: f64,
}

/// Measures of a region.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Region {
    /// Start of the region, mm from the isthmus end.
    pub from_mm: f64,
    /// End, measured like `from_mm`.
    pub to_mm: f64,
    /// Number of measured sections or cuts in the region.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub sections: usize,
    /// Values along the region, by quantity. A quantity that no section has is absent.
    pub quantities: BTreeMap<String, Along>,
}

/// A quantity along a region. Each section is weighted by the length of tube next to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Along {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// Standard deviation between sections.
    pub sd: f64,
    /// Minimum.
    pub min: f64,
    /// Maximum.
    pub max: f64,
}

/// Contours that were measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Basis {
    /// Sections of the simulation.
    #[default]
    Sections,
    /// Planar cuts across the surface before bending.
    Cuts,
}

/// Settings with which a model was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Settings {
    /// Measured contours. Reports of version 0.3.0 and earlier lack this member; they measured
    /// sections.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schema(required = false))]
    pub basis: Basis,
    /// Side of a pixel of the masks. Pixels are larger if the lumen is wider than 8192 of them.
    pub pixel_um: f64,
    /// Minimum and maximum side of the counted boxes, pixels.
    pub boxes_px: [u32; 2],
    /// Size of the counting ring as a fraction of the base ellipse.
    pub ring_share: f64,
    /// Minimum height of a fold or branch.
    pub least_height_um: f64,
    /// Minimum ratio of the height of a fold or branch to the width of its base.
    pub least_slenderness: f64,
    /// Interval of sections or cuts at which thickness, gap, asymmetry, dimensions and lacunarity are
    /// measured. Reports of version 0.3.0 and earlier lack this member; they measured all sections.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schema(required = false))]
    pub detail_every: u32,
    /// Interval of sections or cuts at which the shape tree is built.
    pub tree_every: u32,
    /// Interval of sections or cuts at which layers are measured. Reports of version 0.3.0 and
    /// earlier lack this member.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schema(required = false))]
    pub layers_every: u32,
}

impl Morphometry {
    /// Mean of a quantity over a region. The region `tube` contains the measures of the whole tube.
    #[must_use]
    pub fn mean(&self, quantity: &str, region: &str) -> Option<f64> {
        if region == "tube" {
            return serde_json::json!(self.tube).get(quantity)?.as_f64();
        }
        Some(self.regions.get(region)?.quantities.get(quantity)?.mean)
    }

    /// Means by region and quantity as JSON; the member `tube` contains the measures of the whole
    /// tube.
    #[must_use]
    pub fn means(&self) -> serde_json::Value {
        let means = |region: &Region| -> serde_json::Map<_, _> {
            region.quantities.iter().map(|(name, along)| (name.clone(), along.mean.into())).collect()
        };
        let mut all: serde_json::Map<_, _> =
            self.regions.iter().map(|(name, region)| (name.clone(), means(region).into())).collect();
        all.insert("tube".into(), serde_json::json!(self.tube));
        all.into()
    }
}

/// Places of the regions of a tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regions {
    /// Length of the tube.
    pub length_mm: f64,
    /// Start and end of the junction of isthmus and ampulla, as fractions of the length.
    pub junction: [f64; 2],
    /// Start and end of the measured piece of the tube, as fractions of the length.
    pub piece: [f64; 2],
}

impl Regions {
    /// Measured part of the ampulla, mm; `None` if there is none.
    pub(super) fn ampulla_mm(&self) -> Option<[f64; 2]> {
        let [from, to] = [self.junction[1].max(self.piece[0]), self.piece[1]].map(|part| part * self.length_mm);
        (from < to).then_some([from, to])
    }

    fn ranges(&self) -> [(&'static str, [f64; 2]); 4] {
        let [from, to] = self.junction.map(|part| part * self.length_mm);
        let end = self.length_mm;
        [("isthmus", [0.0, from]), ("junction", [from, to]), ("ampulla", [to, end]), ("whole", [0.0, end])]
    }
}

/// Measured sections or cuts of a model, in ascending order along the tube.
pub(super) struct Found {
    pub(super) basis: Basis,
    pub(super) intervals: Intervals,
    pub(super) z_mm: Vec<f64>,
    pub(super) measures: Vec<Measures>,
    /// Further values along the tube that regions summarize.
    pub(super) steps: BTreeMap<String, Vec<Option<f64>>>,
    /// Mean continuity of the folds, and twist from end to end.
    pub(super) fold_continuity: Option<f64>,
    pub(super) twist_deg: f64,
}

impl Found {
    /// Summarizes the values by region and over the whole tube. `quantities` are those of each
    /// section.
    pub(super) fn summarized(
        self,
        quantities: impl Iterator<Item = &'static Quantity>,
        regions: &Regions,
    ) -> Morphometry {
        let Self { basis, intervals, z_mm, measures, steps, fold_continuity, twist_deg } = self;
        let values = |of: &Quantity| measures.iter().map(|m| of.of(m)).collect();
        let mut along: BTreeMap<String, Vec<Option<f64>>> =
            quantities.map(|quantity| (quantity.name.to_owned(), values(quantity))).collect();
        along.extend(steps);
        let regions_found = regions.ranges().into_iter().filter_map(|(name, range)| {
            Some((name.to_owned(), region(range, name == "whole" || name == "ampulla", &z_mm, &along)?))
        });
        let regions_found: BTreeMap<String, Region> = regions_found.collect();
        let folds = |name: &str| Some(regions_found.get(name)?.quantities.get("primary_folds")?.mean);
        let fold_ratio = folds("isthmus").filter(|&n| n > 0.0).and_then(|n| Some(folds("ampulla")? / n));
        let tube = Tube { fold_ratio, fold_continuity, twist_deg, ..tube(regions, &z_mm, &measures) };
        let settings = Settings {
            basis,
            pixel_um: PIXEL_UM,
            boxes_px: [2, 1 << fractal::LEVELS],
            ring_share: ring::SHARE,
            least_height_um: tree::LEAST_HEIGHT_UM,
            least_slenderness: tree::LEAST_SLENDERNESS,
            detail_every: intervals.detail as u32,
            tree_every: intervals.tree as u32,
            layers_every: intervals.layers as u32,
        };
        // Inserted after the regions, which do not summarize places.
        along.insert("z_mm".into(), z_mm.into_iter().map(Some).collect());
        Morphometry { tube, regions: regions_found, along, settings }
    }
}

/// Number of sections or cuts that are measured in detail in a model with a number of sections.
#[must_use]
pub fn detailed_places(sections: usize) -> usize {
    sections.div_ceil(SECTIONS_PER_DETAILED).clamp(DETAILED[0], DETAILED[1])
}

/// Intervals of measured sections or cuts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Intervals {
    count: usize,
    /// Interval at which more than the outline is measured.
    pub(super) detail: usize,
    /// Interval at which the shape tree is built.
    pub(super) tree: usize,
    /// Interval at which layers are measured, a multiple of that of the shape tree.
    pub(super) layers: usize,
}

impl Intervals {
    /// Intervals of the recorded sections of a model.
    pub(super) fn of_sections(count: usize) -> Self {
        let detail = count.saturating_sub(1).div_ceil(detailed_places(count) - 1).max(1);
        Self { detail, ..Self::of_cuts(count, count) }
    }

    /// Intervals of the measured cuts across a model with a number of recorded sections.
    pub(super) fn of_cuts(count: usize, sections: usize) -> Self {
        let last = count.saturating_sub(1);
        let tree = last.div_ceil(TREES - 1).max(1);
        let layered = (sections / SECTIONS_PER_LAYERED).clamp(LEAST_LAYERED, LAYERED);
        Self { count, detail: 1, tree, layers: tree * last.div_ceil(tree * (layered - 1)).max(1) }
    }

    /// True if more than the outline of a section is measured: at the interval, and where layers are.
    pub(super) fn has_detail(&self, k: usize) -> bool {
        k.is_multiple_of(self.detail) || self.has_layers(k)
    }

    /// True if the shape tree of a section is built.
    pub(super) fn has_tree(&self, k: usize) -> bool {
        k.is_multiple_of(self.tree) || k + 1 == self.count
    }

    /// True if the layers of a section are measured. It then has a shape tree, too.
    pub(super) fn has_layers(&self, k: usize) -> bool {
        k.is_multiple_of(self.layers) || k + 1 == self.count
    }
}

/// Measures of the sections from one place up to but excluding another, or up to the end of the
/// tube.
fn region(
    [from_mm, to_mm]: [f64; 2],
    last: bool,
    z_mm: &[f64],
    along: &BTreeMap<String, Vec<Option<f64>>>,
) -> Option<Region> {
    let within = |z: f64| z >= from_mm && (z < to_mm || last);
    let sections: Vec<usize> = (0..z_mm.len()).filter(|&i| within(z_mm[i])).collect();
    if sections.is_empty() {
        return None;
    }
    let quantities = along.iter().filter_map(|(name, values)| {
        // The sections that have a value share the length of the region.
        let known: Vec<(f64, f64)> = sections.iter().filter_map(|&i| Some((z_mm[i], values[i]?))).collect();
        Some((name.clone(), summary(&known)?))
    });
    Some(Region { from_mm, to_mm, sections: sections.len(), quantities: quantities.collect() })
}

/// Summarizes values at places in ascending order. Each value weighs half the distance between its
/// neighbours.
fn summary(known: &[(f64, f64)]) -> Option<Along> {
    let (first, last) = (known.first()?, known.last()?);
    let weight = |i: usize| match known.len() {
        1 => 1.0,
        n => (known[(i + 1).min(n - 1)].0 - known[i.saturating_sub(1)].0) / 2.0,
    };
    let total = if known.len() == 1 { 1.0 } else { last.0 - first.0 };
    let mean = |of: &dyn Fn(f64) -> f64| {
        known.iter().enumerate().map(|(i, &(_, value))| weight(i) * of(value)).sum::<f64>() / total
    };
    let average = mean(&|value| value);
    Some(Along {
        mean: average,
        median: median(known, weight, total),
        sd: mean(&|value| (value - average).powi(2)).max(0.0).sqrt(),
        min: known.iter().map(|k| k.1).fold(f64::INFINITY, f64::min),
        max: known.iter().map(|k| k.1).fold(f64::NEG_INFINITY, f64::max),
    })
}

/// Smallest value up to which half of the length lies.
fn median(known: &[(f64, f64)], weight: impl Fn(usize) -> f64, total: f64) -> f64 {
    let mut values: Vec<(f64, f64)> = known.iter().enumerate().map(|(i, &(_, value))| (value, weight(i))).collect();
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let mut passed = 0.0;
    let middle = values.iter().find(|(_, weight)| {
        passed += weight;
        // Half, except for the rounding of the sum.
        passed >= total * (0.5 - 1e-12)
    });
    middle.map_or(f64::NAN, |(value, _)| *value)
}

/// Volumes and lengths of the tube.
fn tube(regions: &Regions, z_mm: &[f64], measured: &[Measures]) -> Tube {
    let integral = |of: fn(&Measures) -> f64| -> f64 {
        let pairs = measured.windows(2).zip(z_mm.windows(2));
        pairs.map(|(pair, z)| (z[1] - z[0]) * (of(&pair[0]) + of(&pair[1])) / 2.0).sum()
    };
    let volume = integral(|m| m.lumen_area_mm2);
    let surface = integral(|m| m.lumen_perimeter_mm);
    let ([begin, end], [from, to]) = (regions.piece, regions.junction);
    Tube {
        length_mm: (end - begin) * regions.length_mm,
        isthmus_length_mm: (from.min(end) - begin).max(0.0) * regions.length_mm,
        ampulla_length_mm: (end - to.max(begin)).max(0.0) * regions.length_mm,
        lumen_volume_mm3: volume,
        tissue_volume_mm3: integral(|m| m.tissue_area_mm2),
        lumen_surface_mm2: surface,
        surface_over_volume_per_mm: surface / volume,
        hydraulic_diameter_um: 4e3 * volume / surface,
        ..Tube::default()
    }
}
