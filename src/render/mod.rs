//! Pictures of models without a GPU: sections as in a histological slide, meshes lit and cut open.
//!
//! Everything is computed in a fixed order from the input alone: the same model gives the same picture.

mod bar;
mod glyphs;
mod histology;
mod mesh;
mod named;
mod occlusion;
mod picture;
mod raster;
mod section;
mod view;

pub use histology::{Slide, um_per_pixel};
pub use mesh::mesh_png;
pub use named::{END_WIDTHS, NamedView, UnknownView};
pub use picture::{MAX_SIZE, RenderError};
pub use section::sheet_png;
pub use view::{Plane, View};

/// Media type of the pictures.
pub const MEDIA_TYPE: &str = "image/png";
