//! Pair search among many items that stores only the bounds of blocks of eight items.
//!
//! The bounds of the items are recomputed where they are needed. All pairs are found window by
//! window, each window with its own hierarchy. As in [`super::bvh`], the items must be in coherent
//! order, and every pair with overlapping bounds is found exactly once.

use super::bvh::{Block, Bounds, Bvh, Points, WIDTH, no_points};
use super::descent::lanes;
use crate::vectorize::Vectors;
use std::ops::Range;

const BLOCKS_PER_WINDOW: usize = if cfg!(test) { 1 << 4 } else { 1 << 13 };
/// Blocks whose joint bounds are compared with later blocks.
const BLOCKS_PER_GROUP: usize = if cfg!(test) { 1 << 2 } else { 1 << 6 };

/// Bounds of blocks of items.
pub struct Coarse {
    blocks: Bvh,
    len: usize,
}

/// Consecutive items, followed by the later items that may overlap them.
pub struct Window {
    /// The window's own consecutive items, then the later items in ascending order.
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

    /// Windows over the items. Each overlapping pair lies in exactly one window, and at least one
    /// of the two is the window's own.
    pub fn windows(&self) -> impl Iterator<Item = Window> {
        (0..self.len)
            .step_by(BLOCKS_PER_WINDOW * WIDTH)
            .map(move |start| self.window(start..self.len.min(start + BLOCKS_PER_WINDOW * WIDTH)))
    }

    fn window(&self, own: Range<usize>) -> Window {
        let (first, last) = (own.start / WIDTH, own.end.div_ceil(WIDTH));
        let mut is_near = vec![false; self.len.div_ceil(WIDTH) - last];
        for start in (first..last).step_by(BLOCKS_PER_GROUP) {
            let bounds = self.blocks.bounds(start..last.min(start + BLOCKS_PER_GROUP));
            self.blocks.overlapping_from(&bounds, last, |block| is_near[block - last] = true);
        }
        let mut items: Vec<u32> = own.clone().map(|item| item as u32).collect();
        for (block, _) in (last..).zip(&is_near).filter(|(_, is_near)| **is_near) {
            items.extend((block * WIDTH..self.len.min((block + 1) * WIDTH)).map(|item| item as u32));
        }
        Window { items, own: own.len() }
    }

    /// Calls `visit` for every item whose bounds overlap `query`, in ascending order.
    pub fn overlapping<const N: usize>(
        &self,
        query: &Bounds,
        points: impl Fn(Range<usize>, &mut Points<N>),
        mut visit: impl FnMut(usize),
    ) {
        self.blocks.overlapping(query, |block| {
            lanes(hulls(block, self.len, &points).overlaps(query), |lane| {
                let item = block * WIDTH + lane;
                if item < self.len {
                    visit(item);
                }
            });
        });
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
    use crate::geometry::bvh;
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

    /// All pairs, found by windows.
    fn pairs(coarse: &Coarse, items: &[Segment]) -> Vec<(u32, u32)> {
        let mut found = Vec::new();
        for window in coarse.windows() {
            let numbers = &window.items;
            let bvh = Bvh::of_hulls(Bvh::default(), numbers.len(), |some, of| {
                points(numbers[some].iter().map(|&i| items[i as usize]), of);
            });
            for part in 0..window.own.div_ceil(bvh.part_len()) {
                bvh.pairs(part, |i, j| {
                    if i < window.own {
                        found.push((numbers[i], numbers[j]));
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
            for round in 0..2 {
                let mut expected = Vec::new();
                for i in 0..items.len() {
                    for j in i + 1..items.len() {
                        if bounds(items[i]).overlaps(&bounds(items[j])) {
                            expected.push((i as u32, j as u32));
                        }
                    }
                }
                prop_assert_eq!(pairs(&coarse, &items), expected);
                for &query in items.iter().take(20) {
                    let mut found = Vec::new();
                    coarse.overlapping(&bounds(query), |some, of| points(items[some].iter().copied(), of), |i| found.push(i));
                    let expected: Vec<_> =
                        (0..items.len()).filter(|&i| bounds(query).overlaps(&bounds(items[i]))).collect();
                    prop_assert_eq!(found, expected);
                }
                let changed: Vec<u32> = (0..items.len() as u32).filter(|i| i % 29 == round).collect();
                changed.iter().for_each(|&i| items[i as usize][0] = moved);
                coarse.update(&changed, |some, of| points(items[some].iter().copied(), of));
            }
        }
    }
}
