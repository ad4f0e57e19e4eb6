//! Uniform grid that finds the cells of segments near a box.

use crate::sim::maths::{max, min};

/// Bounding box: minimum x, minimum y, maximum x, maximum y.
pub(super) type Bounds = [f32; 4];

pub(super) const NOTHING: Bounds = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY];

pub(super) fn around(b: Bounds, [x, y]: [f32; 2]) -> Bounds {
    [min(b[0], x), min(b[1], y), max(b[2], x), max(b[3], y)]
}

/// Squared distance of two boxes.
#[inline(always)]
pub(super) fn apart(a: Bounds, b: Bounds) -> f32 {
    let gap = |low: f32, high: f32, other_low: f32, other_high: f32| max(max(other_low - high, low - other_high), 0.0);
    let (x, y) = (gap(a[0], a[2], b[0], b[2]), gap(a[1], a[3], b[1], b[3]));
    x * x + y * y
}

/// A uniform grid over the boxes of the cells of segments.
#[derive(Debug)]
pub(super) struct Grid {
    origin: [f32; 2],
    side: f32,
    size: [usize; 2],
    squares: Vec<Vec<u32>>,
    /// Maximum margin of a segment.
    margin: f32,
}

impl Grid {
    /// Minimum side of a square, µm.
    const SIDE: f32 = 96.0;
    /// Maximum number of squares per cell. If strands lie far apart, squares become larger instead
    /// of more numerous.
    const SPARSE: f32 = 4.0;

    /// A grid over cells with these boxes and margins.
    pub(super) fn new(cells: &[(Bounds, f32)]) -> Self {
        let all = cells.iter().fold(NOTHING, |a, (b, _)| around(around(a, [b[0], b[1]]), [b[2], b[3]]));
        let area = (all[2] - all[0]) * (all[3] - all[1]);
        let side = max(Self::SIDE, (area / (Self::SPARSE * cells.len() as f32)).sqrt());
        let count = |low: f32, high: f32| ((high - low) / side) as usize + 1;
        let size = [count(all[0], all[2]), count(all[1], all[3])];
        let margin = cells.iter().fold(0.0, |most, cell| max(most, cell.1));
        let squares = vec![Vec::new(); size[0] * size[1]];
        let mut grid = Self { origin: [all[0], all[1]], side, size, squares, margin };
        for (k, (bounds, _)) in (0..).zip(cells) {
            for square in grid.visited(*bounds) {
                grid.squares[square].push(k);
            }
        }
        grid
    }

    /// Squares that a box intersects.
    fn visited(&self, b: Bounds) -> impl Iterator<Item = usize> + use<> {
        let (origin, side, size) = (self.origin, self.side, self.size);
        let at = move |axis: usize, v: f32| (((v - origin[axis]) / side).max(0.0) as usize).min(size[axis] - 1);
        (at(1, b[1])..=at(1, b[3]))
            .flat_map(move |row| (at(0, b[0])..=at(0, b[2])).map(move |column| row * size[0] + column))
    }

    /// Appends the cells that may be within `reach` of a box, in ascending order.
    pub(super) fn cells_within(&self, b: Bounds, reach: f32, cells: &mut Vec<u32>) {
        let reach = reach + self.margin;
        for square in self.visited([b[0] - reach, b[1] - reach, b[2] + reach, b[3] + reach]) {
            cells.extend_from_slice(&self.squares[square]);
        }
        cells.sort_unstable();
        cells.dedup();
    }
}
