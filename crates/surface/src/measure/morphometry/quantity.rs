//! Quantities of a section by name: the only list, used by reports, comparisons and plots.

use super::layers::LayerMeasures;
use super::section::Measures;
use super::tree::GENERATIONS;

/// Quantity that has a value in each section.
pub struct Quantity {
    /// Name in reports.
    pub name: &'static str,
    /// Title for readers.
    pub title: &'static str,
    /// Unit; empty for a plain number.
    pub unit: &'static str,
    /// True if the value needs the layers of the wall, which images do not have.
    pub of_layers: bool,
    of: fn(&Measures) -> Option<f64>,
}

impl Quantity {
    /// Returns the value in a section; `None` if the section has none or it is not finite.
    #[must_use]
    pub fn of(&self, measures: &Measures) -> Option<f64> {
        (self.of)(measures).filter(|value| value.is_finite())
    }

    /// Quantities of simulated sections without layers: all except [`ISLANDS`] and those of layers.
    pub fn of_simulated() -> impl Iterator<Item = &'static Self> {
        QUANTITIES.iter().filter(|quantity| quantity.name != ISLANDS && !quantity.of_layers)
    }

    /// Finds a quantity by name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        QUANTITIES.iter().find(|quantity| quantity.name == name)
    }
}

/// Names, titles and units of the changes from one section or cut to the next.
pub const CHANGES: [(&str, &str, &str); 3] = [
    ("fold_splits_per_mm", "Folds that split", "1/mm"),
    ("fold_joins_per_mm", "Folds that join", "1/mm"),
    ("blind_pockets_per_mm", "Clefts that end blind", "1/mm"),
];

/// Name of the number of islands. The lumen of a simulated section is one ring, so it has none;
/// images and planar cuts of the surface have islands.
pub const ISLANDS: &str = "islands";

/// Quantity of the shape of a section.
const fn of_shape(
    name: &'static str,
    title: &'static str,
    unit: &'static str,
    of: fn(&Measures) -> Option<f64>,
) -> Quantity {
    Quantity { name, title, unit, of_layers: false, of }
}

/// Quantity of the layers of a section.
const fn of_layers(
    name: &'static str,
    title: &'static str,
    unit: &'static str,
    of: fn(&Measures) -> Option<f64>,
) -> Quantity {
    Quantity { name, title, unit, of_layers: true, of }
}

macro_rules! quantities {
    ($(@$kind:ident $($name:expr, $title:literal, $unit:literal, $of:expr;)*)*) => {
        /// All quantities of a section; `docs/morphometry.md` defines them.
        pub const QUANTITIES: &[Quantity] = &[$($($kind($name, $title, $unit, $of)),*),*];
    };
}

quantities! {
    @of_shape
    "lumen_area_mm2", "Lumen area", "mm²", |m| Some(m.lumen_area_mm2);
    "tissue_area_mm2", "Tissue area", "mm²", |m| Some(m.tissue_area_mm2);
    "tissue_diameter_mm", "Diameter of the circle of the tissue area", "mm", |m| {
        Some(2.0 * (m.tissue_area_mm2 / std::f64::consts::PI).sqrt())
    };
    "outer_diameter_mm", "Outer diameter", "mm", |m| Some(m.outer_diameter_mm);
    "wall_share", "Wall share", "", |m| Some(m.wall_share);
    "fill", "Fill", "", |m| Some(m.fill);
    "lumen_perimeter_mm", "Lumen perimeter", "mm", |m| Some(m.lumen_perimeter_mm);
    "perimeter_ratio", "Perimeter ratio", "", |m| Some(m.perimeter_ratio);
    "hydraulic_diameter_um", "Hydraulic diameter", "µm", |m| Some(m.hydraulic_diameter_um);
    ISLANDS, "Islands", "", |m| Some(m.islands.into());
    "folds_on_ring", "Folds on the ring", "", |m| Some(m.folds_on_ring.into());
    "primary_folds", "Primary folds", "", |m| branches(m, 0);
    "secondary_folds", "Secondary folds", "", |m| branches(m, 1);
    "tertiary_folds", "Tertiary folds", "", |m| Some(branches(m, 2)? + branches(m, GENERATIONS - 1)?);
    "branching_order", "Branching order, median", "", |m| m.folds.as_ref()?.median_order();
    "branching_order_mean", "Branching order, mean", "", |m| m.folds.as_ref()?.mean_order();
    "fold_height_p5_um", "Fold height, 5th percentile", "µm", |m| Some(m.folds.as_ref()?.height_um?.p5);
    "fold_height_p50_um", "Fold height, median", "µm", |m| Some(m.folds.as_ref()?.height_um?.p50);
    "fold_height_p95_um", "Fold height, 95th percentile", "µm", |m| Some(m.folds.as_ref()?.height_um?.p95);
    "fold_height_cv", "Fold height, coefficient of variation", "", |m| Some(m.folds.as_ref()?.height_um?.cv);
    "fold_height_share", "Fold height over half the base ellipse", "", |m| m.fold_height_share;
    "fold_angle_deg", "Angle of primary folds to the radius, median", "°", |m| m.folds.as_ref()?.angle_deg;
    "asymmetry", "Asymmetry of the mucosa", "", |m| Some(m.around?.asymmetry);
    "angular_cv", "Mucosa by direction, coefficient of variation", "", |m| Some(m.around?.angular_cv);
    "tissue_thickness_p5_um", "Tissue thickness, 5th percentile", "µm", |m| Some(m.thickness_um?.p5);
    "tissue_thickness_p50_um", "Tissue thickness, median", "µm", |m| Some(m.thickness_um?.p50);
    "tissue_thickness_p95_um", "Tissue thickness, 95th percentile", "µm", |m| Some(m.thickness_um?.p95);
    "tissue_thickness_cv", "Tissue thickness, coefficient of variation", "", |m| Some(m.thickness_um?.cv);
    "lumen_gap_p5_um", "Lumen gap, 5th percentile", "µm", |m| Some(m.gap_um?.p5);
    "lumen_gap_p50_um", "Lumen gap, median", "µm", |m| Some(m.gap_um?.p50);
    "lumen_gap_p95_um", "Lumen gap, 95th percentile", "µm", |m| Some(m.gap_um?.p95);
    "lumen_gap_cv", "Lumen gap, coefficient of variation", "", |m| Some(m.gap_um?.cv);
    "touching_share", "Mucosa with a gap below 10 µm", "", |m| m.touching_share;
    "fractal_dimension", "Fractal dimension of the lumen area", "", |m| Some(m.area_dimension?.value);
    "fractal_dimension_error", "Its standard error", "", |m| Some(m.area_dimension?.error);
    "outline_dimension", "Fractal dimension of the lumen outline", "", |m| Some(m.outline_dimension?.value);
    "outline_dimension_error", "Its standard error", "", |m| Some(m.outline_dimension?.error);
    "lacunarity", "Lacunarity of the lumen area", "", |m| m.lacunarity;
    @of_layers
    "muscle_thickness_um", "Muscle thickness", "µm", |m| layer(m, |of| of.muscle_um);
    "circular_thickness_um", "Circular muscle, thickness", "µm", |m| layer(m, |of| of.circular_um);
    "longitudinal_thickness_um", "Longitudinal muscle, thickness", "µm", |m| layer(m, |of| of.longitudinal_um);
    "inner_longitudinal_thickness_um", "Inner longitudinal muscle, thickness", "µm", |m| {
        layer(m, |of| of.inner_longitudinal_um)
    };
    "lamina_thickness_um", "Lamina propria, area over mucosa", "µm", |m| layer(m, |of| of.lamina_um);
    "epithelium_height_um", "Epithelium, area over mucosa", "µm", |m| layer(m, |of| of.epithelium_um);
    "subserosa_thickness_um", "Subserosa, thickness", "µm", |m| layer(m, |of| of.subserosa_um);
    "muscle_area_mm2", "Muscle area", "mm²", |m| layer(m, |of| of.muscle_mm2);
    "mucosa_area_mm2", "Mucosa area", "mm²", |m| layer(m, |of| of.mucosa_mm2);
    "muscle_over_mucosa", "Muscle over mucosa, by area", "", |m| layer(m, LayerMeasures::muscle_over_mucosa);
    "lamina_over_epithelium", "Lamina propria over epithelium, by area", "", |m| m.layers.as_ref()?.lamina_over_epithelium;
    "longitudinal_cover", "Circumference with longitudinal muscle", "", |m| m.layers.as_ref()?.longitudinal_cover;
    "vessels", "Vessels", "", |m| layer(m, |of| of.vessels.into());
    "free_lumen", "Free lumen", "", |m| layer(m, |of| of.free_lumen);
    "lumen_disc_share", "Largest disc in the lumen over the base ellipse", "", |m| m.lumen_disc_share;
    "cleft_lamina_um", "Lamina propria below clefts, median", "µm", |m| m.layers.as_ref()?.cleft_lamina_um;
}

fn layer(measures: &Measures, of: fn(&LayerMeasures) -> f64) -> Option<f64> {
    measures.layers.as_ref().map(of)
}

fn branches(measures: &Measures, generation: usize) -> Option<f64> {
    measures.folds.as_ref().map(|folds| folds.branches[generation].into())
}
