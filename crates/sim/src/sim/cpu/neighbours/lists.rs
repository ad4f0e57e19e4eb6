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

/// Lists of the groups of a part.
#[derive(Clone, Debug, Default)]
pub(in crate::sim::cpu) struct Groups {
    /// For each group, three indices into `list`: of its first segment, of the first segment after
    /// its own ones, and of the end. Empty if all segments are visited.
    spans: Vec<[u32; 3]>,
    list: Vec<u32>,
    /// Groups whose lists are valid for the present evaluation only, with the spans of their
    /// previous lists; and the end of the previous lists.
    mended: Vec<(usize, [u32; 3])>,
    end: usize,
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

    /// Restores the lists that were built for all groups together.
    pub(super) fn settle(&mut self) {
        for (group, span) in self.mended.drain(..) {
            self.spans[group] = span;
            self.list.truncate(self.end);
        }
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
#[derive(Clone, Copy, Debug)]
struct Disc {
    x: f32,
    y: f32,
    margin: f32,
}

impl Tables {
    #[inline(always)]
    pub(super) fn fill(&mut self, chain: &Chain, skin: f32) {
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
        self.blocks.clear();
        self.cells.clear();
        for first in (0..n).step_by(CELL) {
            let segments = first..(first + CELL).min(n);
            let mut cell = (NOTHING, 0.0f32);
            for first in segments.clone().step_by(BLOCK) {
                let (mut b, mut widest) = (NOTHING, 0.0f32);
                for j in first..(first + BLOCK).min(segments.end) {
                    b = around(b, [x[j], y[j]]);
                    widest = max(widest, margin[j]);
                }
                let (width, height) = (b[2] - b[0], b[3] - b[1]);
                let radius = 0.5 * (width * width + height * height).sqrt();
                let margin = widest + SLOPE * radius;
                self.blocks.push(Disc { x: 0.5 * (b[0] + b[2]), y: 0.5 * (b[1] + b[3]), margin });
                cell = (around(around(cell.0, [b[0], b[1]]), [b[2], b[3]]), max(cell.1, widest));
            }
            self.cells.push(cell);
        }
        self.tracts.clear();
        self.tracts.extend(self.cells.chunks(TRACT).map(|cells| {
            cells.iter().fold((NOTHING, 0.0f32), |(b, m), (cell, margin)| {
                (around(around(b, [cell[0], cell[1]]), [cell[2], cell[3]]), max(m, *margin))
            })
        }));
    }
}

impl Tables {
    /// Restless particles, none of which is seen from farther than `sight`.
    pub(super) fn restless(&self, particles: Vec<usize>, sight: f32) -> Restless {
        let Self { x, y, margin, cells, tracts, .. } = self;
        let n = x.len();
        let ends = particles.iter().flat_map(|&i| [(i + n - 1) % n, i]);
        let segments: Vec<Disc> = ends.map(|j| Disc { x: x[j], y: y[j], margin: margin[j] }).collect();
        let seen_from = |(bounds, margin): &(Bounds, f32), segments: &[Disc]| -> Vec<Disc> {
            let is_near = |segment: &&Disc| {
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

impl Restless {
    /// True if the particles may be seen from at most one cell in `share`.
    pub(super) fn are_few(&self, share: usize) -> bool {
        self.near.iter().filter(|near| !near.is_empty()).count() * share <= self.near.len()
    }
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
    pub(super) chain: &'a Chain,
    pub(super) sight: Sight,
    pub(super) tables: &'a Tables,
    pub(super) grid: Option<Grid>,
}

/// Restless particles in ascending order. For each cell, the segments that begin or end at a
/// restless particle and may be seen from the cell.
pub(super) struct Restless {
    particles: Vec<usize>,
    near: Vec<Vec<Disc>>,
}

impl Lists<'_> {
    /// Builds the lists of the groups of these particles, which have these scales.
    #[inline(always)]
    pub(super) fn build<S: Simd>(&self, simd: S, particles: &Range<usize>, scale: &[f32], groups: &mut Groups) {
        groups.spans.clear();
        groups.list.clear();
        groups.mended.clear();
        let scale = |some: &Range<usize>| &scale[some.start - particles.start..some.end - particles.start];
        let mut cells: Vec<u32> = Vec::new();
        for first in particles.clone().step_by(CELL) {
            let run = first..(first + CELL).min(particles.end);
            self.near(&run, scale(&run), &mut cells);
            for first in run.clone().step_by(S::F32_LANES) {
                let group = first..(first + S::F32_LANES).min(run.end);
                let span = self.list(&self.seen(simd, &group, scale(&group)), &group, &cells, &mut groups.list);
                groups.spans.push(span);
            }
        }
        groups.end = groups.list.len();
    }

    /// Rebuilds the lists of groups that have restless particles or see their segments.
    #[inline(always)]
    pub(super) fn mend<S: Simd>(
        &self,
        simd: S,
        particles: &Range<usize>,
        scale: &[f32],
        restless: &Restless,
        groups: &mut Groups,
    ) {
        let mut cells = Vec::new();
        for (number, first) in particles.clone().step_by(S::F32_LANES).enumerate() {
            let near = &restless.near[first / CELL];
            if near.is_empty() {
                continue;
            }
            let group = first..(first + S::F32_LANES).min(particles.end);
            let scale = &scale[first - particles.start..group.end - particles.start];
            let seen = self.seen(simd, &group, scale);
            let next = restless.particles.partition_point(|&i| i < group.start);
            let mut is_concerned = restless.particles.get(next).is_some_and(|&i| i < group.end);
            for &segment in near {
                is_concerned = is_concerned || seen.has(segment);
            }
            if is_concerned {
                self.near(&group, scale, &mut cells);
                groups.mended.push((number, groups.spans[number]));
                groups.spans[number] = self.list(&seen, &group, &cells, &mut groups.list);
            }
        }
    }

    /// Collects the cells in which particles of a run may see a segment, in ascending order.
    fn near(&self, run: &Range<usize>, scale: &[f32], cells: &mut Vec<u32>) {
        let (mut bounds, mut reach) = (NOTHING, 0.0f32);
        for (i, &scale) in run.clone().zip(scale) {
            let [tissue, gap] = self.sight.of(scale);
            bounds = around(bounds, [self.chain.x[i + 1], self.chain.y[i + 1]]);
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
    #[inline(always)]
    fn list<S: Simd>(
        &self,
        seen: &GroupSight<S>,
        group: &Range<usize>,
        cells: &[u32],
        list: &mut Vec<u32>,
    ) -> [u32; 3] {
        let n = self.chain.len();
        let own = OwnSegments::new(group, n);
        let Tables { x, y, margin, blocks, .. } = self.tables;
        let (x, y, margin) = (&x[..n], &y[..n], &margin[..n]);
        let start = list.len() as u32;
        let mut after = start;
        for &cell in cells {
            let first = cell as usize * (CELL / BLOCK);
            for (b, &block) in (first..).zip(&blocks[first..(first + CELL / BLOCK).min(blocks.len())]) {
                if !seen.has(block) {
                    continue;
                }
                for j in b * BLOCK..(b * BLOCK + BLOCK).min(n) {
                    if !own.contains(j) && seen.has(Disc { x: x[j], y: y[j], margin: margin[j] }) {
                        list.push(j as u32);
                        after += u32::from(j < own.run.start);
                    }
                }
            }
        }
        [start, after, list.len() as u32]
    }

    #[inline(always)]
    fn seen<S: Simd>(&self, simd: S, group: &Range<usize>, scale: &[f32]) -> GroupSight<S> {
        let (mut x, mut y, mut mean) = ([FAR; MOST], [FAR; MOST], [0.0; MOST]);
        let (mut side_x, mut side_y) = ([0.0; MOST], [0.0; MOST]);
        for ((l, i), &scale) in group.clone().enumerate().zip(scale) {
            let [tissue, gap] = self.sight.of(scale);
            let half = 0.5 * (gap - tissue);
            (x[l], y[l]) = (self.chain.x[i + 1], self.chain.y[i + 1]);
            mean[l] = 0.5 * (gap + tissue);
            (side_x[l], side_y[l]) = (-half * self.chain.nx[i], -half * self.chain.ny[i]);
        }
        let of = |numbers: [f32; MOST]| Lanes::of(simd, &numbers);
        GroupSight { simd, x: of(x), y: of(y), mean: of(mean), side_x: of(side_x), side_y: of(side_y) }
    }
}
