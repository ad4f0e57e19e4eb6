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
//! | `wall` | depth of the muscular wall |
//! | `map` | tissue of each pixel |

mod contour;
mod grid;
mod map;
#[cfg(test)]
mod tests;
mod wall;

pub use contour::Contour;
pub use grid::Grid;
pub use map::{Place, TissueMap, bands};

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
}

impl Tissue {
    /// All tissues, by value.
    pub const ALL: [Self; 7] = [
        Self::Outside,
        Self::Lumen,
        Self::Epithelium,
        Self::LaminaPropria,
        Self::CircularMuscle,
        Self::LongitudinalMuscle,
        Self::Serosa,
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
        }
    }
}

/// Heights of the layers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layers {
    /// Height of the epithelium, µm: the maximum distance of epithelium from the lumen.
    pub epithelium_um: f64,
    /// Minimum thickness of the lamina propria between epithelium and muscle, µm.
    pub lamina_um: f64,
    /// Thickness of the longitudinal muscle as a fraction of both muscles, 0 to 1.
    pub longitudinal_share: f64,
    /// Thickness of the serosa, µm.
    pub serosa_um: f64,
}
