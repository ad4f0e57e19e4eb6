//! The lumen as a bit mask, and its outline.

use super::shape::Shape;
use crate::geometry::predicates::widen2;

/// Bits in rows of whole words. The last bit of each row is clear.
#[derive(Clone, Debug)]
pub(super) struct Bits {
    /// Words per row.
    pub(super) words: usize,
    pub(super) data: Vec<u64>,
    /// Width and height of the part in which bits may be set.
    pub(super) extent: [usize; 2],
}

/// Maximum number of pixels along a side of a mask.
const MAX_SIDE: f64 = 8192.0;

/// Side of the pixels of a section, µm: `wanted`, or more if the lumen is very large.
pub(super) fn pixel(shape: &Shape<'_>, wanted: f64) -> f64 {
    let [low, high] = bounds(shape);
    let side = (high[0] - low[0]).max(high[1] - low[1]);
    wanted * (side / wanted / MAX_SIDE).max(1.0).ceil()
}

/// Minimum and maximum of x and y over the boundary of the lumen.
pub(super) fn bounds(shape: &Shape<'_>) -> [[f64; 2]; 2] {
    let mut bounds = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    for point in shape.lumen.iter().copied().flatten().map(|&p| widen2(p)) {
        for k in 0..2 {
            bounds[0][k] = bounds[0][k].min(point[k]);
            bounds[1][k] = bounds[1][k].max(point[k]);
        }
    }
    bounds
}

/// Pixels whose centres lie in the lumen. Pixel (0, 0) is at the corner of the bounds of the lumen.
pub(super) fn lumen(shape: &Shape<'_>, pixel: f64) -> Bits {
    let [low, high] = bounds(shape);
    if !(low[0] < high[0] && low[1] < high[1]) {
        return Bits { words: 1, data: Vec::new(), extent: [0; 2] };
    }
    let extent = [0, 1].map(|k| (((high[k] - low[k]) / pixel).ceil() as usize).max(1));
    lumen_within(shape, pixel, low, extent)
}

/// Pixels of a mask with a given lower corner and size whose centres lie in the lumen.
pub(super) fn lumen_within(shape: &Shape<'_>, pixel: f64, low: [f64; 2], extent: [usize; 2]) -> Bits {
    let (words, height) = (extent[0] / 64 + 1, extent[1]);
    let mut data = vec![0_u64; words * height];
    // Toggles the first pixel beyond each crossing of an edge and the centre line of a row.
    for (a, b) in shape.lumen.iter().flat_map(|ring| super::shape::edges(ring)) {
        let [a, b] = [a, b].map(|p| [(p[0] - low[0]) / pixel - 0.5, (p[1] - low[1]) / pixel - 0.5]);
        let (lower, upper) = if a[1] < b[1] { (a, b) } else { (b, a) };
        for row in first_beyond(lower[1], height)..first_beyond(upper[1], height) {
            let share = (row as f64 - lower[1]) / (upper[1] - lower[1]);
            let column = first_beyond(lower[0] + share * (upper[0] - lower[0]), extent[0]);
            data[row * words + column / 64] ^= 1 << (column % 64);
        }
    }
    // A pixel is in the lumen if an odd number of pixels up to it were toggled.
    for row in data.chunks_exact_mut(words) {
        let mut is_odd = 0;
        for word in row {
            for shift in [1, 2, 4, 8, 16, 32] {
                *word ^= *word << shift;
            }
            *word ^= is_odd;
            is_odd = (word.cast_signed() >> 63).cast_unsigned();
        }
    }
    Bits { words, data, extent }
}

/// First pixel whose centre does not lie before a place, at most `end`.
fn first_beyond(place: f64, end: usize) -> usize {
    let floor = place.max(0.0) as usize;
    (floor + usize::from((floor as f64) < place)).min(end)
}

impl Bits {
    pub(super) fn rows(&self) -> usize {
        self.data.len() / self.words
    }

    pub(super) fn row(&self, row: usize) -> &[u64] {
        &self.data[row * self.words..(row + 1) * self.words]
    }

    /// Calls `visit` with the first column and the end of each run of set pixels of a row.
    pub(super) fn runs(&self, row: usize, mut visit: impl FnMut(usize, usize)) {
        let mut start = None;
        for (w, &word) in self.row(row).iter().enumerate() {
            let mut at = 0;
            while at < 64 {
                let wanted = if start.is_some() { !word } else { word };
                let next = at + (wanted >> at).trailing_zeros().min(64 - at);
                if next == 64 {
                    break;
                }
                match start.take() {
                    Some(from) => visit(from, 64 * w + next as usize),
                    None => start = Some(64 * w + next as usize),
                }
                at = next;
            }
        }
        if let Some(from) = start {
            visit(from, 64 * self.words);
        }
    }

    /// Number of set pixels in a part of a row.
    pub(super) fn count(&self, row: usize, from: usize, to: usize) -> u32 {
        if from >= to {
            return 0;
        }
        let (first, last) = (from / 64, (to - 1) / 64);
        let ones = |(w, word): (usize, &u64)| {
            let head = if w == first { !0 << (from % 64) } else { !0 };
            let tail = if w == last { !0 >> (63 - (to - 1) % 64) } else { !0 };
            (word & head & tail).count_ones()
        };
        self.row(row).iter().enumerate().take(last + 1).skip(first).map(ones).sum()
    }

    /// Pixels within a square of `reach` pixels to all sides of a set pixel.
    pub(super) fn dilated(&self, reach: usize) -> Self {
        let mut wide = self.data.clone();
        for out in wide.chunks_exact_mut(self.words) {
            for _ in 0..reach {
                let mut carry = 0;
                let before = out.to_vec();
                for (w, word) in out.iter_mut().enumerate() {
                    let right = before.get(w + 1).map_or(0, |next| next << 63);
                    *word |= before[w] << 1 | carry | before[w] >> 1 | right;
                    carry = before[w] >> 63;
                }
            }
        }
        let rows = self.rows();
        let mut data = vec![0; self.data.len()];
        for (row, out) in data.chunks_exact_mut(self.words).enumerate() {
            for other in row.saturating_sub(reach)..(row + reach + 1).min(rows) {
                out.iter_mut().zip(&wide[other * self.words..]).for_each(|(word, more)| *word |= more);
            }
        }
        Self { data, ..*self }
    }

    /// Set pixels that share a side with a clear pixel.
    pub(super) fn outline(&self) -> Self {
        let empty = vec![0; self.words];
        let rows = self.rows();
        let mut data = Vec::with_capacity(self.data.len());
        for row in 0..rows {
            let here = self.row(row);
            let below = if row > 0 { self.row(row - 1) } else { &empty };
            let above = if row + 1 < rows { self.row(row + 1) } else { &empty };
            for (w, &word) in here.iter().enumerate() {
                let left = word << 1 | if w > 0 { here[w - 1] >> 63 } else { 0 };
                let right = word >> 1 | here.get(w + 1).map_or(0, |next| next << 63);
                data.push(word & !(left & right & below[w] & above[w]));
            }
        }
        Self { data, ..*self }
    }

    /// Halves the resolution: each bit of the result covers two by two bits.
    pub(super) fn halved(&self) -> Self {
        let words = self.words.div_ceil(2);
        let rows = self.rows();
        let mut data = vec![0; words * rows.div_ceil(2)];
        for row in 0..rows {
            let out = &mut data[row / 2 * words..][..words];
            for (w, &word) in self.row(row).iter().enumerate() {
                out[w / 2] |= packed(word | word >> 1) << (32 * (w % 2));
            }
        }
        Self { words, data, extent: self.extent.map(|side| side.div_ceil(2)) }
    }
}

/// Packs the even bits of a word.
fn packed(word: u64) -> u64 {
    let mut x = word & 0x5555_5555_5555_5555;
    x = (x | x >> 1) & 0x3333_3333_3333_3333;
    x = (x | x >> 2) & 0x0F0F_0F0F_0F0F_0F0F;
    x = (x | x >> 4) & 0x00FF_00FF_00FF_00FF;
    x = (x | x >> 8) & 0x0000_FFFF_0000_FFFF;
    (x | x >> 16) & 0x0000_0000_FFFF_FFFF
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_is_set_if_its_centre_lies_in_the_lumen() {
        // A star wider than a word, around an island.
        let star = |radius: f32, points: u32| -> Vec<[f32; 2]> {
            let corner = |k: u32| {
                let (sin, cos) = (std::f32::consts::TAU * k as f32 / points as f32).sin_cos();
                let r = if k.is_multiple_of(2) { radius } else { 0.6 * radius };
                [3.0 + r * cos, -5.0 + r * sin]
            };
            (0..points).map(corner).collect()
        };
        let (whole, island, outer) = (star(410.0, 14), star(120.0, 10), star(600.0, 8));
        let shape = Shape { outer: &outer, lumen: vec![&whole, &island] };
        let bits = lumen(&shape, 4.0);
        let [low, _] = bounds(&shape);
        let mut set = 0;
        for row in 0..bits.rows() {
            for column in 0..64 * bits.words {
                let centre = [low[0] + 4.0 * (column as f64 + 0.5), low[1] + 4.0 * (row as f64 + 0.5)];
                let is_set = bits.row(row)[column / 64] >> (column % 64) & 1 == 1;
                assert_eq!(is_set, shape.has_in_lumen(centre), "{column} {row}");
                set += usize::from(is_set);
            }
        }
        assert!(bits.extent[0] > 128 && set > 5000, "{:?} {set}", bits.extent);
    }
}
