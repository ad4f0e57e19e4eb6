//! Morphometry: measures of sections and tubes for comparison with anatomy (paper, section 4.1).
//!
//! All measures are computed from contours in micrometres, from a simulation or a micrograph.
//! Results depend neither on the number of threads nor on timing. `docs/morphometry.md` defines the
//! measures.
//!
//! | file | subject |
//! |---|---|
//! | `shape` | contours of a section, its base ellipse |
//! | `section` | all measures of one section |
//! | `quantity` | names, titles and units of the measures |
//! | `rays`, `walls` | tissue thickness, lumen gap |
//! | `ring` | folds on a ring, their continuity and twist |
//! | `tree` | folds, their heights and branches by the shape tree |
//! | `around` | distribution of the mucosa around the tube |
//! | `mask`, `fractal` | fractal dimension and lacunarity |
//! | `layers` | layers of the wall: muscle, lamina propria, epithelium, vessels |
//! | `disc` | the largest disc in the lumen |
//! | `track` | folds that split or join along the tube, clefts that end blind |
//! | `sections` | all sections of a simulation |
//! | `cuts` | planar cuts across a surface |
//! | `tube` | measures along the tube, by region, and of the whole tube |
//! | `spread` | percentiles and variation of a sample |

mod around;
mod cuts;
mod disc;
mod fractal;
mod layers;
mod mask;
mod quantity;
mod rays;
mod ring;
mod section;
mod sections;
mod shape;
mod spread;
mod track;
mod tree;
mod tube;
mod walls;

pub use around::Around;
pub use cuts::{AmongCuts, Cuts, morphometry_of_cuts};
pub use fractal::Dimension;
pub use layers::LayerMeasures;
pub use quantity::{CHANGES, ISLANDS, QUANTITIES, Quantity};
pub use section::{Measures, measure};
pub use sections::{LayersAt, morphometry};
pub use shape::Shape;
pub(in crate::measure) use shape::edges;
pub use spread::Spread;
pub use tree::Folds;
pub use tube::{Along, Basis, Morphometry, Region, Regions, Settings, Tube, detailed_places};

#[cfg(test)]
mod tests;
