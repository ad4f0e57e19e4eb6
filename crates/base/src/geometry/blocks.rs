//! A hierarchy of bounding boxes in the plane, over items in spatial order such as the edges of a
//! contour.
//!
//! Eight consecutive boxes form a block, eight blocks a block of the next level. Nothing is sorted.
//! Every pair of overlapping (or touching) boxes is reported exactly once, in an order that depends
//! only on the input.

use super::descent::{self, Block as _, WIDTH, lanes, pairs_below};
use glam::{BVec4A, Vec4};

/// A closed axis-parallel rectangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rect {
    /// Minimum x and y.
    pub min: [f32; 2],
    /// Maximum x and y.
    pub max: [f32; 2],
}

impl Rect {
    /// A rectangle without points.
    pub const EMPTY: Self = Self { min: [f32::INFINITY; 2], max: [f32::NEG_INFINITY; 2] };

    /// Bounding rectangle of `points`.
    #[must_use]
    #[inline]
    pub fn around(points: &[[f32; 2]]) -> Self {
        points.iter().fold(Self::EMPTY, |rect, &p| rect.joined(&Self { min: p, max: p }))
    }

    /// Bounding rectangle of both.
    #[must_use]
    #[inline]
    pub fn joined(&self, other: &Self) -> Self {
        Self {
            min: [self.min[0].min(other.min[0]), self.min[1].min(other.min[1])],
            max: [self.max[0].max(other.max[0]), self.max[1].max(other.max[1])],
        }
    }
}

/// Eight boxes as rows: maximum x, maximum y, negated minimum x, negated minimum y.
#[derive(Clone, Debug)]
struct Block([[Vec4; 2]; 4]);

impl Block {
    fn new(rects: &[Rect]) -> Self {
        let mut rows = [[f32::NEG_INFINITY; WIDTH]; 4];
        for (lane, Rect { min, max }) in rects.iter().enumerate() {
            for (row, value) in rows.iter_mut().zip([max[0], max[1], -min[0], -min[1]]) {
                row[lane] = value;
            }
        }
        Self(rows.map(|row| [0, 4].map(|half| Vec4::from_slice(&row[half..]))))
    }
}

impl descent::Block for Block {
    #[inline(always)]
    fn rows(&self) -> &[[f32; WIDTH]] {
        let rows: &[[f32; WIDTH]; 4] = bytemuck::cast_ref(&self.0);
        rows
    }
}

impl Block {
    #[inline]
    fn lane(&self, lane: usize) -> Rect {
        let rows = self.rows();
        let [max_x, max_y, min_x, min_y] = [0, 1, 2, 3].map(|side| rows[side][lane]);
        Rect { min: [-min_x, -min_y], max: [max_x, max_y] }
    }

    /// Mask of the boxes that overlap `rect`: bit `l` stands for box `l`.
    #[inline]
    fn overlaps(&self, rect: &Rect) -> u32 {
        let (mut first, mut second) = (BVec4A::TRUE, BVec4A::TRUE);
        let nearest = [rect.min[0], rect.min[1], -rect.max[0], -rect.max[1]];
        for ([a, b], nearest) in self.0.iter().zip(nearest.map(Vec4::splat)) {
            first &= nearest.cmple(*a);
            second &= nearest.cmple(*b);
        }
        first.bitmask() | second.bitmask() << 4
    }
}

/// The hierarchy. `levels[0]` contains the boxes, each higher level the bounds of the blocks below.
/// The last level has one block.
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
            levels.push(current.chunks(WIDTH).map(Block::new).collect::<Vec<_>>());
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
        self.levels[0][i / WIDTH].lane(i % WIDTH)
    }

    /// Calls `found` with the number of every box that overlaps `rect`, in ascending order.
    pub fn query(&self, rect: &Rect, mut found: impl FnMut(usize)) {
        if self.len > 0 {
            self.visit(self.levels.len() - 1, 0, rect, &mut found);
        }
    }

    /// Calls `found` with `(i, j)`, `i < j`, for every pair of overlapping boxes.
    pub fn pairs(&self, mut found: impl FnMut(usize, usize)) {
        let mut below = Vec::new();
        if self.len > 0 {
            below.push((self.levels.len() - 1, 0, 0));
        }
        pairs_below(
            &self.levels,
            below,
            #[inline(always)]
            |i, block, others| lanes(others, |lane| found(i, block * WIDTH + lane)),
        );
    }

    /// Calls `found` with the boxes under block `node` of `level` that overlap `rect`.
    fn visit(&self, level: usize, node: usize, rect: &Rect, found: &mut impl FnMut(usize)) {
        lanes(self.levels[level][node].overlaps(rect), |lane| {
            let child = node * WIDTH + lane;
            if level == 0 {
                found(child);
            } else {
                self.visit(level - 1, child, rect, found);
            }
        });
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
