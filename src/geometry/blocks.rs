//! A hierarchy of bounding boxes over items that are already in spatial order, such as the edges of a
//! contour: blocks of eight consecutive boxes, blocks of eight blocks, and so on. Nothing is sorted.
//!
//! Invariant: every pair of overlapping (or touching) boxes is reported exactly once, in an order that
//! depends only on the input.

const WIDTH: usize = 8;

/// A closed axis-parallel rectangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rect {
    /// Least x and y.
    pub min: [f32; 2],
    /// Greatest x and y.
    pub max: [f32; 2],
}

impl Rect {
    /// The empty rectangle.
    pub const EMPTY: Self = Self { min: [f32::INFINITY; 2], max: [f32::NEG_INFINITY; 2] };

    /// The least rectangle around `points`.
    #[must_use]
    #[inline]
    pub fn around(points: &[[f32; 2]]) -> Self {
        points.iter().fold(Self::EMPTY, |rect, &p| rect.joined(&Self { min: p, max: p }))
    }

    /// The least rectangle around both.
    #[must_use]
    #[inline]
    pub fn joined(&self, other: &Self) -> Self {
        Self {
            min: [self.min[0].min(other.min[0]), self.min[1].min(other.min[1])],
            max: [self.max[0].max(other.max[0]), self.max[1].max(other.max[1])],
        }
    }
}

/// Eight boxes side by side.
#[derive(Clone, Debug)]
struct Block {
    min_x: [f32; WIDTH],
    min_y: [f32; WIDTH],
    max_x: [f32; WIDTH],
    max_y: [f32; WIDTH],
}

impl Block {
    fn of(rects: &[Rect]) -> Self {
        let rect = |lane: usize| rects.get(lane).copied().unwrap_or(Rect::EMPTY);
        Self {
            min_x: std::array::from_fn(|lane| rect(lane).min[0]),
            min_y: std::array::from_fn(|lane| rect(lane).min[1]),
            max_x: std::array::from_fn(|lane| rect(lane).max[0]),
            max_y: std::array::from_fn(|lane| rect(lane).max[1]),
        }
    }

    #[inline]
    fn rect(&self, lane: usize) -> Rect {
        Rect { min: [self.min_x[lane], self.min_y[lane]], max: [self.max_x[lane], self.max_y[lane]] }
    }

    /// Bit `lane` is set where that box meets `rect`.
    #[inline]
    fn mask(&self, rect: &Rect) -> u32 {
        let mut mask = 0;
        for lane in 0..WIDTH {
            let hit = (self.min_x[lane] <= rect.max[0])
                & (self.max_x[lane] >= rect.min[0])
                & (self.min_y[lane] <= rect.max[1])
                & (self.max_y[lane] >= rect.min[1]);
            mask |= u32::from(hit) << lane;
        }
        mask
    }
}

/// The hierarchy: `levels[0]` holds the boxes themselves, each further level the bounds of the blocks
/// of the one before, up to a level of one block.
#[derive(Clone, Debug)]
pub struct Blocks {
    len: usize,
    levels: Vec<Vec<Block>>,
}

impl Blocks {
    /// Builds the hierarchy over boxes in spatial order.
    #[must_use]
    pub fn new(rects: &[Rect]) -> Self {
        let mut levels = Vec::new();
        let mut current = rects.to_vec();
        loop {
            levels.push(current.chunks(WIDTH).map(Block::of).collect::<Vec<_>>());
            if current.len() <= WIDTH {
                break;
            }
            current = current
                .chunks(WIDTH)
                .map(|chunk| chunk.iter().fold(Rect::EMPTY, |all, rect| all.joined(rect)))
                .collect();
        }
        Self { len: rects.len(), levels }
    }

    /// Box number `i`.
    #[must_use]
    pub fn rect(&self, i: usize) -> Rect {
        self.levels[0][i / WIDTH].rect(i % WIDTH)
    }

    /// Calls `found` with the number of every box that meets `rect`, in ascending order.
    pub fn query(&self, rect: &Rect, mut found: impl FnMut(usize)) {
        if self.len > 0 {
            self.visit(self.levels.len() - 1, 0, 0, 0, rect, &mut found);
        }
    }

    /// Calls `found` with `(i, j)`, `i < j`, for every pair of boxes that meet.
    pub fn pairs(&self, mut found: impl FnMut(usize, usize)) {
        for (block, lanes) in self.levels[0].iter().enumerate() {
            if self.levels.len() == 1 {
                self.pairs_of(block, lanes, block, &mut found);
                continue;
            }
            let bounds = self.levels[1][block / WIDTH].rect(block % WIDTH);
            let top = self.levels.len() - 1;
            self.visit(top, 0, 1, block, &bounds, &mut |other| {
                self.pairs_of(block, lanes, other, &mut found);
            });
        }
    }

    /// Pairs of a box of block `block` and one of block `other`, `other >= block`.
    #[inline]
    fn pairs_of(&self, block: usize, lanes: &Block, other: usize, found: &mut impl FnMut(usize, usize)) {
        for lane in 0..WIDTH.min(self.len - block * WIDTH) {
            let mut mask = self.levels[0][other].mask(&lanes.rect(lane));
            if block == other {
                mask &= !((2 << lane) - 1);
            }
            while mask != 0 {
                found(block * WIDTH + lane, other * WIDTH + mask.trailing_zeros() as usize);
                mask &= mask - 1;
            }
        }
    }

    /// Descends from block `node` of `level` to the boxes of level `stop` that meet `rect`, leaving out
    /// those numbered below `first`.
    fn visit(&self, level: usize, node: usize, stop: usize, first: usize, rect: &Rect, found: &mut impl FnMut(usize)) {
        let mut mask = self.levels[level][node].mask(rect);
        while mask != 0 {
            let child = node * WIDTH + mask.trailing_zeros() as usize;
            mask &= mask - 1;
            if level == stop {
                if child >= first {
                    found(child);
                }
            } else if (child + 1) * WIDTH.pow((level - stop) as u32) > first {
                self.visit(level - 1, child, stop, first, rect, found);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn meet(a: &Rect, b: &Rect) -> bool {
        (0..2).all(|axis| a.min[axis] <= b.max[axis] && b.min[axis] <= a.max[axis])
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn finds_what_all_pairs_finds(
            boxes in prop::collection::vec((0u8..60, 0u8..60, 0u8..9, 0u8..9), 0..700)
        ) {
            let rects: Vec<Rect> = boxes
                .iter()
                .map(|&(x, y, w, h)| Rect {
                    min: [f32::from(x), f32::from(y)],
                    max: [f32::from(x + w), f32::from(y + h)],
                })
                .collect();
            let blocks = Blocks::new(&rects);
            let mut found = Vec::new();
            blocks.pairs(|i, j| found.push((i, j)));
            found.sort_unstable();
            let mut expected = Vec::new();
            for i in 0..rects.len() {
                for j in i + 1..rects.len() {
                    if meet(&rects[i], &rects[j]) {
                        expected.push((i, j));
                    }
                }
            }
            prop_assert_eq!(found, expected);
            if let Some(first) = rects.first() {
                let mut found = Vec::new();
                blocks.query(first, |i| found.push(i));
                let expected: Vec<usize> =
                    (0..rects.len()).filter(|&i| meet(first, &rects[i])).collect();
                prop_assert_eq!(found, expected);
            }
        }
    }
}
