//! Walls of a section in a grid, and where rays hit them.

use super::shape::{Shape, edges};

type P2 = [f64; 2];

/// Number of edges that are tested together.
const LANES: usize = 8;
/// Side of a cell, relative to squares with one edge each on average. Most cells are empty; the
/// others have several edges.
const CELL: f64 = 2.0;
/// Fraction of the extent of a section below which a hit is the edge on which the ray starts.
const OWN: f64 = 4e-6;
/// Fraction of an edge by which it is extended at both ends, for rays through a common point of two
/// edges.
const SLACK: f32 = 1e-5;

/// Edges of a cell: starts and vectors. Unused lanes have NaN as start.
#[derive(Clone)]
struct Block {
    start: [[f32; LANES]; 2],
    edge: [[f32; LANES]; 2],
}

const EMPTY: Block = Block { start: [[f32::NAN; LANES]; 2], edge: [[0.0; LANES]; 2] };

/// All edges of a section in a grid of square cells.
pub(super) struct Walls {
    corner: P2,
    cell: f64,
    columns: usize,
    rows: usize,
    /// First block of each cell, and the end.
    starts: Vec<u32>,
    blocks: Vec<Block>,
    own: f32,
}

impl Walls {
    pub(super) fn new(shape: &Shape<'_>) -> Self {
        let rings = shape.lumen.iter().copied().chain([shape.outer]);
        let all: Vec<[P2; 2]> = rings.flat_map(|ring| edges(ring).map(|(a, b)| [a, b])).collect();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in all.iter().flatten() {
            for k in 0..2 {
                low[k] = low[k].min(point[k]);
                high[k] = high[k].max(point[k]);
            }
        }
        let extent = [high[0] - low[0], high[1] - low[1]].map(|x| x.max(1e-3));
        let (area, widest) = (extent[0] * extent[1], extent[0].max(extent[1]));
        let cell = (CELL * (area / all.len().max(1) as f64).sqrt()).max(widest / 4096.0);
        let count = |extent: f64| (extent / cell) as usize + 1;
        let (columns, rows) = (count(extent[0]), count(extent[1]));
        let own = (OWN * widest) as f32;
        let mut walls = Self { corner: low, cell, columns, rows, starts: Vec::new(), blocks: Vec::new(), own };
        walls.fill(&all);
        walls
    }

    fn fill(&mut self, all: &[[P2; 2]]) {
        let mut places = vec![0_u32; self.columns * self.rows];
        for edge in all {
            self.cells(edge, |cell| places[cell] += 1);
        }
        let mut starts = vec![0; places.len() + 1];
        for (cell, place) in places.iter_mut().enumerate() {
            starts[cell + 1] = starts[cell] + place.div_ceil(LANES as u32);
            // From here on, place of the next edge.
            *place = starts[cell] * LANES as u32;
        }
        let mut blocks = vec![EMPTY; starts[places.len()] as usize];
        for edge in all {
            let [a, b] = *edge;
            let start = [0, 1].map(|k| (a[k] - self.corner[k]) as f32);
            let along = [0, 1].map(|k| (b[k] - a[k]) as f32);
            self.cells(edge, |cell| {
                let place = places[cell] as usize;
                let (block, lane) = (&mut blocks[place / LANES], place % LANES);
                for k in 0..2 {
                    block.start[k][lane] = start[k];
                    block.edge[k][lane] = along[k];
                }
                places[cell] += 1;
            });
        }
        (self.starts, self.blocks) = (starts, blocks);
    }

    /// Column or row of a coordinate.
    #[inline(always)]
    fn index(&self, axis: usize, x: f64) -> usize {
        let most = [self.columns, self.rows][axis] - 1;
        (((x - self.corner[axis]) / self.cell) as usize).min(most)
    }

    /// Visits the cells that the bounds of an edge overlap.
    #[inline(always)]
    fn cells(&self, [a, b]: &[P2; 2], mut visit: impl FnMut(usize)) {
        let range = |axis: usize| self.index(axis, a[axis].min(b[axis]))..=self.index(axis, a[axis].max(b[axis]));
        for row in range(1) {
            for column in range(0) {
                visit(row * self.columns + column);
            }
        }
    }

    /// Distance from a point on an edge along a unit vector to the first other edge. Inlined, so
    /// that it is compiled for the vectors of its caller.
    #[inline(always)]
    pub(super) fn first(&self, from: P2, along: [f32; 2]) -> Option<f32> {
        let mut at = [self.index(0, from[0]), self.index(1, from[1])];
        let from = [0, 1].map(|k| (from[k] - self.corner[k]) as f32);
        let side = self.cell as f32;
        // On each axis, distance along the ray to the next border of a cell, and between two such
        // borders.
        let mut border = [f32::INFINITY; 2];
        for k in 0..2 {
            if along[k] != 0.0 {
                let line = side * (at[k] as f32 + if along[k] > 0.0 { 1.0 } else { 0.0 });
                border[k] = (line - from[k]) / along[k];
            }
        }
        let between = along.map(|x| side / x.abs());
        let ends = [self.columns, self.rows];
        let mut nearest = [f32::INFINITY; LANES];
        let mut least = f32::INFINITY;
        loop {
            let cell = at[1] * self.columns + at[0];
            let blocks = &self.blocks[self.starts[cell] as usize..self.starts[cell + 1] as usize];
            for block in blocks {
                meet(from, along, block, self.own, &mut nearest);
            }
            if !blocks.is_empty() {
                least = smallest(&nearest);
            }
            let axis = usize::from(border[1] < border[0]);
            if least <= border[axis] {
                return Some(least);
            }
            if along[axis] > 0.0 {
                at[axis] += 1;
                if at[axis] == ends[axis] {
                    break;
                }
            } else {
                at[axis] = at[axis].checked_sub(1)?;
            }
            border[axis] += between[axis];
        }
        least.is_finite().then_some(least)
    }
}

/// Lowers `nearest` to the distances along a ray to the edges of a block, if they are larger than
/// `own`.
#[inline(always)]
fn meet([x, y]: [f32; 2], [dx, dy]: [f32; 2], block: &Block, own: f32, nearest: &mut [f32; LANES]) {
    let Block { start: [sx, sy], edge: [ex, ey] } = block;
    for i in 0..LANES {
        let scale = 1.0 / (dx * ey[i] - dy * ex[i]);
        let [tx, ty] = [sx[i] - x, sy[i] - y];
        let distance = (tx * ey[i] - ty * ex[i]) * scale;
        let place = (tx * dy - ty * dx) * scale;
        // No short-circuit evaluation, so that all lanes do the same. Comparisons with NaN are
        // false.
        let hit = (distance > own) & ((place - 0.5).abs() <= 0.5 + SLACK) & (distance < nearest[i]);
        nearest[i] = if hit { distance } else { nearest[i] };
    }
}

#[inline(always)]
fn smallest(values: &[f32; LANES]) -> f32 {
    let least = |a: f32, b: f32| if b < a { b } else { a };
    let mut four = [0.0; LANES / 2];
    for (i, value) in four.iter_mut().enumerate() {
        *value = least(values[i], values[i + LANES / 2]);
    }
    least(least(four[0], four[2]), least(four[1], four[3]))
}
