//! Pictures of models without a GPU: sections as histological slides, and meshes, shaded, textured
//! and cut open, with stained layers on the faces of cuts.
//!
//! Everything is computed in a fixed order from the input alone, so the same model gives the same
//! picture.

mod bar;
mod drawing;
mod faces;
mod glyphs;
mod histology;
mod mesh;
mod named;
mod occlusion;
mod outlines;
mod page;
mod picture;
mod piece;
mod raster;
mod section;
mod staged;
mod view;
mod wire;

pub use drawing::Drawing;
pub use faces::Finish;
pub use histology::{Slide, um_per_pixel};
pub use mesh::{mesh_drawing, mesh_png};
pub use named::{END_WIDTHS, NamedView, UnknownView};
pub use outlines::{Outline, outlines_png};
pub use page::{OVERSAMPLING, Panel, line_height, page_png};
pub use picture::{MAX_SIZE, RenderError};
pub use piece::piece;
pub use section::{SectionStyle, extent_um, section_drawing, sheet_png};
pub use view::{Plane, View};
pub use wire::{edge_count, wire_drawing};

/// Media type of the pictures.
pub const MEDIA_TYPE: &str = "image/png";
