//! A bounding-volume hierarchy without pointers and without sorting: eight items in their given order form a block, eight
//! blocks a block of the next level, and so on.
//!
//! Its quality depends on the coherence of the order, which is good for the strips of a lofted surface; for other surfaces
//! the caller sorts first (see [`morton`]). A volume is bounded along five directions: x, y, z, x + y and x − y.
//!
//! Invariant: the bounds of two items with a common point overlap. Bounds are stored in f32, rounded to nearest; rounding
//! is monotone, so that overlapping bounds still overlap, and no outward rounding is needed.

use rayon::prelude::*;

const AXES: usize = 5;

/// Items of a block and children of a node.
pub const WIDTH: usize = 8;

/// Extent of an item along the five directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    low: [f32; AXES],
    high: [f32; AXES],
}

impl Bounds {
    /// Bounds of nothing, which overlap nothing.
    pub const EMPTY: Self = Self { low: [f32::INFINITY; AXES], high: [f32::NEG_INFINITY; AXES] };

    /// Bounds of the convex hull of some points.
    #[inline]
    #[must_use]
    pub fn of<const N: usize>(points: [[f64; 3]; N]) -> Self {
        let mut bounds = Self::EMPTY;
        for [x, y, z] in points {
            let along = [x as f32, y as f32, z as f32, (x + y) as f32, (x - y) as f32];
            for (axis, value) in along.into_iter().enumerate() {
                bounds.low[axis] = bounds.low[axis].min(value);
                bounds.high[axis] = bounds.high[axis].max(value);
            }
        }
        bounds
    }

    /// Bounds of both.
    #[must_use]
    pub fn with(mut self, other: &Self) -> Self {
        for axis in 0..AXES {
            self.low[axis] = self.low[axis].min(other.low[axis]);
            self.high[axis] = self.high[axis].max(other.high[axis]);
        }
        self
    }

    /// Whether both may have a point in common.
    #[inline]
    #[must_use]
    pub fn overlaps(&self, other: &Self) -> bool {
        (0..AXES).all(|axis| self.low[axis] <= other.high[axis] && other.low[axis] <= self.high[axis])
    }

    /// Sum of the extents along x, y and z; negative for nothing.
    #[must_use]
    pub fn size(&self) -> f32 {
        (0..3).map(|axis| self.high[axis] - self.low[axis]).sum()
    }

    /// Bounds that contain every point within `reach` of these.
    #[must_use]
    fn grown(mut self, reach: f32) -> Self {
        if reach > 0.0 {
            for axis in 0..AXES {
                // A margin compensates for the rounding of this sum.
                let by = if axis < 3 { reach } else { reach * 1.5 };
                self.low[axis] -= by + self.low[axis].abs() * 1e-6;
                self.high[axis] += by + self.high[axis].abs() * 1e-6;
            }
        }
        self
    }
}

/// The bounds of eight items, by direction, so that one pass over each row tests all of them.
#[derive(Clone, Copy)]
struct Block {
    low: [[f32; WIDTH]; AXES],
    high: [[f32; WIDTH]; AXES],
}

impl Block {
    fn of(bounds: impl Iterator<Item = Bounds>) -> Self {
        let mut block = Self { low: [[f32::INFINITY; WIDTH]; AXES], high: [[f32::NEG_INFINITY; WIDTH]; AXES] };
        for (lane, b) in bounds.enumerate() {
            for axis in 0..AXES {
                block.low[axis][lane] = b.low[axis];
                block.high[axis][lane] = b.high[axis];
            }
        }
        block
    }

    #[inline]
    fn lane(&self, lane: usize) -> Bounds {
        Bounds { low: std::array::from_fn(|a| self.low[a][lane]), high: std::array::from_fn(|a| self.high[a][lane]) }
    }

    /// Lower bounds of the squared distances of a point from the items; infinite for an empty lane. The directions x + y and
    /// x − y are left out: testing them takes longer than what they would exclude.
    #[inline]
    fn squared_distances(&self, point: &Query) -> [f32; WIDTH] {
        // Comparisons rather than `max`, which treats NaN apart, so that all lanes are computed at once.
        let greater = |a: f32, b: f32| if a > b { a } else { b };
        let mut sums = [0.0; WIDTH];
        for axis in 0..3 {
            let (low, high) = (&self.low[axis], &self.high[axis]);
            for (lane, sum) in sums.iter_mut().enumerate() {
                let outside = greater(greater(low[lane] - point.high[axis], point.low[axis] - high[lane]), 0.0);
                *sum += outside * outside;
            }
        }
        sums
    }

    fn union(&self) -> Bounds {
        (0..WIDTH).fold(Bounds::EMPTY, |sum, lane| sum.with(&self.lane(lane)))
    }

    /// Bit `l` is set where item `l` overlaps `query`. An empty lane overlaps nothing, nor do bounds that are NaN.
    #[inline]
    #[expect(clippy::neg_cmp_op_on_partial_ord, reason = "NaN must count as apart")]
    fn overlaps(&self, query: &Bounds) -> u32 {
        let mut apart = [0u32; WIDTH];
        for axis in 0..AXES {
            let (low, high) = (&self.low[axis], &self.high[axis]);
            let (query_low, query_high) = (query.low[axis], query.high[axis]);
            for lane in 0..WIDTH {
                apart[lane] |= u32::from(!(low[lane] <= query_high)) | u32::from(!(query_low <= high[lane]));
            }
        }
        let mut mask = 0;
        for (lane, apart) in apart.into_iter().enumerate() {
            mask |= (1 - apart) << lane;
        }
        mask
    }
}

/// A point, with a margin for the rounding of bounds and of the point itself.
struct Query {
    low: [f32; 3],
    high: [f32; 3],
}

impl Query {
    fn of(point: [f64; 3]) -> Self {
        let margin = |x: f64| x.abs() as f32 * 2.5e-7;
        Self { low: point.map(|x| x as f32 - margin(x)), high: point.map(|x| x as f32 + margin(x)) }
    }
}

/// A search for an item near a point.
pub struct Search<D> {
    /// The squared distance of an item.
    pub squared_distance: D,
    /// The search ends at the first item that is no farther than this, squared.
    pub enough: f64,
    /// The squared distance of the nearest item found, at first the limit; items that are not nearer are passed over.
    pub best: f64,
    /// The nearest item found, at first none.
    pub item: Option<usize>,
}

impl<D> Search<D> {
    fn has_ended(&self) -> bool {
        self.item.is_some() && self.best <= self.enough
    }
}

/// The hierarchy.
pub struct Bvh {
    /// `levels[0]` bounds the items, each next level the blocks of the one before; the last has one block.
    levels: Vec<Vec<Block>>,
    len: usize,
}

impl Bvh {
    /// Builds the hierarchy of `len` items, `bounds(i)` those of item `i`.
    #[must_use]
    pub fn build(len: usize, bounds: impl Fn(usize) -> Bounds + Sync) -> Self {
        let first: Vec<Block> = (0..len.div_ceil(WIDTH))
            .into_par_iter()
            .with_min_len(256)
            .map(|block| Block::of((block * WIDTH..len.min((block + 1) * WIDTH)).map(&bounds)))
            .collect();
        let mut levels = vec![first];
        while let Some(last) = levels.last().filter(|last| last.len() > 1) {
            let next = last
                .par_chunks(WIDTH)
                .with_min_len(64)
                .map(|children| Block::of(children.iter().map(Block::union)))
                .collect();
            levels.push(next);
        }
        Self { levels, len }
    }

    /// Takes new bounds of some items, in ascending order, into account.
    pub fn update(&mut self, items: &[u32], bounds: impl Fn(usize) -> Bounds + Sync) {
        let mut changed: Vec<usize> = items.iter().map(|&item| item as usize).collect();
        for level in 0..self.levels.len() {
            changed.iter_mut().for_each(|of| *of /= WIDTH);
            changed.dedup();
            let (below, rest) = self.levels.split_at_mut(level);
            let block_of = |block: &usize| {
                let children = |count: usize| block * WIDTH..count.min((block + 1) * WIDTH);
                match below.last() {
                    None => Block::of(children(self.len).map(&bounds)),
                    Some(below) => Block::of(below[children(below.len())].iter().map(Block::union)),
                }
            };
            let blocks: Vec<Block> = changed.par_iter().with_min_len(64).map(block_of).collect();
            for (&at, block) in changed.iter().zip(blocks) {
                rest[0][at] = block;
            }
        }
    }

    /// Number of blocks of items.
    #[must_use]
    pub fn blocks(&self) -> usize {
        self.levels[0].len()
    }

    /// Calls `visit(i, j)` for every item `i` of a block and every item `j > i` of the whole hierarchy that come
    /// within `reach` of each other by their bounds. Over all blocks each pair is visited once.
    pub fn pairs(&self, block: usize, reach: f32, mut visit: impl FnMut(usize, usize)) {
        let own = &self.levels[0][block];
        let lanes: [Bounds; WIDTH] = std::array::from_fn(|lane| own.lane(lane).grown(reach));
        let query = own.union().grown(reach);
        let top = self.levels.len() - 1;
        self.descend(top, 0, &query, block, &mut |other| {
            let there = &self.levels[0][other];
            for (lane, bounds) in lanes.iter().enumerate() {
                let item = block * WIDTH + lane;
                if item >= self.len {
                    break;
                }
                let mut mask = there.overlaps(bounds);
                if other == block {
                    mask &= !0 << (lane + 1);
                }
                while mask != 0 {
                    let second = other * WIDTH + mask.trailing_zeros() as usize;
                    mask &= mask - 1;
                    if second < self.len {
                        visit(item, second);
                    }
                }
            }
        });
    }

    /// Calls `visit` for every item whose bounds overlap `query`, in ascending order.
    pub fn overlapping(&self, query: &Bounds, mut visit: impl FnMut(usize)) {
        self.descend(self.levels.len() - 1, 0, query, 0, &mut |block| {
            let mut mask = self.levels[0][block].overlaps(query);
            while mask != 0 {
                let item = block * WIDTH + mask.trailing_zeros() as usize;
                mask &= mask - 1;
                if item < self.len {
                    visit(item);
                }
            }
        });
    }

    /// Looks for the item nearest to `point`, of those nearer than `search.best`, and ends at one that is near enough. The
    /// first ones looked at are those around item `around`.
    pub fn nearest<D: FnMut(usize) -> f64>(&self, point: [f64; 3], around: Option<usize>, search: &mut Search<D>) {
        // A node of this level has 512 items: the fastest choice for levels of detail.
        const AROUND: usize = 2;
        if self.len == 0 {
            return;
        }
        let (top, query) = (self.levels.len() - 1, Query::of(point));
        if let Some(item) = around {
            let level = AROUND.min(top);
            self.approach(level, item >> (3 * (level + 1)), &query, search);
        }
        if !search.has_ended() {
            self.approach(top, 0, &query, search);
        }
    }

    /// Visits the children of a block, nearest first.
    fn approach<D: FnMut(usize) -> f64>(&self, level: usize, node: usize, point: &Query, search: &mut Search<D>) {
        // Bounds are rounded in the last steps of f32.
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

    /// Calls `leaf` for each block of items from `first` on whose bounds overlap `query`.
    fn descend(&self, level: usize, node: usize, query: &Bounds, first: usize, leaf: &mut impl FnMut(usize)) {
        if level == 0 {
            leaf(node);
            return;
        }
        let below = level - 1;
        let (begin, count) = (first >> (3 * below), self.levels[below].len());
        let mut mask = self.levels[level][node].overlaps(query);
        while mask != 0 {
            let child = node * WIDTH + mask.trailing_zeros() as usize;
            mask &= mask - 1;
            if child >= begin && child < count {
                self.descend(below, child, query, first, leaf);
            }
        }
    }
}

/// Position along the Morton curve of a point given as fractions (0 to 1) of a box, 10 bits per axis.
#[must_use]
pub fn morton(fraction: [f32; 3]) -> u32 {
    let spread = |f: f32| {
        let mut v = (f.clamp(0.0, 1.0) * 1023.0) as u32;
        v = (v | (v << 16)) & 0x0300_00FF;
        v = (v | (v << 8)) & 0x0300_F00F;
        v = (v | (v << 4)) & 0x030C_30C3;
        (v | (v << 2)) & 0x0924_9249
    };
    spread(fraction[0]) | (spread(fraction[1]) << 1) | (spread(fraction[2]) << 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        #[test]
        fn pairs_are_those_of_brute_force(
            items in prop::collection::vec(prop::array::uniform2(prop::array::uniform3(-9i8..9)), 0..300),
            reach in 0i8..2,
        ) {
            let at = |p: [i8; 3]| p.map(f64::from);
            let bounds: Vec<_> = items.iter().map(|[p, d]| {
                let end = std::array::from_fn(|i| p[i] + d[i] / 4);
                Bounds::of([at(*p), at(end)])
            }).collect();
            let bvh = Bvh::build(bounds.len(), |i| bounds[i]);
            let mut found = Vec::new();
            for block in 0..bvh.blocks() {
                bvh.pairs(block, f32::from(reach), |i, j| found.push((i, j)));
            }
            found.sort_unstable();
            let mut expected = Vec::new();
            for i in 0..bounds.len() {
                for j in i + 1..bounds.len() {
                    if bounds[i].grown(f32::from(reach)).overlaps(&bounds[j]) {
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
                assert!(a.low == b.low && a.high == b.high);
            }
        }
    }

    #[test]
    fn the_curve_of_morton_interleaves() {
        assert_eq!(morton([1.0, 1.0, 1.0]), (1 << 30) - 1);
        assert_eq!(morton([0.0, 0.0, 1.0]), 0x2492_4924);
        assert_eq!(morton([0.0; 3]), 0);
    }
}
