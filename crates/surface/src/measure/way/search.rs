//! The search for a wide and short way from gate to gate.

use super::clearance::Walls;
use super::gates::{Gate, Gates};
use super::{P3, length, minus};
use crate::model::WallRows;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};

/// Half width of a gate at which a way costs twice its length, µm.
const NARROW_UM: f64 = 30.0;
const LEAST_HALF_WIDTH_UM: f64 = 0.1;
/// Maximum number of intervals between rows with gates.
const LEVELS: usize = 80;
/// Maximum number of searches. Each leaves out the steps that were blocked in those before.
const SEARCHES: usize = 100;

/// A row with its gates, and how each gate continues up to the next such row.
struct Level {
    row: usize,
    gates: Gates,
    middles: Vec<P3>,
    half_widths: Vec<f64>,
    /// Middle of each gate at the next level.
    tops: Vec<P3>,
    /// Cost of the way of each gate up to the next level, and the gate there.
    climbs: Vec<(f64, Gate)>,
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
}

impl Lumen<'_> {
    fn middle(&self, row: usize, gate: Gate) -> P3 {
        let [a, b] = self.ends(row, gate);
        [0, 1, 2].map(|k| 0.5 * (a[k] + b[k]))
    }

    fn half_width(&self, row: usize, gate: Gate) -> f64 {
        let [a, b] = self.ends(row, gate);
        0.5 * length(minus(b, a))
    }

    fn ends(&self, row: usize, gate: Gate) -> [P3; 2] {
        let vertices = self.rows.row(row).vertices;
        gate.map(|i| self.positions_um[vertices[i as usize] as usize])
    }

    /// The gate of the same columns in the next row.
    fn above(&self, row: usize, gate: Gate) -> Gate {
        let (here, next) = (self.rows.row(row).columns, self.rows.row(row + 1).columns);
        gate.map(|i| next.partition_point(|&column| column < here[i as usize]) as u32)
    }
}

fn narrowness(half_width: f64) -> f64 {
    let narrow = NARROW_UM / half_width.max(LEAST_HALF_WIDTH_UM);
    1.0 + narrow * narrow
}

/// Points of a way from the first row to the last one. If there is none, the row up to which ways
/// lead.
pub(super) fn points(lumen: &Lumen<'_>, walls: &Walls<'_>) -> Result<Vec<P3>, usize> {
    let levels = levels(lumen)?;
    let mut blocked: HashSet<Step> = HashSet::new();
    for _ in 0..SEARCHES {
        let (first, steps) = cheapest(&levels, &blocked).map_err(|level| levels[level].row)?;
        let tested: Vec<Step> = (steps.par_iter().copied())
            .filter(|step| !line(lumen, &levels, step).windows(2).all(|pair| walls.is_free(pair[0], pair[1])))
            .collect();
        if tested.is_empty() {
            let mut points = vec![levels[0].middles[first as usize]];
            for step in steps {
                points.extend(&line(lumen, &levels, &step)[1..]);
            }
            return Ok(points);
        }
        blocked.extend(tested);
    }
    Err(0)
}

fn levels(lumen: &Lumen<'_>) -> Result<Vec<Level>, usize> {
    let last = lumen.rows.len() - 1;
    let count = LEVELS.min(last);
    let rows: Vec<usize> = (0..=count).map(|k| k * last / count).collect();
    let level = |k: usize| {
        let row = rows[k];
        let in_section = |&v: &u32| [0, 1].map(|axis| lumen.straight[v as usize][axis]);
        let contour: Vec<[f32; 2]> = lumen.rows.row(row).vertices.iter().map(in_section).collect();
        let gates = Gates::of(&contour).map_err(|_| row)?;
        let climb = |&gate: &Gate| {
            let (mut cost, mut gate, mut at) = (0.0, gate, lumen.middle(row, gate));
            for row in row..*rows.get(k + 1).unwrap_or(&row) {
                gate = lumen.above(row, gate);
                let next = lumen.middle(row + 1, gate);
                cost += length(minus(next, at)) * narrowness(lumen.half_width(row + 1, gate));
                at = next;
            }
            (cost, gate)
        };
        let climbs: Vec<(f64, Gate)> = gates.gates.iter().map(climb).collect();
        let top = *rows.get(k + 1).unwrap_or(&row);
        Ok(Level {
            row,
            tops: climbs.iter().map(|&(_, gate)| lumen.middle(top, gate)).collect(),
            middles: gates.gates.iter().map(|&gate| lumen.middle(row, gate)).collect(),
            half_widths: gates.gates.iter().map(|&gate| lumen.half_width(row, gate)).collect(),
            climbs,
            gates,
        })
    };
    (0..rows.len()).into_par_iter().map(level).collect()
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

/// Points of a step, with both ends.
fn line(lumen: &Lumen<'_>, levels: &[Level], step: &Step) -> Vec<P3> {
    let level = &levels[step.level as usize];
    let mut points = vec![level.middles[step.from as usize]];
    if !step.is_up {
        points.push(level.middles[step.to as usize]);
        return points;
    }
    let next = &levels[step.level as usize + 1];
    let mut gate = level.gates.gates[step.from as usize];
    for row in level.row..next.row {
        gate = lumen.above(row, gate);
        points.push(lumen.middle(row + 1, gate));
    }
    points.push(next.middles[step.to as usize]);
    points
}
