//! Pair search among many items that stores only the bounds of blocks of eight items.
//!
//! The bounds of the items are recomputed where they are needed. All pairs are found window by
//! window, each window with its own hierarchy. As in [`super::bvh`], the items must be in coherent
//! order, and every pair with overlapping bounds is found exactly once.

use super::bvh::{Block, Bvh, Points, WIDTH, no_points};
use crate::vectorize::Vectors;
use std::ops::Range;

const BLOCKS_PER_WINDOW: usize = if cfg!(test) { 1 << 4 } else { 1 << 13 };
/// Consecutive blocks whose joint bounds are compared with all blocks.
const BLOCKS_PER_GROUP: u32 = if cfg!(test) { 1 << 2 } else { 1 << 6 };

/// Bounds of blocks of items.
pub struct Coarse {
    blocks: Bvh,
    len: usize,
}

/// Items of some blocks, followed by the other items that may overlap them.
pub struct Window {
    /// The window's own items, then the others, both in ascending order.
    pub items: Vec<u32>,
    /// Number of own items.
    pub own: usize,
}

impl Coarse {
    /// Builds the bounds of `len` items that are convex hulls of points. `points` writes the points
    /// of up to eight consecutive items.
    #[must_use]
    pub fn of_hulls<const N: usize>(len: usize, points: impl Fn(Range<usize>, &mut Points<N>) + Sync) -> Self {
        let blocks = Bvh::build(len.div_ceil(WIDTH), |block| hulls(block, len, &points).union());
        Self { blocks, len }
    }

    /// Recomputes the bounds of `items`, which must ascend.
    pub fn update<const N: usize>(&mut self, items: &[u32], points: impl Fn(Range<usize>, &mut Points<N>) + Sync) {
        let mut blocks: Vec<u32> = items.iter().map(|item| item / WIDTH as u32).collect();
        blocks.dedup();
        self.blocks.update(&blocks, |block| hulls(block, self.len, &points).union());
    }

    /// Windows over all items.
    pub fn windows(&self) -> impl Iterator<Item = Window> {
        self.windows_of((0..self.len.div_ceil(WIDTH) as u32).collect(), BLOCKS_PER_WINDOW)
    }

    /// Windows over the items of some blocks, given by ascending numbers. Each overlapping pair
    /// with such an item lies in exactly one window, and at least one of the two is the window's
    /// own.
    pub fn windows_over(&self, blocks: Vec<u32>) -> impl Iterator<Item = Window> {
        // Scattered blocks overlap more other ones, which take memory.
        let is_scattered = blocks.len() * WIDTH < self.len / 4;
        self.windows_of(blocks, BLOCKS_PER_WINDOW / if is_scattered { 4 } else { 2 })
    }

    fn windows_of(&self, blocks: Vec<u32>, most: usize) -> impl Iterator<Item = Window> {
        let starts = (0..blocks.len()).step_by(most);
        starts.map(move |start| self.window(&blocks, start..blocks.len().min(start + most)))
    }

    /// Window over some of the `blocks`.
    fn window(&self, blocks: &[u32], own: Range<usize>) -> Window {
        let mut is_near = vec![false; self.len.div_ceil(WIDTH)];
        for group in blocks[own.clone()].chunk_by(|a, b| a / BLOCKS_PER_GROUP == b / BLOCKS_PER_GROUP) {
            let bounds = self.blocks.bounds(group);
            self.blocks.overlapping(&bounds, |block| is_near[block] = true);
        }
        // Pairs with items of earlier windows lie in those.
        blocks[..own.end].iter().for_each(|&block| is_near[block as usize] = false);
        let of = |block: u32| block * WIDTH as u32..(self.len as u32).min((block + 1) * WIDTH as u32);
        let mut items: Vec<u32> = blocks[own].iter().flat_map(|&block| of(block)).collect();
        let own = items.len();
        items.extend((0..).zip(&is_near).filter(|(_, is_near)| **is_near).flat_map(|(block, _)| of(block)));
        Window { items, own }
    }
}

/// Bounds of the items of a block.
fn hulls<const N: usize>(block: usize, len: usize, points: impl Fn(Range<usize>, &mut Points<N>)) -> Block {
    Vectors::best().run(
        #[inline(always)]
        || {
            let mut of_block = no_points();
            points(block * WIDTH..len.min((block + 1) * WIDTH), &mut of_block);
            Block::of_hulls(&of_block)
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::bvh::{self, Bounds};
    use proptest::prelude::*;

    type Segment = [[i8; 3]; 2];

    fn ends([p, d]: Segment) -> [[f64; 3]; 2] {
        let end = std::array::from_fn(|i| p[i] + d[i] / 4);
        [p, end].map(|p: [i8; 3]| p.map(f64::from))
    }

    fn bounds(segment: Segment) -> Bounds {
        Bounds::of(ends(segment))
    }

    /// Writes the ends of segments.
    fn points(segments: impl Iterator<Item = Segment>, points: &mut Points<2>) {
        bvh::points(segments.map(ends), points);
    }

    /// Pairs found in windows.
    fn pairs(windows: impl Iterator<Item = Window>, items: &[Segment]) -> Vec<(u32, u32)> {
        let mut found = Vec::new();
        for window in windows {
            let numbers = &window.items;
            let bvh = Bvh::of_hulls(Bvh::default(), numbers.len(), |some, of| {
                points(numbers[some].iter().map(|&i| items[i as usize]), of);
            });
            for part in 0..window.own.div_ceil(bvh.part_len()) {
                bvh.pairs(part, |i, j| {
                    if i < window.own {
                        found.push((numbers[i].min(numbers[j]), numbers[i].max(numbers[j])));
                    }
                });
            }
        }
        found.sort_unstable();
        found
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        #[test]
        fn windows_have_each_pair_once(
            mut items in prop::collection::vec(prop::array::uniform2(prop::array::uniform3(-40i8..40)), 1..1500),
            moved in prop::array::uniform3(-40i8..40),
        ) {
            let mut coarse = Coarse::of_hulls(items.len(), |some, of| points(items[some].iter().copied(), of));
            for round in 0..2u32 {
                let mut expected = Vec::new();
                for i in 0..items.len() {
                    for j in i + 1..items.len() {
                        if bounds(items[i]).overlaps(&bounds(items[j])) {
                            expected.push((i as u32, j as u32));
                        }
                    }
                }
                prop_assert_eq!(&pairs(coarse.windows(), &items), &expected);
                let is_some = |block: u32| block % 5 < 2 + round;
                let some = (0..items.len().div_ceil(WIDTH) as u32).filter(|&block| is_some(block)).collect();
                expected.retain(|&(i, j)| is_some(i / WIDTH as u32) || is_some(j / WIDTH as u32));
                prop_assert_eq!(pairs(coarse.windows_over(some), &items), expected);
                let changed: Vec<u32> = (0..items.len() as u32).filter(|i| i % 29 == round).collect();
                changed.iter().for_each(|&i| items[i as usize][0] = moved);
                coarse.update(&changed, |some, of| points(items[some].iter().copied(), of));
            }
        }
    }
}
