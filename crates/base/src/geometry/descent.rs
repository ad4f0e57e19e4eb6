//! Pair search in a hierarchy of blocks of eight, by simultaneous descent into two branches.

use crate::vectorize::{Lanes, Simd, Vectors, WithSimd};
use glam::Vec4;

/// Children per block.
pub(super) const WIDTH: usize = 8;

/// Bounds of eight items or blocks.
pub(super) trait Block {
    /// Extents of the eight along some directions, then along the opposite directions.
    fn rows(&self) -> &[[f32; WIDTH]];
}

/// Mask of the children of `block` that overlap child `lane` of `other`. A missing child overlaps
/// nothing.
#[inline(always)]
fn overlapping<S: Simd>(simd: S, block: &impl Block, other: &impl Block, lane: usize) -> u32 {
    let (rows, others) = (block.rows(), other.rows());
    // Extent beyond the nearest coordinate. The sign of the sum is exact. The sum of two infinite
    // coordinates may be NaN, which loses every comparison.
    let mut least = Lanes::all(simd, f32::INFINITY);
    for (side, row) in rows.iter().enumerate() {
        let opposite = others[(side + rows.len() / 2) % rows.len()][lane];
        least = (Lanes::of(simd, row) + Lanes::all(simd, opposite)).min(least);
    }
    let mut numbers = [0.0; WIDTH];
    least.write(&mut numbers);
    not_negative(&numbers)
}

/// Mask of the numbers that are 0 or more.
#[inline(always)]
pub(super) fn not_negative(numbers: &[f32; WIDTH]) -> u32 {
    let mask = |half: usize| Vec4::from_slice(&numbers[half..]).cmpge(Vec4::ZERO).bitmask();
    mask(0) | mask(4) << 4
}

/// Calls `visit(i, block, others)` for every item `i` and block that contains later items
/// overlapping `i`. Bit `l` of `others` stands for item `l` of the block.
///
/// `below` are pairs of blocks `(level, first, second)`, `first <= second`, under which the search
/// descends. `levels[0]` contains the blocks of items, each higher level the blocks of the level
/// below.
#[inline(always)]
pub(super) fn pairs_below<B: Block>(
    levels: &[Vec<B>],
    below: Vec<(usize, usize, usize)>,
    visit: impl FnMut(usize, usize, u32),
) {
    Vectors::best_of_eight().run_in_lanes(Descent { levels, below, visit });
}

struct Descent<'a, B, V> {
    levels: &'a [Vec<B>],
    below: Vec<(usize, usize, usize)>,
    visit: V,
}

impl<B: Block, V: FnMut(usize, usize, u32)> WithSimd for Descent<'_, B, V> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { levels, mut below, mut visit } = self;
        while let Some((level, first, second)) = below.pop() {
            let (a, b) = (&levels[level][first], &levels[level][second]);
            // All children of a block are candidates against the block itself; against another
            // block, only children that overlap it.
            let mut mask = match levels.get(level + 1) {
                Some(above) if first != second => overlapping(simd, a, &above[second / WIDTH], second % WIDTH),
                _ => !0 >> (32 - WIDTH),
            };
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let mut others = overlapping(simd, b, a, lane);
                if first == second {
                    // An item does not form a pair with itself, but a block does at higher levels.
                    others &= !0 << (lane + usize::from(level == 0));
                }
                let child = first * WIDTH + lane;
                if level > 0 {
                    lanes(others, |other| below.push((level - 1, child, second * WIDTH + other)));
                } else if others != 0 {
                    visit(child, second, others);
                }
            }
        }
    }
}

/// Calls `visit` with the position of each bit that is set.
#[inline(always)]
pub fn lanes(mut mask: u32, mut visit: impl FnMut(usize)) {
    while mask != 0 {
        visit(mask.trailing_zeros() as usize);
        mask &= mask - 1;
    }
}
