//! Morphometry: what a section or a tube measures, to be compared with anatomy (paper, section 4.1).
//!
//! Every measure is of contours in micrometres, whether a simulation made them or a micrograph was traced. The result depends neither
//! on the number of threads nor on timing. `docs/morphometry.md` has the definitions.
//!
//! | file | subject |
//! |---|---|
//! | `shape` | contours of a section, its base ellipse |
//! | `section` | the measures of one section |
//! | `quantity` | their names, titles and units |
//! | `rays` | tissue thickness, lumen gap |
//! | `ring` | folds on a ring, their continuity and twist |
//! | `tree` | folds, their heights and branches by the shape tree |
//! | `around` | how the mucosa is spread around the tube |
//! | `mask`, `fractal` | fractal dimension and lacunarity |
//! | `cuts` | planar cuts across the ampulla |
//! | `tube` | along the tube, by region, and of the whole |

mod around;
mod cuts;
mod fractal;
mod mask;
mod quantity;
mod rays;
mod ring;
mod section;
mod shape;
mod spread;
mod tree;
mod tube;
mod walls;

pub use around::Around;
pub use cuts::{AmongCuts, Cuts, cuts};
pub use fractal::Dimension;
pub use quantity::{QUANTITIES, Quantity};
pub use section::{Measures, measure};
pub use shape::Shape;
pub use spread::Spread;
pub use tree::Folds;
pub use tube::{Along, Morphometry, Region, Regions, Settings, Tube, morphometry};

#[cfg(test)]
mod tests;
