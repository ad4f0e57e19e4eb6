//! Divides an image into the outside, the tissue and the lumen.
//!
//! Tissue is connected across pixel sides, everything else across sides and corners. Where four
//! pixels meet crosswise, the two open ones are therefore connected, and a narrow cleft between
//! folds stays open.

use super::error::MicrographError;
use super::read::Image;

/// Not tissue, and not in a region yet.
const OPEN: u8 = 0;
/// Tissue.
const TISSUE: u8 = 1;
/// Tissue whose piece has been counted.
const SEEN: u8 = 2;
/// The largest piece of tissue.
const SECTION: u8 = 3;
/// Around the section, including debris: other pieces of tissue.
const OUTSIDE: u8 = 4;
/// Lumen.
const LUMEN: u8 = 5;
/// Hole that is not lumen: too small, or in the wall.
const CLOSED: u8 = 6;
/// Flag of a pixel of the outside or the lumen whose right side was traced.
const TRACED: u8 = 0x80;

/// Region whose border is traced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Region {
    Outside = OUTSIDE,
    Lumen = LUMEN,
}

/// Classes of all pixels, with a margin of one pixel that is not tissue.
pub(super) struct PixelRegions {
    stride: usize,
    pixels: Vec<u8>,
}

impl PixelRegions {
    /// `classes` has for each value whether it is tissue.
    pub(super) fn new(image: &Image, classes: &[bool]) -> Self {
        let stride = image.width + 2;
        let rows = image.values.chunks_exact(image.width);
        let mut pixels = vec![OPEN; stride * (rows.len() + 2)];
        for (row, out) in rows.zip(pixels.chunks_exact_mut(stride).skip(1)) {
            for (value, out) in row.iter().zip(&mut out[1..]) {
                *out = if classes[usize::from(*value)] { TISSUE } else { OPEN };
            }
        }
        Self { stride, pixels }
    }

    /// Numbers of columns and rows, including the margin.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.stride, self.pixels.len() / self.stride]
    }

    /// Marks the largest piece of tissue as the section, and everything around it as the outside.
    pub(super) fn keep_the_largest_piece(&mut self) -> Result<(), MicrographError> {
        let mut largest = (0, 0);
        for i in 0..self.pixels.len() {
            if self.pixels[i] == TISSUE {
                let count = self.fill(i, false, SEEN, |pixel| pixel == TISSUE);
                // Of several largest pieces, the first wins.
                if count > largest.0 {
                    largest = (count, i);
                }
            }
        }
        if largest.0 == 0 {
            return Err(MicrographError::NoTissue);
        }
        self.fill(largest.1, false, SECTION, |pixel| pixel == SEEN);
        self.fill(0, true, OUTSIDE, |pixel| pixel != SECTION && pixel != OUTSIDE);
        let [columns, rows] = self.size();
        let is_section = |column: usize, row: usize| self.pixels[row * columns + column] == SECTION;
        let beside = (1..rows - 1).any(|row| is_section(1, row) || is_section(columns - 2, row));
        let above = (1..columns - 1).any(|column| is_section(column, 1) || is_section(column, rows - 2));
        if beside || above { Err(MicrographError::CutOff) } else { Ok(()) }
    }

    /// Marks the holes of at least `least` pixels as lumen. Pieces of tissue in them are islands;
    /// holes in islands become tissue.
    pub(super) fn find_the_lumen(&mut self, least: f64) -> Result<(), MicrographError> {
        let mut found = false;
        for i in 1..self.pixels.len() {
            // Every hole of the section has a pixel to the right of the section; holes of islands
            // have none.
            if self.pixels[i] == OPEN && self.pixels[i - 1] == SECTION {
                let count = self.fill(i, true, LUMEN, |pixel| pixel == OPEN);
                if (count as f64) < least {
                    self.close(i);
                } else {
                    found = true;
                }
            }
        }
        if found { Ok(()) } else { Err(MicrographError::NoLumen) }
    }

    /// Turns a hole that was marked as lumen into tissue.
    pub(super) fn close(&mut self, at: usize) {
        self.fill(at, true, CLOSED, |pixel| pixel & !TRACED == LUMEN);
    }

    /// Marks the pixels that are connected to `start` through pixels for which `belongs` is true.
    /// `belongs` must be false for the mark. Returns the number of marked pixels.
    fn fill(&mut self, start: usize, corners: bool, mark: u8, belongs: impl Fn(u8) -> bool) -> usize {
        let (stride, reach) = (self.stride, usize::from(corners));
        // First pixels of runs within rows. Runs are marked already, so each is listed once.
        let mut runs = Vec::new();
        let mut count = 0;
        let mut enter = |pixels: &mut [u8], at: usize, runs: &mut Vec<u32>| {
            let row = at / stride * stride;
            let (mut from, mut to) = (at, at + 1);
            while from > row && belongs(pixels[from - 1]) {
                from -= 1;
            }
            while to < row + stride && belongs(pixels[to]) {
                to += 1;
            }
            pixels[from..to].fill(mark);
            count += to - from;
            runs.push(from as u32);
            to
        };
        enter(&mut self.pixels, start, &mut runs);
        while let Some(from) = runs.pop() {
            let from = from as usize;
            let row = from / stride * stride;
            let length = self.pixels[from..row + stride].iter().take_while(|&&pixel| pixel == mark).count();
            let (low, high) = ((from - row).saturating_sub(reach), (from - row + length + reach).min(stride));
            for beside in [row.checked_sub(stride), Some(row + stride).filter(|&row| row < self.pixels.len())] {
                let Some(beside) = beside else { continue };
                let mut at = beside + low;
                while at < beside + high {
                    if belongs(self.pixels[at]) {
                        at = enter(&mut self.pixels, at, &mut runs);
                    }
                    at += 1;
                }
            }
        }
        count
    }

    /// True if a pixel belongs to a region.
    pub(super) fn is(&self, region: Region, at: usize) -> bool {
        self.pixels[at] & !TRACED == region as u8
    }

    /// Records that the right side of a pixel was traced.
    pub(super) fn mark(&mut self, at: usize) {
        self.pixels[at] |= TRACED;
    }

    /// Next pixel, from `at` on, of a region whose right side is on its border and was not traced.
    pub(super) fn next(&self, region: Region, at: usize) -> Option<usize> {
        let last = self.pixels.len() - 1;
        (at..last).find(|&i| self.pixels[i] == region as u8 && !self.is(region, i + 1))
    }
}
