//! Growth: edges are split at their midpoint. Both halves get half of the rest length, so the
//! contour is unchanged; the growth of the rest lengths then buckles it (paper, section 3: "the
//! number of particles also increases").
//!
//! Stratified tournaments decide which edges are split. The loop is divided into as many runs as
//! there are splits to make. The runs have equal length or equal weight ([`Weights`]). Each run has
//! one winner, and no edge wins twice.

use super::clefts::mean_anchor;
use super::variety::{Around, HEAVIEST, WEIGHT};
use crate::random::{self, Stream};
use crate::sim::layout::StepRow;
use crate::sim::plan::Plan;
use crate::sim::state::{InnerLoop, OuterLoop, contortion_sign};

/// Minimum clearance for a split, in units of the minimum clearance of the guard. A split without
/// this clearance is deferred.
pub(super) const ROOM: f32 = 40.0;
/// Span of the curvature at a fold tip, in particles.
pub(super) const SPAN: usize = 3;

/// Splits edges of the inner loop up to the target of the row. `clearance` contains the clearance
/// of each particle at the last step; an empty slice means unknown. Returns the number of deferred
/// splits.
pub(super) fn grow_inner(plan: &Plan, time: i64, row: &StepRow, s: &mut InnerLoop, clearance: &[f32]) -> u32 {
    let n = s.len();
    let wanted = (row.inner_target as usize).saturating_sub(n).min(n);
    if wanted == 0 {
        return 0;
    }
    let event = (time / i64::from(plan.grow_every)) as u32;
    let mut winners = Vec::with_capacity(wanted);
    let runs = Runs::new(plan, time, s, wanted);
    for run in 0..wanted {
        let (first, end) = (runs.first(run), runs.first(run + 1));
        if first == end {
            continue;
        }
        let mut best: Option<(f32, usize)> = None;
        for c in 0..plan.candidates {
            let word = random::word(plan.seed, Stream::Growth, event, run as u32 * plan.candidates + c);
            let edge = first + random::below(word, (end - first).min(65_536) as u32) as usize;
            let score = score(row, s, edge);
            if has_room(plan, s, clearance, edge) && best.is_none_or(|(b, _)| score > b) {
                best = Some((score, edge));
            }
        }
        winners.extend(best.map(|(_, edge)| edge));
    }
    split(plan, time, row, s, &winners);
    (wanted - winners.len()) as u32
}

/// Runs of edges with equal parts of the growth.
struct Runs {
    count: usize,
    edges: usize,
    /// Sum of the weights of the edges before each edge; empty if all edges have the same weight.
    before: Vec<u32>,
    /// Sum of all weights.
    total: usize,
}

impl Runs {
    fn new(plan: &Plan, time: i64, s: &InnerLoop, count: usize) -> Self {
        let (edges, mut before, mut total) = (s.len(), Vec::new(), 0);
        if let Some(weights) = Weights::new(plan, time) {
            for edge in 0..edges {
                before.push(total);
                total += weights.of(s, edge);
            }
        }
        let total = if before.is_empty() { edges } else { total as usize };
        Self { count, edges, before, total }
    }

    /// Index of the first edge of a run, or the number of edges for the end of the last run. A run
    /// without edges begins where the next run does.
    fn first(&self, run: usize) -> usize {
        let bound = run * self.total / self.count;
        if self.before.is_empty() {
            bound
        } else if run == self.count {
            self.edges
        } else {
            self.before.partition_point(|&sum| (sum as usize) < bound)
        }
    }
}

/// Weights of edges in growth.
struct Weights<'a> {
    row: &'a StepRow,
    around: Option<Around<'a>>,
}

impl<'a> Weights<'a> {
    /// Weights at step `time`; `None` if all edges have the same weight.
    fn new(plan: &'a Plan, time: i64) -> Option<Self> {
        let (row, around) = (plan.at(time), Around::new(plan, time));
        (around.is_some() || row.room != 0.0 || row.spare != 0.0).then_some(Self { row, around })
    }

    /// Weight of an edge. Weights are integers, so their sums are exact.
    fn of(&self, s: &InnerLoop, edge: usize) -> u32 {
        let around = self.around.as_ref().map_or(0.0, |around| around.rate([s.anchor_x[edge], s.anchor_y[edge]]));
        let excess = length(point(s, edge), point(s, edge + 1)) / self.row.edge - 1.0;
        let rate = libm::expf(around + self.row.room * excess) * (1.0 - self.row.spare * s.cleft[edge]);
        (WEIGHT * rate + 0.5).clamp(1.0, HEAVIEST) as u32
    }
}

fn point(s: &InnerLoop, i: usize) -> [f32; 2] {
    let i = i % s.len();
    [s.x[i], s.y[i]]
}

fn length(a: [f32; 2], b: [f32; 2]) -> f32 {
    ((b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1])).sqrt()
}

fn has_room(plan: &Plan, s: &InnerLoop, clearance: &[f32], edge: usize) -> bool {
    let least = ROOM * plan.clearance;
    let next = (edge + 1) % s.len();
    let free = |i: usize| clearance.get(i).is_none_or(|&c| c >= least);
    free(edge) && free(next) && length(point(s, edge), point(s, next)) >= least
}

/// Length in units of the rest length, plus the weighted sharpness of the fold tip at the edge.
fn score(row: &StepRow, s: &InnerLoop, edge: usize) -> f32 {
    let n = s.len();
    let (a, b) = (point(s, edge), point(s, edge + 1));
    let (before, after) = (point(s, edge + n - SPAN), point(s, edge + 1 + SPAN));
    let (t0, t1) = ([a[0] - before[0], a[1] - before[1]], [after[0] - b[0], after[1] - b[1]]);
    let lengths = (length(before, a) * length(b, after)).max(1e-12);
    let cross = (t0[0] * t1[1] - t0[1] * t1[0]) / lengths;
    let dot = (t0[0] * t1[0] + t0[1] * t1[1]) / lengths;
    // The loop runs counter-clockwise around the lumen, so it turns right around the tip of a fold.
    let tip = if cross < 0.0 { 1.0 - dot } else { 0.0 };
    length(a, b) / row.edge + row.tip_weight * tip
}

/// Splits the edges `winners`, in ascending order.
fn split(plan: &Plan, time: i64, row: &StepRow, s: &mut InnerLoop, winners: &[usize]) {
    let (n, region) = (s.len(), plan.region(time));
    let mut grown = InnerLoop { next_id: s.next_id, ..InnerLoop::default() };
    let mut winners = winners.iter().peekable();
    for i in 0..n {
        grown.push(s.id[i], s.fields().map(|field| field[i]));
        if winners.next_if(|&&winner| winner == i).is_some() {
            let (old, new, j) = (grown.len() - 1, grown.len(), (i + 1) % n);
            grown.push(grown.next_id, s.fields().map(|field| 0.5 * (field[i] + field[j])));
            let anchor = if plan.clefts.is_empty() {
                region.nearest([grown.x[new], grown.y[new]], row)
            } else {
                mean_anchor([grown.anchor_x[new], grown.anchor_y[new]])
            };
            (grown.rest[old], grown.rest[new]) = (0.5 * s.rest[i], 0.5 * s.rest[i]);
            (grown.anchor_x[new], grown.anchor_y[new]) = (anchor[0], anchor[1]);
            grown.sign[new] = contortion_sign(plan, grown.next_id);
            grown.next_id += 1;
        }
    }
    *s = grown;
}

/// Splits edges of the outer loop up to the target of the row. The loop is divided into as many
/// equal runs as particles are missing, and the longest edge of each run is split.
pub(super) fn grow_outer(row: &StepRow, s: &mut OuterLoop) {
    let n = s.len();
    let wanted = (row.outer_target as usize).saturating_sub(n).min(n);
    for run in (0..wanted).rev() {
        let (first, end) = (run * n / wanted, (run + 1) * n / wanted);
        let edge_length = |i: usize| length(s.p[i], s.p[(i + 1) % n]);
        let longest = (first..end).fold(first, |best, i| if edge_length(i) > edge_length(best) { i } else { best });
        let (a, b) = (s.p[longest], s.p[(longest + 1) % n]);
        let (va, vb) = (s.v[longest], s.v[(longest + 1) % n]);
        let middle = |a: [f32; 2], b: [f32; 2]| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        let id = (n + wanted - 1 - run) as u32;
        s.id.insert(longest + 1, id);
        s.p.insert(longest + 1, middle(a, b));
        s.v.insert(longest + 1, middle(va, vb));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_equal_weight_cover_all_edges_once() {
        let weights = |i: usize| 1 + (i * 7919 % 255) as u32;
        for (edges, count) in [(1, 1), (10, 10), (100, 7), (1000, 400)] {
            let before: Vec<u32> = (0..edges).map(|i| (0..i).map(weights).sum()).collect();
            let total: u32 = (0..edges).map(weights).sum();
            let runs = Runs { count, edges, before, total: total as usize };
            assert_eq!((runs.first(0), runs.first(count)), (0, edges));
            for run in 0..count {
                let (first, end) = (runs.first(run), runs.first(run + 1));
                assert!(first <= end);
                let weight: u32 = (first..end).map(weights).sum();
                let even = f64::from(total) / count as f64;
                assert!((f64::from(weight) - even).abs() <= 256.0, "run {run} of {count}: {weight}, not about {even}");
            }
        }
    }
}
