//! What is accepted.

use std::ops::RangeInclusive;

/// Sides of a pixel that are accepted, µm.
pub const PIXEL_UM: RangeInclusive<f64> = 0.05..=100.0;
/// Longer sides of a section that are accepted, mm.
pub const EXTENT_MM: RangeInclusive<f64> = 0.05..=200.0;
/// Holes in the tissue and pieces of tissue in the lumen count if they are at least this large, µm².
pub const LEAST_AREA_UM2: f64 = 500.0;
/// Most pixels along a side of an image.
pub const MAX_SIDE: u32 = 8192;
/// Most bytes of a file that a caller should read; larger than any image of the greatest size that is compressed at all.
pub const MAX_BYTES: u64 = 64 << 20;
/// Most points of all contours of an image: the measures take about 250 bytes a point.
pub(super) const MAX_POINTS: usize = 1 << 20;
