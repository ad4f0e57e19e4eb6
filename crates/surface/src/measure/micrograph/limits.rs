//! Limits of accepted images.

use std::ops::RangeInclusive;

/// Accepted sides of a pixel, µm.
pub const PIXEL_UM: RangeInclusive<f64> = 0.05..=100.0;
/// Accepted longer sides of a section, mm.
pub const EXTENT_MM: RangeInclusive<f64> = 0.05..=200.0;
/// Minimum area of holes in the tissue and of pieces of tissue in the lumen, µm².
pub const LEAST_AREA_UM2: f64 = 500.0;
/// Maximum number of pixels along a side of an image.
pub const MAX_SIDE: u32 = 8192;
/// Maximum size of a file that callers should read, bytes. Larger than any compressed image of the
/// maximum size.
pub const MAX_BYTES: u64 = 64 << 20;
/// Maximum number of points of all contours of an image. The measures take about 250 bytes per
/// point.
pub(super) const MAX_POINTS: usize = 1 << 20;
