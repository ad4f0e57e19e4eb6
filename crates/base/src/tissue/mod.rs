//! Tissue layers of a cross section, on a grid of pixels.
//!
//! This is the only definition of the layers. Stained pictures (`render/histology`) and label
//! images and volumes (`export/labels`) read it, so they agree pixel by pixel. docs/histology.md
//! gives the definitions in words.
//!
//! | file | subject |
//! |---|---|
//! | `grid` | pixels over a section |
//! | `contour` | lines with their arc length |
//! | `fill` | pixels inside closed lines |
//! | `field` | inner border of the muscle |
//! | `wall` | layers of the wall |
//! | `bundles`, `vessels` | longitudinal bundles and vessels, which continue along the tube |
//! | `map` | tissue of each pixel |
//! | `relief`, `lattice` | texture of mucosa and serosa seen from outside, for pictures |

mod bundles;
mod contour;
mod field;
mod fill;
mod grid;
mod lattice;
mod map;
mod relief;
#[cfg(test)]
mod tests;
mod vessels;
mod wall;

use crate::random::{Stream, unit, words};
use std::f64::consts::TAU;

pub use contour::Contour;
pub use grid::Grid;
pub use map::{Place, TissueMap, bands};
pub use relief::{Relief, Sampling, WallTexture};

/// Content of a pixel or voxel. The discriminant is the value in label images and volumes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Tissue {
    /// Outside the tube.
    Outside = 0,
    /// The open space inside the tube.
    Lumen = 1,
    /// The columnar epithelium that lines the lumen.
    Epithelium = 2,
    /// Connective tissue: the cores of the folds and the layer under the epithelium.
    LaminaPropria = 3,
    /// The inner muscle, whose fibres run around the tube.
    CircularMuscle = 4,
    /// The outer muscle, whose fibres run along the tube.
    LongitudinalMuscle = 5,
    /// The outermost layer.
    Serosa = 6,
    /// Loose connective tissue between muscle and serosa.
    Subserosa = 7,
    /// A muscle inside the circular one, whose fibres run along the tube.
    InnerLongitudinalMuscle = 8,
    /// A blood vessel of the wall, with its own wall.
    Vessel = 9,
}

impl Tissue {
    /// All tissues, by value.
    pub const ALL: [Self; 10] = [
        Self::Outside,
        Self::Lumen,
        Self::Epithelium,
        Self::LaminaPropria,
        Self::CircularMuscle,
        Self::LongitudinalMuscle,
        Self::Serosa,
        Self::Subserosa,
        Self::InnerLongitudinalMuscle,
        Self::Vessel,
    ];

    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Outside => "outside",
            Self::Lumen => "lumen",
            Self::Epithelium => "epithelium",
            Self::LaminaPropria => "lamina propria",
            Self::CircularMuscle => "circular muscle",
            Self::LongitudinalMuscle => "longitudinal muscle",
            Self::Serosa => "serosa",
            Self::Subserosa => "subserosa",
            Self::InnerLongitudinalMuscle => "inner longitudinal muscle",
            Self::Vessel => "vessel",
        }
    }
}

/// Layers of the wall at a place along the tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layers {
    /// Height of the epithelium, µm: the maximum distance of epithelium from the lumen.
    pub epithelium_um: f64,
    /// Minimum thickness of the lamina propria between epithelium and muscle, µm.
    pub lamina_um: f64,
    /// Radius of the disc that fits into every part of the muscle: half the width of the widest
    /// core of a fold that contains no muscle, µm.
    pub opening_um: f64,
    /// Thickness of the inner longitudinal muscle, µm.
    pub inner_longitudinal_um: f64,
    /// Thickness of the outer longitudinal muscle as a fraction of the muscle, 0 to 1.
    pub longitudinal_share: f64,
    /// Share of the circumference that the outer longitudinal muscle covers, 0 to 1.
    pub longitudinal_cover: f64,
    /// Thickness of the subserosa opposite to the mesosalpinx, µm. At the mesosalpinx, in the
    /// direction of −y, it is three times as thick.
    pub subserosa_um: f64,
    /// Thickness of the serosa, µm.
    pub serosa_um: f64,
    /// Number of vessels: half of them between the muscles, half of them in the subserosa. A
    /// fraction is the area of a vessel that ends.
    pub vessels: f64,
    /// Place along the tube, µm, and seed of the model: bundles and vessels depend on both.
    pub z_um: f64,
    /// Seed of the model.
    pub seed: u64,
}

impl Layers {
    /// No layers at all, with a longitudinal muscle that would surround the tube.
    pub const NONE: Self = Self {
        epithelium_um: 0.0,
        lamina_um: 0.0,
        opening_um: 0.0,
        inner_longitudinal_um: 0.0,
        longitudinal_share: 0.0,
        longitudinal_cover: 1.0,
        subserosa_um: 0.0,
        serosa_um: 0.0,
        vessels: 0.0,
        z_um: 0.0,
        seed: 0,
    };

    /// Minimum distance of muscle from the lumen, µm.
    fn mucosa_um(&self) -> f64 {
        self.epithelium_um + self.lamina_um
    }
}

/// Minimum wavelength along the tube of the wandering of bundles and vessels, µm; chosen.
const WAVE_UM: f64 = 3000.0;
/// First counter of the random numbers of the wall. Those of cells and of the lattice are lower.
const WALL: u32 = 1 << 31;

/// Four random numbers in `[0, 1)` of the structure `k` of a model.
fn random(seed: u64, k: u32) -> [f64; 4] {
    words(seed, Stream::Histology, u32::MAX, WALL + k).map(|word| f64::from(unit(word)))
}

/// Displacement of the structure `k` at the place of a section, from −1 to 1. It changes slowly
/// along the tube.
fn wander(layers: &Layers, k: u32) -> f64 {
    let [wave, phase, other_wave, other_phase] = random(layers.seed, k);
    let sine = |wave: f64, phase: f64| libm::sin(TAU * (layers.z_um / (WAVE_UM * (1.0 + 2.0 * wave)) + phase));
    0.6 * sine(wave, phase) + 0.4 * sine(other_wave, other_phase)
}
