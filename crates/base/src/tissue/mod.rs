//! The layers of a cross section: which tissue a point belongs to, on a grid of pixels.
//!
//! The one definition of the layers. Stained pictures (`render/histology`), label images and label volumes (`export/labels`)
//! all read it, so they agree pixel by pixel. docs/histology.md gives the definitions in words.
//!
//! | file | subject |
//! |---|---|
//! | `grid` | pixels over a section |
//! | `contour` | a closed line with its arc length |
//! | `wall` | the muscular wall: how deep it reaches from the outside |
//! | `map` | the tissue of each pixel |

mod contour;
mod grid;
mod map;
#[cfg(test)]
mod tests;
mod wall;

pub use contour::Contour;
pub use grid::Grid;
pub use map::{Place, TissueMap, bands};

/// What a pixel or voxel shows; the discriminant is its value in label images and volumes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Tissue {
    /// Outside the tube.
    Outside = 0,
    /// The open space inside.
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
    /// All, by value.
    pub const ALL: [Self; 7] = [
        Self::Outside,
        Self::Lumen,
        Self::Epithelium,
        Self::LaminaPropria,
        Self::CircularMuscle,
        Self::LongitudinalMuscle,
        Self::Serosa,
    ];

    /// Its name in files.
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
    /// Height of the epithelium, µm: tissue within it of the lumen is epithelium.
    pub epithelium_um: f64,
    /// Least thickness of the lamina propria between epithelium and muscle, µm.
    pub lamina_um: f64,
    /// Share of the longitudinal muscle in the thickness of both, 0 to 1.
    pub longitudinal_share: f64,
    /// Thickness of the serosa, µm.
    pub serosa_um: f64,
}
