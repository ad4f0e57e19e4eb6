//! Neighbour search: for each particle the blocks of segments that it may interact with, in ascending order.
//!
//! Invariant: the blocks of a particle contain every segment within its range; other segments in them add zeros. So
//! all searches give the same bytes. `lists` are built from bounding boxes of blocks. They are kept while twice the
//! greatest displacement since then, plus the growth of the ranges, is within the skin (the two-step search suggested in
//! the paper, section 4).

use super::chain::Chain;
use super::pairs::CLEARANCE_CAP;
use super::vectorize::vectorize;
use crate::sim::layout::{LANES, StepRow};
use crate::sim::maths::{max, min};
use crate::sim::state::InnerLoop;
use crate::spec::Search;
use rayon::prelude::*;
use std::ops::Range;

/// Distance by which lists reach beyond the range of the forces, µm.
pub(super) const SKIN: f32 = 24.0;

/// A run of particles processed by one thread, with the list of blocks of each.
#[derive(Debug, Default)]
pub(super) struct Part {
    pub(super) particles: Range<usize>,
    /// Start and end in `blocks` of the list of each particle.
    spans: Vec<[u32; 2]>,
    blocks: Vec<u32>,
    /// Greatest 1/d of each segment of the loop to the particles of this part, padded to whole blocks.
    pub(super) near: Vec<[f32; LANES]>,
}

impl Part {
    /// The list of the `i`-th particle of this part.
    #[inline(always)]
    pub(super) fn blocks(&self, i: usize) -> &[u32] {
        let [first, end] = self.spans[i];
        &self.blocks[first as usize..end as usize]
    }
}

/// Bounding box: least x, least y, greatest x, greatest y.
type Bounds = [f32; 4];

/// The neighbour search, with its lists.
#[derive(Debug)]
pub(super) struct Neighbours {
    search: Search,
    threads: usize,
    pub(super) parts: Vec<Part>,
    bounds: Vec<Bounds>,
    built_x: Vec<f32>,
    built_y: Vec<f32>,
    /// Range of the forces and least search distance that the lists were built for.
    built_range: f32,
    built_sight: f32,
    valid: bool,
    builds: u64,
}

impl Neighbours {
    pub(super) fn new(search: Search, threads: usize) -> Self {
        Self {
            search,
            threads: threads.max(1),
            parts: Vec::new(),
            bounds: Vec::new(),
            built_x: Vec::new(),
            built_y: Vec::new(),
            built_range: 0.0,
            built_sight: 0.0,
            valid: false,
            builds: 0,
        }
    }

    /// Starts the count of builds at `builds`.
    pub(super) fn counted_from(self, builds: u64) -> Self {
        Self { builds, ..self }
    }

    pub(super) fn builds(&self) -> u64 {
        self.builds
    }

    /// Discards the lists, because the loop or its ranges changed.
    pub(super) fn invalidate(&mut self) {
        self.valid = false;
    }

    /// Rebuilds the lists if they are outdated for `chain`.
    pub(super) fn prepare(&mut self, chain: &Chain, state: &InnerLoop, row: &StepRow) {
        let keep = self.valid
            && match self.search {
                Search::Lists => self.still_holds(chain, state, row),
                Search::Grid => false,
                Search::AllPairs => true,
            };
        if !keep {
            self.build(chain, state, row);
        }
    }

    fn still_holds(&self, chain: &Chain, state: &InnerLoop, row: &StepRow) -> bool {
        let n = chain.len();
        let moved = vectorize(
            #[inline(always)]
            || {
                let (x, y) = (&chain.x[1..=n], &chain.y[1..=n]);
                let (bx, by) = (&self.built_x[..n], &self.built_y[..n]);
                let mut far = [0.0f32; LANES];
                let whole = n - n % LANES;
                for i in (0..whole).step_by(LANES) {
                    for l in 0..LANES {
                        let (dx, dy) = (x[i + l] - bx[i + l], y[i + l] - by[i + l]);
                        far[l] = max(far[l], dx * dx + dy * dy);
                    }
                }
                for i in whole..n {
                    let (dx, dy) = (x[i] - bx[i], y[i] - by[i]);
                    far[0] = max(far[0], dx * dx + dy * dy);
                }
                far.iter().fold(0.0f32, |a, &b| max(a, b)).sqrt()
            },
        );
        let widest = state.scale.iter().fold(1.0f32, |a, &b| max(a, b));
        let widened = max(max(reach(row) - self.built_range, 0.0) * widest, least_sight(row) - self.built_sight);
        2.0 * moved + widened <= SKIN - 0.01
    }

    fn build(&mut self, chain: &Chain, state: &InnerLoop, row: &StepRow) {
        self.builds += 1;
        self.cut(chain.len(), chain.blocks.len());
        self.bounds.clear();
        self.bounds.extend((0..chain.blocks.len()).map(|b| segment_bounds(chain, b)));
        let built = Built { chain, state, row, bounds: &self.bounds };
        match self.search {
            Search::AllPairs => {
                for part in &mut self.parts {
                    part.blocks.clear();
                    part.blocks.extend(0..chain.blocks.len() as u32);
                    part.spans.clear();
                    part.spans.resize(part.particles.len(), [0, chain.blocks.len() as u32]);
                }
            }
            Search::Lists => each(&mut self.parts, |part| built.lists(part)),
            Search::Grid => {
                let grid = Grid::new(&built);
                each(&mut self.parts, |part| grid.lists(&built, part));
            }
        }
        self.built_x.clear();
        self.built_x.extend_from_slice(&chain.x[1..=chain.len()]);
        self.built_y.clear();
        self.built_y.extend_from_slice(&chain.y[1..=chain.len()]);
        self.built_range = reach(row);
        self.built_sight = least_sight(row);
        self.valid = true;
    }

    /// Divides the loop into parts of whole blocks.
    fn cut(&mut self, n: usize, blocks: usize) {
        // Several parts per thread, because folds make the work per particle uneven.
        let count = if self.threads == 1 { 1 } else { (self.threads * 4).min(blocks) };
        self.parts.resize_with(count, Part::default);
        for (k, part) in self.parts.iter_mut().enumerate() {
            let (first, end) = (k * blocks / count, (k + 1) * blocks / count);
            part.particles = first * LANES..(end * LANES).min(n);
            part.near.clear();
            part.near.resize(blocks, [0.0; LANES]);
        }
    }
}

/// Runs `work` on every part, in parallel.
pub(super) fn each(parts: &mut [Part], work: impl Fn(&mut Part) + Sync + Send) {
    if parts.len() == 1 {
        work(&mut parts[0]);
    } else {
        parts.par_iter_mut().for_each(work);
    }
}

/// Range of the self-intersection force at scale 1.
fn reach(row: &StepRow) -> f32 {
    row.range_max()
}

/// Least search distance of every particle, whatever its range: for clearances and the barrier.
fn least_sight(row: &StepRow) -> f32 {
    max(CLEARANCE_CAP, row.barrier_distance)
}

fn segment_bounds(chain: &Chain, block: usize) -> Bounds {
    let first = block * LANES + 1;
    let end = (first + LANES).min(chain.len() + 1);
    // Segments run to the next particle: one point more.
    chain.x[first..=end]
        .iter()
        .zip(&chain.y[first..=end])
        .fold([f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY], |b, (&x, &y)| {
            [min(b[0], x), min(b[1], y), max(b[2], x), max(b[3], y)]
        })
}

#[inline(always)]
fn gap(low: f32, high: f32, other_low: f32, other_high: f32) -> f32 {
    max(max(other_low - high, low - other_high), 0.0)
}

/// Inputs of the lists.
struct Built<'a> {
    chain: &'a Chain,
    state: &'a InnerLoop,
    row: &'a StepRow,
    bounds: &'a [Bounds],
}

impl Built<'_> {
    /// Reach of the list of particle `i`: its range or the least search distance, plus the skin.
    #[inline(always)]
    fn range(&self, i: usize) -> f32 {
        max(reach(self.row) * self.state.scale[i], least_sight(self.row)) + SKIN
    }

    fn lists(&self, part: &mut Part) {
        part.spans.clear();
        part.blocks.clear();
        let mut candidates: Vec<u32> = Vec::new();
        let mut i = part.particles.start;
        while i < part.particles.end {
            let end = (i + LANES).min(part.particles.end);
            let own = segment_bounds(self.chain, i / LANES);
            let widest = (i..end).fold(0.0f32, |r, i| max(r, self.range(i)));
            candidates.clear();
            candidates.extend((0..self.bounds.len() as u32).filter(|&b| {
                let b = self.bounds[b as usize];
                let (dx, dy) = (gap(own[0], own[2], b[0], b[2]), gap(own[1], own[3], b[1], b[3]));
                dx * dx + dy * dy <= widest * widest
            }));
            for i in i..end {
                let first = part.blocks.len() as u32;
                self.select(i, &candidates, &mut part.blocks);
                part.spans.push([first, part.blocks.len() as u32]);
            }
            i = end;
        }
    }

    /// Appends those of the ascending `candidates` that are within the range of particle `i`.
    #[inline(always)]
    fn select(&self, i: usize, candidates: &[u32], blocks: &mut Vec<u32>) {
        let (x, y) = (self.chain.x[i + 1], self.chain.y[i + 1]);
        let range = self.range(i);
        blocks.extend(candidates.iter().copied().filter(|&b| {
            let b = self.bounds[b as usize];
            let (dx, dy) = (gap(x, x, b[0], b[2]), gap(y, y, b[1], b[3]));
            dx * dx + dy * dy <= range * range
        }));
    }
}

/// A uniform grid over the blocks' bounding boxes.
struct Grid {
    origin: [f32; 2],
    cell: f32,
    size: [usize; 2],
    cells: Vec<Vec<u32>>,
}

impl Grid {
    /// Least side of a cell, µm: about the size of a block.
    const CELL: f32 = 96.0;
    /// Most cells per block: strands that lie far apart make cells larger instead of more numerous.
    const SPARSE: f32 = 4.0;

    fn new(built: &Built<'_>) -> Self {
        let all =
            built.bounds.iter().fold([f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY], |a, b| {
                [min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])]
            });
        let area = (all[2] - all[0]) * (all[3] - all[1]);
        let cell = max(Self::CELL, (area / (Self::SPARSE * built.bounds.len() as f32)).sqrt());
        let cells = |low: f32, high: f32| ((high - low) / cell) as usize + 1;
        let size = [cells(all[0], all[2]), cells(all[1], all[3])];
        let mut grid = Self { origin: [all[0], all[1]], cell, size, cells: vec![Vec::new(); size[0] * size[1]] };
        for (index, b) in built.bounds.iter().enumerate() {
            grid.visit(*b, |grid, cell| grid.cells[cell].push(index as u32));
        }
        grid
    }

    fn span(&self, axis: usize, low: f32, high: f32) -> std::ops::RangeInclusive<usize> {
        let at = |v: f32| (((v - self.origin[axis]) / self.cell).max(0.0) as usize).min(self.size[axis] - 1);
        at(low)..=at(high)
    }

    fn visit(&mut self, b: Bounds, mut what: impl FnMut(&mut Self, usize)) {
        for row in self.span(1, b[1], b[3]) {
            for column in self.span(0, b[0], b[2]) {
                what(self, row * self.size[0] + column);
            }
        }
    }

    fn lists(&self, built: &Built<'_>, part: &mut Part) {
        part.spans.clear();
        part.blocks.clear();
        let mut candidates: Vec<u32> = Vec::new();
        for i in part.particles.clone() {
            let (x, y, range) = (built.chain.x[i + 1], built.chain.y[i + 1], built.range(i));
            candidates.clear();
            for row in self.span(1, y - range, y + range) {
                for column in self.span(0, x - range, x + range) {
                    candidates.extend_from_slice(&self.cells[row * self.size[0] + column]);
                }
            }
            candidates.sort_unstable();
            candidates.dedup();
            let first = part.blocks.len() as u32;
            built.select(i, &candidates, &mut part.blocks);
            part.spans.push([first, part.blocks.len() as u32]);
        }
    }
}
