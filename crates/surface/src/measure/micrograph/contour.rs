//! Traces the border of a region through the midpoints of pixel sides, and smooths it.
//!
//! The raw border is the one of marching squares. Its distance from the centres of all pixels is
//! 1/√8 of a pixel, and two parts of it that do not follow each other are twice as far apart.
//! Smoothing moves a point by less than 1/√8 of a pixel, so smoothed borders cross neither each
//! other nor the centre of a pixel.

use super::error::MicrographError;
use super::regions::{PixelRegions, Region};

/// Closed border with the region to its left, as seen in the picture.
pub(super) struct Loop {
    /// Midpoints of pixel sides, in half pixels from the upper left corner. One coordinate is odd,
    /// the other even.
    sides: Vec<[u16; 2]>,
    /// Number of pixels inside, negative for a clockwise border.
    pub(super) area: i64,
    /// One pixel of the region at the border.
    pub(super) start: usize,
}

/// Directions in the order of left turns: right, up, left, down.
const STEPS: [[isize; 2]; 4] = [[1, 0], [0, -1], [-1, 0], [0, 1]];
const UP: usize = 1;

/// Borders of a region, except those around fewer than `least` pixels. `room` is the maximum number
/// of points and is reduced by the points found.
pub(super) fn trace(
    field: &mut PixelRegions,
    region: Region,
    least: f64,
    room: &mut usize,
) -> Result<Vec<Loop>, MicrographError> {
    let mut loops = Vec::new();
    let mut from = 0;
    while let Some(start) = field.next(region, from) {
        let border = follow(field, region, start, *room)?;
        if border.area > 0 || border.area as f64 <= -least {
            *room -= border.sides.len();
            loops.push(border);
        }
        from = start;
    }
    Ok(loops)
}

/// Follows the border upward from the right side of a pixel.
fn follow(field: &mut PixelRegions, region: Region, start: usize, room: usize) -> Result<Loop, MicrographError> {
    let stride = field.size()[0];
    // Corner of pixels, and the direction in which the next side is passed.
    let (first, mut towards) = ([start % stride + 1, start / stride + 1], UP);
    let mut at = first;
    let mut ring = Loop { sides: Vec::new(), area: 0, start };
    loop {
        if ring.sides.len() == room {
            return Err(MicrographError::Rough);
        }
        let [dx, dy] = STEPS[towards];
        ring.sides.push([(2 * at[0]).wrapping_add_signed(dx) as u16, (2 * at[1]).wrapping_add_signed(dy) as u16]);
        ring.area -= dy as i64 * at[0] as i64;
        if towards == UP {
            field.mark((at[1] - 1) * stride + at[0] - 1);
        }
        at = [at[0].wrapping_add_signed(dx), at[1].wrapping_add_signed(dy)];
        // The two pixels ahead, among the four around the corner.
        let (left, right) = match towards {
            0 => ([0, 1], [0, 0]),
            1 => ([1, 1], [0, 1]),
            2 => ([1, 0], [1, 1]),
            _ => ([0, 0], [1, 0]),
        };
        let is = |[x, y]: [usize; 2]| field.is(region, (at[1] - y) * stride + at[0] - x);
        // The region is connected across corners, so the border turns right if the pixel to the
        // right belongs to the region, even if the one to the left does not.
        towards = if is(right) {
            (towards + 3) % 4
        } else if is(left) {
            towards
        } else {
            (towards + 1) % 4
        };
        if at == first && towards == UP {
            return Ok(ring);
        }
    }
}

/// Weights of a point and of its neighbours on both sides: the value of the parabola that fits
/// eleven points best (Savitzky and Golay 1964). Straight and evenly bent borders stay in place.
const WEIGHTS: [f64; 6] = [89.0 / 429.0, 84.0 / 429.0, 69.0 / 429.0, 44.0 / 429.0, 9.0 / 429.0, -36.0 / 429.0];
/// Maximum motion of a point, pixels; less than 1/√8.
const REACH: f64 = 0.35;

impl Loop {
    /// Smooth border, in pixels from the upper left corner.
    pub(super) fn smooth(&self) -> impl Iterator<Item = [f64; 2]> {
        let n = self.sides.len();
        let at = move |i: usize| self.sides[i % n].map(|half| f64::from(half) / 2.0);
        (0..n).map(move |i| {
            let raw = at(i);
            let mut moved = [0, 1].map(|axis| WEIGHTS[0] * raw[axis] - raw[axis]);
            for (k, weight) in WEIGHTS.iter().enumerate().skip(1) {
                let (before, after) = (at(i + n * k - k), at(i + k));
                for axis in 0..2 {
                    moved[axis] += weight * (before[axis] + after[axis]);
                }
            }
            let far = (moved[0] * moved[0] + moved[1] * moved[1]).sqrt() / REACH;
            [0, 1].map(|axis| raw[axis] + moved[axis] / far.max(1.0))
        })
    }
}
