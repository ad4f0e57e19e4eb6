//! A bounding-volume hierarchy without pointers and without sorting.
//!
//! Eight items in their given order form a block, eight blocks a block of the next level. The order
//! must be spatially coherent. The strips of a lofted surface are; for other surfaces the caller
//! sorts first (see [`curve`](super::curve)). A volume is bounded along five directions: x, y, z, x
//! + y and x − y.
//!
//! Invariant: the bounds of two items with a common point overlap. Bounds are f32, rounded to
//! nearest. Rounding is monotone, so overlapping bounds still overlap and no outward rounding is
//! needed.

pub use super::descent::lanes;
use super::descent::{self, not_negative, pairs_below};
use crate::vectorize::Vectors;
use rayon::prelude::*;
use std::ops::Range;

mod ray;

pub use ray::Ray;

const AXES: usize = 5;

/// Each direction counts in both senses.
const SIDES: usize = 2 * AXES;

/// Levels within a part, its own included. A part contains 512 items.
const PART_LEVELS: usize = 3;

const BLOCKS_PER_TASK: usize = 256;

/// Items per block, and children per node.
pub const WIDTH: usize = descent::WIDTH;

/// Maximum coordinates along the five directions, then the maxima of the negated coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds([f32; SIDES]);

impl Bounds {
    /// Bounds without points. They overlap nothing.
    pub const EMPTY: Self = Self([f32::NEG_INFINITY; SIDES]);

    /// Bounds of the convex hull of points.
    #[inline]
    #[must_use]
    pub fn of<const N: usize>(points: [[f64; 3]; N]) -> Self {
        let mut bounds = Self::EMPTY;
        for [x, y, z] in points {
            let along = [x as f32, y as f32, z as f32, (x + y) as f32, (x - y) as f32];
            for (axis, value) in along.into_iter().enumerate() {
                bounds.0[axis] = larger(value, bounds.0[axis]);
                bounds.0[AXES + axis] = larger(-value, bounds.0[AXES + axis]);
            }
        }
        bounds
    }

    /// Bounds of both.
    #[inline(always)]
    #[must_use]
    pub fn with(mut self, other: &Self) -> Self {
        for side in 0..SIDES {
            self.0[side] = larger(other.0[side], self.0[side]);
        }
        self
    }

    /// True if the bounded volumes may intersect.
    #[inline]
    #[must_use]
    pub fn overlaps(&self, other: &Self) -> bool {
        (0..SIDES).all(|side| self.minimum(side) <= other.0[side])
    }

    /// Sum of the extents along x, y and z; negative for [`Self::EMPTY`].
    #[must_use]
    #[inline]
    pub fn size(&self) -> f32 {
        (0..3).map(|axis| self.0[axis] + self.0[AXES + axis]).sum()
    }

    #[inline(always)]
    fn minimum(&self, side: usize) -> f32 {
        -self.0[(side + AXES) % SIDES]
    }
}

/// The larger of two numbers. Unlike `f32::max`, a plain comparison does not treat NaN specially
/// and compiles to one vector instruction.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Bounds of eight items as rows, one per side, so that one pass over a row tests all eight.
#[derive(Clone, Copy, PartialEq)]
#[repr(align(32))]
pub(super) struct Block([[f32; WIDTH]; SIDES]);

/// Points of eight items: `[point][axis][item]`. The points of missing items are NaN.
pub type Points<const N: usize> = [[[f64; WIDTH]; 3]; N];

/// [`Points`] without items.
pub const fn no_points<const N: usize>() -> Points<N> {
    [[[f64::NAN; WIDTH]; 3]; N]
}

/// Writes the points of up to eight items into `points`. Returning them would copy them more than
/// once.
#[inline(always)]
pub fn points<const N: usize>(items: impl Iterator<Item = [[f64; 3]; N]>, points: &mut Points<N>) {
    let mut count = 0;
    for item in items {
        for (point, of_item) in points.iter_mut().zip(item) {
            for (axis, x) in point.iter_mut().zip(of_item) {
                axis[count] = x;
            }
        }
        count += 1;
    }
    if count < WIDTH {
        points.as_flattened_mut().iter_mut().for_each(|axis| axis[count..].fill(f64::NAN));
    }
}

impl Block {
    /// Bounds of eight missing items.
    const EMPTY: Self = Self([[f32::NEG_INFINITY; WIDTH]; SIDES]);

    /// Bounds of the convex hulls of the points of each item.
    #[inline(always)]
    pub(super) fn of_hulls<const N: usize>(points: &Points<N>) -> Self {
        let mut rows = [[f32::NEG_INFINITY; WIDTH]; SIDES];
        for [x, y, z] in points {
            let mut along = [[0.0f32; WIDTH]; AXES];
            for lane in 0..WIDTH {
                along[0][lane] = x[lane] as f32;
                along[1][lane] = y[lane] as f32;
                along[2][lane] = z[lane] as f32;
                along[3][lane] = (x[lane] + y[lane]) as f32;
                along[4][lane] = (x[lane] - y[lane]) as f32;
            }
            for axis in 0..AXES {
                for lane in 0..WIDTH {
                    let value = along[axis][lane];
                    rows[axis][lane] = larger(value, rows[axis][lane]);
                    rows[AXES + axis][lane] = larger(-value, rows[AXES + axis][lane]);
                }
            }
        }
        Self(rows)
    }

    fn from_bounds(bounds: impl Iterator<Item = Bounds>) -> Self {
        let mut rows = [[f32::NEG_INFINITY; WIDTH]; SIDES];
        for (lane, b) in bounds.enumerate() {
            for (row, value) in rows.iter_mut().zip(b.0) {
                row[lane] = value;
            }
        }
        Self(rows)
    }

    /// Lower bounds of the squared distances from a point to the items; infinite for a missing
    /// item. Testing x + y and x − y as well would take longer than the visits that it saves.
    #[inline]
    fn squared_distances(&self, point: &PointQuery) -> [f32; WIDTH] {
        let mut sums = [0.0; WIDTH];
        for axis in 0..3 {
            let (high, low) = (&self.0[axis], &self.0[AXES + axis]);
            for lane in 0..WIDTH {
                let outside = larger(larger(-low[lane] - point.high[axis], point.low[axis] - high[lane]), 0.0);
                sums[lane] += outside * outside;
            }
        }
        sums
    }

    fn lane(&self, lane: usize) -> Bounds {
        Bounds(self.0.map(|row| row[lane]))
    }

    pub(super) fn union(&self) -> Bounds {
        Bounds(self.0.map(|row| row.into_iter().fold(f32::NEG_INFINITY, larger)))
    }

    /// Mask of the children that overlap `query`: bit `l` stands for child `l`. The sums are those
    /// of [`pairs_below`].
    #[inline(always)]
    pub(super) fn overlaps(&self, query: &Bounds) -> u32 {
        let mut least = [f32::INFINITY; WIDTH];
        for (side, row) in self.0.iter().enumerate() {
            let opposite = query.0[(side + AXES) % SIDES];
            for lane in 0..WIDTH {
                let beyond = row[lane] + opposite;
                least[lane] = if beyond < least[lane] { beyond } else { least[lane] };
            }
        }
        not_negative(&least)
    }
}

impl descent::Block for Block {
    #[inline(always)]
    fn rows(&self) -> &[[f32; WIDTH]] {
        &self.0
    }
}

/// A point with a margin for the rounding of bounds and of the point itself.
struct PointQuery {
    low: [f32; 3],
    high: [f32; 3],
}

impl PointQuery {
    fn new(point: [f64; 3]) -> Self {
        let margin = |x: f64| x.abs() as f32 * 2.5e-7;
        Self { low: point.map(|x| x as f32 - margin(x)), high: point.map(|x| x as f32 + margin(x)) }
    }
}

/// State of a search for an item near a point.
pub struct NearestSearch<D> {
    /// Computes the squared distance of an item.
    pub squared_distance: D,
    /// Squared distance at which the search stops at the first item found.
    pub good_enough: f64,
    /// Squared distance of the nearest item found; initially the limit, beyond which items are
    /// ignored.
    pub best: f64,
    /// The nearest item found.
    pub item: Option<usize>,
}

impl<D> NearestSearch<D> {
    fn has_ended(&self) -> bool {
        self.item.is_some() && self.best <= self.good_enough
    }
}

/// The hierarchy. See the [module](self).
#[derive(Default)]
pub struct Bvh {
    /// `levels[0]` bounds the items, each higher level the blocks below. The last level has one
    /// block.
    levels: Vec<Vec<Block>>,
    len: usize,
}

impl Bvh {
    /// Builds the hierarchy of `len` items. `bounds(i)` returns the bounds of item `i`.
    #[must_use]
    pub fn build(len: usize, bounds: impl Fn(usize) -> Bounds + Sync) -> Self {
        let first: Vec<Block> = (0..len.div_ceil(WIDTH))
            .into_par_iter()
            .with_min_len(BLOCKS_PER_TASK)
            .map(|block| Block::from_bounds((block * WIDTH..len.min((block + 1) * WIDTH)).map(&bounds)))
            .collect();
        Self::from_item_blocks(first, len)
    }

    /// Builds the hierarchy of `len` items that are convex hulls of points, reusing the memory of
    /// another hierarchy. `points` writes the points of up to eight consecutive items.
    #[must_use]
    pub fn of_hulls<const N: usize>(
        memory: Self,
        len: usize,
        points: impl Fn(Range<usize>, &mut Points<N>) + Sync,
    ) -> Self {
        let mut first = memory.levels.into_iter().next().unwrap_or_default();
        let count = len.div_ceil(WIDTH);
        if first.capacity() < count {
            // Frees the memory before it takes more, and no more than that.
            drop(first);
            first = Vec::with_capacity(count);
        }
        first.resize(count, Block::EMPTY);
        first.par_chunks_mut(BLOCKS_PER_TASK).enumerate().for_each(|(run, blocks)| {
            Vectors::best().run(
                #[inline(always)]
                || {
                    let mut of_block = no_points();
                    for (block, at) in blocks.iter_mut().zip(run * BLOCKS_PER_TASK..) {
                        points(at * WIDTH..len.min((at + 1) * WIDTH), &mut of_block);
                        *block = Block::of_hulls(&of_block);
                    }
                },
            );
        });
        Self::from_item_blocks(first, len)
    }

    /// Builds the levels above the blocks of items.
    fn from_item_blocks(first: Vec<Block>, len: usize) -> Self {
        let mut levels = vec![first];
        while let Some(last) = levels.last().filter(|last| last.len() > 1) {
            let next = last
                .par_chunks(WIDTH)
                .with_min_len(64)
                .map(|children| Block::from_bounds(children.iter().map(Block::union)))
                .collect();
            levels.push(next);
        }
        Self { levels, len }
    }

    /// Replaces the bounds of `items`, which must ascend.
    pub fn update(&mut self, items: &[u32], bounds: impl Fn(usize) -> Bounds + Sync) {
        let mut changed: Vec<usize> = items.iter().map(|&item| item as usize).collect();
        for level in 0..self.levels.len() {
            changed.iter_mut().for_each(|of| *of /= WIDTH);
            changed.dedup();
            let (below, rest) = self.levels.split_at_mut(level);
            let block_of = |block: &usize| {
                let children = |count: usize| block * WIDTH..count.min((block + 1) * WIDTH);
                match below.last() {
                    None => Block::from_bounds(children(self.len).map(&bounds)),
                    Some(below) => Block::from_bounds(below[children(below.len())].iter().map(Block::union)),
                }
            };
            let blocks: Vec<Block> = changed.par_iter().with_min_len(64).map(block_of).collect();
            for (&at, block) in changed.iter().zip(blocks) {
                rest[0][at] = block;
            }
        }
    }

    /// Number of items per part. The last part may have fewer.
    #[must_use]
    pub fn part_len(&self) -> usize {
        WIDTH.pow(PART_LEVELS.min(self.levels.len()) as u32)
    }

    /// Calls `visit(i, j)` for every item `i` of a part and every item `j > i` of the hierarchy
    /// whose bounds overlap the bounds of `i`. Over all parts, each pair is visited once.
    pub fn pairs(&self, part: usize, mut visit: impl FnMut(usize, usize)) {
        self.pairs_by_block(
            part,
            #[inline(always)]
            |i, block, others| lanes(others, |lane| visit(i, block * WIDTH + lane)),
        );
    }

    /// Like [`Self::pairs`], by blocks: `visit(i, block, others)`. Bit `l` of `others` stands for
    /// item `WIDTH * block + l`.
    #[expect(clippy::redundant_closure, reason = "a reference to a closure would not be inlined")]
    pub fn pairs_by_block(&self, part: usize, mut visit: impl FnMut(usize, usize, u32)) {
        let level = PART_LEVELS.min(self.levels.len()) - 1;
        let mut below = Vec::new();
        let own = self.levels[level][part].union();
        self.descend(self.levels.len() - 1, level, 0, &own, part, &mut |other| below.push((level, part, other)));
        pairs_below(
            &self.levels,
            below,
            #[inline(always)]
            |i, block, others| visit(i, block, others),
        );
    }

    /// Calls `visit` for every item whose bounds overlap `query`, in ascending order.
    pub fn overlapping(&self, query: &Bounds, mut visit: impl FnMut(usize)) {
        self.descend(self.levels.len() - 1, 0, 0, query, 0, &mut |block| {
            lanes(self.levels[0][block].overlaps(query), |lane| {
                let item = block * WIDTH + lane;
                if item < self.len {
                    visit(item);
                }
            });
        });
    }

    /// Bounds of some items.
    pub(super) fn bounds(&self, items: &[u32]) -> Bounds {
        let of = |&item: &u32| self.levels[0][item as usize / WIDTH].lane(item as usize % WIDTH);
        items.iter().map(of).fold(Bounds::EMPTY, |all, item| all.with(&item))
    }

    /// Searches the item nearest to `point`. The search starts near item `around`, ignores items
    /// that are not nearer than `search.best`, and stops early at an item that is good enough.
    pub fn nearest<D: FnMut(usize) -> f64>(
        &self,
        point: [f64; 3],
        around: Option<usize>,
        search: &mut NearestSearch<D>,
    ) {
        // A node of this level has 512 items, the fastest choice for levels of detail.
        const AROUND: usize = 2;
        if self.len == 0 {
            return;
        }
        let (top, query) = (self.levels.len() - 1, PointQuery::new(point));
        if let Some(item) = around {
            let level = AROUND.min(top);
            self.approach(level, item >> (3 * (level + 1)), &query, search);
        }
        if !search.has_ended() {
            self.approach(top, 0, &query, search);
        }
    }

    /// Visits the children of a block, nearest first.
    fn approach<D: FnMut(usize) -> f64>(
        &self,
        level: usize,
        node: usize,
        point: &PointQuery,
        search: &mut NearestSearch<D>,
    ) {
        // Bounds are rounded in the last places of f32.
        const ROUNDING: f64 = 1.0 + 1e-6;
        let bounds = self.levels[level][node].squared_distances(point);
        let limit = (search.best * ROUNDING) as f32;
        let mut near = [(0.0, 0); WIDTH];
        let mut count = 0;
        for (lane, bound) in bounds.into_iter().enumerate() {
            if bound < limit {
                let mut at = count;
                while at > 0 && near[at - 1].0 > bound {
                    near[at] = near[at - 1];
                    at -= 1;
                }
                near[at] = (bound, lane);
                count += 1;
            }
        }
        for &(bound, lane) in &near[..count] {
            if f64::from(bound) >= search.best * ROUNDING || search.has_ended() {
                return;
            }
            let child = node * WIDTH + lane;
            if level > 0 {
                self.approach(level - 1, child, point, search);
            } else {
                let distance = (search.squared_distance)(child);
                if distance < search.best {
                    (search.best, search.item) = (distance, Some(child));
                }
            }
        }
    }

    /// Calls `found` for each block of level `stop` under block `node` of `level` that overlaps
    /// `query`, in ascending order, without the blocks before `first`.
    fn descend(
        &self,
        level: usize,
        stop: usize,
        node: usize,
        query: &Bounds,
        first: usize,
        found: &mut impl FnMut(usize),
    ) {
        if level == stop {
            found(node);
            return;
        }
        let below = level - 1;
        let begin = first >> (3 * (below - stop));
        let mut mask = self.levels[level][node].overlaps(query);
        while mask != 0 {
            let child = node * WIDTH + mask.trailing_zeros() as usize;
            mask &= mask - 1;
            if child >= begin {
                self.descend(below, stop, child, query, first, found);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        #[test]
        fn pairs_are_those_of_brute_force(
            items in prop::collection::vec(prop::array::uniform2(prop::array::uniform3(-9i8..9)), 0..1500),
        ) {
            let at = |p: [i8; 3]| p.map(f64::from);
            let ends: Vec<_> =
                items.iter().map(|[p, d]| [at(*p), at(std::array::from_fn(|i| p[i] + d[i] / 4))]).collect();
            let bounds: Vec<_> = ends.iter().map(|ends| Bounds::of(*ends)).collect();
            let bvh = Bvh::build(bounds.len(), |i| bounds[i]);
            let other = Bvh::build(bounds.len() + 100, |_| Bounds::of([[0.0; 3]]));
            let ends = Bvh::of_hulls(other, items.len(), |some, of| points(ends[some].iter().copied(), of));
            prop_assert!(ends.levels == bvh.levels);
            let mut found = Vec::new();
            for part in 0..bounds.len().div_ceil(bvh.part_len()) {
                bvh.pairs(part, |i, j| found.push((i, j)));
            }
            found.sort_unstable();
            let mut expected = Vec::new();
            for i in 0..bounds.len() {
                for j in i + 1..bounds.len() {
                    if bounds[i].overlaps(&bounds[j]) {
                        expected.push((i, j));
                    }
                }
            }
            prop_assert_eq!(found, expected);
            for query in bounds.iter().take(20) {
                let mut found = Vec::new();
                bvh.overlapping(query, |i| found.push(i));
                let expected: Vec<_> = (0..bounds.len()).filter(|&i| query.overlaps(&bounds[i])).collect();
                prop_assert_eq!(found, expected);
            }
        }
    }

    #[test]
    fn an_updated_hierarchy_is_as_if_it_were_built_anew() {
        let place = |i: usize, moved: usize| {
            let moved = if i % 37 == 5 { moved as f64 * 100.0 } else { 0.0 };
            Bounds::of([[i as f64, moved, 0.0], [i as f64 + 1.0, moved, 1.0]])
        };
        for len in [1, 8, 9, 64, 700, 5000] {
            let mut updated = Bvh::build(len, |i| place(i, 0));
            let changed: Vec<u32> = (0..len as u32).filter(|i| i % 37 == 5).collect();
            updated.update(&changed, |i| place(i, 1));
            let anew = Bvh::build(len, |i| place(i, 1));
            for (a, b) in updated.levels.iter().flatten().zip(anew.levels.iter().flatten()) {
                assert!(a == b);
            }
        }
    }
}
