//! Measures of one section.

use super::around::{Around, around};
use super::disc::largest_radius;
use super::fractal::{Dimension, dimension, lacunarity};
use super::layers::{self, LayerMeasures};
use super::mask;
use super::rays::distances;
use super::ring;
use super::shape::{Ellipse, Shape};
use super::spread::Spread;
use super::tree::{self, Folds};
use crate::tissue::Layers;

/// Side of the pixels of masks, µm. Larger if the lumen is wider than 8192 of them.
pub(super) const PIXEL_UM: f64 = 4.0;

/// Maximum distance between the starts of rays in images and in sections and cuts of models, µm.
const IMAGE_RAYS_UM: f64 = 5.0;
pub(super) const MODEL_RAYS_UM: f64 = 10.0;

/// Square micrometres in a square millimetre.
const MM2_UM2: f64 = 1e6;

/// Measures of a section. A measure that does not exist for the section is `None`, such as the
/// height of folds if there are none.
#[derive(Clone, Debug, PartialEq)]
pub struct Measures {
    /// Area of the lumen.
    pub lumen_area_mm2: f64,
    /// Area of the tissue, islands included.
    pub tissue_area_mm2: f64,
    /// Diameter of the circle with the area within the outer contour.
    pub outer_diameter_mm: f64,
    /// Fraction of the area within the outer contour that lies outside the base ellipse.
    pub wall_share: f64,
    /// Fraction of the area of the base ellipse that is tissue.
    pub fill: f64,
    /// Length of the boundary of the lumen.
    pub lumen_perimeter_mm: f64,
    /// That length relative to the circumference of the base ellipse.
    pub perimeter_ratio: f64,
    /// Four times the area of the lumen over its perimeter.
    pub hydraulic_diameter_um: f64,
    /// Islands: pieces of tissue surrounded by lumen.
    pub islands: u32,
    /// Folds that cross the ring, 0.75 of the base ellipse.
    pub folds_on_ring: u32,
    /// Folds by the shape tree; `None` if the tree was not built for this section.
    pub folds: Option<Folds>,
    /// Median height of the primary folds over half the mean diameter of the base ellipse.
    pub fold_height_share: Option<f64>,
    /// Diameter of the largest disc in the lumen over the mean diameter of the base ellipse; `None`
    /// if the layers were not measured.
    pub lumen_disc_share: Option<f64>,
    /// Layers of the wall; `None` if they were not measured in this section.
    pub layers: Option<LayerMeasures>,
    /// Distribution of the boundary of the lumen around the tube. `None`, like all of the following,
    /// if only the outline of the section was measured.
    pub around: Option<Around>,
    /// Distances from the boundary of the lumen along its normals through tissue to the next wall, µm.
    pub thickness_um: Option<Spread>,
    /// Distances from the boundary of the lumen along its normals through the lumen to the next wall, µm.
    pub gap_um: Option<Spread>,
    /// Share of the boundary of the lumen with a gap below 10 µm.
    pub touching_share: Option<f64>,
    /// Box-counting dimension of the area of the lumen.
    pub area_dimension: Option<Dimension>,
    /// Box-counting dimension of the outline of the lumen.
    pub outline_dimension: Option<Dimension>,
    /// Lacunarity of the area of the lumen.
    pub lacunarity: Option<f64>,
}

impl Measures {
    /// Adds what rays and pixels show. The largest disc is looked for in a section with layers.
    fn add_detail(&mut self, shape: &Shape<'_>, base: &Ellipse, rays_um: f64, layers: Option<&Layers>) {
        let along = distances(shape, rays_um, layers.is_some());
        self.around = around(shape, base);
        (self.thickness_um, self.gap_um, self.touching_share) = (along.thickness, along.gap, along.touching);
        self.lumen_disc_share = layers.map(|_| 2.0 * largest_radius(shape, along.chords) / base.mean_diameter());
        let bits = mask::lumen(shape, mask::pixel(shape, PIXEL_UM));
        (self.area_dimension, self.outline_dimension) = (dimension(&bits), dimension(&bits.outline()));
        self.lacunarity = lacunarity(&bits);
    }
}

/// What is measured of a section.
#[derive(Clone, Copy)]
pub(super) struct Scope<'a> {
    /// Maximum distance between the starts of rays, µm. `None` measures only areas, lengths and the
    /// counting ring.
    pub(super) rays_um: Option<f64>,
    /// True if the shape tree is built.
    pub(super) tree: bool,
    /// Layers, if they are measured.
    pub(super) layers: Option<&'a Layers>,
}

/// Measures a section. `trees` also builds its shape tree, which takes longer than all other
/// measures.
#[must_use]
pub fn measure(shape: &Shape<'_>, trees: bool) -> Measures {
    measure_with(shape, &shape.base_ellipse(), Scope { rays_um: Some(IMAGE_RAYS_UM), tree: trees, layers: None })
}

/// Measures a section with its base ellipse.
pub(super) fn measure_with(shape: &Shape<'_>, base: &Ellipse, scope: Scope<'_>) -> Measures {
    let (lumen, outer, perimeter) = (shape.lumen_area(), shape.outer_area(), shape.perimeter());
    let folds = if scope.tree { tree::folds(shape, base) } else { None };
    let clefts = folds.as_ref().map_or(&[][..], |folds| &folds.clefts);
    let layers = scope.layers.filter(|_| !shape.lumen.is_empty());
    let height = folds.as_ref().and_then(|folds| folds.height_um);
    let mut measures = Measures {
        lumen_area_mm2: lumen / MM2_UM2,
        tissue_area_mm2: (outer - lumen) / MM2_UM2,
        outer_diameter_mm: 2.0 * (outer / std::f64::consts::PI).sqrt() / 1e3,
        wall_share: 1.0 - base.area() / outer,
        fill: 1.0 - lumen / base.area(),
        lumen_perimeter_mm: perimeter / 1e3,
        perimeter_ratio: perimeter / base.circumference(),
        hydraulic_diameter_um: 4.0 * lumen / perimeter,
        islands: shape.islands(),
        folds_on_ring: ring::count(shape, base),
        layers: layers.map(|layers| layers::measured(shape, layers, clefts, base.centre)),
        folds,
        fold_height_share: height.map(|height| 2.0 * height.p50 / base.mean_diameter()),
        lumen_disc_share: None,
        around: None,
        thickness_um: None,
        gap_um: None,
        touching_share: None,
        area_dimension: None,
        outline_dimension: None,
        lacunarity: None,
    };
    if let Some(rays_um) = scope.rays_um {
        measures.add_detail(shape, base, rays_um, layers);
    }
    measures
}
