//! The search for pairs in a hierarchy of blocks of eight: by descending two of its branches at once.

/// Children of a block.
pub(super) const WIDTH: usize = 8;

/// The bounds of eight items or blocks.
pub(super) trait Block {
    /// Those of one.
    type Bounds;

    /// The bounds of child `lane`.
    fn lane(&self, lane: usize) -> Self::Bounds;

    /// Bit `l` is set where child `l` overlaps `query`. A lane without a child overlaps nothing.
    fn overlaps(&self, query: &Self::Bounds) -> u32;
}

/// Calls `visit(i, block, others)` for every item `i` and block of items that overlap it: bit `l` of `others` is set for item `l` of
/// the block if it comes after `i`. They are searched for below pairs of blocks `(level, first, second)`, of which the second is not
/// before the first. `levels[0]` has the blocks of items, each further level those of the one before.
#[inline(always)]
pub(super) fn pairs_below<B: Block>(
    levels: &[Vec<B>],
    mut below: Vec<(usize, usize, usize)>,
    mut visit: impl FnMut(usize, usize, u32),
) {
    while let Some((level, first, second)) = below.pop() {
        let (a, b) = (&levels[level][first], &levels[level][second]);
        // Of a block and itself all children count; of two blocks, those of the first that reach into the second.
        let mut mask = match levels.get(level + 1) {
            Some(above) if first != second => a.overlaps(&above[second / WIDTH].lane(second % WIDTH)),
            _ => !0 >> (32 - WIDTH),
        };
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            let mut others = b.overlaps(&a.lane(lane));
            if first == second {
                // An item with itself is no pair, but there may be pairs within a block.
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

/// Calls `visit` for each bit that is set.
#[inline(always)]
pub(super) fn lanes(mut mask: u32, mut visit: impl FnMut(usize)) {
    while mask != 0 {
        visit(mask.trailing_zeros() as usize);
        mask &= mask - 1;
    }
}
