//! Neighbour search: for each group of consecutive particles the segments that one of them may interact with, ascending.
//!
//! Invariant: the list of a group contains every segment within the range of one of its particles; other segments in it add
//! zeros. So all searches and all sizes of groups give the same bytes.
//!
//! A particle sees farther through tissue than across a gap (D of [`super::pairs`]), so its lists hold what lies within D plus a
//! skin. They are kept until motion may have used up the skin (the two-step search suggested in the paper, section 4). With q from
//! a point of a segment to the particle, the slack |q| − D changes by at most [`SLOPE`] times a change of q, and by half of
//! the difference of the two ranges times a change of the normal.

use super::chain::{BLOCK, Chain, Stretch};
use super::pairs::{CLEARANCE_CAP, FAR};
use crate::sim::layout::StepRow;
use crate::sim::maths::{greatest, max, min};
use crate::spec::Search;
use crate::vectorize::Vectors;
use rayon::prelude::*;
use std::ops::Range;

/// With a skin s, lists grow in proportion to s and last for s/v evaluations if slack is used up at the rate v: the sum of both costs is
/// least at √(`THRIFT`·v), µm. Measured with the presets `paper` and `pig`.
const THRIFT: f32 = 60.0;
/// Least and greatest skin, µm, and the first one.
const SKINS: [f32; 2] = [5.0, 30.0];
const FIRST_SKIN: f32 = 10.0;
/// Least range over the greatest one for which lists are built: the less, the steeper the slack.
const LEAST_RANGE: f32 = 0.25;
/// Greatest change of the slack over a change of the distance: arithmetic over geometric mean of the two ranges.
const SLOPE: f32 = 1.25;
/// Segments in a cell of the search: eight blocks.
const CELL: usize = 8 * BLOCK;
/// Parts begin at multiples of this number of particles: of any group.
const GRAIN: usize = 16;

/// A run of particles processed by one thread, with the list of each group.
#[derive(Clone, Debug, Default)]
pub(super) struct Part {
    pub(super) particles: Range<usize>,
    /// Of each group the place in `list` of its first segment, of the first one after its own segments, and the end. Empty if
    /// all segments are visited.
    spans: Vec<[u32; 3]>,
    list: Vec<u32>,
    /// Positions and normals when the lists were built.
    built: [Vec<f32>; 4],
    /// Squares of the greatest displacement, and of the greatest change of a normal, since then.
    moved: f32,
    turned: f32,
}

/// The segments that begin or end at a particle of a group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Own {
    pub(super) run: Range<usize>,
    /// The last segment of the loop, if it ends at the first particle and does not belong to the run.
    pub(super) last: Option<usize>,
}

impl Own {
    #[inline(always)]
    pub(super) fn of(particles: &Range<usize>, n: usize) -> Self {
        let last = (particles.start == 0 && particles.end < n).then(|| n - 1);
        Self { run: particles.start.saturating_sub(1)..particles.end, last }
    }

    #[inline(always)]
    fn contains(&self, j: usize) -> bool {
        self.run.contains(&j) || self.last == Some(j)
    }
}

impl Part {
    /// Visits the segments near a group in ascending order, with whether they are its own ones. Plain loops, since adapters of
    /// iterators would not be compiled for wide vectors.
    #[inline(always)]
    pub(super) fn visit(&self, group: usize, own: &Own, n: usize, mut visit: impl FnMut(usize, bool)) {
        if self.spans.is_empty() {
            for j in 0..own.run.start {
                visit(j, false);
            }
            for j in own.run.clone() {
                visit(j, true);
            }
            for j in own.run.end..own.last.unwrap_or(n) {
                visit(j, false);
            }
        } else {
            let [first, after, end] = self.spans[group].map(|at| at as usize);
            for &j in &self.list[first..after] {
                visit(j as usize, false);
            }
            for j in own.run.clone() {
                visit(j, true);
            }
            for &j in &self.list[after..end] {
                visit(j as usize, false);
            }
        }
        if let Some(last) = own.last {
            visit(last, true);
        }
    }

    /// Notes how far the particles have moved to `next`.
    #[inline(always)]
    pub(super) fn follow(&mut self, next: &Stretch<'_>) {
        let n = self.particles.len();
        let [bx, by, bnx, bny] = self.built.each_ref().map(|v| &v[..]);
        if bx.len() != n {
            return;
        }
        let (x, y, nx, ny) = (&next.x[..n], &next.y[..n], &next.nx[..n], &next.ny[..n]);
        self.moved = greatest(n, |i| square([x[i] - bx[i], y[i] - by[i]]));
        // The normals of the first and the last particle are not known yet.
        self.turned = greatest(n.saturating_sub(2), |i| square([nx[i + 1] - bnx[i + 1], ny[i + 1] - bny[i + 1]]));
    }
}

#[inline(always)]
fn square([x, y]: [f32; 2]) -> f32 {
    x * x + y * y
}

/// Bounding box: least x, least y, greatest x, greatest y.
type Bounds = [f32; 4];

const NOTHING: Bounds = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY];

fn around(b: Bounds, [x, y]: [f32; 2]) -> Bounds {
    [min(b[0], x), min(b[1], y), max(b[2], x), max(b[3], y)]
}

/// Squared distance of two boxes.
#[inline(always)]
fn apart(a: Bounds, b: Bounds) -> f32 {
    let gap = |low: f32, high: f32, other_low: f32, other_high: f32| max(max(other_low - high, low - other_high), 0.0);
    square([gap(a[0], a[2], b[0], b[2]), gap(a[1], a[3], b[1], b[3])])
}

/// How far a particle of scale 1 sees: through tissue, across a gap; and what every particle sees at least, for clearances
/// and the barrier. All µm.
#[derive(Clone, Copy, Debug, Default)]
struct Sight {
    tissue: f32,
    gap: f32,
    least: f32,
}

impl Sight {
    fn at(row: &StepRow) -> Self {
        Self {
            tissue: row.range_mean - row.range_half,
            gap: row.range_mean + row.range_half,
            least: max(CLEARANCE_CAP, row.barrier_distance),
        }
    }

    /// Ranges of a particle through tissue and across a gap, at least `least` and [`LEAST_RANGE`].
    #[inline(always)]
    fn of(self, scale: f32) -> [f32; 2] {
        let [tissue, gap] = [max(scale * self.tissue, self.least), max(scale * self.gap, self.least)];
        [max(tissue, LEAST_RANGE * gap), max(gap, LEAST_RANGE * tissue)]
    }
}

/// The neighbour search, with its lists.
#[derive(Clone, Debug)]
pub(super) struct Neighbours {
    search: Search,
    vectors: Vectors,
    threads: usize,
    pub(super) parts: Vec<Part>,
    tables: Tables,
    built: Sight,
    /// Greatest scale of a particle.
    widest: f32,
    /// Distance by which lists reach beyond the ranges, µm, how much of it may have been used up, and by how many evaluations.
    skin: f32,
    used: f32,
    evaluations: u32,
    valid: bool,
    builds: u64,
}

impl Neighbours {
    pub(super) fn new(search: Search, vectors: Vectors, threads: usize) -> Self {
        Self {
            search,
            vectors,
            threads: threads.max(1),
            parts: Vec::new(),
            tables: Tables::default(),
            built: Sight::default(),
            widest: 1.0,
            skin: FIRST_SKIN,
            used: 0.0,
            evaluations: 0,
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

    /// Divides a loop of `n` particles into parts, and discards the lists.
    pub(super) fn divide(&mut self, n: usize) {
        // Several parts per thread, because folds make the work per particle uneven.
        let grains = n.div_ceil(GRAIN);
        let count = if self.threads == 1 { 1 } else { (self.threads * 4).min(grains) };
        self.parts.resize_with(count, Part::default);
        for (k, part) in self.parts.iter_mut().enumerate() {
            let (first, end) = (k * grains / count, (k + 1) * grains / count);
            part.particles = first * GRAIN..(end * GRAIN).min(n);
        }
        self.valid = false;
    }

    /// Rebuilds the lists if they are outdated for `chain`.
    pub(super) fn prepare(&mut self, chain: &Chain, scale: &[f32], row: &StepRow) {
        let keep = self.valid
            && match self.search {
                Search::Lists => {
                    self.used = self.used_up(chain, row);
                    self.evaluations += 1;
                    self.used <= self.skin - 0.01
                }
                Search::Grid => false,
                Search::AllPairs => true,
            };
        if !keep {
            self.build(chain, scale, row);
        }
    }

    /// By how much the slack between a particle and a segment may have shrunk since the lists were built.
    fn used_up(&self, chain: &Chain, row: &StepRow) -> f32 {
        let (mut moved, mut turned) = (0.0, 0.0);
        for part in &self.parts {
            moved = max(moved, part.moved);
            turned = max(turned, part.turned);
            let count = part.particles.len();
            for k in [0, count - 1] {
                let i = part.particles.start + k;
                turned = max(turned, square([chain.nx[i] - part.built[2][k], chain.ny[i] - part.built[3][k]]));
            }
        }
        let (built, now) = (self.built, Sight::at(row));
        let wider = max(max(now.tissue - built.tissue, now.gap - built.gap), 0.0);
        let widened = max(wider * self.widest, now.least - built.least);
        let [tissue, gap] = built.of(self.widest);
        let turning = 0.5 * (tissue - gap).abs() * turned.sqrt();
        SLOPE * 2.0 * moved.sqrt() + turning + widened
    }

    fn build(&mut self, chain: &Chain, scale: &[f32], row: &StepRow) {
        self.builds += 1;
        self.valid = true;
        self.built = Sight::at(row);
        self.widest = scale.iter().fold(1.0f32, |a, &b| max(a, b));
        if self.search == Search::AllPairs {
            return;
        }
        if self.evaluations > 0 {
            let rate = self.used / self.evaluations as f32;
            self.skin = min(max((THRIFT * rate).sqrt(), SKINS[0]), SKINS[1]);
        }
        (self.used, self.evaluations) = (0.0, 0);
        let (vectors, tables, skin) = (self.vectors, &mut self.tables, self.skin);
        vectors.run(
            #[inline(always)]
            || tables.fill(chain, skin),
        );
        let grid = (self.search == Search::Grid).then(|| Grid::new(tables));
        let built = Built { chain, scale, sight: self.built, tables, grid };
        each(self.parts.iter_mut(), |part| {
            vectors.run(
                #[inline(always)]
                || match vectors.lanes() {
                    16 => built.lists::<16>(part),
                    _ => built.lists::<8>(part),
                },
            );
        });
    }
}

/// Runs `work` on every item, in parallel.
pub(super) fn each<T: Send>(items: impl Iterator<Item = T>, work: impl Fn(T) + Sync + Send) {
    let items: Vec<T> = items.collect();
    if items.len() == 1 {
        items.into_iter().for_each(work);
    } else {
        items.into_par_iter().for_each(work);
    }
}

/// What the search reads of the segments.
#[derive(Clone, Debug, Default)]
struct Tables {
    /// Middle of each segment, and by how much the slack at its points may be less than there, plus the skin.
    x: Vec<f32>,
    y: Vec<f32>,
    margin: Vec<f32>,
    /// The same for blocks of segments.
    blocks: Vec<Round>,
    /// Box around the middles of the segments of each cell, and the greatest of their margins.
    cells: Vec<(Bounds, f32)>,
}

/// A place and the margin around it.
#[derive(Clone, Copy, Debug)]
struct Round {
    x: f32,
    y: f32,
    margin: f32,
}

impl Tables {
    #[inline(always)]
    fn fill(&mut self, chain: &Chain, skin: f32) {
        let n = chain.len();
        for v in [&mut self.x, &mut self.y, &mut self.margin] {
            v.resize(n, 0.0);
        }
        let (x, y, margin) = (&mut self.x[..n], &mut self.y[..n], &mut self.margin[..n]);
        let (ax, ay) = (&chain.x[1..n + 2], &chain.y[1..n + 2]);
        for j in 0..n {
            let (dx, dy) = (ax[j + 1] - ax[j], ay[j + 1] - ay[j]);
            x[j] = ax[j] + 0.5 * dx;
            y[j] = ay[j] + 0.5 * dy;
            margin[j] = skin + 0.5 * SLOPE * (dx * dx + dy * dy).sqrt();
        }
        let boxed = |first: usize, size: usize| {
            (first..(first + size).min(n))
                .fold((NOTHING, 0.0f32), |(b, m), j| (around(b, [x[j], y[j]]), max(m, margin[j])))
        };
        self.blocks.clear();
        self.blocks.extend((0..n).step_by(BLOCK).map(|first| {
            let (b, margin) = boxed(first, BLOCK);
            let radius = 0.5 * square([b[2] - b[0], b[3] - b[1]]).sqrt();
            Round { x: 0.5 * (b[0] + b[2]), y: 0.5 * (b[1] + b[3]), margin: margin + SLOPE * radius }
        }));
        self.cells.clear();
        self.cells.extend((0..n).step_by(CELL).map(|first| boxed(first, CELL)));
    }
}

/// How far the particles of a group see.
struct Seen<const G: usize> {
    x: [f32; G],
    y: [f32; G],
    mean: [f32; G],
    side_x: [f32; G],
    side_y: [f32; G],
}

impl<const G: usize> Seen<G> {
    /// Whether a place is in sight of one of the particles, or at most `margin` beyond.
    #[inline(always)]
    fn has(&self, place: Round) -> bool {
        let mut any = false;
        for l in 0..G {
            let (qx, qy) = (self.x[l] - place.x, self.y[l] - place.y);
            let square = qx * qx + qy * qy;
            // |q| ≤ D + margin, squared: D = mean + side·q/|q|.
            let ahead = max(square - (self.side_x[l] * qx + self.side_y[l] * qy), 0.0);
            let reach = self.mean[l] + place.margin;
            any |= ahead * ahead <= reach * reach * square;
        }
        any
    }
}

/// Inputs of the lists.
struct Built<'a> {
    chain: &'a Chain,
    scale: &'a [f32],
    sight: Sight,
    tables: &'a Tables,
    grid: Option<Grid>,
}

impl Built<'_> {
    #[inline(always)]
    fn lists<const G: usize>(&self, part: &mut Part) {
        let n = self.chain.len();
        part.spans.clear();
        part.list.clear();
        let mut cells: Vec<u32> = Vec::new();
        let mut first = part.particles.start;
        while first < part.particles.end {
            let end = (first + CELL).min(part.particles.end);
            self.near(first..end, &mut cells);
            while first < end {
                let group = first..(first + G).min(end);
                self.list::<G>(&group, n, &cells, part);
                first = group.end;
            }
        }
        let own = part.particles.clone();
        let places = own.start + 1..own.end + 1;
        let now =
            [&self.chain.x[places.clone()], &self.chain.y[places], &self.chain.nx[own.clone()], &self.chain.ny[own]];
        for (built, now) in part.built.iter_mut().zip(now) {
            built.clear();
            built.extend_from_slice(now);
        }
        (part.moved, part.turned) = (0.0, 0.0);
    }

    /// The cells, ascending, in which particles of a run may see something.
    fn near(&self, run: Range<usize>, cells: &mut Vec<u32>) {
        let (mut bounds, mut reach) = (NOTHING, 0.0f32);
        for i in run {
            let [tissue, gap] = self.sight.of(self.scale[i]);
            bounds = around(bounds, [self.chain.x[i + 1], self.chain.y[i + 1]]);
            reach = max(reach, max(tissue, gap));
        }
        cells.clear();
        let sees = |&k: &u32| {
            let (cell, margin) = self.tables.cells[k as usize];
            let reach = reach + margin;
            apart(bounds, cell) <= reach * reach
        };
        match &self.grid {
            Some(grid) => {
                grid.cells_within(bounds, reach, cells);
                cells.retain(sees);
            }
            None => cells.extend((0..self.tables.cells.len() as u32).filter(sees)),
        }
    }

    /// Appends the list of a group.
    #[inline(always)]
    fn list<const G: usize>(&self, group: &Range<usize>, n: usize, cells: &[u32], part: &mut Part) {
        let seen = self.seen::<G>(group);
        let own = Own::of(group, n);
        let Tables { x, y, margin, blocks, .. } = self.tables;
        let (x, y, margin) = (&x[..n], &y[..n], &margin[..n]);
        let start = part.list.len() as u32;
        let mut after = start;
        for &cell in cells {
            let first = cell as usize * (CELL / BLOCK);
            for (b, &block) in (first..).zip(&blocks[first..(first + CELL / BLOCK).min(blocks.len())]) {
                if !seen.has(block) {
                    continue;
                }
                for j in b * BLOCK..(b * BLOCK + BLOCK).min(n) {
                    if !own.contains(j) && seen.has(Round { x: x[j], y: y[j], margin: margin[j] }) {
                        part.list.push(j as u32);
                        after += u32::from(j < own.run.start);
                    }
                }
            }
        }
        part.spans.push([start, after, part.list.len() as u32]);
    }

    #[inline(always)]
    fn seen<const G: usize>(&self, group: &Range<usize>) -> Seen<G> {
        let mut seen = Seen { x: [FAR; G], y: [FAR; G], mean: [0.0; G], side_x: [0.0; G], side_y: [0.0; G] };
        for (l, i) in group.clone().enumerate() {
            let [tissue, gap] = self.sight.of(self.scale[i]);
            let half = 0.5 * (gap - tissue);
            (seen.x[l], seen.y[l]) = (self.chain.x[i + 1], self.chain.y[i + 1]);
            seen.mean[l] = 0.5 * (gap + tissue);
            (seen.side_x[l], seen.side_y[l]) = (-half * self.chain.nx[i], -half * self.chain.ny[i]);
        }
        seen
    }
}

/// A uniform grid over the boxes of the cells of segments.
#[derive(Debug)]
struct Grid {
    origin: [f32; 2],
    side: f32,
    size: [usize; 2],
    squares: Vec<Vec<u32>>,
    /// The greatest margin of a segment.
    margin: f32,
}

impl Grid {
    /// Least side of a square, µm.
    const SIDE: f32 = 96.0;
    /// Most squares per cell: strands that lie far apart make squares larger instead of more numerous.
    const SPARSE: f32 = 4.0;

    fn new(tables: &Tables) -> Self {
        let cells = &tables.cells;
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

    /// The squares that a box meets.
    fn visited(&self, b: Bounds) -> impl Iterator<Item = usize> + use<> {
        let (origin, side, size) = (self.origin, self.side, self.size);
        let at = move |axis: usize, v: f32| (((v - origin[axis]) / side).max(0.0) as usize).min(size[axis] - 1);
        (at(1, b[1])..=at(1, b[3]))
            .flat_map(move |row| (at(0, b[0])..=at(0, b[2])).map(move |column| row * size[0] + column))
    }

    /// The cells, ascending, that may be within `reach` of a box.
    fn cells_within(&self, b: Bounds, reach: f32, cells: &mut Vec<u32>) {
        let reach = reach + self.margin;
        for square in self.visited([b[0] - reach, b[1] - reach, b[2] + reach, b[3] + reach]) {
            cells.extend_from_slice(&self.squares[square]);
        }
        cells.sort_unstable();
        cells.dedup();
    }
}
