//! The search for a wide and short way from gate to gate.

use super::clearance::Walls;
use super::gates::{Gate, Gates};
use super::point::{Bend, P3, divided, length, minus};
use crate::model::WallRows;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};

/// Half width of a gate at which a way costs twice its length, µm.
const NARROW_UM: f64 = 30.0;
/// Length of the pieces of lines that are bent, µm.
const PIECE_UM: f64 = 100.0;
const LEAST_HALF_WIDTH_UM: f64 = 0.1;
/// Number of intervals between heights with gates.
const LEVELS: usize = 80;
/// Maximum number of searches. Each leaves out the steps that were blocked in those before.
const SEARCHES: usize = 100;

/// A height with its gates, and how each gate continues up to the next such height.
struct Level {
    at: Height,
    gates: Gates,
    middles: Vec<P3>,
    half_widths: Vec<f64>,
    /// Middle of each gate at the next level.
    tops: Vec<P3>,
    /// Cost of the way of each gate up to the next level, and the gate there.
    climbs: Vec<(f64, Gate)>,
}

/// A row, or a place between it and the next one.
#[derive(Clone, Copy, Debug)]
struct Height {
    row: usize,
    /// From 0 at the row to 1 at the next one.
    t: f64,
}

/// A way between neighbouring gates of a level, or up to a gate of the next level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Step {
    level: u32,
    from: u32,
    to: u32,
    is_up: bool,
}

/// Rows of the inner wall, with positions in the straight tube and on the surface.
pub(super) struct Lumen<'a> {
    pub(super) rows: &'a WallRows,
    pub(super) straight: &'a [[f32; 3]],
    pub(super) positions_um: &'a [P3],
    pub(super) bend: Option<Bend<'a>>,
}

impl Lumen<'_> {
    fn middle(&self, at: Height, gate: Gate) -> P3 {
        let [a, b] = self.ends(at, gate);
        [0, 1, 2].map(|k| 0.5 * (a[k] + b[k]))
    }

    fn half_width(&self, at: Height, gate: Gate) -> f64 {
        let [a, b] = self.ends(at, gate);
        0.5 * length(minus(b, a))
    }

    fn ends(&self, at: Height, gate: Gate) -> [P3; 2] {
        gate.map(|i| self.between(at, i, |vertex| self.positions_um[vertex as usize]))
    }

    /// Value of a column at a height, from its values at vertices.
    fn between<const N: usize>(&self, at: Height, i: u32, value: impl Fn(u32) -> [f64; N]) -> [f64; N] {
        let here = value(self.rows.row(at.row).vertices[i as usize]);
        if at.t == 0.0 {
            return here;
        }
        let [next] = self.above(at.row, [i]);
        let next = value(self.rows.row(at.row + 1).vertices[next as usize]);
        std::array::from_fn(|k| here[k] + at.t * (next[k] - here[k]))
    }

    /// Heights after one up to another one, at which lines may turn, with a gate at each.
    fn upwards(&self, from: Height, to: Height, gate: Gate) -> Vec<(Height, Gate)> {
        let mut found = Vec::with_capacity(to.row - from.row + 1);
        let mut gate = gate;
        for row in from.row..to.row {
            gate = self.above(row, gate);
            found.push((Height { row: row + 1, t: 0.0 }, gate));
        }
        if to.t > 0.0 {
            found.push((to, gate));
        }
        found
    }

    fn bent(&self, point: P3) -> P3 {
        self.bend.map_or(point, |bend| bend(point))
    }

    /// Indices of the same columns in the next row.
    fn above<const N: usize>(&self, row: usize, indices: [u32; N]) -> [u32; N] {
        let (here, next) = (self.rows.row(row).columns, self.rows.row(row + 1).columns);
        indices.map(|i| next.partition_point(|&column| column < here[i as usize]) as u32)
    }
}

fn narrowness(half_width: f64) -> f64 {
    let narrow = NARROW_UM / half_width.max(LEAST_HALF_WIDTH_UM);
    1.0 + narrow * narrow
}

/// Points of a way from the first row to the last one. If there is none, the row up to which ways
/// lead.
pub(super) fn points(lumen: &Lumen<'_>, walls: &Walls<'_>) -> Result<Vec<P3>, usize> {
    let levels = levels(lumen);
    if levels.iter().any(|level| level.middles.is_empty()) || levels.len() < 2 {
        return Err(0);
    }
    let mut blocked: HashSet<Step> = HashSet::new();
    let mut last = 0;
    for _ in 0..SEARCHES {
        let (first, steps) = cheapest(&levels, &blocked).map_err(|level| levels[level].at.row)?;
        let tested: Vec<Step> = (steps.par_iter().copied())
            .filter(|step| !line(lumen, &levels, step).windows(2).all(|pair| walls.is_free(pair[0], pair[1])))
            .collect();
        if tested.is_empty() {
            let mut points = vec![lumen.bent(levels[0].middles[first as usize])];
            for step in steps {
                points.extend(&line(lumen, &levels, &step)[1..]);
            }
            return Ok(points);
        }
        last = levels[tested[0].level as usize].at.row;
        blocked.extend(tested);
    }
    Err(last)
}

fn levels(lumen: &Lumen<'_>) -> Vec<Level> {
    let last = lumen.rows.len() - 1;
    let heights: Vec<Height> = (0..=LEVELS)
        .map(|k| {
            let (row, rest) = (k * last / LEVELS, k * last % LEVELS);
            // Between rows only if there are fewer rows than levels.
            Height { row, t: if last < LEVELS { rest as f64 / LEVELS as f64 } else { 0.0 } }
        })
        .collect();
    let gates_at = |&at: &Height| {
        let count = lumen.rows.row(at.row).len() as u32;
        let straight = |vertex: u32| lumen.straight[vertex as usize].map(f64::from);
        let contour: Vec<[f32; 2]> =
            (0..count).map(|i| lumen.between(at, i, straight)).map(|[x, y, _]| [x as f32, y as f32]).collect();
        // Rounding between rows may spoil a contour; its level is left out.
        Some((at, Gates::of(&contour).ok()?))
    };
    let found: Vec<(Height, Gates)> = heights.par_iter().filter_map(gates_at).collect();
    let tops: Vec<Height> = found.iter().skip(1).chain(found.last()).map(|(at, _)| *at).collect();
    let level = |((at, gates), top): ((Height, Gates), Height)| {
        let climb = |&gate: &Gate| {
            let (mut cost, mut from, mut last) = (0.0, lumen.middle(at, gate), gate);
            for (height, gate) in lumen.upwards(at, top, gate) {
                let next = lumen.middle(height, gate);
                cost += length(minus(next, from)) * narrowness(lumen.half_width(height, gate));
                (from, last) = (next, gate);
            }
            (cost, last)
        };
        let climbs: Vec<(f64, Gate)> = gates.gates.iter().map(climb).collect();
        Level {
            at,
            tops: climbs.iter().map(|&(_, gate)| lumen.middle(top, gate)).collect(),
            middles: gates.gates.iter().map(|&gate| lumen.middle(at, gate)).collect(),
            half_widths: gates.gates.iter().map(|&gate| lumen.half_width(at, gate)).collect(),
            climbs,
            gates,
        }
    };
    found.into_par_iter().zip(tops).map(level).collect()
}

/// The first gate and the steps of the way of least cost. If there is none, the last level that can
/// be reached.
fn cheapest(levels: &[Level], blocked: &HashSet<Step>) -> Result<(u32, Vec<Step>), usize> {
    let mut costs: Vec<f64> =
        levels[0].half_widths.iter().map(|&half_width| NARROW_UM * narrowness(half_width)).collect();
    let mut from: Vec<Vec<Option<Step>>> = Vec::with_capacity(levels.len());
    let mut back = vec![None; costs.len()];
    for (k, level) in levels.iter().enumerate() {
        spread(k, level, blocked, &mut costs, &mut back);
        from.push(back);
        let Some(next) = levels.get(k + 1) else { break };
        let mut next_costs = vec![f64::INFINITY; next.middles.len()];
        let mut next_back = vec![None; next.middles.len()];
        for (gate, &(climb, above)) in level.climbs.iter().enumerate().filter(|(gate, _)| costs[*gate].is_finite()) {
            let begin = level.tops[gate];
            for &to in above.iter().flat_map(|&vertex| &next.gates.at[vertex as usize]) {
                let step = Step { level: k as u32, from: gate as u32, to, is_up: true };
                let aside = length(minus(next.middles[to as usize], begin)) * narrowness(next.half_widths[to as usize]);
                let cost = costs[gate] + climb + aside;
                if cost < next_costs[to as usize] && !blocked.contains(&step) {
                    (next_costs[to as usize], next_back[to as usize]) = (cost, Some(step));
                }
            }
        }
        if next_costs.iter().all(|cost| cost.is_infinite()) {
            return Err(k);
        }
        (costs, back) = (next_costs, next_back);
    }
    let last = (0..costs.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b])).unwrap_or(0);
    let (mut level, mut gate, mut steps) = (levels.len() - 1, last as u32, Vec::new());
    while let Some(step) = from[level][gate as usize] {
        steps.push(step);
        (level, gate) = (step.level as usize, step.from);
    }
    steps.reverse();
    Ok((gate, steps))
}

/// Spreads costs from gate to gate of a level (Dijkstra).
fn spread(k: usize, level: &Level, blocked: &HashSet<Step>, costs: &mut [f64], back: &mut [Option<Step>]) {
    // The bits of positive numbers are ordered like the numbers.
    let mut open: BinaryHeap<Reverse<(u64, u32)>> = (costs.iter().zip(0..))
        .filter(|(cost, _)| cost.is_finite())
        .map(|(cost, gate)| Reverse((cost.to_bits(), gate)))
        .collect();
    while let Some(Reverse((cost, gate))) = open.pop() {
        let cost = f64::from_bits(cost);
        if cost > costs[gate as usize] {
            continue;
        }
        for &to in &level.gates.beside[gate as usize] {
            let [a, b] = [gate, to].map(|gate| gate as usize);
            let narrow = narrowness(0.5 * (level.half_widths[a] + level.half_widths[b]));
            let next = cost + length(minus(level.middles[b], level.middles[a])) * narrow;
            let step = Step { level: k as u32, from: gate, to, is_up: false };
            if next < costs[b] && !blocked.contains(&step) {
                (costs[b], back[b]) = (next, Some(step));
                open.push(Reverse((next.to_bits(), to)));
            }
        }
    }
}

/// Points of a step in the model, with both ends.
fn line(lumen: &Lumen<'_>, levels: &[Level], step: &Step) -> Vec<P3> {
    let points = straight_line(lumen, levels, step);
    match lumen.bend {
        Some(bend) => divided(&points, PIECE_UM).into_iter().map(bend).collect(),
        None => points,
    }
}

fn straight_line(lumen: &Lumen<'_>, levels: &[Level], step: &Step) -> Vec<P3> {
    let level = &levels[step.level as usize];
    let mut points = vec![level.middles[step.from as usize]];
    if !step.is_up {
        points.push(level.middles[step.to as usize]);
        return points;
    }
    let next = &levels[step.level as usize + 1];
    let gate = level.gates.gates[step.from as usize];
    points.extend(lumen.upwards(level.at, next.at, gate).into_iter().map(|(height, gate)| lumen.middle(height, gate)));
    points.push(next.middles[step.to as usize]);
    points
}
