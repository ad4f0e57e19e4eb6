//! Neighbour lists of a part: segments that the particles of a group may interact with.

use super::grid::{Bounds, Grid, NOTHING, apart, around};
use crate::sim::cpu::chain::{BLOCK, Chain};
use crate::sim::cpu::pairs::{CLEARANCE_CAP, FAR, MOST};
use crate::sim::layout::StepRow;
use crate::sim::maths::max;
use crate::vectorize::{Lanes, Simd};
use std::ops::Range;

/// Maximum change of the slack per change of the distance: arithmetic divided by geometric mean of
/// the two ranges.
pub(super) const SLOPE: f32 = 1.25;
/// Minimum range, in units of the maximum range, for which lists are built. The smaller the
/// quotient of both, the steeper the slack.
const LEAST_RANGE: f32 = 0.25;
/// Number of segments in a cell of the search: eight blocks.
const CELL: usize = 8 * BLOCK;
/// Number of cells in a tract.
const TRACT: usize = 16;

/// Reference positions and normals of the particles of a part.
#[derive(Clone, Debug, Default)]
pub(in crate::sim::cpu) struct References {
    pub(super) x: Vec<f32>,
    pub(super) y: Vec<f32>,
    pub(super) nx: Vec<f32>,
    pub(super) ny: Vec<f32>,
}

impl References {
    /// Takes over the positions and normals of these particles.
    pub(super) fn take(&mut self, chain: &Chain, own: &Range<usize>) {
        let places = own.start + 1..own.end + 1;
        let now = [&chain.x[places.clone()], &chain.y[places], &chain.nx[own.clone()], &chain.ny[own.clone()]];
        for (reference, now) in [&mut self.x, &mut self.y, &mut self.nx, &mut self.ny].into_iter().zip(now) {
            reference.clear();
            reference.extend_from_slice(now);
        }
    }

    /// Squares of the displacement of particle `k` of the part, which is particle `i` of the loop,
    /// and of the change of its normal.
    #[inline(always)]
    pub(super) fn changes(&self, k: usize, chain: &Chain, i: usize) -> [f32; 2] {
        [
            square([chain.x[i + 1] - self.x[k], chain.y[i + 1] - self.y[k]]),
            square([chain.nx[i] - self.nx[k], chain.ny[i] - self.ny[k]]),
        ]
    }
}

#[inline(always)]
pub(super) fn square([x, y]: [f32; 2]) -> f32 {
    x * x + y * y
}

/// Lists of the groups of a part.
#[derive(Clone, Debug, Default)]
pub(in crate::sim::cpu) struct Groups {
    /// For each group, three indices into `list`: of its first segment, of the first segment after
    /// its own ones, and of the end. Empty if all segments are visited.
    spans: Vec<[u32; 3]>,
    list: Vec<u32>,
    /// Maximum length of `list`, from which it is compacted.
    most: usize,
}

impl Groups {
    /// Visits the segments near a group in ascending order, with true for segments of the group.
    /// Uses plain loops, because the compiler would not vectorize iterator adapters.
    #[inline(always)]
    pub(in crate::sim::cpu) fn visit(
        &self,
        group: usize,
        own: &OwnSegments,
        n: usize,
        mut visit: impl FnMut(usize, bool),
    ) {
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

    /// True if the list of a group contains a segment that is not its own.
    fn contain(&self, group: usize, segment: u32) -> bool {
        let [first, _, end] = self.spans[group].map(|at| at as usize);
        self.list[first..end].binary_search(&segment).is_ok()
    }

    /// Removes lists that are no longer used, if they take much memory.
    fn compact(&mut self) {
        if self.list.len() <= self.most {
            return;
        }
        let mut list = Vec::with_capacity(self.list.len());
        for span in &mut self.spans {
            let (from, start) = (span[0], list.len() as u32);
            list.extend_from_slice(&self.list[from as usize..span[2] as usize]);
            *span = span.map(|at| at - from + start);
        }
        self.most = 2 * list.len();
        self.list = list;
    }
}

/// Segments that begin or end at a particle of a group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::sim::cpu) struct OwnSegments {
    pub(in crate::sim::cpu) run: Range<usize>,
    /// Last segment of the loop, if it ends at the first particle and does not belong to the run.
    pub(in crate::sim::cpu) last: Option<usize>,
}

impl OwnSegments {
    #[inline(always)]
    pub(in crate::sim::cpu) fn new(particles: &Range<usize>, n: usize) -> Self {
        let last = (particles.start == 0 && particles.end < n).then(|| n - 1);
        Self { run: particles.start.saturating_sub(1)..particles.end, last }
    }

    #[inline(always)]
    fn contains(&self, j: usize) -> bool {
        self.run.contains(&j) || self.last == Some(j)
    }
}

/// Ranges of a particle of scale 1, µm: through tissue, across a gap, and the minimum range of
/// every particle for clearances and the barrier.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sight {
    pub(super) tissue: f32,
    pub(super) gap: f32,
    pub(super) least: f32,
}

impl Sight {
    pub(super) fn at(row: &StepRow) -> Self {
        Self {
            tissue: row.range_mean - row.range_half,
            gap: row.range_mean + row.range_half,
            least: max(CLEARANCE_CAP, row.barrier_distance),
        }
    }

    /// Ranges of a particle through tissue and across a gap. Both are at least `least`, and at
    /// least [`LEAST_RANGE`] of the other.
    #[inline(always)]
    pub(super) fn of(self, scale: f32) -> [f32; 2] {
        let [tissue, gap] = [max(scale * self.tissue, self.least), max(scale * self.gap, self.least)];
        [max(tissue, LEAST_RANGE * gap), max(gap, LEAST_RANGE * tissue)]
    }
}

/// Tables of segments for the search.
#[derive(Clone, Debug, Default)]
pub(super) struct Tables {
    /// Midpoint of each segment. The margin is the maximum decrease of the slack from the midpoint
    /// to another point of the segment, plus the skin.
    x: Vec<f32>,
    y: Vec<f32>,
    margin: Vec<f32>,
    /// Midpoints and margins of blocks of segments.
    blocks: Vec<Disc>,
    /// Box around the midpoints of the segments of each cell, and maximum of their margins.
    pub(super) cells: Vec<(Bounds, f32)>,
    /// Boxes and margins of tracts of cells.
    tracts: Vec<(Bounds, f32)>,
}

/// A point and the margin around it.
#[derive(Clone, Copy, Debug, Default)]
struct Disc {
    x: f32,
    y: f32,
    margin: f32,
}

impl Tables {
    /// Fills the tables for the present positions.
    #[inline(always)]
    pub(super) fn fill(&mut self, chain: &Chain, skin: f32) {
        let n = chain.len();
        for v in [&mut self.x, &mut self.y, &mut self.margin] {
            v.resize(n, 0.0);
        }
        let (x, y, margin) = (&mut self.x[..n], &mut self.y[..n], &mut self.margin[..n]);
        let (ax, ay) = (&chain.x[1..n + 2], &chain.y[1..n + 2]);
        for j in 0..n {
            (x[j], y[j], margin[j]) = segment([ax[j], ay[j]], [ax[j + 1], ay[j + 1]], skin);
        }
        self.blocks.clear();
        self.blocks.resize(n.div_ceil(BLOCK), Disc::default());
        self.cells.clear();
        self.cells.resize(n.div_ceil(CELL), (NOTHING, 0.0));
        for cell in 0..self.cells.len() {
            self.join(cell);
        }
        self.join_cells();
    }

    /// Moves a segment to these ends. [`Tables::join`] must follow.
    pub(super) fn place(&mut self, j: usize, [a, b]: [[f32; 2]; 2], skin: f32) {
        (self.x[j], self.y[j], self.margin[j]) = segment(a, b, skin);
    }

    /// Computes the blocks of a cell, and the cell.
    #[inline(always)]
    fn join(&mut self, cell: usize) {
        let Self { x, y, margin, blocks, cells, .. } = self;
        let segments = cell * CELL..((cell + 1) * CELL).min(x.len());
        let mut joined = (NOTHING, 0.0f32);
        for first in segments.clone().step_by(BLOCK) {
            let (mut b, mut widest) = (NOTHING, 0.0f32);
            for j in first..(first + BLOCK).min(segments.end) {
                b = around(b, [x[j], y[j]]);
                widest = max(widest, margin[j]);
            }
            let (width, height) = (b[2] - b[0], b[3] - b[1]);
            let radius = 0.5 * (width * width + height * height).sqrt();
            let margin = widest + SLOPE * radius;
            blocks[first / BLOCK] = Disc { x: 0.5 * (b[0] + b[2]), y: 0.5 * (b[1] + b[3]), margin };
            joined = (around(around(joined.0, [b[0], b[1]]), [b[2], b[3]]), max(joined.1, widest));
        }
        cells[cell] = joined;
    }

    /// Computes the tracts.
    fn join_cells(&mut self) {
        self.tracts.clear();
        self.tracts.extend(self.cells.chunks(TRACT).map(|cells| {
            cells.iter().fold((NOTHING, 0.0f32), |(b, m), (cell, margin)| {
                (around(around(b, [cell[0], cell[1]]), [cell[2], cell[3]]), max(m, *margin))
            })
        }));
    }

    /// Restless particles, after their `segments` have been placed. No particle sees a segment that
    /// is farther than `sight`.
    pub(super) fn restless(&mut self, particles: Vec<usize>, segments: &[usize], sight: f32) -> Restless {
        for touched in segments.chunk_by(|a, b| a / CELL == b / CELL) {
            self.join(touched[0] / CELL);
        }
        self.join_cells();
        let Self { x, y, margin, cells, tracts, .. } = &*self;
        let disc = |&j: &usize| (j as u32, Disc { x: x[j], y: y[j], margin: margin[j] });
        let segments: Vec<(u32, Disc)> = segments.iter().map(disc).collect();
        let seen_from = |(bounds, margin): &(Bounds, f32), segments: &[(u32, Disc)]| -> Vec<(u32, Disc)> {
            let is_near = |(_, segment): &&(u32, Disc)| {
                let reach = sight + margin + segment.margin;
                apart(*bounds, around(NOTHING, [segment.x, segment.y])) <= reach * reach
            };
            segments.iter().filter(is_near).copied().collect()
        };
        let near = tracts.iter().zip(cells.chunks(TRACT)).flat_map(|(tract, cells)| {
            let segments = seen_from(tract, &segments);
            cells.iter().map(move |cell| seen_from(cell, &segments))
        });
        let near = near.collect();
        Restless { particles, near }
    }
}

/// Midpoint and margin of a segment between two points.
#[inline(always)]
fn segment([ax, ay]: [f32; 2], [bx, by]: [f32; 2], skin: f32) -> (f32, f32, f32) {
    let (dx, dy) = (bx - ax, by - ay);
    (ax + 0.5 * dx, ay + 0.5 * dy, skin + 0.5 * SLOPE * (dx * dx + dy * dy).sqrt())
}

/// Ranges of the particles of a group.
struct GroupSight<S: Simd> {
    simd: S,
    x: Lanes<S>,
    y: Lanes<S>,
    mean: Lanes<S>,
    side_x: Lanes<S>,
    side_y: Lanes<S>,
}

impl<S: Simd> GroupSight<S> {
    /// True if a disc is in sight of one of the particles.
    #[inline(always)]
    fn has(&self, place: Disc) -> bool {
        let all = |number| Lanes::all(self.simd, number);
        let (qx, qy) = (self.x - all(place.x), self.y - all(place.y));
        let square = qx * qx + qy * qy;
        // |q| ≤ D + margin, squared: D = mean + side·q/|q|.
        let ahead = (square - (self.side_x * qx + self.side_y * qy)).max(all(0.0));
        let reach = self.mean + all(place.margin);
        (ahead * ahead).any_at_most(reach * reach * square)
    }
}

/// Search for the segments that groups may see.
pub(super) struct Lists<'a> {
    pub(super) sight: Sight,
    pub(super) tables: &'a Tables,
    pub(super) grid: Option<Grid>,
}

/// Restless particles in ascending order. For each cell, the segments that begin or end at a
/// restless particle and may be seen from the cell.
pub(super) struct Restless {
    particles: Vec<usize>,
    near: Vec<Vec<(u32, Disc)>>,
}

/// Buffers of the search: cells in which the particles of a run may see a segment, blocks that a
/// group sees, and segments that it sees. Only the cells end with the vector.
#[derive(Default)]
struct Found {
    cells: Vec<u32>,
    blocks: Vec<u32>,
    segments: Vec<u32>,
}

/// Extends a buffer to at least `least` entries.
fn extend(buffer: &mut Vec<u32>, least: usize) {
    if buffer.len() < least {
        buffer.resize(least, 0);
    }
}

/// Particles of a part whose lists are built.
#[derive(Clone, Copy)]
pub(super) struct OwnParticles<'a> {
    pub(super) range: &'a Range<usize>,
    pub(super) references: &'a References,
    pub(super) scale: &'a [f32],
    /// Number of particles of the loop.
    pub(super) n: usize,
}

impl OwnParticles<'_> {
    /// Index, in the part, of a range of particles.
    fn local(&self, some: &Range<usize>) -> Range<usize> {
        some.start - self.range.start..some.end - self.range.start
    }
}

impl Lists<'_> {
    /// Builds the lists of all groups of a part.
    #[inline(always)]
    pub(super) fn build<S: Simd>(&self, simd: S, own: OwnParticles<'_>, groups: &mut Groups) {
        groups.spans.clear();
        groups.list.clear();
        let mut found = Found::default();
        for first in own.range.clone().step_by(CELL) {
            let run = first..(first + CELL).min(own.range.end);
            self.near(own, &run, &mut found.cells);
            for first in run.clone().step_by(S::F32_LANES) {
                let group = first..(first + S::F32_LANES).min(run.end);
                let span = self.list(own.n, &self.seen(simd, own, &group), &group, &mut found, &mut groups.list);
                groups.spans.push(span);
            }
        }
        groups.most = 2 * groups.list.len();
    }

    /// Rebuilds the lists of groups that have restless particles or lack one of their segments.
    #[inline(always)]
    pub(super) fn mend<S: Simd>(&self, simd: S, own: OwnParticles<'_>, restless: &Restless, groups: &mut Groups) {
        let mut found = Found::default();
        for (number, first) in own.range.clone().step_by(S::F32_LANES).enumerate() {
            let near = &restless.near[first / CELL];
            if near.is_empty() {
                continue;
            }
            let group = first..(first + S::F32_LANES).min(own.range.end);
            let seen = self.seen(simd, own, &group);
            let next = restless.particles.partition_point(|&i| i < group.start);
            let mut is_outdated = restless.particles.get(next).is_some_and(|&i| i < group.end);
            if !is_outdated {
                let segments = OwnSegments::new(&group, own.n);
                let lacks = |&(j, segment): &(u32, Disc)| {
                    seen.has(segment) && !segments.contains(j as usize) && !groups.contain(number, j)
                };
                is_outdated = near.iter().any(lacks);
            }
            if is_outdated {
                self.near(own, &group, &mut found.cells);
                groups.spans[number] = self.list(own.n, &seen, &group, &mut found, &mut groups.list);
            }
        }
        groups.compact();
    }

    /// Collects the cells in which particles of a run may see a segment, in ascending order.
    fn near(&self, own: OwnParticles<'_>, run: &Range<usize>, cells: &mut Vec<u32>) {
        let (mut bounds, mut reach) = (NOTHING, 0.0f32);
        for k in own.local(run) {
            let [tissue, gap] = self.sight.of(own.scale[k]);
            bounds = around(bounds, [own.references.x[k], own.references.y[k]]);
            reach = max(reach, max(tissue, gap));
        }
        cells.clear();
        let sees = |(other, margin): &(Bounds, f32)| {
            let reach = reach + margin;
            apart(bounds, *other) <= reach * reach
        };
        let Tables { cells: all, tracts, .. } = self.tables;
        match &self.grid {
            Some(grid) => {
                grid.cells_within(bounds, reach, cells);
                cells.retain(|&k| sees(&all[k as usize]));
            }
            None => {
                for ((tract, first), others) in tracts.iter().zip((0..).step_by(TRACT)).zip(all.chunks(TRACT)) {
                    if sees(tract) {
                        cells.extend((first..).zip(others).filter_map(|(k, other)| sees(other).then_some(k)));
                    }
                }
            }
        }
    }

    /// Appends the list of a group. Returns its span.
    ///
    /// The loops write every candidate, and count those that are seen: a branch on what is seen
    /// would often be mispredicted. They call no function, not even to grow a vector, because calls
    /// preserve no vector registers.
    #[inline(always)]
    fn list<S: Simd>(
        &self,
        n: usize,
        seen: &GroupSight<S>,
        group: &Range<usize>,
        found: &mut Found,
        list: &mut Vec<u32>,
    ) -> [u32; 3] {
        let Tables { x, y, margin, blocks, .. } = self.tables;
        let Found { cells, blocks: seen_blocks, segments } = found;
        extend(seen_blocks, cells.len() * (CELL / BLOCK));
        let mut count = 0;
        for &cell in &*cells {
            let first = cell as usize * (CELL / BLOCK);
            for (b, &block) in (first..).zip(&blocks[first..(first + CELL / BLOCK).min(blocks.len())]) {
                seen_blocks[count] = b as u32;
                count += usize::from(seen.has(block));
            }
        }
        let seen_blocks = &seen_blocks[..count];
        extend(segments, count * BLOCK);
        let mut count = 0;
        for &b in seen_blocks {
            let run = b as usize * BLOCK..(b as usize * BLOCK + BLOCK).min(n);
            let places = x[run.clone()].iter().zip(&y[run.clone()]).zip(&margin[run.clone()]);
            for (j, ((&x, &y), &margin)) in run.zip(places) {
                segments[count] = j as u32;
                count += usize::from(seen.has(Disc { x, y, margin }));
            }
        }
        let segments = &segments[..count];
        let own = OwnSegments::new(group, n);
        let [first, after] = [own.run.start, own.run.end].map(|j| segments.partition_point(|&i| (i as usize) < j));
        let end = own.last.map_or(count, |j| segments.partition_point(|&i| (i as usize) < j));
        let start = list.len();
        list.extend_from_slice(&segments[..first]);
        list.extend_from_slice(&segments[after..end]);
        [start, start + first, list.len()].map(|at| at as u32)
    }

    #[inline(always)]
    fn seen<S: Simd>(&self, simd: S, own: OwnParticles<'_>, group: &Range<usize>) -> GroupSight<S> {
        let (mut x, mut y, mut mean) = ([FAR; MOST], [FAR; MOST], [0.0; MOST]);
        let (mut side_x, mut side_y) = ([0.0; MOST], [0.0; MOST]);
        for (l, k) in own.local(group).enumerate() {
            let [tissue, gap] = self.sight.of(own.scale[k]);
            let half = 0.5 * (gap - tissue);
            let References { x: rx, y: ry, nx, ny } = own.references;
            (x[l], y[l]) = (rx[k], ry[k]);
            mean[l] = 0.5 * (gap + tissue);
            (side_x[l], side_y[l]) = (-half * nx[k], -half * ny[k]);
        }
        let of = |numbers: [f32; MOST]| Lanes::of(simd, &numbers);
        GroupSight { simd, x: of(x), y: of(y), mean: of(mean), side_x: of(side_x), side_y: of(side_y) }
    }
}
